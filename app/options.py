"""Command-line options: the kinds of value, their parsing, and the options that commands share.

A field of a dataclass of options is `goal: PoseOption` or
`epsilon: Annotated[float, number(at_least=1.0)] = 8.0`.
"""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
import inspect
import math
import shutil
import textwrap
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Optional, TypeVar

import tyro

# A hook that tyro does not promise to keep: pyproject.toml pins the version it belongs to, and
# tests/test_cli.py covers every kind of mistake that comes through it.
from tyro import _errors as tyro_errors
from tyro.constructors import PrimitiveConstructorSpec

from app.output import InputError, as_bad_input, say
from controller.gait import PACES
from controller.policy import PolicyError, load_policy
from controller.tracking_limits import with_tracking_limits
from maps.grid import OccupancyGrid
from maps.map_files import MapError, load_map
from planner.options import PLANNERS, PlannerOptions
from sim.robot import Robot
from sim.robots import get_robot

Options = TypeVar("Options")


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


class Poses(tuple[Pose, ...]):
    """Poses in the order in which they are come to."""


class Size(NamedTuple):
    """Width and height of pictures in pixels."""

    width: int
    height: int


LEAST_PX, MOST_PX = 64, 7680
ABOUT_MAP = ("resolution", "origin", "unknown_is_free")  # of MapOptions; for nothing without a map
_MOST_LETTERS = 100  # in a line of the help
_Spec = PrimitiveConstructorSpec[Any]
Numbers = TypeVar("Numbers", Pose, Interval, Reach)


def _reader(
    kind: type[Numbers],
    wanted: str,
    fits: Callable[[Numbers], bool] = lambda _: True,
    *,
    angles: Sequence[int] = (),
) -> Callable[[str], Numbers]:
    """Reads finite numbers with commas between, those at `angles` as such; or ValueError."""

    def read(text: str) -> Numbers:
        with contextlib.suppress(ValueError, TypeError):
            words = enumerate(text.split(","))
            value = kind(*[(_angle if k in angles else float)(word) for k, word in words])
            if all(map(math.isfinite, value)) and fits(value):
                return value
        raise ValueError(f"{text!r} is not {wanted}")

    return read


def _angle(text: str) -> float:
    """Radians of a number, or of a number of degrees such as 90deg; raises ValueError."""
    degrees = text.strip().removesuffix("°").removesuffix("deg")
    if degrees != text.strip():
        return math.radians(float(degrees))
    angle_rad = float(text)
    if 2 * math.pi < abs(angle_rad) < math.inf:
        turn_deg = math.degrees(math.remainder(angle_rad, 2 * math.pi))
        warnings.warn(
            f"{angle_rad:g} is read as radians, the same as {turn_deg:.0f}deg; "
            f"write {angle_rad:g}deg for degrees",
            stacklevel=2,
        )
    return angle_rad


parse_pose = _reader(
    Pose,
    "a pose; write X,Y,YAW in metres and radians, such as 2,1,1.57 or 2,1,90deg",
    angles=(2,),
)
parse_interval, parse_angles = (
    _reader(Interval, f"a range; write LOW,HIGH, such as {such}", lambda r: r[0] <= r[1], angles=at)
    for such, at in (("-1,1", ()), ("-1.57,1.57 or -90deg,90deg", (0, 1)))
)
parse_reach = _reader(
    Reach,
    "a reach; write M,RAD in metres and radians, such as 0.05,0.1 or 0.05,5deg",
    lambda reach: min(reach) >= 0,
    angles=(1,),
)


def parse_size(text: str) -> Size:
    """Reads a size such as 1280x720; raises ValueError unless films can have it."""
    with contextlib.suppress(ValueError):
        width, height = map(int, text.lower().split("x"))
        if all(LEAST_PX <= side <= MOST_PX and side % 2 == 0 for side in (width, height)):
            return Size(width, height)
    raise ValueError(
        f"{text!r} is not a size; write WIDTHxHEIGHT, two even numbers of {LEAST_PX} to {MOST_PX} "
        "such as 1280x720"
    )


def _show(value: object) -> list[str]:
    """A value as the help shows it and as it would be typed."""
    if value is None or value in ((), "", {}):
        return ["none"]
    if isinstance(value, (Pose, Interval, Reach)):
        return [",".join(f"{part:g}" for part in value)]
    if isinstance(value, Size):
        return [f"{value.width}x{value.height}"]
    if isinstance(value, tuple):
        return [",".join(map(str, value))]
    return [str(value)]


