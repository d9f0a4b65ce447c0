"""Plans by sampling: OMPL finds a path of the body, footsteps follow it, ARA* bridges gaps.

There is no lower bound, so epsilon is infinite. Poses (n, 3) are x_m, y_m, yaw_rad in the grid
frame. The steps are told in docs/notes/planner_design.md.
"""

from __future__ import annotations

import contextlib
import math
import time
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from maps.grid import OccupancyGrid, distance_field
from planner.collision import Terrain, radius_of
from planner.heuristics.heuristic import tables_of
from planner.lattice.lattice import build_lattice
from planner.lattice.steps import MICRO
from planner.options import PlannerOptions
from planner.plan import PlanStatus, from_frame, to_frame
from planner.robot_model import StepModel
from planner.sampling.footsteps_along_path import (
    NO_STEPS,
    Footsteps,
    PathFootsteps,
    Stance,
    cost_of,
    resample,
)
from planner.sampling.ompl_paths import (
    EFFORTS,
    BodyQuery,
    SampledPath,
    find_path,
    nearest_standing,
    outline_of,
)
from planner.sampling.path_headings import choose_headings
from planner.search.ara_star import plan_ara
from planner.search.first_plan import is_cut_off
from planner.search.problem import (
    GoalContext,
    Request,
    Result,
    failure,
    no_body_path,
    no_first_step,
)
from planner.search.reachability import Floods
from planner.search.shut_passages import is_shut
from planner.time_limit import OutOfTime, check_time, is_late, time_left_s

FloatArray = NDArray[np.float64]
_GAP_EXPANSIONS = 20_000
_GAP_MARGIN_M = 1.0
# By how many points of the path (2.5 cm or 3 degrees apart) a search over a gap begins before it
# and ends behind it; the next if one fails.
_GAPS = ((8, 24), (24, 60), (60, 140))
# Room beside the body on both sides of the path; the next if a corridor holds no plan.
_CORRIDORS_M = (0.5, 2.0)
_FLOOD_NODES = 1 << 17  # of each flood
_NEAR_M = 0.5  # how far from the start the body's path may begin
_PATH_SHARE = 0.5  # of the time that is left: steps along the path take time too
_FIRST_ITERATIONS = 2_000  # before the lattice is asked whether there is any way


@dataclass(frozen=True, kw_only=True)
class Window:
    """Terrain of a rectangle of cells; corner_m (2,): its first corner in the grid frame.

    Plans in a window are valid on the map; proofs that there is none are not.
    """

    terrain: Terrain
    corner_m: FloatArray


def window_around(terrain: Terrain, points: FloatArray, margin_m: float) -> Window:
    """The window around points (n, 2) with a margin."""
    size = terrain.resolution_m
    low = np.floor((points.min(axis=0) - margin_m) / size).astype(int)
    high = np.ceil((points.max(axis=0) + margin_m) / size).astype(int)
    col0, row0 = (int(v) for v in np.maximum(low, 0))
    rows, cols = terrain.blocked.shape
    cut = np.s_[row0 : min(int(high[1]), rows), col0 : min(int(high[0]), cols)]
    parts: dict[str, Any] = {
        name: np.ascontiguousarray(part[cut])
        for name, part in terrain._asdict().items()
        if isinstance(part, np.ndarray) and part.shape == terrain.blocked.shape
    }
    return Window(terrain=terrain._replace(**parts), corner_m=np.array([col0, row0]) * size)


def corridor_along(terrain: Terrain, line: FloatArray, half_width_m: float) -> Window:
    """The window along a line (n, 2), blocked except near the line."""
    window = window_around(terrain, line, half_width_m + terrain.resolution_m)
    size = terrain.resolution_m
    cells = np.floor((line - window.corner_m) / size).astype(np.int32)
    near = np.zeros(window.terrain.blocked.shape, np.uint8)
    thickness = max(1, round(2 * half_width_m / size))
    cv2.polylines(near, [cells.reshape(-1, 1, 2)], False, 1, thickness)
    blocked = window.terrain.blocked | (near == 0)
    narrow = window.terrain._replace(blocked=blocked, clearance_m=distance_field(blocked, size))
    return replace(window, terrain=narrow)


