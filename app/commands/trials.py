"""The command `trials`: many random walks on one map, and the table of how they ended."""

from __future__ import annotations

import functools
import hashlib
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from app.cluster import ClusterOption
from app.evaluation.trials_summary import summarise, table
from app.navigation.report import Outcome, installed_versions
from app.options import (
    CountOption,
    FolderOption,
    OptionalFile,
    WorkersOption,
    find_robot_with_limits,
    number,
    read_grid,
)
from app.output import ExitCode, InputError, ProgressBar, claim_folder, say, to_json, write_text
from app.ros.recording import recording, require_recordable
from app.walk_options import WalkOptions
from app.workers import compile_planner, in_order
from controller.policy import Policy
from maps.files import from_json, read_json
from maps.grid import OccupancyGrid
from planner.plan import feet_at
from planner.robot_model import StepModel
from sim.robot import Robot

if TYPE_CHECKING:
    from app.navigation.navigator import Navigator
    from controller.walker import Controller
    from planner.collision import Terrain

FORMAT = "navigation-trials/1"
TRIALS = "trials.json"
WRITTEN_EVERY_S = 5.0
Pose = tuple[float, float, float]
DRAWS_PER_POSE = 10_000


@dataclass(frozen=True, kw_only=True)
class TrialsOptions(WalkOptions):
    """Walk between many random pairs of free poses on a map, and print how it went.

    Start and goal are drawn from all poses at which the robot can stand; the same seed gives
    the same pairs and walks, whatever the number of workers.
    """

    count: CountOption = 100
    """How many pairs, such as 100."""

    apart: Annotated[float, number(at_least=0.0)] = 1.5
    """Least distance in metres between start and goal, such as 1.5."""

    reachable: bool = False
    """Draw only pairs between which the robot can walk facing ahead, by the width of the way."""

    workers: WorkersOption = 0
    """Processes that walk, such as 2; 0 for all cores."""

    cluster: ClusterOption = None
    """Ray cluster that does the work, such as auto or 10.0.0.1:6379; none: this machine alone."""

    out: FolderOption = Path("runs/trials")
    """Folder for trials.json, such as runs/trials; made when missing."""

    record: OptionalFile = None
    """Also write an MCAP file a walk, such as walk.mcap: walk-0.mcap, walk-1.mcap and so on."""

    resume: bool = False
    """Go on with the trials in the folder: what they have walked is not walked again."""

    json: bool = False
    """Print trials.json on standard output, and nothing else there."""


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One pair to walk; plain values, so that it can go to another process."""

    number: int
    start: Pose
    goal: Pose
    seed: int


def run(options: TrialsOptions) -> int:
    """Carries the command out; returns the exit code."""
    grid = read_grid(options)
    robot, policy, engine = options.load()
    claim_folder(options.out, option="--out")
    require_recordable(options.record, None)
    file, settings = options.out / TRIALS, settings_of(options, grid, robot, policy, engine.about)
    results = finished(file, settings)[: options.count] if options.resume else []
    trials = draw_trials(grid, options)
    compile_planner(robot.step_model, options.planner_options())  # once, not in every worker

    def written() -> dict[str, Any]:
        """What trials.json holds now."""
        document = {
            "format": FORMAT,
            "map": str(options.map),
            "robot": robot.name,
            "seed": options.seed,
            "settings": settings,
            "versions": installed_versions(),
            "summary": summarise(results),
            "trials": results,
        }
        write_text(file, to_json(document))
        return document

    written_s = time.monotonic()
    try:
        with ProgressBar("walks", len(trials)) as bar:
            walk = functools.partial(walk_one, grid, with_whole_paths(options))
            missing = trials[len(results) :]
            for result in in_order(walk, missing, options.workers, cluster=options.cluster):
                results.append(result)
                reached = sum(r["outcome"] == "reached" for r in results)
                bar.update(len(results), f"{reached} reached")
                if time.monotonic() - written_s > WRITTEN_EVERY_S:
                    written()
                    written_s = time.monotonic()
    except KeyboardInterrupt:
        if results:
            written()
            say(f"{len(results)} of {len(trials)} walks are in {file}; --resume goes on with them")
        raise
    document = written()
    print(to_json(document) if options.json else table(document["summary"]) + "\n", end="")
    return ExitCode.DONE


def settings_of(
    options: TrialsOptions,
    grid: OccupancyGrid,
    robot: Robot,
    policy: Controller,
    engine: Mapping[str, Any] | None,
) -> dict[str, Any]:
    """All that the walks depend on, but for how many there are."""
    sensing = options.sensing()
    ground = hashlib.sha256(repr((grid.shape, grid.resolution_m, grid.origin)).encode())
    ground.update(grid.cells.tobytes())
    if grid.elevation_m is not None:
        ground.update(grid.elevation_m.tobytes())
    return {
        "map_sha256": ground.hexdigest(),
        "controller": options.controller,
        "policy_sha256": policy.about["sha256"] if isinstance(policy, Policy) else None,
        "step_model": asdict(robot.step_model),
        "planner": asdict(options.planner_options()),
        "apart_m": options.apart,
        "reachable": options.reachable,
        "pace": options.pace,
        "push_n_s": options.push,
        "sensing": sensing and asdict(sensing),
        "engine": engine,
        "hardware": options.hardware and asdict(options.hardware),
    }


def finished(file: Path, settings: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The walks in a file of trials, from the first one on.

    Raises:
        InputError: There is no such file, or its walks depend on something else.
    """
    try:
        document = read_json(file)
        known, trials = document["settings"], list(document["trials"])
        known.keys()
        to_json({"summary": summarise(trials), "trials": trials})
    except (OSError, ValueError, KeyError, TypeError, AttributeError, IndexError):
        raise InputError(f"--resume: {file} holds no trials to go on with") from None
    wanted = from_json(to_json(settings))
    for name in wanted:
        if known.get(name) != wanted[name]:
            raise InputError(
                f"--resume: the trials in {file} have another {name}; give the same options, or "
                "another --out"
            )
    return trials


