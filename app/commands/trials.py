"""The command `trials`: many random walks on one map, and the table of how they ended."""

from __future__ import annotations

import functools
import hashlib
import math
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from app.cluster import ClusterOption
from app.controllers import ControllerOption, load_controlled
from app.navigation.report import Outcome, Percentiles, installed_versions
from app.options import (
    CountOption,
    FolderOption,
    OptionalFile,
    PaceOption,
    PlanningOptions,
    PushOption,
    WorkersOption,
    find_robot_with_limits,
    number,
    read_grid,
)
from app.output import ExitCode, InputError, ProgressBar, claim_folder, say, to_json, write_text
from app.ros.recording import recording, require_recordable
from app.workers import compile_planner, in_order
from controller.policy import Policy
from maps.files import from_json, read_json
from maps.grid import OccupancyGrid
from planner.plan import feet_at
from planner.robot_model import StepModel
from sim.robot import Robot

if TYPE_CHECKING:
    from controller.walker import Controller
    from planner.collision import Terrain

FORMAT = "navigation-trials/1"
TRIALS = "trials.json"
WRITTEN_EVERY_S = 5.0
Pose = tuple[float, float, float]
DRAWS_PER_POSE = 10_000


@dataclass(frozen=True, kw_only=True)
class TrialsOptions(PlanningOptions):
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

    controller: ControllerOption = "policy"
    """Who walks: the trained policy, or a controller by a model, such as lipm (docs/lipm.md)."""

    pace: PaceOption = "normal"
    """How quickly to step, such as fast; turns and climbs are taken no faster than normal."""

    push: PushOption = 0.0
    """Push the robot by so many N s every 3 to 5 seconds of the walk, from anywhere, such as 10."""

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
    robot, policy = load_controlled(options, options.controller, options.pace)
    claim_folder(options.out, option="--out")
    require_recordable(options.record, None)
    file, settings = options.out / TRIALS, settings_of(options, grid, robot, policy)
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
    options: TrialsOptions, grid: OccupancyGrid, robot: Robot, policy: Controller
) -> dict[str, Any]:
    """All that the walks depend on, but for how many there are."""
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
    from app.navigation.navigator import Navigator, NavigatorConfig
    from planner.collision import terrain_of

    robot, policy = load_controlled(options, options.controller, options.pace)
    planner = replace(options.planner_options(), seed=trial.seed)
    navigator = Navigator(
        grid,
        robot,
        policy,
        start=trial.start,
        goal=trial.goal,
        seed=trial.seed,
        config=NavigatorConfig(planner=planner, pace=options.pace, push_n_s=options.push),
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
        "joined": joined,
        "narrow_place": None if report.narrow_place is None else asdict(report.narrow_place),
        "planning_time_s": report.planning_time_s,
        "sim_time_s": report.sim_time_s,
    }


def summarise(results: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Counts of outcomes, and percentiles over all feet placed."""
    outcomes = Counter(result["outcome"] for result in results)
    errors = np.concatenate([result["foot_errors_m"] for result in results] or [[]])
    clearances = [r["min_clearance_m"] for r in results if r["min_clearance_m"] is not None]
    goals = [r["goal_error_m"] for r in results if r["outcome"] == Outcome.REACHED]
    parted = [result for result in results if not result.get("joined", True)]
    return {
        "walks": len(results),
        **{str(outcome): outcomes.get(str(outcome), 0) for outcome in Outcome},
        "unconnected": len(parted),
        "narrow_places": _narrow_places([r["narrow_place"] for r in parted if r["narrow_place"]]),
        "steps_taken": len(errors),
        "replans": sum(result["replans"] for result in results),
        "recovery_steps": sum(result["recovery_steps"] for result in results),
        "foot_error_m": _percentiles(errors),
        "goal_error_m": _percentiles(goals),
        "min_clearance_m": min(clearances, default=None),
        "planning_time_s": _percentiles([result["planning_time_s"] for result in results]),
        "gait": _gait(results),
        "relaxed": dict(sum((Counter(r.get("relaxed", {})) for r in results), Counter())),
        "sim_time_s": sum(result["sim_time_s"] for result in results),
    }


def _narrow_places(places: Sequence[Mapping[str, float]]) -> list[dict[str, float]]:
    """The different ones, to within a decimetre, with how many pairs each parts; most first."""
    at = [(round(place["x"], 1), round(place["y"], 1)) for place in places]
    counted = Counter(at).most_common()
    return [{**places[at.index(spot)], "pairs": count} for spot, count in counted]


def _gait(results: Sequence[Mapping[str, Any]]) -> dict[str, float] | None:
    """Medians over the walks of what their gait was like; None where nobody walked far enough."""
    gaits = [result["gait"] for result in results if result["gait"] is not None]
    if not gaits:
        return None

    def median(name: str) -> float:
        values = [gait[name] for gait in gaits]
        return float(np.median([v["median"] if isinstance(v, Mapping) else v for v in values]))

    names = ("pelvis_height_m", "pelvis_bob_m", "swing_apex_m", "peak_force_weights")
    return {name: median(name) for name in (*names, "cost_of_transport", "speed_m_s")}


def table(summary: Mapping[str, Any]) -> str:
    """The summary for people."""
    walks = summary["walks"]
    rows = {"walks": f"{walks}"}
    for outcome in Outcome:
        count = summary[str(outcome)]
        rows[str(outcome)] = f"{count} ({100 * count / walks:.1f} %)"
    parted = summary["unconnected"]
    if parted:
        rows["reached"] += f", of {walks - parted} that a way joins"
        rows["no_path"] += f"; {parted} pairs lie in parts that this robot cannot pass between"
        rows["no_path"] += "".join(
            f", {place['width_m']:.2f} m wide at {place['x']:.1f},{place['y']:.1f}"
            for place in summary["narrow_places"][:3]
        )
    rows["steps taken"] = f"{summary['steps_taken']}, {summary['recovery_steps']} against a push"
    rows["replans"] = f"{summary['replans']}"
    for key, title in (("foot_error_m", "feet from their steps"), ("goal_error_m", "goal missed")):
        if summary[key] is not None:
            rows[title] = ", ".join(f"{100 * v:.1f} cm {name}" for name, v in summary[key].items())
    if summary["min_clearance_m"] is not None:
        rows["least clearance"] = f"{100 * summary['min_clearance_m']:.1f} cm"
    if summary["gait"] is not None:
        rows["gait (medians)"] = (
            "pelvis {pelvis_height_m:.2f} m, bob {bob:.1f} cm, feet lifted {apex:.1f} cm, "
            "cost of transport {cost_of_transport:.2f} at {speed_m_s:.2f} m/s".format(
                bob=100 * summary["gait"]["pelvis_bob_m"],
                apex=100 * summary["gait"]["swing_apex_m"],
                **summary["gait"],
            )
        )
    if summary["relaxed"]:
        told = (f"{stage} {count}" for stage, count in summary["relaxed"].items())
        rows["constraints dropped"] = ", ".join(told).replace("_", " ")
    return "\n".join(f"{title:<24}{value}" for title, value in rows.items())


def _percentiles(values: ArrayLike) -> dict[str, float] | None:
    found = Percentiles.of(values)
    return None if found is None else asdict(found)