def search_window(
    window: Window,
    model: StepModel,
    stance: Stance,
    goal: FloatArray,
    options: PlannerOptions,
    began: float,
) -> tuple[Footsteps | None, Result]:
    """Steps by ARA* in a window from a stance to both feet beside a pose (3,), or None."""
    terrain, tables = window.terrain, tables_of(model)
    floor = OccupancyGrid(
        cells=np.zeros(terrain.blocked.shape, np.uint8), resolution_m=terrain.resolution_m
    )
    x_m, y_m = (float(v) for v in goal[:2] - window.corner_m)
    lattice = build_lattice(floor, terrain, model, tables.steps, (x_m, y_m, float(goal[2])))
    result = plan_ara(
        Request(
            context=GoalContext(lattice=lattice, model=model, tables=tables),
            feet_lattice=to_frame(stance.feet, goal),
            feet_m=stance.feet_m,
            stands=stance.pair_margin_m < model.body_margin_m,
            first_side=stance.first_side,
        ),
        options,
        began,
    )
    if result.status is not PlanStatus.FOUND:
        return None, result
    poses = from_frame(result.pose_lattice, goal)
    return Footsteps(side=result.side, pose=poses, z_m=result.z_m), result


@dataclass(frozen=True, kw_only=True)
class GridRequest:
    """A request in the grid frame: stance, and goal (3,), the pair pose.

    began: time.perf_counter() from which the options' time limit counts.
    """

    request: Request
    options: PlannerOptions
    began: float
    stance: Stance
    goal: FloatArray

    def cost_um(self, steps: Footsteps) -> int:
        """Cost of steps from the stance to the goal."""
        return cost_of(self.request.lattice, self.request.model, self.stance, steps)


def in_grid_frame(request: Request, options: PlannerOptions, began: float) -> GridRequest:
    """A request in the grid frame."""
    x, y, cos, sin = request.lattice.frame
    goal = np.array([x, y, math.atan2(sin, cos)])
    stance = Stance(
        feet=from_frame(request.feet_lattice, goal),
        feet_m=request.feet_m,
        first_side=request.first_side,
        pair_margin_m=request.pair_margin_m,
    )
    return GridRequest(request=request, options=options, began=began, stance=stance, goal=goal)


def follow_path(query: GridRequest, path: FloatArray) -> Footsteps | None:
    """Steps along a path to the goal; None where a gap could not be bridged."""
    request, stance = query.request, query.stance
    walked, at = NO_STEPS, 0
    while True:
        check_time()
        along = PathFootsteps(request.lattice, request.model, path[at:], stance)
        rest = along.to_end()
        if rest is not None:
            return walked.then(rest)
        bridge = _bridge_gap(query, path[at:], along, stance)
        if bridge is None:
            return None
        walked, at = walked.then(bridge[0]), at + bridge[1]
        if at == len(path) - 1:
            return walked
        stance = bridge[0].stance_after(stance, request.model.body_margin_m)


def _bridge_gap(
    query: GridRequest, path: FloatArray, along: PathFootsteps, stance: Stance
) -> tuple[Footsteps, int] | None:
    """Steps along a path and over the gap where they end, and the point that they reach.

    Both feet then stand beside that point.
    """
    model, terrain = query.request.model, query.request.lattice.terrain
    options = replace(query.options, name="ara", stop_at_first=True, max_expansions=_GAP_EXPANSIONS)
    for back, on in _GAPS:
        check_time()
        left_at, lead = along.to_point(along.end - back)
        reached = min(max(along.end, 0) + on, len(path) - 1)
        leaving = lead.stance_after(stance, model.body_margin_m)
        points = np.concatenate([leaving.feet, path[max(left_at, 0) : reached + 1]])[:, :2]
        window = window_around(terrain, points, _GAP_MARGIN_M)
        steps, _ = search_window(window, model, leaving, path[reached], options, query.began)
        if steps is not None:
            return lead.then(steps), reached
    return None


