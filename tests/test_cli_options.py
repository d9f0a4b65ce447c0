"""Reading of command-line words: what is taken, and the one line that refuses the rest."""

from __future__ import annotations

import dataclasses
import math
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import pytest

from app.cli import COMMANDS, PROGRAM, load_run
from app.options import (
    FolderArgument,
    OptionalFile,
    OptionalInterval,
    Pose,
    PoseOption,
    choice,
    number,
    parse_angles,
    parse_options,
    parse_size,
    whole_number,
)
from app.output import InputError


@dataclass(frozen=True, kw_only=True)
class SampleOptions:
    """A command for these tests."""

    goal: PoseOption
    """Where to, such as 2,1,1.57."""

    start: PoseOption = Pose(0.0, 0.0, 0.0)
    """Where from, such as 1,2,3."""

    epsilon: Annotated[float, number(at_least=1.0)] = 8.0
    """Bound, such as 2."""

    time_limit: Annotated[float, number(above=0.0)] = 5.0
    """Seconds, such as 1."""

    count: Annotated[int, whole_number(at_least=1)] = 1
    """How many, such as 3."""

    planner: Annotated[str, choice("ara", "rstar")] = "ara"
    """Which, such as ara."""

    out: OptionalFile = None
    """File, such as plan.json."""

    json: bool = False
    """Print the document."""

    width: OptionalInterval = None
    """Range, such as -1,1."""


@dataclass(frozen=True, kw_only=True)
class Switches:
    """One switch that is on and one that is off."""

    walks: bool = True
    """Whether it walks."""

    json: bool = False
    """Whether it prints."""


def parse(*words: str) -> SampleOptions:
    return parse_options(SampleOptions, words, program="prog sample", example="prog sample --x 1")


def refusal(*words: str) -> str:
    with pytest.raises(InputError) as caught:
        parse(*words)
    return str(caught.value)


@pytest.mark.parametrize(
    "words",
    [
        ("--goal", "-1,2,0"),
        ("--goal=-1,2,0",),
        ("--goal", "-1.0,2e0,0"),
        ("--goal", " -1, 2, 0"),
        ("--json", "--goal", "-1,2,0"),
    ],
)
def test_a_pose_may_begin_with_a_minus(words):
    assert parse(*words).goal == Pose(-1.0, 2.0, 0.0)


def test_a_pose_may_begin_with_a_bare_point():
    assert parse("--goal", "-.5,.25,0").goal == Pose(-0.5, 0.25, 0.0)


@pytest.mark.parametrize("word", ["2,1,90deg", "2,1,90°", "2,1, 90deg", "2,1,450deg"])
def test_a_heading_may_be_in_degrees(word):
    x_m, y_m, yaw_rad = parse("--goal", word).goal
    assert (x_m, y_m) == (2.0, 1.0)
    assert math.remainder(yaw_rad - math.pi / 2, 2 * math.pi) == pytest.approx(0.0, abs=1e-12)


def test_a_heading_that_looks_like_degrees_is_told_of():
    with pytest.warns(UserWarning, match="90 is read as radians, the same as 117deg; write 90deg"):
        assert parse("--goal", "2,1,90").goal.yaw_rad == 90.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parse("--goal", "2,1,6.28")


@pytest.mark.parametrize("word", ["2,1,deg", "2,90deg,0", "2,1,90 degrees", "2,1,infdeg"])
def test_degrees_are_for_headings_alone(word):
    assert "or 2,1,90deg" in refusal("--goal", word)


def test_a_range_of_headings_is_read_as_headings_are():
    low, high = parse_angles("-90deg,1.5")
    assert low == pytest.approx(-math.pi / 2)
    assert high == 1.5
    with pytest.warns(UserWarning, match="90 is read as radians"):
        assert parse_angles("0,90") == (0.0, 90.0)
    for word in ("1,0", "90deg,0deg", "0", "0,nan"):
        with pytest.raises(ValueError, match=r"such as -1\.57,1\.57 or -90deg,90deg"):
            parse_angles(word)


