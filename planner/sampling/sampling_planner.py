"""Plans by way of a path of the body: OMPL finds the path, footsteps follow it, the lattice helps.

1. A path of the body in SE(2) by the sampling planner of the chosen name. While it finds none, the
   2D search of the lattice has a look whether there is any way.
2. Along that path the body is turned to face the way where there is room, and footsteps follow it
   (`follow.py`).
3. Unless the first plan is good enough, ARA* searches in a corridor along the path; the cheaper
   plan is taken.

Nothing of this proves how much cheaper a plan might be, so epsilon is infinite.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from maps.grid import OccupancyGrid, distance_field
from planner.collision import Terrain
from planner.heuristics.heuristic import tables_of
from planner.lattice.footsteps import NO_STEPS, Footsteps, Stance, cost_of
from planner.lattice.lattice import build_lattice
from planner.lattice.steps import MICRO
from planner.options import PlannerOptions
from planner.plan import PlanStatus, wrap_angle
from planner.robot_model import StepModel
from planner.sampling.footsteps_along_path import Strand, dense
from planner.sampling.ompl_paths import (
    EFFORTS,
    BodyQuery,
    BodyWay,
    Effort,
    Limits,
    find_way,
    nearest_standing,
    outline_of,
)
from planner.sampling.path_headings import face_the_way
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
from planner.search.reachability import expand_both, new_flood, why_enclosed

# Lattice searches on a part of the map: across a gap in a walk, or in a corridor along a line.
#
# A window is a rectangle of the map's cells. What is free in it is free on the map, so its plans
# hold there; what is proven in it is not. All poses are x_m, y_m, yaw_rad in the grid frame of the
# map.

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Window:
    """Terrain of some rows and columns; corner_m (2,): their first corner in the grid frame."""

    terrain: Terrain
    corner_m: FloatArray


def window_around(terrain: Terrain, points: FloatArray, margin_m: float) -> Window:
    """The window that holds points (n, 2) and as much around them."""
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
    """The window along a line (n, 2) in which all is blocked but what lies near the line."""
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
    """Steps by ARA* from a stance to both feet beside a pose (3,), if the window has any."""
    terrain, tables = window.terrain, tables_of(model)
    floor = OccupancyGrid(
        cells=np.zeros(terrain.blocked.shape, np.uint8), resolution_m=terrain.resolution_m
    )
    x_m, y_m = (float(v) for v in goal[:2] - window.corner_m)
    lattice = build_lattice(floor, terrain, model, tables.steps, (x_m, y_m, float(goal[2])))
    result = plan_ara(
        Request(
            context=GoalContext(lattice=lattice, model=model, tables=tables),
            feet_lattice=into_frame(stance.feet, goal),
            feet_m=stance.feet_m,
            stands=stance.pair_margin_m < model.body_margin_m,
            first_side=stance.first_side,
        ),
        options,
        began,
    )
    if result.status is not PlanStatus.FOUND:
        return None, result
    poses = out_of_frame(result.pose_lattice, goal)
    return Footsteps(side=result.side, pose=poses, z_m=result.z_m), result


def into_frame(poses: FloatArray, frame: FloatArray) -> FloatArray:
    """Poses (n, 3) as seen from a frame (3,)."""
    cos, sin = math.cos(frame[2]), math.sin(frame[2])
    x, y = (poses[:, :2] - frame[:2]).T
    return np.column_stack(
        [cos * x + sin * y, cos * y - sin * x, wrap_angle(poses[:, 2] - frame[2])]
    )


def out_of_frame(poses: FloatArray, frame: FloatArray) -> FloatArray:
    """The inverse of `into_frame`."""
    cos, sin = math.cos(frame[2]), math.sin(frame[2])
    x, y = poses[:, :2].T
    return np.column_stack(
        [
            frame[0] + cos * x - sin * y,
            frame[1] + sin * x + cos * y,
            wrap_angle(poses[:, 2] + frame[2]),
        ]
    )


# Walking along a path of the body from feet anywhere, led over its gaps by the lattice search.
#
# For whatever has a path: poses (n, 3) x_m, y_m, yaw_rad in the grid frame, which end at the goal.
_GAP_EXPANSIONS = 20_000
_GAP_MARGIN_M = 1.0
# By how many points of the path, which are 2.5 cm or 3 degrees apart, the walk goes back before a
# gap and reaches on behind it: little at first, and more while that does not help.
_GAPS = ((8, 24), (24, 60), (60, 140))
# Room beside the body on both sides of the path; the wider where the narrower holds no plan.
_CORRIDORS_M = (0.5, 2.0)


@dataclass(frozen=True, kw_only=True)
class Errand:
    """What is to be walked: a request in the grid frame. goal (3,): the pair pose.

    began: time.perf_counter() from which the options' time limit counts.
    """

    request: Request
    options: PlannerOptions
    began: float
    stance: Stance
    goal: FloatArray

    @property
    def is_late(self) -> bool:
        """Whether the time is over."""
        limit_s = self.options.time_limit_s
        return limit_s is not None and time.perf_counter() - self.began >= limit_s

    def cost_um(self, steps: Footsteps) -> int:
        """Cost of steps from the stance to the goal."""
        return cost_of(self.request.lattice, self.request.model, self.stance, steps)


def errand_of(request: Request, options: PlannerOptions, began: float) -> Errand:
    """A request as an errand."""
    x, y, cos, sin = request.lattice.frame
    goal = np.array([x, y, math.atan2(sin, cos)])
    stance = Stance(
        feet=out_of_frame(request.feet_lattice, goal),
        feet_m=request.feet_m,
        first_side=request.first_side,
        pair_margin_m=0.0 if request.stands else request.model.body_margin_m,
    )
    return Errand(request=request, options=options, began=began, stance=stance, goal=goal)


def follow(errand: Errand, path: FloatArray) -> Footsteps | None:
    """Steps along a path to the goal; None where a gap is too wide for the lattice search."""
    request, stance = errand.request, errand.stance
    walked, at = NO_STEPS, 0
    while True:
        strand = Strand(request.lattice, request.model, path[at:], stance)
        rest = strand.to_end()
        if rest is not None:
            return walked.then(rest)
        bridge = _bridge(errand, path[at:], strand, stance)
        if bridge is None:
            return None
        walked, at = walked.then(bridge[0]), at + bridge[1]
        if at == len(path) - 1:
            return walked
        stance = bridge[0].stance_after(stance, request.model.body_margin_m)


def _bridge(
    errand: Errand, path: FloatArray, strand: Strand, stance: Stance
) -> tuple[Footsteps, int] | None:
    """Steps along a path and over the gap where its strand ends, and the point that they reach.

    Both feet then stand beside that point.
    """
    model, terrain = errand.request.model, errand.request.lattice.terrain
    options = replace(
        errand.options, name="ara", stop_at_first=True, max_expansions=_GAP_EXPANSIONS
    )
    for back, on in _GAPS:
        if errand.is_late:
            break
        left_at, lead = strand.to_point(strand.end - back)
        reached = min(max(strand.end, 0) + on, len(path) - 1)
        leaving = lead.stance_after(stance, model.body_margin_m)
        points = np.concatenate([leaving.feet, path[max(left_at, 0) : reached + 1]])[:, :2]
        window = window_around(terrain, points, _GAP_MARGIN_M)
        steps, _ = search_window(window, model, leaving, path[reached], options, errand.began)
        if steps is not None:
            return lead.then(steps), reached
    return None


def search_along(errand: Errand, path: FloatArray) -> tuple[Footsteps | None, int]:
    """Steps by ARA* in a corridor along a path, if there are any; and the expansions spent."""
    request, expansions = errand.request, 0
    radius_m = math.hypot(*request.lattice.body)
    options = replace(errand.options, name="ara")
    for room_m in _CORRIDORS_M:
        window = corridor_along(request.lattice.terrain, path[:, :2], radius_m + room_m)
        steps, result = search_window(
            window, request.model, errand.stance, errand.goal, options, errand.began
        )
        expansions += result.expansions
        if steps is not None or errand.is_late:
            break
    return steps, expansions


# What proves, without a plan and without a full search, that no steps lead to the goal.

_NODES = 1 << 17  # that each flood goes on from


def is_shut(request: Request) -> str:
    """Why there is no way as the search of the body's path knows it; empty if that is unknown."""
    nodes, _ = request.first_nodes()
    if not len(nodes):
        return no_first_step(request).reason
    return no_body_path().reason if is_cut_off(request, nodes) else ""