def search_corridor(query: GridRequest, path: FloatArray) -> tuple[Footsteps | None, int]:
    """Steps by ARA* in a corridor along a path, or None; and the expansions."""
    request, expansions = query.request, 0
    radius_m = radius_of(request.lattice.body)
    options = replace(query.options, name="ara")
    for room_m in _CORRIDORS_M:
        window = corridor_along(request.lattice.terrain, path[:, :2], radius_m + room_m)
        steps, result = search_window(
            window, request.model, query.stance, query.goal, options, query.began
        )
        expansions += result.expansions
        if steps is not None or is_late():
            break
    return steps, expansions


def plan_by_sampling(request: Request, options: PlannerOptions, began: float) -> Result:
    """The search of all `SAMPLING_PLANNERS`; began: time.perf_counter() of the request."""
    query = in_grid_frame(request, options, began)
    sampled = _find_path(query, _FIRST_ITERATIONS)
    if not len(sampled.corners):
        if not request.has_first_step:
            return replace(no_first_step(request), expansions=sampled.iterations)
        if is_cut_off(request):
            return replace(no_body_path(), expansions=sampled.iterations)
        sampled = _find_path(query, options.max_expansions)
    if not len(sampled.corners):
        return _no_plan(query, sampled)
    terrain, outline = request.lattice.terrain, outline_of(request.model)
    path = resample(choose_headings(terrain, outline, request.model, sampled.corners))
    steps, searched, first_s = follow_path(query, path), 0, math.inf
    if steps is not None:
        first_s = time.perf_counter() - began
    if steps is None or not options.stop_at_first:
        found = None
        with contextlib.suppress(OutOfTime):
            found, searched = search_corridor(query, path)
        if found is not None and (steps is None or query.cost_um(found) < query.cost_um(steps)):
            first_s = min(first_s, time.perf_counter() - began)
            steps = found
    if steps is None:
        return _no_plan(query, sampled)
    return Result(
        status=PlanStatus.FOUND,
        side=steps.side,
        pose_lattice=to_frame(steps.pose, query.goal),
        z_m=steps.z_m,
        cost_m=query.cost_um(steps) / MICRO,
        expansions=sampled.iterations + searched,
        time_to_first_s=first_s,
    )


def _find_path(query: GridRequest, most: int) -> SampledPath:
    """A path of the body from where it is, or from nearby if it stands too near to obstacles."""
    request, options = query.request, query.options
    terrain, outline = request.lattice.terrain, outline_of(request.model)
    left, right = query.stance.feet
    turn = math.remainder(right[2] - left[2], 2 * math.pi)
    pair = np.array([*(left[:2] + right[:2]) / 2, left[2] + turn / 2])
    start = nearest_standing(terrain, outline, pair, _NEAR_M)
    if start is None:
        return SampledPath(corners=np.zeros((0, 3)), iterations=0)
    effort = EFFORTS[options.name]
    left_s = time_left_s()
    effort = effort._replace(
        most=min(effort.most, options.max_expansions, most),
        until_s=None if left_s == math.inf else time.perf_counter() + _PATH_SHARE * left_s,
    )
    body = BodyQuery(terrain=terrain, outline=outline, start=start, goal=query.goal)
    return find_path(options.name, body, effort, options.seed)


def _no_plan(query: GridRequest, sampled: SampledPath) -> Result:
    """NO_PATH if that is proven, else TIMED_OUT."""
    request = query.request
    if is_shut(request):
        return replace(no_body_path(), expansions=sampled.iterations)
    floods = Floods(request.lattice, request.first_steps[0], request.context.ends)
    floods.expand(_FLOOD_NODES)
    if floods.reason:
        return failure(PlanStatus.NO_PATH, floods.reason, sampled.iterations)
    name = query.options.name
    limit = f"{sampled.iterations} iterations"
    if is_late():
        limit = f"{query.options.time_limit_s:g} s"
    what = "no path of the body"
    if len(sampled.corners):
        what = "a path of the body, but no steps along it,"
    reason = f"{name} found {what} within {limit}; another seed or planner may do better"
    return failure(PlanStatus.TIMED_OUT, reason, sampled.iterations)
