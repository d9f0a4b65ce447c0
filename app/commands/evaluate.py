"""The command `evaluate`: how well a controller walks, section by section, as one report."""

from __future__ import annotations

import functools
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from app.cluster import ClusterOption, connected, on_cluster
from app.controllers import CONTROLLERS, ControllerOption, find_policy, load_controlled
from app.engines import EngineOptions, load_engine
from app.navigation.report import installed_versions
from app.options import (
    CountOption,
    FolderOption,
    RobotOptions,
    SeedOption,
    WorkersOption,
    find_robot,
    some_of,
    text,
)
from app.output import (
    ExitCode,
    InputError,
    ProgressBar,
    claim_folder,
    say,
    to_json,
    write_text,
)
from controller.tracking_limits import TrackingLimits, tracking_limits_path, tracking_limits_text
from maps.files import read_json
from sim.robot import Robot

if TYPE_CHECKING:
    from app.evaluation.parts import EvaluationSetup, Part, Results
    from controller.walker import Controller

FORMAT = "policy-evaluation/2"
SECTION_NAMES = ("modes", "stairs", "gait", "push", "energy", "pace", "hardware", "long", "limits")
# Sections whose parts are rows of one table; the others have one document for each part.
TABLES = ("modes", "stairs", "push", "energy", "pace", "hardware")
# With fewer walks 99 % and 97 % are told apart by chance only.
ENOUGH_EPISODES = 100
# What of another evaluation is shown; the rest stays in its own report.
SHOWN_BESIDE = (
    "policy_sha256",
    "controller",
    "engine",
    "trained",
    "episodes",
    "seed",
    *SECTION_NAMES[:-1],
)


@dataclass(frozen=True, kw_only=True)
class EvaluateOptions(EngineOptions, RobotOptions):
    """Measure how well a controller walks, and write one report with figures.

    Sections: falls and foot errors of every mode (modes), stairs with noise on treads and joints
    (stairs), joint loads, ground force and contact (gait), push recovery (push), speed and cost of
    transport (energy), falls and speed with quicker steps (pace), falls with motors, encoders,
    load and ground that differ from the model (hardware), a minute of mixed walking (long), and the
    steps and margins that planning may count on (limits); what the last finds is stored
    beside the policy, where plans find it.
    The folder gets report.md, evaluation.json and the figures. What is done is kept when the run
    is cut off: the same command goes on from there.
    """

    out: FolderOption
    """Folder of the report, such as runs/evaluate; made when missing."""

    sections: Annotated[tuple[str, ...], some_of(*SECTION_NAMES)] = SECTION_NAMES
    """What to measure, such as modes,stairs."""

    episodes: CountOption = 1000
    """Episodes of each mode, such as 1000; where there are many cases, a share of it for each."""

    seed: SeedOption = 1
    """Seed of the episodes, such as 1; training never uses the same ones."""

    workers: WorkersOption = 0
    """Threads for the physics, such as 2; 0 for all cores. The result does not depend on it."""

    cluster: ClusterOption = None
    """Ray cluster, each part on as many cores as workers (or 1), such as auto; none: no cluster."""

    controller: ControllerOption = "policy"
    """Who walks: the trained policy, or a controller by a model, such as lipm (docs/lipm.md)."""

    beside: Annotated[Path | None, text("DIR|NAME", Path)] = None
    """An evaluation to show beside it, such as runs/other, or a controller to measure, lipm."""

    json: bool = False
    """Print evaluation.json on standard output, and nothing else there."""


def run(options: EvaluateOptions) -> int:
    """Carries the command out; returns the exit code."""
    from app.evaluation.report_text import report

    other = other_of(options)
    # What is wrong with one of them is said before anything is measured.
    measured = [load_measured(each) for each in (options, other) if each is not None]
    load_engine(options, measured[0][0])
    beside: dict[str, Any] | None = None
    if other is None and options.beside is not None:
        beside = read_beside(options.beside, measured[0][0].name)
    claim_folder(options.out, option="--out")
    if other is not None:
        claim_folder(other.out, option="--out")
        beside = shown_beside(evaluated(other, *measured[1]))
    document = evaluated(options, *measured[0], beside)
    print(to_json(document) if options.json else report(document), end="")
    return ExitCode.DONE


def load_measured(options: EvaluateOptions) -> tuple[Robot, Controller]:
    """The robot as its file states it, whatever was measured of it before, and what walks it."""
    if options.controller != "policy":
        return load_controlled(options, options.controller, "normal")
    robot = find_robot(options.robot)
    return robot, find_policy(robot, options.policy)


def other_of(options: EvaluateOptions) -> EvaluateOptions | None:
    """How the controller that `--beside` names is measured: the same way, in a folder within.

    Raises:
        InputError: It is the one that walks already.
    """
    name = str(options.beside)
    if name not in CONTROLLERS:
        return None
    if name == options.controller:
        others = " or ".join(each for each in CONTROLLERS if each != name)
        raise InputError(f"--beside {name}: that is who walks already; give {others}")
    return replace(options, controller=name, policy=None, beside=None, out=options.out / name)


