"""The commands `dataset` and `dataset check`: a corpus of plans, and the check of its steps."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import math
import os
import shutil
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from app.cluster import ClusterOption
from app.navigation.report import installed_versions
from app.options import (
    ABOUT_MAP,
    CountOption,
    FolderArgument,
    FolderOption,
    Interval,
    MapOptions,
    OptionalAngles,
    OptionalFile,
    OptionalInterval,
    OptionalPose,
    Pose,
    RobotName,
    SeedOption,
    WorkersOption,
    choice,
    find_robot,
    read_grid,
    text,
    whole_number,
)
from app.output import (
    ExitCode,
    InputError,
    ProgressBar,
    as_bad_input,
    claim_folder,
    refuse_given,
    release_folder,
    say,
    to_json,
    write_text,
)
from app.workers import compile_planner, in_order, portions
from maps.map_files import HEIGHTS, IMAGE, YAML, MapError, copy_map, find_map
from planner.corpus.corpus import MANIFEST, PLANS, Corpus, CorpusError, corpus_of
from planner.options import PLANNERS, PlannerOptions
from planner.plan import to_frame
from sim.robot import Robot

if TYPE_CHECKING:
    from planner.corpus.generate import Drawn, RandomPlans

FORMATS = ("npz", "lhw")
STAGE = ".dataset-"  # begins the name of the folder in which a corpus is made
TEXT, SHEET, HISTOGRAMS = "plans.txt", "plans.png", "steps.png"
# All files that a corpus may have.
PATTERNS = (PLANS, YAML, f"{IMAGE}.*", f"{HEIGHTS}.*", TEXT, SHEET, HISTOGRAMS, MANIFEST)
GOAL_X_M, GOAL_Y_M = Interval(0.0, 2.0), Interval(-1.0, 1.0)
GOAL_YAW_RAD = Interval(-math.pi / 2, math.pi / 2)
ANY_HEADING = Interval(-math.pi, math.pi)
ORIGIN = Pose(0.0, 0.0, 0.0)
# Expansions for one plan before it counts as failed: no clock, so that corpora repeat.
MOST_EXPANSIONS = 300_000
DRAW_PORTION = 25
CHECK_FORMAT = "footstep-corpus-check/1"
CHECK_PORTION = 50
_SHOWN = 20


@dataclass(frozen=True, kw_only=True)
class DatasetOptions(MapOptions):
    """Plan footsteps to many random goals: a corpus to train on.

    Without a map every plan begins at 0,0,0 on an empty floor and ends up to 2 m ahead, up to 1 m
    aside, turned by up to 90 degrees. The folder gets plans.npz, manifest.json and two pictures,
    plans.png and steps.png. The same seed gives the same plans whatever the number of workers.
    `dataset check DIR` checks every step of a corpus by independent geometry.
    """

    out: FolderOption
    """Folder of the corpus, such as runs/corpus; made when missing."""

    count: CountOption = 1000
    """How many plans, such as 1000."""

    robot: RobotName = "jvrc1"
    """Whose footsteps, such as jvrc1."""

    seed: SeedOption = 0
    """Seed of all that is drawn, such as 7."""

    goal_x: OptionalInterval = None
    """Range of the goals' x in metres, such as 0,4; none: 0,2, or the whole map."""

    goal_y: OptionalInterval = None
    """Range of the goals' y in metres, such as -2,2; none: -1,1, or the whole map."""

    goal_yaw: OptionalAngles = None
    """Range of the goals' yaw, such as -90deg,90deg or -1,1 in radians; none: a quarter turn, on a
    map any heading."""

    start: OptionalPose = None
    """Where every plan starts, such as 0,0,0; none: 0,0,0, on a map anywhere."""

    obstacles: Annotated[int, whole_number(at_least=0, at_most=1000)] = 0
    """Boxes of random size and place for each plan anew, such as 5."""

    map: OptionalFile = None  # type: ignore[assignment]  # here a map is not needed
    """Draw start and goal on this map, such as maps/room.png."""

    planner: Annotated[str, choice(*PLANNERS)] = PlannerOptions.name
    """Which search, such as ara."""

    refine: bool = False
    """Move the steps of each plan off the lattice to where they cost less."""

    workers: WorkersOption = 0
    """Processes that plan, such as 2; 0 for all cores."""

    cluster: ClusterOption = None
    """Ray cluster that does the work, such as auto or 10.0.0.1:6379; none: this machine alone."""

    format: Annotated[str, choice(*FORMATS)] = "npz"
    """The default npz alone, or such as lhw: also plans.txt, which the paper's own code reads."""

    json: bool = False
    """Print manifest.json on standard output, and nothing else there."""


@dataclass(frozen=True, kw_only=True)
class DatasetCheckOptions:
    """Check every step of every plan of a corpus by independent, exact geometry.

    Feet alternate, steps are within the limits, feet keep their gap, feet and body are off every
    obstacle, the last two feet are those of the goal. The exit code is 2 if any plan fails.
    """

    folder: FolderArgument
    """Folder of the corpus, such as runs/corpus."""

    robot: Annotated[str | None, text("NAME")] = None
    """Check against this robot as it is now, such as jvrc1; none: as the manifest tells."""

    workers: WorkersOption = 0
    """Processes that check, such as 2; 0 for all cores."""

    json: bool = False
    """Print what was found as a document on standard output, and nothing else there."""