def how_enclosed(request: Request) -> str:
    """What floods of the lattice prove to enclose the start or the goal; empty if unknown."""
    lattice = request.lattice
    flood = new_flood(lattice, request.first_nodes()[0], request.context.ends)
    flood, verdict = expand_both(lattice, flood, _NODES)
    return why_enclosed(verdict, flood) if verdict.is_enclosed else ""


_NEAR_M = 0.5  # how far from the start the body's path may begin
_GLANCE = 2_000  # iterations before the lattice is asked whether there is any way


def plan_by_sampling(request: Request, options: PlannerOptions, began: float) -> Result:
    """The backend of all `SAMPLING_PLANNERS`; see `backends.py`."""
    errand = errand_of(request, options, began)
    way = _find_way(errand, _GLANCE)
    if not len(way.corners):
        shut = is_shut(request)
        if shut:
            return failure(PlanStatus.NO_PATH, shut, way.iterations)
        way = _find_way(errand, options.max_expansions)
    if not len(way.corners):
        return _no_plan(errand, way)
    lattice = request.lattice
    path = dense(
        face_the_way(lattice.terrain, outline_of(request.model), request.model, way.corners)
    )
    steps, searched, first_s = follow(errand, path), 0, math.inf
    if steps is not None:
        first_s = time.perf_counter() - began
    if steps is None or not options.stop_at_first:
        found, searched = search_along(errand, path)
        if found is not None and (steps is None or errand.cost_um(found) < errand.cost_um(steps)):
            first_s = min(first_s, time.perf_counter() - began)
            steps = found
    if steps is None:
        return _no_plan(errand, way)
    return _found(errand, steps, way.iterations + searched, first_s)


