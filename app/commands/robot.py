"""The commands `robot check` and `robot draft`: robots from files, checked and begun."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from app.options import FolderOption, OptionalFile, OptionalLength, find_robot, text
from app.output import (
    ExitCode,
    InputError,
    as_bad_input,
    make_folder,
    refuse_given,
    require_writable,
    say,
    to_json,
)
from sim.robot_file import FILE
from sim.robots import robot_names

if TYPE_CHECKING:
    from sim.draft.draft import DraftChoices

CHECK_FORMAT = "robot-check/1"
DRAFT_FORMAT = "robot-draft/1"
SHEET, SHEET_ENDINGS = "robot.png", (".png", ".jpg", ".jpeg")
_OF_SOURCES = ("name", "package", "forward", "feet", "sole", "torque_limit", "speed_limit")
RobotArgument = Annotated[str, text("ROBOT"), tyro.conf.Positional]


@dataclass(frozen=True, kw_only=True)
class RobotCheckOptions:
    """Check a robot: the folder of its file or the name of one that comes along (as for --robot).

    A line each: pass, or what is wrong and which key of robot.yaml mends it. The exit code is 0
    when all pass and 2 when something is wrong. docs/adding-a-robot.md tells of the checks.
    """

    robot: RobotArgument
    """Which robot, such as robots/talos."""

    image: OptionalFile = None
    """Also draw it, with joint axes, soles and a table, into this file, such as robot.png."""

    json: bool = False
    """Print what was found as a document on standard output, and nothing else there."""


def run_check(options: RobotCheckOptions) -> int:
    """Carries the command out; returns the exit code."""
    require_writable(options.image, option="--image", endings=SHEET_ENDINGS)
    robot = find_robot(options.robot)
    # Here and not above: it loads MuJoCo, for which wrong input need not wait.
    from sim.robot_checks import check_robot

    findings, wrong = [], 0
    for finding in check_robot(robot):
        findings.append(asdict(finding))
        wrong += bool(finding.problems)
        if not options.json:
            print(f"{'wrong' if finding.problems else 'pass ':5}  {finding.check}: ", end="")
            print("; ".join(finding.problems) or finding.measured, flush=True)
    if options.image is not None and not findings[0]["problems"]:
        from app.pictures.robot_sheet import write_robot_sheet

        write_robot_sheet(options.image, robot)
    if options.json:
        document = {"format": CHECK_FORMAT, "robot": robot.option, "checks": findings}
        print(to_json(document), end="")
    passed = f"{len(findings) - wrong} of {len(findings)} checks pass"
    say(f"{robot.title}: {passed}")
    return ExitCode.BAD_INPUT if wrong else ExitCode.DONE


def _packages(words: str) -> dict[str, Path]:
    """Reads folders of packages such as NAME=DIR,NAME=DIR."""
    packages = {}
    for word in words.split(","):
        name, equals, folder = word.partition("=")
        if not (name and equals and folder):
            raise ValueError(f"{word!r} is not a package; write NAME=DIR, such as talos_data=talos")
        if not Path(folder).is_dir():
            raise ValueError(f"{folder} is no folder that exists: name that of {name}")
        packages[name] = Path(folder)
    return packages


def _two_names(words: str) -> tuple[str, ...]:
    names = tuple(word.strip() for word in words.split(","))
    if len(names) != 2 or not all(names) or names[0] == names[1]:
        raise ValueError(f"{words!r} is not two names; write LEFT,RIGHT, such as l_foot,r_foot")
    return names


def _sole(words: str) -> tuple[float, ...]:
    try:
        sizes = tuple(float(word) for word in words.split(","))
    except ValueError:
        sizes = ()
    if len(sizes) != 3 or not all(0 < size < 1 for size in sizes):
        raise ValueError(
            f"{words!r} is not a sole; write LENGTH,WIDTH,DEPTH in m, such as 0.2,0.1,0.1"
        )
    return sizes


def _forward(word: str) -> str:
    if word not in ("x", "-x", "y", "-y"):
        raise ValueError(f"{word!r} is not one of x, -x, y, -y")
    return word


@dataclass(frozen=True, kw_only=True)
class RobotDraftOptions:
    """Draft a robot file from a URDF or an MJCF, with everything that geometry and figures tell.

    Base, legs, the roles of their joints, soles, half-sitting, gains, shapes and step limits are
    found, whatever the names, and drawn into robot.png. What was guessed is told: correct it in
    robot.yaml, and run `robot check` on the folder. A file that pip installed may be given as
    DISTRIBUTION:FILE. The name of a robot that comes along in place of a file writes that one.
    Then every command takes the folder (--robot DIR).
    """

    file: Annotated[str, text("FILE"), tyro.conf.Positional]
    """The URDF or MJCF, such as talos.urdf."""

    out: FolderOption
    """The folder for the robot file, such as robots/talos."""

    name: Annotated[str, text("NAME")] = ""
    """What it is called, such as talos; without it the model's own name."""

    package: Annotated[Mapping[str, Path], text("NAME=DIR,NAME=DIR...", _packages)] = (
        # A new one for every command line.
        field(default_factory=dict)
    )
    """Where packages are that the URDF names by package://, such as talos_data=/opt/talos_data."""

    forward: Annotated[str, text("x|-x|y|-y", _forward)] = ""
    """Which axis of the base looks forward, such as -x; without it the way that knees bend."""

    feet: Annotated[tuple[str, ...], text("LEFT,RIGHT", _two_names)] = ()
    """The bodies of the feet, such as l_foot,r_foot; without it the lowest mirrored chains."""

    sole: Annotated[tuple[float, ...], text("LENGTH,WIDTH,DEPTH", _sole)] = ()
    """The sole in m and how far the ankle is above it, such as 0.2,0.1,0.1, if no mesh shows it."""

    torque_limit: OptionalLength = None
    """Torque limit of all leg joints in N m, such as 150, where the model has none."""

    speed_limit: OptionalLength = None
    """Speed limit of all leg joints in rad/s, such as 12, where the model has none."""

    force: bool = False
    """Replace a robot file that is there."""

    json: bool = False
    """Print the draft as a document on standard output, and nothing else there."""