def run(options: DatasetOptions) -> int:
    """Carries the command out; returns the exit code."""
    began = time.perf_counter()
    robot = find_robot(options.robot)
    wanted = wanted_plans(options, robot)
    # Here and not above: wrong input need not wait for matplotlib.
    from app.pictures.dataset_pictures import write_contact_sheet, write_histograms

    with folder_to_fill(options.out) as folder:
        drawn = draw(wanted, options.count, options.workers, options.cluster)
        drawn_s = time.perf_counter() - began
        corpus = corpus_of([d.plan for d in drawn if d.plan], robot.name, [d.box for d in drawn])
        manifest = manifest_of(options, wanted, drawn)
        corpus.save(folder, manifest)
        if options.map is not None:
            copy_map(
                find_map(options.map, resolution_m=options.resolution, origin=options.origin),
                folder,
            )
        if options.format == "lhw":
            write_text(folder / TEXT, lhw_text(corpus, wanted.model.stance_width_m))
        one_scale = wanted.start is not None
        write_contact_sheet(folder / SHEET, corpus, wanted.grid, wanted.model, one_scale=one_scale)
        write_histograms(folder / HISTOGRAMS, corpus, wanted.model)
        document = (folder / MANIFEST).read_text(encoding="utf-8")
    if options.json:
        print(document, end="")
    count, expansions = len(corpus), manifest["expansions"]
    say(
        f"{count} plans with {len(corpus.side)} steps in {drawn_s:.1f} s "
        f"({count / drawn_s:.0f} plans/s, {expansions / drawn_s:.0f} expansions/s), "
        f"{time.perf_counter() - began:.1f} s in all; {manifest['draws'] - count} draws refused"
    )
    return ExitCode.DONE


def wanted_plans(options: DatasetOptions, robot: Robot) -> RandomPlans:
    """What the options ask for.

    Raises:
        InputError: The map cannot be read, or there is none for options that are about it.
    """
    from planner.corpus.generate import RandomPlans, floor_around

    start = options.start
    if options.map is None:
        refuse_given(options, ABOUT_MAP, "is about a map: give --map too")
        start = start or ORIGIN
        x, y, yaw = options.goal_x or GOAL_X_M, options.goal_y or GOAL_Y_M, GOAL_YAW_RAD
        corners = (x.low, y.low, 0.0), (x.high, y.high, 0.0)
        with as_bad_input(ValueError):
            grid = floor_around([*corners, start], robot.step_model)
    else:
        grid = read_grid(options)
        x0, y0, x1, y1 = grid.bounds_world()
        x, y = options.goal_x or Interval(x0, x1), options.goal_y or Interval(y0, y1)
        yaw = ANY_HEADING
    return RandomPlans(
        grid=grid,
        model=robot.step_model,
        goal_x_m=x,
        goal_y_m=y,
        goal_yaw_rad=options.goal_yaw or yaw,
        start=start,
        obstacles=options.obstacles,
        seed=options.seed,
        options=PlannerOptions(
            name=options.planner,
            max_expansions=MOST_EXPANSIONS,
            refine=options.refine,
            unknown_is_free=options.unknown_is_free,
        ),
    )


def draw(wanted: RandomPlans, count: int, workers: int, cluster: str | None = None) -> list[Drawn]:
    """So many plans, in the order of their numbers.

    Raises:
        InputError: For one of them no draw gave a plan.
    """
    from planner.corpus.generate import random_plans

    # Once, and not in every worker.
    compile_planner(wanted.model, wanted.options)
    drawn: list[Drawn] = []
    jobs = portions(count, workers, DRAW_PORTION)
    with ProgressBar("plans", count) as bar:
        plans = functools.partial(random_plans, wanted)
        for some in in_order(plans, jobs, workers, cluster=cluster):
            for one in some:
                if one.plan is None:
                    total = one.refused.total()
                    causes = ", ".join(f"{n} {cause}" for cause, n in one.refused.most_common())
                    raise InputError(
                        f"plan {len(drawn)} cannot be drawn: {total} of {total} draws of start and "
                        f"goal failed ({causes}); the last one: {one.reason}; try other ranges or "
                        "fewer obstacles"
                    )
                drawn.append(one)
            bar.update(len(drawn))
    return drawn


def manifest_of(options: DatasetOptions, wanted: RandomPlans, drawn: list[Drawn]) -> dict[str, Any]:
    """What made the corpus: nothing here depends on the clock or on the workers."""
    refused = sum((one.refused for one in drawn), Counter())
    grid = wanted.grid
    return {
        "seed": options.seed,
        "draws": len(drawn) + refused.total(),
        "refused": dict(sorted(refused.items())),
        "expansions": sum(one.plan.expansions for one in drawn if one.plan),
        "start": wanted.start,
        "goal_x_m": wanted.goal_x_m,
        "goal_y_m": wanted.goal_y_m,
        "goal_yaw_rad": wanted.goal_yaw_rad,
        "obstacles": options.obstacles,
        "map": None if options.map is None else {"read": str(options.map), "file": YAML},
        "floor": {
            "rows": grid.shape[0],
            "cols": grid.shape[1],
            "resolution_m": grid.resolution_m,
            "origin": grid.origin,
        },
        "planner": dataclasses.asdict(wanted.options),
        "step_model": dataclasses.asdict(wanted.model),
        "versions": installed_versions(("numpy", "numba", "opencv-python-headless")),
    }