def test_everything_given_is_taken():
    options = parse(
        *("--goal", "2,1,1.57", "--start", "1,-1,3", "--epsilon", "3", "--time-limit=0.5"),
        *("--count", "7", "--planner", "rstar", "--out", "a/b.json", "--json"),
    )
    assert options == SampleOptions(
        goal=Pose(2.0, 1.0, 1.57),
        start=Pose(1.0, -1.0, 3.0),
        epsilon=3.0,
        time_limit=0.5,
        count=7,
        planner="rstar",
        out=Path("a/b.json"),
        json=True,
    )


def test_what_is_not_given_has_its_default():
    assert parse("--goal", "0,0,0") == SampleOptions(goal=Pose(0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    "text", ["2,1", "2,1,0,0", "2,1,x", "nan,0,0", "0,inf,0", "", "2 1 0", ","]
)
def test_a_malformed_pose_is_named_with_the_right_form(text):
    message = refusal("--goal", text)
    assert message.startswith("--goal: ")
    assert repr(text) in message
    assert "2,1,1.57" in message


def test_a_range_may_begin_with_a_minus():
    assert parse("--goal", "0,0,0", "--width", "-1,2.5").width == (-1.0, 2.5)
    assert parse("--goal", "0,0,0", "--width=-2,-2").width == (-2.0, -2.0)


@pytest.mark.parametrize("text", ["1", "1,0", "1,2,3", "a,b", "nan,1", "0,inf", ""])
def test_a_malformed_range_is_named_with_the_right_form(text):
    told = f"--width: {text!r} is not a range; write LOW,HIGH, such as -1,1"
    assert refusal("--goal", "0,0,0", "--width", text) == told


@dataclass(frozen=True, kw_only=True)
class SampleArgument:
    """A command that takes a folder without naming it."""

    folder: FolderArgument
    """Folder, such as runs."""


def test_an_argument_without_a_name():
    def read(*words: str) -> SampleArgument:
        return parse_options(SampleArgument, words, program="prog", example="")

    assert read("runs/a").folder == Path("runs/a")
    with pytest.raises(InputError, match=r"^DIR must be given; "):
        read()
    with pytest.raises(InputError, match=r"^'b' belongs to no option; "):
        read("a", "b")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--epsilon", "abc"), "--epsilon: 'abc' is not a number of at least 1.0"),
        (("--epsilon", "0.5"), "--epsilon: '0.5' is not a number of at least 1.0"),
        (("--epsilon", "nan"), "--epsilon: 'nan' is not a number of at least 1.0"),
        (("--epsilon", "inf"), "--epsilon: 'inf' is not a number of at least 1.0"),
        (("--time-limit", "0"), "--time-limit: '0' is not a number above 0.0"),
        (("--time-limit", "-3"), "--time-limit: '-3' is not a number above 0.0"),
        (("--count", "1.5"), "--count: '1.5' is not a whole number of at least 1"),
        (("--count", "0"), "--count: '0' is not a whole number of at least 1"),
        (("--planner", "rrt"), "--planner: 'rrt' is not one of ara, rstar"),
    ],
)
def test_a_bad_value_is_named_with_what_would_be_right(words, told):
    assert refusal("--goal", "0,0,0", *words) == told


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--gaol", "0,0,0"), "there is no option --gaol; did you mean --goal?"),
        (("--goal", "0,0,0", "--bogus", "4"), "there is no option --bogus;"),
        (("--goal", "0,0,0", "--time_limits=4"), "did you mean --time-limit?"),
        (("--goal", "0,0,0", "--no-json"), "there is no option --no-json; did you mean --json?"),
        (("--goal", "0,0,0", "extra"), "'extra' belongs to no option"),
        (("--goal", "2", "1", "1.57"), "'1' belongs to no option"),
        ((), "--goal X,Y,YAW must be given"),
        (("--start", "0,0,0"), "--goal X,Y,YAW must be given"),
        (("--goal",), "--goal X,Y,YAW was given no value"),
        (("--goal", "--json"), "--goal X,Y,YAW was given no value"),
    ],
)
def test_wrong_options_are_told_in_one_line(words, told):
    message = refusal(*words)
    assert told in message
    assert message.endswith("'prog sample --help' shows the options")
    assert "\n" not in message


