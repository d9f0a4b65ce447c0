"""The kinds of value that options take, each with its own reading and its own complaint.

Use them as `goal: PoseOption` or `epsilon: Annotated[float, number(at_least=1.0)] = 8.0`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import tyro
from tyro.constructors import PrimitiveConstructorSpec


class Pose(NamedTuple):
    """A pose on the floor, in the map frame; yaw is counter-clockwise."""

    x_m: float
    y_m: float
    yaw_rad: float


class Interval(NamedTuple):
    """A closed interval of numbers."""

    low: float
    high: float


class Reach(NamedTuple):
    """How far from a pose another one may be: between the points, and between the headings."""

    m: float
    rad: float


def parse_reach(text: str) -> Reach:
    """The reach written as `M,RAD`, metres and radians.

    Raises:
        ValueError: Not two finite numbers of at least 0 with a comma between them.
    """
    parts = text.split(",")
    try:
        values = [float(part) for part in parts]
    except ValueError:
        values = []
    if len(values) != 2 or not all(math.isfinite(value) and value >= 0 for value in values):
        raise ValueError(
            f"{text!r} is not a reach; write M,RAD in metres and radians, such as 0.05,0.1"
        )
    return Reach(*values)


def parse_interval(text: str) -> Interval:
    """The interval written as `LOW,HIGH`.

    Raises:
        ValueError: Not two finite numbers with a comma between them, the lower one first.
    """
    parts = text.split(",")
    try:
        values = [float(part) for part in parts]
    except ValueError:
        values = []
    if len(values) != 2 or not all(map(math.isfinite, values)) or values[0] > values[1]:
        raise ValueError(f"{text!r} is not a range; write LOW,HIGH, such as -1,1")
    return Interval(*values)


def parse_pose(text: str) -> Pose:
    """The pose written as `X,Y,YAW`, metres and radians.

    Raises:
        ValueError: Not three finite numbers with commas between them.
    """
    parts = text.split(",")
    try:
        values = [float(part) for part in parts]
    except ValueError:
        values = []
    if len(values) != 3 or not all(map(math.isfinite, values)):
        raise ValueError(
            f"{text!r} is not a pose; write X,Y,YAW in metres and radians, such as 2,1,1.57"
        )
    return Pose(*values)


def parse_poses(text: str) -> tuple[Pose, ...]:
    """Poses written one after another with colons between.

    Raises:
        ValueError: One of them is not a pose.
    """
    return tuple(parse_pose(part) for part in text.split(":"))


def number(
    *, at_least: float | None = None, above: float | None = None
) -> PrimitiveConstructorSpec[float]:
    """Reads a finite number within bounds, for `Annotated[float, ...]`."""
    return _number(float, "NUMBER", "a number", at_least=at_least, above=above)


def whole_number(*, at_least: int | None = None) -> PrimitiveConstructorSpec[int]:
    """Reads a whole number within bounds, for `Annotated[int, ...]`."""
    return _number(int, "COUNT", "a whole number", at_least=at_least, above=None)


def choice(*names: str) -> PrimitiveConstructorSpec[str]:
    """Reads one of the names, for `Annotated[str, ...]`."""

    def read(words: list[str]) -> str:
        if words[0] not in names:
            raise ValueError(f"{words[0]!r} is not one of {', '.join(names)}")
        return words[0]

    return _spec("|".join(names), read)


def some_of(*names: str) -> PrimitiveConstructorSpec[tuple[str, ...]]:
    """Reads some of the names with commas between, for `Annotated[tuple[str, ...], ...]`."""

    def read(words: list[str]) -> tuple[str, ...]:
        chosen = [word.strip() for word in words[0].split(",")]
        for word in chosen:
            if word not in names:
                raise ValueError(f"{word!r} is not one of {', '.join(names)}")
        return tuple(name for name in names if name in chosen)

    return _spec("NAME,NAME,...", read)


def text(metavar: str) -> PrimitiveConstructorSpec[str]:
    """Reads any text, for `Annotated[str, ...]`; the metavar stands for it in the help."""
    return _spec(metavar, lambda words: words[0])


def _number(
    kind: Callable[[str], Any],
    metavar: str,
    noun: str,
    *,
    at_least: float | None,
    above: float | None,
) -> PrimitiveConstructorSpec[Any]:
    wanted = noun
    if at_least is not None:
        wanted += f" of at least {at_least}"
    if above is not None:
        wanted += f" above {above}"

    def read(words: list[str]) -> Any:
        try:
            value = kind(words[0])
        except ValueError:
            value = math.nan
        # A comparison with nan is false, so each test names what is right, not what is wrong.
        large_enough = at_least is None or value >= at_least
        if not (math.isfinite(value) and large_enough and (above is None or value > above)):
            raise ValueError(f"{words[0]!r} is not {wanted}")
        return value

    return _spec(metavar, read)


def _show(value: object) -> list[str]:
    """A value as the help shows it and as it would be typed."""
    if value is None or value == ():
        return ["none"]
    if isinstance(value, (Pose, Interval, Reach)):
        return [",".join(f"{part:g}" for part in value)]
    if isinstance(value, tuple):
        return [",".join(map(str, value))]
    return [str(value)]


def _spec(metavar: str, read: Callable[[list[str]], Any]) -> PrimitiveConstructorSpec[Any]:
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=read,
        is_instance=lambda value: True,
        str_from_instance=_show,
    )


PoseOption = Annotated[Pose, _spec("X,Y,YAW", lambda words: parse_pose(words[0]))]
OptionalPose = Annotated[Pose | None, _spec("X,Y,YAW", lambda words: parse_pose(words[0]))]
PosesOption = Annotated[
    tuple[Pose, ...], _spec("X,Y,YAW:X,Y,YAW...", lambda words: parse_poses(words[0]))
]
OptionalInterval = Annotated[
    Interval | None, _spec("LOW,HIGH", lambda words: parse_interval(words[0]))
]
ReachOption = Annotated[Reach, _spec("M,RAD", lambda words: parse_reach(words[0]))]
OptionalLength = Annotated[float | None, number(above=0)]
OptionalTime = Annotated[float | None, number(above=0)]
FileOption = Annotated[Path, _spec("FILE", lambda words: Path(words[0]))]
OptionalFile = Annotated[Path | None, _spec("FILE", lambda words: Path(words[0]))]
FolderOption = Annotated[Path, _spec("DIR", lambda words: Path(words[0]))]
FolderArgument = Annotated[Path, _spec("DIR", lambda words: Path(words[0])), tyro.conf.Positional]
OptionalFolder = Annotated[Path | None, _spec("DIR", lambda words: Path(words[0]))]
