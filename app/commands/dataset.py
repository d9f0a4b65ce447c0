"""The command `dataset`: a corpus of plans to random goals, with its manifest and pictures."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import math
import os
import shutil
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from app.commands.dataset_options import DatasetOptions
from app.navigation.report import installed_versions
from app.options import Interval, MapOptions, Pose, find_robot, read_grid
from app.output import ExitCode, InputError, ProgressBar, make_folder, say, write_text
from app.workers import in_order, portions
from maps.map_files import HEIGHTS, IMAGE, YAML, copy_map, find_map
from planner.corpus.corpus import MANIFEST, PLANS, Corpus, corpus_of
from planner.corpus.generate import Drawn, RandomPlans, floor_around, random_plans
from planner.options import PlannerOptions
from sim.robot import Robot

TEXT, SHEET, HISTOGRAMS = "plans.txt", "plans.png", "steps.png"
# All that a corpus may have.
PATTERNS = (PLANS, YAML, f"{IMAGE}.*", f"{HEIGHTS}.*", TEXT, SHEET, HISTOGRAMS, MANIFEST)
GOAL_X_M, GOAL_Y_M = Interval(0.0, 2.0), Interval(-1.0, 1.0)
GOAL_YAW_RAD = Interval(-math.pi / 2, math.pi / 2)
ANY_HEADING = Interval(-math.pi, math.pi)
ORIGIN = Pose(0.0, 0.0, 0.0)
# States to look at for one plan before it counts as failed, in place of a limit on the clock.
MOST_EXPANSIONS = 300_000
PORTION = 25


def run(options: DatasetOptions) -> int:
    """Carries the command out; returns the exit code."""
    began = time.perf_counter()
    robot = find_robot(options.robot)
    wanted = wanted_plans(options, robot)
    with folder_to_fill(options.out) as folder:
        drawn = draw(wanted, options.count, options.workers)
        drawn_s = time.perf_counter() - began
        corpus = corpus_of([d.plan for d in drawn if d.plan], robot.name, [d.box for d in drawn])
        corpus.save(folder, manifest_of(options, wanted, drawn))
        if options.map is not None:
            copy_map(
                find_map(options.map, resolution_m=options.resolution, origin=options.origin),
                folder,
            )
        if options.format == "lhw":
            write_text(folder / TEXT, lhw_text(corpus, wanted.model.stance_width_m))
        write_pictures(folder, corpus, wanted)
        document = (folder / MANIFEST).read_text(encoding="utf-8")
    if options.json:
        print(document, end="")
    say(summary(drawn, drawn_s, time.perf_counter() - began))
    return ExitCode.DONE


def wanted_plans(options: DatasetOptions, robot: Robot) -> RandomPlans:
    """What the options ask for.

    Raises:
        InputError: The map cannot be read, or there is none for options that are about it.
    """
    start = options.start
    if options.map is None:
        if options.resolution or options.origin or options.unknown_is_free:
            raise InputError(
                "--resolution, --origin and --unknown-is-free are about a map: give --map too"
            )
        start = start or ORIGIN
        x, y = options.goal_x or GOAL_X_M, options.goal_y or GOAL_Y_M
        yaw = options.goal_yaw or GOAL_YAW_RAD
        corners = (x.low, y.low, 0.0), (x.high, y.high, 0.0)
        grid = floor_around([*corners, start], robot.step_model)
    else:
        grid = read_grid(
            MapOptions(
                map=options.map,
                resolution=options.resolution,
                origin=options.origin,
                unknown_is_free=options.unknown_is_free,
            )
        )
        x0, y0, x1, y1 = grid.bounds_world()
        x, y = options.goal_x or Interval(x0, x1), options.goal_y or Interval(y0, y1)
        yaw = options.goal_yaw or ANY_HEADING
    return RandomPlans(
        grid=grid,
        model=robot.step_model,
        goal_x_m=x,
        goal_y_m=y,
        goal_yaw_rad=yaw,
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


def draw(wanted: RandomPlans, count: int, workers: int) -> list[Drawn]:
    """So many plans, in the order of their numbers.

    Raises:
        InputError: For one of them no draw gave a plan.
    """
    drawn: list[Drawn] = []
    jobs = portions(count, workers, PORTION)
    with ProgressBar("plans", count) as bar:
        for some in in_order(functools.partial(random_plans, wanted), jobs, workers):
            for one in some:
                if one.plan is None:
                    raise InputError(_why_none(len(drawn), one))
                drawn.append(one)
            bar.update(len(drawn))
    return drawn


def _why_none(number: int, failed: Drawn) -> str:
    total = failed.refused.total()
    causes = ", ".join(f"{count} {cause}" for cause, count in failed.refused.most_common())
    return (
        f"plan {number} cannot be drawn: {total} of {total} draws of start and goal failed "
        f"({causes}); the last one: {failed.reason}; try other ranges or fewer obstacles"
    )


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


def summary(drawn: list[Drawn], drawn_s: float, whole_s: float) -> str:
    """How much was made and how fast, in one line."""
    steps = sum(len(one.plan) for one in drawn if one.plan)
    expansions = sum(one.plan.expansions for one in drawn if one.plan)
    refused = sum(one.refused.total() for one in drawn)
    return (
        f"{len(drawn)} plans with {steps} steps in {drawn_s:.1f} s "
        f"({len(drawn) / drawn_s:.0f} plans/s, {expansions / drawn_s:.0f} expansions/s), "
        f"{whole_s:.1f} s in all; {refused} draws refused"
    )


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
        x_m, y_m, yaw_rad = corpus.start[i]
        cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
        away = pose[:, :2] - (x_m, y_m)
        steps = [(0.0, half_m if side[0] == 1 else -half_m, 0.0)] if len(side) else []
        steps += zip(
            cos * away[:, 0] + sin * away[:, 1],
            cos * away[:, 1] - sin * away[:, 0],
            [math.remainder(yaw - yaw_rad, 2 * math.pi) for yaw in pose[:, 3]],
            strict=True,
        )
        lines += [",".join(repr(float(value)) for value in step) for step in steps]
        lines.append("---")
    return "\n".join(lines) + "\n"


def write_pictures(folder: Path, corpus: Corpus, wanted: RandomPlans) -> None:
    """The contact sheet of some plans and the histograms of all steps."""
    # Here and not above: wrong input need not wait for matplotlib.
    from app.pictures.dataset_pictures import write_contact_sheet, write_histograms

    write_contact_sheet(
        folder / SHEET, corpus, wanted.grid, wanted.model, one_scale=wanted.start is not None
    )
    write_histograms(folder / HISTOGRAMS, corpus, wanted.model)


@contextlib.contextmanager
def folder_to_fill(out: Path) -> Iterator[Path]:
    """Gives a temporary folder; on leaving, its files take the place of the old corpus in `out`.

    If the block raises, nothing is left and an old corpus stays as it was.

    Raises:
        InputError: The folder cannot be made or written.
    """
    was_there = out.exists()
    make_folder(out, option="--out")
    stage = None
    try:
        stage = Path(tempfile.mkdtemp(prefix=".dataset-", dir=out))
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
            with contextlib.suppress(OSError):
                out.rmdir()
