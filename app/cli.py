"""The command line: finds the command, reads its options, runs it, and gives the exit code."""

from __future__ import annotations

import contextlib
import os
import sys
import warnings
from collections.abc import Iterator, Sequence

from app.command_table import COMMANDS
from app.output import ExitCode, InputError, one_line

PROGRAM = "python main.py"


def main(arguments: Sequence[str]) -> int:
    """Runs the command line and returns the exit code.

    Wrong input and Ctrl-C end in one line on standard error. Anything else that is raised is a
    fault of the program and keeps its traceback.
    """
    try:
        with _warnings_in_one_line():
            code = _dispatch(list(arguments))
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


def overview() -> str:
    """The help of the program as a whole."""
    width = max(map(len, COMMANDS))
    lines = [f"usage: {PROGRAM} COMMAND [OPTIONS]", ""]
    lines += ["A humanoid robot that walks to where it is told, on a map.", "", "commands:"]
    lines += [f"  {name:<{width}}  {command.summary}" for name, command in COMMANDS.items()]
    lines += ["", f"example: {PROGRAM} {COMMANDS['navigate'].example}"]
    lines += [f"options of a command: {PROGRAM} COMMAND --help"]
    return "\n".join(lines)


def _dispatch(arguments: list[str]) -> int:
    if not arguments:
        raise InputError(f"no command given; the commands are {', '.join(COMMANDS)}")
    name, *rest = arguments
    if name in ("-h", "--help", "help"):
        print(overview())
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
        program=f"{PROGRAM} {name}",
        example=f"{PROGRAM} {command.example}",
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
