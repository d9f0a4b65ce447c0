"""The command line: finds the command, reads its options, runs it, and gives the exit code."""

from __future__ import annotations

import contextlib
import importlib
import os
import sys
import typing
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from app.output import ExitCode, InputError, one_line

PROGRAM = "python main.py"


@dataclass(frozen=True)
class Command:
    """One command, by name only: its module is imported when the command is asked for.

    Attributes:
        run: `module:function`; the function takes a dataclass, whose fields are the options and
            whose docstring heads the help, and returns the exit code.
        summary: One line for the list of commands.
        example: A command line that works, without `python main.py`.
        draws: Whether it may draw the robot. It then settles the GL library itself, before it
            imports MuJoCo (`prepare_gl` in sim/gl.py); for others rendering is off.
    """

    run: str
    summary: str
    example: str
    draws: bool = False

    def load_run(self) -> Callable[[Any], int]:
        """The function that carries the command out."""
        module, _, name = self.run.partition(":")
        run: Callable[[Any], int] = getattr(importlib.import_module(module), name)
        return run

    def load_options(self) -> type[Any]:
        """The dataclass of the options."""
        options: type[Any] = typing.get_type_hints(self.load_run())["options"]
        return options


COMMANDS: Mapping[str, Command] = MappingProxyType(
    {
        "dataset": Command(
            "app.commands.dataset:run",
            "plan footsteps to many random goals: a corpus to train on",
            "dataset --count 1000 --out runs/corpus",
        ),
        "dataset check": Command(
            "app.commands.dataset:run_check",
            "check every step of a corpus by independent geometry",
            "dataset check runs/corpus",
        ),
        "evaluate": Command(
            "app.commands.evaluate:run",
            "measure how well a policy walks, as one report with figures",
            "evaluate --robot jvrc1 --out runs/evaluate",
        ),
        "export": Command(
            "app.commands.export:run",
            "write a policy as one ONNX file for other programs",
            "export --robot jvrc1 --out policy.onnx",
        ),
        "navigate": Command(
            "app.commands.navigate:run",
            "plan, walk the plan in MuJoCo with the trained policy, report",
            "navigate --map maps/room.png --goal 2,1,1.57",
            draws=True,
        ),
        "plan": Command(
            "app.commands.plan:run",
            "plan footsteps from a start to a goal on a map",
            "plan --map maps/room.png --goal 2,1,1.57 --image plan.png",
        ),
        "serve": Command(
            "app.commands.serve:run",
            "open a web page: click a goal and watch the robot walk there",
            "serve --map maps/room.png",
        ),
        "train": Command(
            "app.commands.train:run",
            "train the policy that walks",
            "train --robot jvrc1 --out runs/train",
        ),
        "trials": Command(
            "app.commands.trials:run",
            "walk many random pairs of start and goal on a map",
            "trials --map maps/room.png --count 100",
        ),
    }
)


def main(arguments: Sequence[str], program: str = PROGRAM) -> int:
    """Runs the command line and returns the exit code; `program` is how it was called.

    Wrong input and Ctrl-C end in one line on standard error. Anything else that is raised is a
    fault of the program and keeps its traceback.
    """
    try:
        with _warnings_in_one_line():
            code = _dispatch(list(arguments), program)
            sys.stdout.flush()
            return code
    except InputError as error:
        # One line, but for a map without its YAML: that message shows the lines to write.
        print(f"error: {error}", file=sys.stderr)
        return ExitCode.BAD_INPUT
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return ExitCode.INTERRUPTED
    except BrokenPipeError:
        # The reader of our output (head, say) has left. Standard output must not be flushed
        # again at exit: give it a place where that succeeds.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return ExitCode.DONE


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
    if name not in COMMANDS:
        raise InputError(f"there is no command {name!r}; the commands are {', '.join(COMMANDS)}")
    if f"{name} {' '.join(rest[:1])}" in COMMANDS:
        name, rest = f"{name} {rest[0]}", rest[1:]
    command = COMMANDS[name]

    # Here and not above: reading options costs an import that the overview does without.
    from app.options import parse_options

    options = parse_options(
        command.load_options(),
        rest,
        program=f"{program} {name}",
        example=f"{program} {command.example}",
    )
    if not command.draws:
        from sim.gl import switch_gl_off

        switch_gl_off()
    return command.load_run()(options)


@contextlib.contextmanager
def _warnings_in_one_line() -> Iterator[None]:
    """Shows each warning meant for people as one line, without the source line it came from.

    Those are UserWarning and its kin; what else there is speaks to programmers, and the tests
    show it.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = lambda message, *_args, **_kwargs: print(
            f"warning: {one_line(message)}", file=sys.stderr
        )
        yield
