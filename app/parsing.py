"""From command-line words to a dataclass of options, with one clear line for what is wrong."""

from __future__ import annotations

import dataclasses
import difflib
import inspect
from collections.abc import Sequence
from typing import Any, TypeVar

import tyro

# A hook that tyro does not promise to keep: pyproject.toml pins the version it belongs to, and
# tests/test_cli.py covers every kind of mistake that comes through it.
from tyro import _errors as tyro_errors

from app.errors import InputError

Options = TypeVar("Options")


def parse_options(
    kind: type[Options], words: Sequence[str], *, program: str, example: str
) -> Options:
    """The options that the words give.

    Args:
        kind: Dataclass of the options; field `time_limit` is read from `--time-limit`.
        words: The words after the command.
        program: What was typed up to and including the command; stands in the help.
        example: A whole command line for the help.

    Raises:
        InputError: An option is unknown, missing, or has a wrong value.
        SystemExit: With code 0, after the help was asked for and printed.
    """

    def complain(event: tyro_errors.ParseErrorEvent) -> None:
        raise InputError(_message(event, kind, program))

    description = f"{inspect.cleandoc(kind.__doc__ or '')}\n\nexample:\n  {example}"
    on = {f"--{name}" for name in _switches_on(kind)}
    with tyro_errors.on_parse_error(complain):
        return tyro.cli(
            kind,
            prog=program,
            description=description,
            # tyro knows such a switch by the name that turns it off only.
            args=[word for word in words if word not in on],
            config=(tyro.conf.FlagCreatePairsOff,),
        )


def _switches_on(kind: type[Any]) -> set[str]:
    """Names of the switches that are on unless turned off."""
    fields = dataclasses.fields(kind)
    return {field.name.replace("_", "-") for field in fields if field.default is True}


def _message(event: tyro_errors.ParseErrorEvent, kind: type[Any], program: str) -> str:
    """What is wrong and what would be right, for one mistake that tyro found."""
    help_line = f"'{program} --help' shows the options"
    if isinstance(event, tyro_errors.UnrecognizedArgs):
        return f"{_unknown(event.tokens[0], kind)}; {help_line}"
    if isinstance(event, tyro_errors.MissingArgs):
        # A mistyped name makes the right one missing too: the mistyped one is the better news.
        if event.unrecognized_tokens:
            return f"{_unknown(event.unrecognized_tokens[0], kind)}; {help_line}"
        names = ", ".join(_name_and_value(missing.arg) for missing in event.missing_arguments)
        return f"{names} must be given; {help_line}"
    if isinstance(event, tyro_errors.BadValue):
        return f"{_name_and_value(event.argument)} was given no value; {help_line}"
    if isinstance(event, tyro_errors.InvalidChoice):
        choices = ", ".join(event.choices)
        return f"{_name(event.argument)}: {event.value!r} is not one of {choices}"
    if isinstance(event, tyro_errors.InstantiationFailure) and event.argument is not None:
        return f"{_name(event.argument)}: {event.message}"
    return f"{getattr(event, 'message', 'the options do not go together')}; {help_line}"


def _unknown(word: str, kind: type[Any]) -> str:
    if not word.startswith("-"):
        return f"{word!r} belongs to no option"
    name = word.partition("=")[0]
    known = [f"--{field.name.replace('_', '-')}" for field in dataclasses.fields(kind)]
    known += [f"--no-{name}" for name in _switches_on(kind)]
    near = difflib.get_close_matches(name, known, n=1)
    return f"there is no option {name}" + (f"; did you mean {near[0]}?" if near else "")


def _name(argument: Any) -> str:
    return str(argument.lowered.name_or_flags[-1])


def _name_and_value(argument: Any) -> str:
    if argument.is_positional():
        return str(argument.lowered.metavar)
    return f"{_name(argument)} {argument.lowered.metavar or ''}".strip()