def _find_way(errand: Errand, most: int) -> BodyWay:
    """A path of the body from where it is, or from near there if it stands too near to walls."""
    request, options = errand.request, errand.options
    terrain, outline = request.lattice.terrain, outline_of(request.model)
    left, right = errand.stance.feet
    turn = math.remainder(right[2] - left[2], 2 * math.pi)
    pair = np.array([*(left[:2] + right[:2]) / 2, left[2] + turn / 2])
    start = nearest_standing(terrain, outline, pair, _NEAR_M)
    if start is None:
        return BodyWay(corners=np.zeros((0, 3)), iterations=0)
    effort = EFFORTS[options.name]
    limit_s = options.time_limit_s
    limits = Limits(
        effort=Effort(min(effort.most, options.max_expansions, most), effort.more),
        until_s=None if limit_s is None else errand.began + limit_s,
    )
    query = BodyQuery(terrain=terrain, outline=outline, start=start, goal=errand.goal)
    return find_way(options.name, query, limits, options.seed)


def _found(errand: Errand, steps: Footsteps, expansions: int, first_s: float) -> Result:
    return Result(
        status=PlanStatus.FOUND,
        side=steps.side,
        pose_lattice=into_frame(steps.pose, errand.goal),
        z_m=steps.z_m,
        cost_m=errand.cost_um(steps) / MICRO,
        expansions=expansions,
        time_to_first_s=first_s,
    )


def _no_plan(errand: Errand, way: BodyWay) -> Result:
    """Proven that there is no way, or out of time."""
    proof = how_enclosed(errand.request)
    if proof:
        return failure(PlanStatus.NO_PATH, proof, way.iterations)
    name = errand.options.name
    limit = f"{way.iterations} iterations"
    if errand.is_late:
        limit = f"{errand.options.time_limit_s:g} s"
    what = "no path of the body"
    if len(way.corners):
        what = "a path of the body, but no steps along it,"
    reason = f"{name} found {what} within {limit}; another seed or planner may do better"
    return failure(PlanStatus.TIMED_OUT, reason, way.iterations)