@pytest.mark.parametrize(
    ("words", "walks", "json"),
    [
        ((), True, False),
        (("--walks",), True, False),
        (("--no-walks", "--json"), False, True),
    ],
)
def test_a_switch_that_is_on_can_be_said_both_ways(words, walks, json):
    options = parse_options(Switches, words, program="prog switches", example="prog switches")
    assert (options.walks, options.json) == (walks, json)


def test_a_mistyped_switch_is_named():
    with pytest.raises(InputError, match="did you mean --no-walks"):
        parse_options(Switches, ["--no-walk"], program="prog switches", example="prog switches")


def test_help_shows_every_option_its_default_and_an_example(capsys):
    with pytest.raises(SystemExit) as left:
        parse("--help")
    assert left.value.code == 0
    text = capsys.readouterr().out
    for part in (
        *("--goal X,Y,YAW", "(required)", "--start X,Y,YAW", "(default: 0,0,0)"),
        *("--epsilon NUMBER", "(default: 8.0)", "--time-limit NUMBER", "(default: 5.0)"),
        *("--count COUNT", "(default: 1)", "--planner ara|rstar", "(default: ara)"),
        *("--out FILE", "(default: none)", "--json", "(default: False)", "prog sample --x 1"),
    ):
        assert part in text, part


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help_for_every_option(name, capsys):
    command = COMMANDS[name]
    _, kind = load_run(name)
    with pytest.raises(SystemExit):
        parse_options(kind, ["--help"], program=name, example=f"{PROGRAM} {command.example}")
    text = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert f"{PROGRAM} {command.example}" in text
    # A switch that is on has two names: "--refine, --no-refine".
    told = {entry.partition(" ")[0].rstrip(","): entry for entry in text.split(" --")}
    for field in dataclasses.fields(kind):
        # An argument without a name of its own stands above the options.
        place = field.name.replace("_", "-")
        place = f"no-{place}" if field.default is True else place
        entry = told[place] if place in told else text.partition("positional arguments")[2]
        assert "(default: " in entry or "(required)" in entry
        # A switch needs no example: its name is one.
        assert "such as" in entry or isinstance(field.default, bool), f"no example for --{entry}"


@pytest.mark.parametrize("name", COMMANDS)
def test_no_line_of_a_help_is_cut_or_ends_early(name, capsys, monkeypatch):
    _, kind = load_run(name)

    def lines_of_help(columns: int) -> list[str]:
        monkeypatch.setenv("COLUMNS", str(columns))
        with pytest.raises(SystemExit):
            parse_options(kind, ["--help"], program=name, example="prog x")
        lines = capsys.readouterr().out.splitlines()
        return [line for line in lines if not line.startswith("usage: ")]

    assert max(map(len, lines_of_help(70))) <= 70
    # With room for all, each option is told on one line, below its name if that is long.
    options = [line.strip("│ ") for line in lines_of_help(400) if line.startswith("│")]
    told = [line for line in options if " " in line and "--help" not in line]
    assert all(line.endswith(")") for line in told), told
    assert not [line for line in told if line.endswith(("(default: )", "'')", "'{}')"))]


@pytest.mark.parametrize("name", COMMANDS)
def test_every_example_is_one_that_the_command_takes(name):
    command = COMMANDS[name]
    assert command.example.startswith(f"{name} ")
    words = command.example.removeprefix(f"{name} ").split()
    run, kind = load_run(name)
    parse_options(kind, words, program=name, example="")
    assert callable(run)


@pytest.mark.parametrize("word", ["1280x720", "1280X720"])
def test_a_size_of_a_film_is_read(word):
    assert parse_size(word) == (1280, 720)


@pytest.mark.parametrize(
    "word",
    ["1280", "1281x720", "1280x721", "0x0", "62x720", "9000x720", "axb", "1280x720x3", "-64x64"],
)
def test_a_size_that_no_film_can_have_is_refused(word):
    with pytest.raises(ValueError, match=f"{word!r} is not a size; write WIDTHxHEIGHT"):
        parse_size(word)