def draw_trials(grid: OccupancyGrid, options: TrialsOptions) -> list[Trial]:
    """Pairs of free poses, uniform over the map's area and all headings.

    Raises:
        InputError: The robot can hardly stand anywhere on this map, or not so far apart.
    """
    from planner.collision import terrain_of
    from planner.endpoints import what_blocks

    rng = np.random.default_rng(options.seed)
    model = find_robot_with_limits(options.robot, options.policy).step_model
    terrain = terrain_of(grid, options.unknown_is_free)
    x0, y0, x1, y1 = grid.bounds_world()

    def free_pose() -> Pose:
        for _ in range(DRAWS_PER_POSE):
            x, y, yaw = rng.uniform((x0, y0, -math.pi), (x1, y1, math.pi))
            pose = round(x, 3), round(y, 3), round(yaw, 3)
            if not what_blocks(grid, terrain, model, feet_at(pose, model.stance_width_m)):
                return pose
        raise InputError("the robot can hardly stand anywhere on this map: there is no free pose")

    are_joined = wide_ways(grid, terrain, model) if options.reachable else lambda *_: True

    trials: list[Trial] = []
    for seed in range(options.seed, options.seed + 1000 * options.count):
        start, goal = free_pose(), free_pose()
        if math.dist(start[:2], goal[:2]) >= options.apart and are_joined(start, goal):
            trials.append(Trial(number=len(trials), start=start, goal=goal, seed=seed))
            if len(trials) == options.count:
                return trials
    joined = " that a way joins" if options.reachable else ""
    raise InputError(
        f"--apart: free poses {options.apart:g} m apart{joined} can hardly be found on this map"
    )


def wide_ways(
    grid: OccupancyGrid, terrain: Terrain, model: StepModel
) -> Callable[[Sequence[float], Sequence[float]], bool]:
    """Tells whether a way on which the robot can walk facing ahead joins two poses."""
    from planner.search.passages import components, needed_m

    part = components(terrain.clearance_m, needed_m(model) / 2)

    def are_joined(start: Sequence[float], goal: Sequence[float]) -> bool:
        row, col = grid.world_to_cell([start[:2], goal[:2]]).T
        first, last = part[row, col]
        return bool(first == last > 0)

    return are_joined


def with_whole_paths(options: TrialsOptions) -> TrialsOptions:
    """The options with files that a process in another folder finds or puts where they belong."""
    policy, record = (path and path.resolve() for path in (options.policy, options.record))
    return replace(options, policy=policy, record=record)


def walk_one(grid: OccupancyGrid, options: TrialsOptions, trial: Trial) -> dict[str, Any]:
    """Plan and walk one pair."""
    from app.navigation.navigator import Navigator
    from planner.collision import terrain_of

    robot, policy, engine = options.load()
    planner = replace(options.planner_options(), seed=trial.seed)
    navigator = Navigator(
        grid,
        robot,
        policy,
        start=trial.start,
        goal=trial.goal,
        seed=trial.seed,
        config=options.navigator_config(engine, planner),
    )
    file = options.record and options.record.with_stem(f"{options.record.stem}-{trial.number}")
    with recording(navigator, record=file, bag=None) as recorder:
        navigator.plan()
        while navigator.outcome is None:
            navigator.tick()
            if recorder is not None:
                recorder.ticked()
        report = navigator.report(map=str(options.map))
        if recorder is not None:
            recorder.ended(report.to_json())
    joined = report.outcome is not Outcome.NO_PATH
    if not joined:
        terrain = terrain_of(grid, options.unknown_is_free)
        joined = wide_ways(grid, terrain, robot.step_model)(trial.start, trial.goal)
    told = (
        *("goal_error_m", "goal_error_rad"),
        *("steps_planned", "steps_taken", "replans", "recovery_steps"),
    )
    return {
        "number": trial.number,
        "start": list(trial.start),
        "goal": list(trial.goal),
        "outcome": str(report.outcome),
        "reason": report.reason,
        **{name: getattr(report, name) for name in told},
        "foot_errors_m": [round(placed.error_m, 4) for placed in navigator.placed],
        "min_clearance_m": navigator.min_clearance_m,
        "gait": None if report.gait is None else asdict(report.gait),
        "relaxed": navigator.walker.relaxed[0],
        "sensed": _sensed(navigator),
        "joined": joined,
        "narrow_place": None if report.narrow_place is None else asdict(report.narrow_place),
        "planning_time_s": report.planning_time_s,
        "sim_time_s": report.sim_time_s,
    }


def _sensed(navigator: Navigator) -> dict[str, Any] | None:
    """How well the robot knew where it was; None where it knew its true state."""
    sensing = navigator.sensing
    if sensing is None:
        return None
    errors_m = [round(error_m, 4) for error_m in sensing.own_errors_m]
    return {**asdict(sensing.summary()), "own_foot_errors_m": errors_m}