def lhw_text(corpus: Corpus, stance_width_m: float) -> str:
    """The plans as the text that the paper's reference code reads.

    Each plan begins with the foot that stands while the other takes the first step; x and y are in
    the frame of the pair pose at the start. A line `---` stands before, between and after the
    plans: a reader that keeps a plan when it meets the next one keeps the last one too.
    """
    lines = ["---"]
    half_m = stance_width_m / 2
    for i in range(len(corpus)):
        side, pose = corpus.plan(i)
        x_m, y_m, _ = to_frame(pose[:, [0, 1, 3]], corpus.start[i]).T
        turns = [math.remainder(yaw - corpus.start[i, 2], 2 * math.pi) for yaw in pose[:, 3]]
        steps = [(0.0, half_m if side[0] == 1 else -half_m, 0.0)] if len(side) else []
        steps += zip(x_m, y_m, turns, strict=True)
        lines += [",".join(repr(float(value)) for value in step) for step in steps]
        lines.append("---")
    return "\n".join(lines) + "\n"


@contextlib.contextmanager
def folder_to_fill(out: Path) -> Iterator[Path]:
    """Gives a temporary folder; on leaving, its files take the place of the old corpus in `out`.

    If the block raises, nothing is left and an old corpus stays as it was.

    Raises:
        InputError: The folder cannot be made or written.
    """
    was_there = out.exists()
    claim_folder(out, option="--out")
    stage = None
    for left in out.glob(f"{STAGE}*"):  # by one that was killed
        shutil.rmtree(left, ignore_errors=True)
    try:
        stage = Path(tempfile.mkdtemp(prefix=STAGE, dir=out))
        yield stage
        # The manifest comes last: it says that the rest is there.
        new = sorted((path.name for path in stage.iterdir()), key=lambda name: name == MANIFEST)
        for old in (path for pattern in PATTERNS for path in out.glob(pattern)):
            if old.name not in new:
                old.unlink(missing_ok=True)
        for name in new:
            os.replace(stage / name, out / name)
    except OSError as error:
        raise InputError(f"--out: cannot write {out}: {error.strerror or error}") from error
    finally:
        if stage is not None:
            shutil.rmtree(stage, ignore_errors=True)
        if not was_there:
            release_folder(out)
            with contextlib.suppress(OSError):
                out.rmdir()


def run_check(options: DatasetCheckOptions) -> int:
    """Carries the command out; returns the exit code."""
    from planner.corpus.check import check_plans, plan_of, rules_of

    with as_bad_input(CorpusError, MapError):
        corpus = Corpus.load(options.folder, even_if_changed=True)
        rules = rules_of(options.folder, corpus)
    if options.robot is not None:
        rules = dataclasses.replace(rules, model=find_robot(options.robot).step_model)
    portion_of = portions(len(corpus), options.workers, CHECK_PORTION)
    width_m = rules.model.stance_width_m
    jobs = [[(plan_of(corpus, i, width_m), corpus.box[i]) for i in some] for some in portion_of]
    wrong: dict[int, list[str]] = {}  # by the number of the plan
    with ProgressBar("plans", len(corpus)) as bar:
        found = in_order(functools.partial(check_plans, rules), jobs, options.workers)
        for numbers, lines in zip(portion_of, found, strict=True):
            wrong |= {n: those for n, those in zip(numbers, lines, strict=True) if those}
            bar.update(numbers.stop, f"{len(wrong)} wrong" if wrong else "")
    digest = hashlib.sha256((options.folder / PLANS).read_bytes()).hexdigest()
    changed = digest != corpus.manifest.get("sha256")
    document = {
        "format": CHECK_FORMAT,
        "folder": str(options.folder),
        "robot": options.robot or corpus.robot,
        "plans": len(corpus),
        "steps": len(corpus.side),
        "changed": changed,
        "wrong": {str(number): lines for number, lines in wrong.items()},
    }
    if options.json:
        print(to_json(document), end="")
    else:
        counts = f"{len(corpus)} plans with {len(corpus.side)} steps"
        print(f"{counts}: " + (f"{len(wrong)} plans are wrong" if wrong else "all are right"))
    told = [f"plan {number}: {line}" for number, lines in wrong.items() for line in lines]
    for line in told[:_SHOWN]:
        say(line)
    if len(told) > _SHOWN:
        say(f"... and {len(told) - _SHOWN} more; --json shows all")
    if changed:
        say(f"{PLANS} is not the file that {MANIFEST} was written for")
    return ExitCode.BAD_INPUT if wrong or changed else ExitCode.DONE