def text(metavar: str, read: Callable[[str], Any] = lambda word: word) -> _Spec:
    """Reads one word as it is, or by a function; the metavar stands for it in the help."""
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=lambda words: read(words[0]),
        is_instance=lambda value: True,
        str_from_instance=_show,
    )


def number(
    *,
    at_least: float | None = None,
    above: float | None = None,
    at_most: float = math.inf,
    whole: bool = False,
    metavar: str = "NUMBER",
) -> _Spec:
    """Reads a finite number within bounds, for `Annotated[float, ...]`."""
    wanted = "a whole number" if whole else "a number"
    wanted += "" if at_least is None else f" of at least {at_least}"
    wanted += "" if above is None else f" above {above}"

    def read(word: str) -> Any:
        try:
            value = int(word) if whole else float(word)
        except ValueError:
            value = math.nan
        # A comparison with nan is false, so each test names what is right, not what is wrong.
        large_enough = at_least is None or value >= at_least
        if not (abs(value) < math.inf and large_enough and (above is None or value > above)):
            raise ValueError(f"{word!r} is not {wanted}")
        if value > at_most:
            raise ValueError(f"{word!r} is too large: at most {at_most}")
        return value

    return text(metavar, read)


def whole_number(*, at_least: int, at_most: int = 10**9, metavar: str = "COUNT") -> _Spec:
    """Reads a whole number within bounds, for `Annotated[int, ...]`."""
    return number(at_least=at_least, at_most=at_most, whole=True, metavar=metavar)


def choice(*names: str) -> _Spec:
    """Reads one of the names, for `Annotated[str, ...]`."""
    return text("|".join(names), lambda word: _one_of(names, word))


def some_of(*names: str) -> _Spec:
    """Reads some of the names with commas between, for `Annotated[tuple[str, ...], ...]`."""

    def read(words: str) -> tuple[str, ...]:
        chosen = [_one_of(names, word.strip()) for word in words.split(",")]
        return tuple(name for name in names if name in chosen)

    return text("NAME,NAME,...", read)


def _one_of(names: Sequence[str], word: str) -> str:
    if word not in names:
        raise ValueError(f"{word!r} is not one of {', '.join(names)}")
    return word


# Types are spelled so that tyro can tell by itself whether a default is of its type. For Any,
# `X | None` and `tuple[X, ...]` it loads typeguard: a tenth of the time of loading all of `plan`.
_POSE = text("X,Y,YAW", parse_pose)
PoseOption = Annotated[Pose, _POSE]
OptionalPose = Annotated[Optional[Pose], _POSE]  # noqa: UP045
PosesOption = Annotated[
    Poses, text("X,Y,YAW:X,Y,YAW...", lambda word: Poses(map(parse_pose, word.split(":"))))
]
OptionalInterval = Annotated[Optional[Interval], text("LOW,HIGH", parse_interval)]  # noqa: UP045
OptionalAngles = Annotated[Optional[Interval], text("LOW,HIGH", parse_angles)]  # noqa: UP045
SizeOption = Annotated[Size, text("WIDTHxHEIGHT", parse_size)]
ReachOption = Annotated[Reach, text("M,RAD", parse_reach)]
OptionalLength = Annotated[Optional[float], number(above=0)]  # noqa: UP045
OptionalTime = OptionalLength
_FILE, _FOLDER = text("FILE", Path), text("DIR", Path)
FileOption = Annotated[Path, _FILE]
OptionalFile = Annotated[Optional[Path], _FILE]  # noqa: UP045
FolderOption = Annotated[Path, _FOLDER]
FolderArgument = Annotated[Path, _FOLDER, tyro.conf.Positional]
OptionalFolder = Annotated[Optional[Path], _FOLDER]  # noqa: UP045
RobotName = Annotated[str, text("NAME")]
PaceOption = Annotated[str, choice(*PACES)]
PushOption = Annotated[float, number(at_least=0.0)]
SeedOption = Annotated[int, whole_number(at_least=0, at_most=2**63 - 1, metavar="SEED")]
# More processes or threads than any machine has cores; each of them takes memory.
WorkersOption = Annotated[int, whole_number(at_least=0, at_most=4096)]
CountOption = Annotated[int, whole_number(at_least=1)]
# On unless turned off: the help shows the switch that does so, and its default.
SwitchedOn = Annotated[bool, tyro.conf.arg(help_behavior_hint="(default: False)")]


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

    if not {"-h", "--help"}.isdisjoint(words):
        # tyro would leave long lines to the terminal, which cuts words.
        print(f"{_filled(inspect.cleandoc(kind.__doc__ or ''))}\n\nexample:\n  {example}\n")
    on = {f"--{name}" for name in _switches_on(kind)}
    with tyro_errors.on_parse_error(complain):
        return tyro.cli(
            kind,
            prog=program,
            description="",
            # tyro knows such a switch by the name that turns it off only.
            args=[word for word in words if word not in on],
            config=(tyro.conf.FlagCreatePairsOff,),
        )


