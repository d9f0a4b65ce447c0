"""The command line: finds the command, reads its options, runs it, and gives the exit code."""

from __future__ import annotations

import contextlib
import errno
import gc
import importlib
import os
import signal
import sys
import threading
import typing
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from app.output import ExitCode, InputError, one_line, release_folders, told_by_one_rank
from maps.yaml_files import YamlFileError

PROGRAM = "python main.py"
# Loading and compiling make objects by the hundred thousand that stay; to look through them for
# garbage as often as Python does by itself took a tenth of the time of loading.
_COLLECTED_EVERY = 50_000, 20, 20
# What the system says of a full disk, and of a path that it refuses whatever is done with it.
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_REFUSED = {
    *(errno.ENAMETOOLONG, errno.ELOOP, errno.EACCES, errno.EPERM, errno.EROFS),
    *(errno.EMFILE, errno.ENFILE, errno.EIO),
}


@dataclass(frozen=True)
class Command:
    """One command as the list of commands tells of it; `load_run` imports what it does.

    Attributes:
        summary: One line for the list of commands.
        example: A command line that works, without `python main.py`.
        draws: Whether it may draw the robot. It then settles the GL library itself, before it
            imports MuJoCo (`prepare_gl` in sim/gl.py); for others rendering is off.
    """

    summary: str
    example: str
    draws: bool = False


COMMANDS: Mapping[str, Command] = MappingProxyType(
    {
        "compare": Command(
            "compare a robot's log with the simulator, joint by joint",
            "compare log.csv --robot jvrc1",
        ),
        "dataset": Command(
            "plan footsteps to many random goals: a corpus to train on",
            "dataset --count 1000 --out runs/corpus",
        ),
        "dataset check": Command(
            "check every step of a corpus by independent geometry",
            "dataset check runs/corpus",
        ),
        "evaluate": Command(
            "measure how well a policy walks, as one report with figures",
            "evaluate --robot jvrc1 --out runs/evaluate",
        ),
        "export": Command(
            "write a policy as one ONNX file for other programs",
            "export --robot jvrc1 --out policy.onnx",
        ),
        "navigate": Command(
            "plan, walk the plan in MuJoCo with the trained policy, report",
            "navigate --map maps/room.png --goal 2,1,1.57",
            draws=True,
        ),
        "plan": Command(
            "plan footsteps from a start to a goal on a map",
            "plan --map maps/room.png --goal 2,1,1.57 --image plan.png",
        ),
        "ros1": Command(
            "be the ROS 1 node footstep_planner: services and topics that plan",
            "ros1 --robot jvrc1",
        ),
        "ros2": Command(
            "be a ROS 2 node: map and goal on topics, a robot that walks there",
            "ros2 --robot jvrc1",
        ),
        "robot check": Command(
            "check a robot: what is right, and which key mends what is wrong",
            "robot check jvrc1",
        ),
        "robot draft": Command(
            "draft a robot file from a URDF or an MJCF",
            "robot draft talos.urdf --out robots/talos",
        ),
        "serve": Command(
            "open a web page: click a goal and watch the robot walk there",
            "serve --map maps/room.png",
        ),
        "sweep": Command(
            "train many policies: every combination of seeds, rewards and robots",
            "sweep sweep.yaml --out runs/sweep",
        ),
        "train": Command(
            "train the policy that walks",
            "train --robot jvrc1 --out runs/train",
        ),
        "trials": Command(
            "walk many random pairs of start and goal on a map",
            "trials --map maps/room.png --count 100",
        ),
    }
)


def load_run(name: str) -> tuple[Callable[[Any], int], type[Any]]:
    """The function that carries a command out, and the dataclass of its options.

    `dataset check` is `run_check` in app/commands/dataset.py. It takes the dataclass, whose fields
    are the options and whose docstring heads the help, and returns the exit code.
    """
    module, *rest = name.split()
    run = getattr(importlib.import_module(f"app.commands.{module}"), "_".join(["run", *rest]))
    return run, typing.get_type_hints(run)["options"]


