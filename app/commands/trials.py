"""The command `trials`: many random walks on one map, and the table of how they ended."""

from __future__ import annotations

import functools
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from app.navigation.report import Outcome, Percentiles, installed_versions
from app.options import (
    FolderOption,
    PaceOption,
    PlanningOptions,
    find_robot_with_limits,
    load_walker,
    number,
    read_grid,
    whole_number,
)
from app.output import (
    ExitCode,
    InputError,
    ProgressBar,
    make_folder,
    to_json,
    write_text,
)
from app.workers import in_order
from maps.grid import OccupancyGrid
from planner.options import PlannerOptions
from planner.plan import feet_at

FORMAT = "navigation-trials/1"
Pose = tuple[float, float, float]
DRAWS_PER_POSE = 10_000


@dataclass(frozen=True, kw_only=True)
class TrialsOptions(PlanningOptions):
    """Walk between many random pairs of free poses on a map, and print how it went.

    Start and goal are drawn from all poses at which the robot can stand; the same seed gives
    the same pairs and walks, whatever the number of workers.
    """

    count: Annotated[int, whole_number(at_least=1)] = 100
    """How many pairs, such as 100."""

    apart: Annotated[float, number(at_least=0.0)] = 1.5
    """Least distance in metres between start and goal, such as 1.5."""

    pace: PaceOption = "normal"
    """How quickly to step, such as fast; turns and climbs are taken no faster than normal."""

    workers: Annotated[int, whole_number(at_least=0)] = 0
    """Processes that walk, such as 2; 0 for all cores."""

    out: FolderOption = Path("runs/trials")
    """Folder for trials.json, such as runs/trials; made when missing."""

    json: bool = False
    """Print trials.json on standard output, and nothing else there."""


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One pair to walk; plain values, so that it can go to another process."""

    number: int
    start: Pose
    goal: Pose
    seed: int


@dataclass(frozen=True, kw_only=True)
class TrialSettings:
    """What all trials of a run have in common."""

    grid: OccupancyGrid
    robot: str
    policy: Path | None = None
    planner: PlannerOptions = field(default_factory=PlannerOptions)
    pace: str = "normal"


def run(options: TrialsOptions) -> int:
    """Carries the command out; returns the exit code."""
    grid = read_grid(options)
    robot, _ = load_walker(options.robot, options.policy, options.pace)
    make_folder(options.out, option="--out")
    settings = TrialSettings(
        grid=grid,
        robot=robot.name,
        policy=options.policy,
        planner=options.planner_options(),
        pace=options.pace,
    )
    trials = draw_trials(settings, options.count, options.apart, options.seed)
    results = []
    with ProgressBar("walks", len(trials)) as bar:
        for result in in_order(functools.partial(walk_one, settings), trials, options.workers):
            results.append(result)
            bar.update(len(results), f"{sum(r['outcome'] == 'reached' for r in results)} reached")
    document: dict[str, Any] = {
        "format": FORMAT,
        "map": str(options.map),
        "robot": robot.name,
        "seed": options.seed,
        "versions": installed_versions(),
        "summary": summarise(results),
        "trials": results,
    }
    write_text(options.out / "trials.json", to_json(document))
    print(to_json(document) if options.json else table(document["summary"]) + "\n", end="")
    return ExitCode.DONE


def draw_trials(settings: TrialSettings, count: int, apart_m: float, seed: int) -> list[Trial]:
    """Pairs of free poses, uniform over the map's area and all headings.

    Raises:
        InputError: The robot can hardly stand anywhere on this map, or not so far apart.
    """
    from planner.collision import terrain_of
    from planner.endpoints import what_blocks

    rng = np.random.default_rng(seed)
    model = find_robot_with_limits(settings.robot, settings.policy).step_model
    terrain = terrain_of(settings.grid, settings.planner.unknown_is_free)
    x0, y0, x1, y1 = settings.grid.bounds_world()

    def free_pose() -> Pose:
        for _ in range(DRAWS_PER_POSE):
            x, y, yaw = rng.uniform((x0, y0, -math.pi), (x1, y1, math.pi))
            pose = round(x, 3), round(y, 3), round(yaw, 3)
            feet = feet_at(pose, model.stance_width_m)
            if not what_blocks(settings.grid, terrain, model, feet):
                return pose
        raise InputError("the robot can hardly stand anywhere on this map: there is no free pose")

    trials: list[Trial] = []
    for attempt in range(1000 * count):
        if len(trials) == count:
            break
        start, goal = free_pose(), free_pose()
        if math.dist(start[:2], goal[:2]) >= apart_m:
            trials.append(Trial(number=len(trials), start=start, goal=goal, seed=seed + attempt))
    if len(trials) < count:
        raise InputError(f"--apart: free poses {apart_m:g} m apart can hardly be found on this map")
    return trials


def walk_one(settings: TrialSettings, trial: Trial) -> dict[str, Any]:
    """Plan and walk one pair."""
    from app.navigation.navigator import Navigator, NavigatorConfig

    robot, policy = load_walker(settings.robot, settings.policy)
    navigator = Navigator(
        settings.grid,
        robot,
        policy,
        start=trial.start,
        goal=trial.goal,
        seed=trial.seed,
        config=NavigatorConfig(
            planner=replace(settings.planner, seed=trial.seed), pace=settings.pace
        ),
    )
    navigator.plan()
    while navigator.outcome is None:
        navigator.tick()
    report = navigator.report()
    return {
        "number": trial.number,
        "start": list(trial.start),
        "goal": list(trial.goal),
        "outcome": str(report.outcome),
        "reason": report.reason,
        "goal_error_m": report.goal_error_m,
        "goal_error_rad": report.goal_error_rad,
        "steps_planned": report.steps_planned,
        "steps_taken": report.steps_taken,
        "replans": report.replans,
        "foot_errors_m": [round(placed.error_m, 4) for placed in navigator.placed],
        "min_clearance_m": navigator.min_clearance_m,
        "gait": None if report.gait is None else asdict(report.gait),
        "planning_time_s": report.planning_time_s,
        "sim_time_s": report.sim_time_s,
    }


def summarise(results: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Counts of outcomes, and percentiles over all feet placed."""
    outcomes = Counter(result["outcome"] for result in results)
    errors = np.concatenate([result["foot_errors_m"] for result in results] or [[]])
    first_plans = [result["planning_time_s"] for result in results]
    clearances = [r["min_clearance_m"] for r in results if r["min_clearance_m"] is not None]
    goals = [r["goal_error_m"] for r in results if r["outcome"] == Outcome.REACHED]
    return {
        "walks": len(results),
        **{str(outcome): outcomes.get(str(outcome), 0) for outcome in Outcome},
        "steps_taken": len(errors),
        "replans": sum(result["replans"] for result in results),
        "foot_error_m": _percentiles(errors),
        "goal_error_m": _percentiles(goals),
        "min_clearance_m": min(clearances, default=None),
        "planning_time_s": _percentiles(first_plans),
        "gait": _gait(results),
        "sim_time_s": sum(result["sim_time_s"] for result in results),
    }