def _filled(text: str) -> str:
    """The paragraphs of a text in lines that fit the terminal, and can be read."""
    width = min(shutil.get_terminal_size().columns, _MOST_LETTERS)
    paragraphs = text.split("\n\n")
    return "\n\n".join(textwrap.fill(part, width, break_on_hyphens=False) for part in paragraphs)


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


@dataclass(frozen=True, kw_only=True)
class MapOptions:
    """Which map, and how to read it."""

    map: FileOption
    """The map: an image with its YAML beside it, or the YAML, such as maps/room.png."""

    resolution: OptionalLength = None
    """Metres per pixel, such as 0.05, for an image without a YAML; wins over the YAML's."""

    origin: OptionalPose = None
    """Pose of the map's lower-left corner, such as -4,-3,0; wins over the YAML's."""

    unknown_is_free: bool = False
    """Let the robot step on cells of which the map says neither free nor occupied."""


@dataclass(frozen=True, kw_only=True)
class GoalOptions(MapOptions):
    """From where to where on the map."""

    goal: PoseOption
    """Where to stand in the end, in metres and radians, such as 2,1,1.57 or 2,1,90deg."""

    start: PoseOption = Pose(0.0, 0.0, 0.0)
    """Where the robot stands at first, such as -1,2,0."""

    goal_tolerance: ReachOption = Reach(0.0, 0.0)
    """How far from the goal, and how far turned, a cheaper plan may end, such as 0.05,0.08."""


@dataclass(frozen=True, kw_only=True)
class RobotOptions:
    """Which robot, and who moves it."""

    robot: RobotName = "jvrc1"
    """Which robot, such as jvrc1, or the folder of a robot file, such as robots/talos."""

    policy: OptionalFile = None
    """The policy that walks, such as runs/train/jvrc1.safetensors; none: the robot's own."""


@dataclass(frozen=True, kw_only=True)
class PlanningOptions(RobotOptions, MapOptions):
    """Which robot, and how its steps on the map are planned."""

    planner: Annotated[str, choice(*PLANNERS)] = PlannerOptions.name
    """Which planner, such as ara; docs/planners.md tells them apart."""

    refine: SwitchedOn = True
    """Leave the steps on the lattice, and do not move them to where they cost less."""

    seed: SeedOption = 0
    """Seed of everything random, such as 7."""

    def planner_options(self, **others: Any) -> PlannerOptions:
        """What the planner is told, with other fields of PlannerOptions beside these."""
        return PlannerOptions(
            name=self.planner,
            refine=self.refine,
            unknown_is_free=self.unknown_is_free,
            seed=self.seed,
            **others,
        )


def read_grid(options: MapOptions) -> OccupancyGrid:
    """The map that the options name.

    Raises:
        InputError: It cannot be read.
    """
    with as_bad_input(MapError):
        grid = load_map(options.map, resolution_m=options.resolution, origin=options.origin)
    if not options.map.exists():
        say(f"map {options.map}: not in this folder; taking the one that comes with the program")
    return grid


def find_robot(name: str) -> Robot:
    """The robot of that name.

    Raises:
        InputError: There is none; the message lists those there are.
    """
    with as_bad_input(ValueError):
        return get_robot(name)


def find_robot_with_limits(name: str, policy: Path | None = None) -> Robot:
    """The robot of that name with the step model that planning uses.

    Step limits and margins are those that the policy, by default the robot's own, was measured to
    keep (`evaluate` stores them beside it), or the robot's file's where nothing was measured.

    Raises:
        InputError: There is no such robot or policy, or what was measured cannot be read.
    """
    robot = find_robot(name)
    with as_bad_input(PolicyError):
        if policy is not None:
            load_policy(robot, policy)
        return with_tracking_limits(robot, policy)