def run_draft(options: RobotDraftOptions) -> int:
    """Carries the command out; returns the exit code."""
    if (options.out / FILE).exists() and not options.force:
        raise InputError(
            f"--out: {options.out / FILE} is there, perhaps corrected by hand: name another "
            "folder, or add --force"
        )
    # Here and not above: it loads MuJoCo, for which wrong input need not wait.
    from sim.draft.draft import draft
    from sim.draft.legs import DraftError
    from sim.robot_file_text import document_of, write_robot
    from sim.source_model import SourceError, read_source, source_path

    guessed: tuple[str, ...] = ()
    if options.file in robot_names():
        refuse_given(options, _OF_SOURCES, f"is for a URDF or an MJCF: {options.file} is complete")
        with as_bad_input(ValueError):
            document, model = document_of(find_robot(options.file))
        make_folder(options.out, option="--out")
        write_robot(options.out, document, model)
    else:
        with as_bad_input(SourceError, DraftError):
            path = source_path(options.file)
            source = read_source(path, options.package)
            try:
                found = draft(source, _choices(options), _meshes(options, path))
            except DraftError as error:
                raise DraftError(f"{path}: {error}") from None
        make_folder(options.out, option="--out")
        found.write(options.out)
        document, guessed = found.document, found.guessed
    from app.pictures.robot_sheet import write_robot_sheet

    write_robot_sheet(options.out / SHEET, find_robot(str(options.out)), guessed)
    if options.json:
        told = {"format": DRAFT_FORMAT, "folder": str(options.out), "guessed": guessed}
        print(to_json({**told, "robot": document}), end="")
    else:
        for line in guessed:
            print(f"guessed  {line}")
    say(f"{options.out / FILE}: {document['title']}; next: robot check {options.out}")
    return ExitCode.DONE


def _choices(options: RobotDraftOptions) -> DraftChoices:
    from sim.draft.draft import DraftChoices

    return DraftChoices(
        name=options.name,
        forward=options.forward,
        feet=options.feet,
        sole_m=options.sole,
        torque_limit_nm=options.torque_limit,
        speed_limit_rad_s=options.speed_limit,
    )


def _meshes(options: RobotDraftOptions, path: Path) -> dict[str, Any]:
    """The key `meshes`: the file from the robot's folder, unless it is one of a distribution."""
    is_installed = ":" in options.file and not Path(options.file).exists()
    folder = options.out.absolute()
    file = options.file if is_installed else os.path.relpath(path.absolute(), folder)
    packages = {n: os.path.relpath(p.absolute(), folder) for n, p in options.package.items()}
    return {"file": file, **({"packages": packages} if packages else {})}