def _gait(results: Sequence[Mapping[str, Any]]) -> dict[str, float] | None:
    """Medians over the walks of what their gait was like; None where nobody walked far enough."""
    gaits = [result["gait"] for result in results if result["gait"] is not None]
    if not gaits:
        return None
    values = {
        "pelvis_height_m": [gait["pelvis_height_m"]["median"] for gait in gaits],
        "pelvis_bob_m": [gait["pelvis_bob_m"] for gait in gaits],
        "swing_apex_m": [gait["swing_apex_m"]["median"] for gait in gaits],
        "peak_force_weights": [gait["peak_force_weights"] for gait in gaits],
        "cost_of_transport": [gait["cost_of_transport"] for gait in gaits],
        "speed_m_s": [gait["speed_m_s"] for gait in gaits],
    }
    return {name: float(np.median(of_walks)) for name, of_walks in values.items()}


def table(summary: Mapping[str, Any]) -> str:
    """The summary for people."""
    walks = summary["walks"]
    rows = [f"{'walks':<24}{walks}"]
    for outcome in Outcome:
        count = summary[str(outcome)]
        rows.append(f"{outcome:<24}{count} ({100 * count / walks:.1f} %)")
    rows.append(f"{'steps taken':<24}{summary['steps_taken']}")
    rows.append(f"{'replans':<24}{summary['replans']}")
    for key, title in (("foot_error_m", "feet from their steps"), ("goal_error_m", "goal missed")):
        values = summary[key]
        if values is not None:
            shown = ", ".join(f"{100 * v:.1f} cm {name}" for name, v in values.items())
            rows.append(f"{title:<24}{shown}")
    if summary["min_clearance_m"] is not None:
        rows.append(f"{'least clearance':<24}{100 * summary['min_clearance_m']:.1f} cm")
    if summary["gait"] is not None:
        rows.append(
            "{:<24}pelvis {pelvis_height_m:.2f} m, bob {bob:.1f} cm, feet lifted {apex:.1f} cm, "
            "cost of transport {cost_of_transport:.2f} at {speed_m_s:.2f} m/s".format(
                "gait (medians)",
                bob=100 * summary["gait"]["pelvis_bob_m"],
                apex=100 * summary["gait"]["swing_apex_m"],
                **summary["gait"],
            )
        )
    return "\n".join(rows)


def _percentiles(values: ArrayLike) -> dict[str, float] | None:
    found = Percentiles.of(values)
    return None if found is None else asdict(found)