def evaluated(
    options: EvaluateOptions,
    robot: Robot,
    controller: Controller,
    beside: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """evaluation.json, measured and written with its report and figures."""
    from app.evaluation.limits import measured_of
    from app.evaluation.parts import EvaluationSetup
    from app.evaluation.report_text import report
    from app.evaluation.sections import parts_of

    setup = EvaluationSetup(
        robot=robot,
        controller=controller,
        episodes=options.episodes,
        seed=options.seed,
        engine=load_engine(options, robot),
        threads=options.workers or (1 if options.cluster else os.cpu_count()) or 1,
    )
    parts = parts_of(setup)
    results: Results = {}

    def write(document: dict[str, Any]) -> None:
        write_text(options.out / "evaluation.json", to_json(document))
        write_text(options.out / "report.md", report(document))

    try:
        _measure(parts, options, setup, results)
    except KeyboardInterrupt:
        write(document_of(setup, parts, results, None))
        raise
    stored = store_limits(options, setup, measured_of(setup, results))
    document = document_of(setup, parts, results, stored)
    if beside is not None:
        document["beside"] = beside
    # Here and not above: it takes a while to load, and a run that is cut off needs none of it.
    from app.evaluation.figures import write_figures

    write_figures(document, options.out)
    write(document)
    return document


def _measure(
    parts: Sequence[Part], options: EvaluateOptions, setup: EvaluationSetup, results: Results
) -> None:
    """Fill in the results of all parts that are wanted, or kept from a run of the same settings."""
    from app.evaluation.parts import ResultCache, finite

    kept = ResultCache(options.out, setup)
    found = {part.name: kept.read(part) for part in parts}
    results |= {name: result for name, result in found.items() if result is not None}
    wanted = [part for part in parts if part.section in options.sections]
    if not wanted:
        raise InputError(
            f"--sections {','.join(options.sections)} goes with --controller policy and --engine "
            "mujoco: nothing else holds it"
        )
    missing = [part for part in wanted if part.name not in results]
    if len(missing) < len(wanted):
        say(f"{len(wanted) - len(missing)} of {len(wanted)} parts are there already")
    done = 0.0
    with ProgressBar("evaluating, s walked", sum(part.robot_seconds for part in missing)) as bar:
        for part, result in _measured(missing, options, setup, results):
            results[part.name] = finite(result)
            kept.write(part, results[part.name])
            done += part.robot_seconds
            bar.update(done, part.name)


def _measured(
    parts: Sequence[Part], options: EvaluateOptions, setup: EvaluationSetup, results: Results
) -> Iterator[tuple[Part, dict[str, Any]]]:
    """Each part with its result, as it is measured; `results` has those of the parts before."""
    from app.evaluation.sections import measure_part

    if options.cluster is None:
        yield from ((part, part.measure(results)) for part in parts)
        return
    with connected(options.cluster):
        # First what needs no other part, then what needs those.
        for needs in (False, True):
            some = [part for part in parts if bool(part.needs) == needs]
            known = {name: results[name] for part in some for name in part.needs}
            measure = functools.partial(measure_part, setup, known)
            names = [part.name for part in some]
            for number, result in on_cluster(measure, names, options.cluster, cpus=setup.threads):
                yield some[number], result


def store_limits(
    options: EvaluateOptions, setup: EvaluationSetup, measured: TrackingLimits | None
) -> str | None:
    """Put what planning is to know beside the weights; gives the file, or None if it is not put."""
    if measured is None or "limits" not in options.sections:
        return None
    if options.controller != "policy":
        say(f"limits of {options.controller} are not stored: it plans with the robot's file")
        return None
    if setup.engine.about is not None:
        say(f"limits in {options.engine} are not stored: plans keep to those in mujoco")
        return None
    path = tracking_limits_path(options.policy, setup.robot)
    if setup.episodes < ENOUGH_EPISODES:
        say(f"{setup.episodes} episodes are too few to tell 99 %: {path} is left as it is")
        return None
    try:
        write_text(path, tracking_limits_text(measured))
    except InputError as error:
        say(f"what planning is to know of this policy is not stored beside it: {error}")
        return None
    return path.name


def document_of(
    setup: EvaluationSetup, parts: Sequence[Part], results: Results, stored: str | None
) -> dict[str, Any]:
    """evaluation.json: what is known of each section; of those not measured there is nothing."""
    from app.evaluation.limits import measured_of
    from app.evaluation.sections import SECTIONS

    document: dict[str, Any] = {
        "format": FORMAT,
        "robot": setup.robot.name,
        **setup.who,
        "trained": setup.trained,
        "episodes": setup.episodes,
        "seed": setup.seed,
        "versions": installed_versions(),
    }
    for section in SECTIONS:
        names = [part.name for part in parts if part.section == section]
        done = [name for name in names if name in results]
        if section == "limits":
            if done == names:
                measured = measured_of(setup, results)
                document[section] = {
                    **{name.removeprefix("limits-"): results[name] for name in names},
                    "measured": None if measured is None else asdict(measured),
                    "stored": stored,
                }
        elif done:
            rows = [results[name] for name in done]
            document[section] = rows if section in TABLES else rows[0]
    return document


def read_beside(folder: Path, robot: str) -> dict[str, Any]:
    """What is shown beside it of another evaluation of this robot, in a folder.

    Raises:
        InputError: No evaluation of this robot's modes is there; says what is.
    """
    path = folder / "evaluation.json"
    try:
        document = read_json(path)
    except OSError as error:
        raise InputError(
            f"--beside: {path} cannot be read ({error.strerror}); give the folder of an evaluation"
        ) from None
    except ValueError:
        document = None
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise InputError(f"--beside: {path} is not an evaluation of format {FORMAT}")
    if document.get("robot") != robot:
        raise InputError(f"--beside: {path} is of {document.get('robot')}, not of {robot}")
    if not document.get("modes"):
        raise InputError(f"--beside: {path} has no modes; measure it with --sections modes")
    return shown_beside(document)


def shown_beside(document: Mapping[str, Any]) -> dict[str, Any]:
    """What a report says of another evaluation."""
    return {key: document[key] for key in SHOWN_BESIDE if key in document}