def main(arguments: Sequence[str], program: str = PROGRAM) -> int:
    """Runs the command line and returns the exit code; `program` is how it was called.

    Wrong input, Ctrl-C, SIGTERM and files that the system refuses end in one line on standard
    error. Anything else that is raised is a fault of the program and keeps its traceback.
    """
    _open_streams()
    gc.set_threshold(*_COLLECTED_EVERY)
    stops: list[type[KeyboardInterrupt]] = []
    try:
        with _warnings_in_one_line(), _stoppable(stops), contextlib.ExitStack() as at_end:
            at_end.callback(release_folders)
            code = _dispatch(list(arguments), program)
            sys.stdout.flush()
            return code
    except (InputError, YamlFileError) as error:
        # One line, but for a map without its YAML: that message shows the lines to write.
        told, colon, lines = str(error).partition(":\n")
        _tell(f"error: {one_line(told)}{colon}{lines}")
        return ExitCode.BAD_INPUT
    except KeyboardInterrupt as stop:
        return _stopped(type(stop))
    except BrokenPipeError:
        # The reader of our output (head, say) has left.
        _leave_output()
        return ExitCode.DONE
    except OSError as error:
        if error.errno in _FULL:
            where = one_line(error.filename or "standard output")
            _tell(f"error: cannot write {where}: {error.strerror}")
            _leave_output()
            return ExitCode.BAD_INPUT
        if stops:
            return _stopped(stops[0])
        if error.errno not in _REFUSED or error.filename is None:
            raise
        _tell(f"error: cannot use {one_line(error.filename)}: {error.strerror}")
        return ExitCode.BAD_INPUT
    except MemoryError:
        _tell(
            "error: not enough memory: the map is too large for this machine; look at its metres "
            "per pixel, or take a part of it or fewer workers"
        )
        return ExitCode.BAD_INPUT
    except Exception:
        # A library that is being imported makes an ImportError of what a signal raises in it.
        if stops:
            return _stopped(stops[0])
        raise


def _stopped(by: type[KeyboardInterrupt]) -> int:
    """Tells that a signal has stopped the command; the exit code."""
    is_term = issubclass(by, _Terminated)
    _tell("terminated" if is_term else "interrupted")
    return ExitCode.TERMINATED if is_term else ExitCode.INTERRUPTED


def _leave_output() -> None:
    """Gives what standard output still holds a place where flushing it at exit succeeds."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _open_streams() -> None:
    """Opens streams that were closed from the start, lest another file takes their place."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDWR), mode))


def _tell(line: str) -> None:
    """One line on standard error, where that can be written."""
    with contextlib.suppress(OSError):
        print(line, file=sys.stderr)


def overview(program: str = PROGRAM) -> str:
    """The help of the program as a whole."""
    width = max(map(len, COMMANDS))
    lines = [f"usage: {program} COMMAND [OPTIONS]", ""]
    lines += ["A humanoid robot that walks to where it is told, on a map.", "", "commands:"]
    lines += [f"  {name:<{width}}  {command.summary}" for name, command in COMMANDS.items()]
    lines += ["", f"example: {program} {COMMANDS['navigate'].example}"]
    lines += [f"options of a command: {program} COMMAND --help"]
    return "\n".join(lines)


def _dispatch(arguments: list[str], program: str) -> int:
    if not arguments:
        raise InputError(f"no command given; the commands are {', '.join(COMMANDS)}")
    name, *rest = arguments
    if name in ("-h", "--help", "help"):
        print(overview(program))
        return ExitCode.DONE
    if name == "--version":
        import importlib.metadata

        print(f"footfall {importlib.metadata.version('footfall-navigation')}")
        return ExitCode.DONE
    if f"{name} {' '.join(rest[:1])}" in COMMANDS:
        name, rest = f"{name} {rest[0]}", rest[1:]
    if name not in COMMANDS:
        import difflib

        near = difflib.get_close_matches(name, COMMANDS, n=1)
        guess = f"did you mean {near[0]}? " if near else ""
        raise InputError(
            f"there is no command {name!r}; {guess}the commands are {', '.join(COMMANDS)}"
        )
    command = COMMANDS[name]

    # Here and not above: reading options costs an import that the overview does without.
    from app.options import parse_options

    run, kind = load_run(name)
    with told_by_one_rank():
        options = parse_options(
            kind, rest, program=f"{program} {name}", example=f"{program} {command.example}"
        )
    if not command.draws:
        from sim.gl import switch_gl_off

        switch_gl_off()
    return run(options)


class _Terminated(KeyboardInterrupt):
    """SIGTERM: what Ctrl-C leaves in order is left in order then too."""


@contextlib.contextmanager
def _stoppable(stops: list[type[KeyboardInterrupt]]) -> Iterator[None]:
    """Lets SIGTERM raise `_Terminated` as Ctrl-C raises KeyboardInterrupt, and notes both.

    In the one thread that can be told of signals; where Ctrl-C is ignored it stays so.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(number: int, frame: object) -> None:
        stops.append(_Terminated if number == signal.SIGTERM else KeyboardInterrupt)
        raise stops[-1]

    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    signal.signal(signal.SIGTERM, stop)
    if before[signal.SIGINT] is signal.default_int_handler:
        signal.signal(signal.SIGINT, stop)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)


@contextlib.contextmanager
def _warnings_in_one_line() -> Iterator[None]:
    """Shows each warning meant for people as one line, without the source line it came from.

    Those are UserWarning and its kin; what else there is speaks to programmers, and the tests
    show it.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = lambda message, *_args, **_kwargs: _tell(
            f"warning: {one_line(message)}"
        )
        yield
