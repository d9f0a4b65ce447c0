"""What a command ends with: the exit codes, and the errors that mean wrong input."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from enum import IntEnum


class ExitCode(IntEnum):
    """Exit codes that people and scripts rely on."""

    DONE = 0
    BAD_INPUT = 2
    NO_PLAN = 3
    WALK_FAILED = 4
    INTERRUPTED = 130


class InputError(Exception):
    """Something the person gave is wrong: the message names it and says what would be right.

    Not a ValueError, so that nothing between here and the command line takes it for one.
    """


@contextlib.contextmanager
def as_bad_input(*kinds: type[Exception]) -> Iterator[None]:
    """Turns errors of these kinds, raised inside, into an InputError of the same message.

    Name the narrowest kinds that wrong input raises: a ValueError out of a fault in the program
    must stay a traceback.
    """
    try:
        yield
    except kinds as error:
        raise InputError(str(error)) from error


def one_line(message: object) -> str:
    """The message with every run of white space, line ends included, made one blank."""
    return " ".join(str(message).split())
