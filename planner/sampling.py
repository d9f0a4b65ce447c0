"""Plans by way of a path of the body: OMPL finds the path, footsteps follow it, the lattice helps.

1. A look at the lattice's 2D search: where it proves that there is no way, nothing else is tried.
2. A path of the body in SE(2) by the sampling planner of the chosen name; the body then is turned
   to face the way where there is room.
3. Footsteps along it. Where they come to an end, ARA* in a window leads across to a later pose.
4. With effort left, ARA* in a corridor along the path; the cheaper plan is taken.

Nothing of this proves how much cheaper a plan might be, so epsilon is infinite.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planner.along_path import Strand, dense
from planner.ara import plan_ara
from planner.body_motion import Outline, nearest_standing, outline_of
from planner.enclosed import how_enclosed
from planner.footsteps import NO_STEPS, Footsteps, Stance, cost_of
from planner.headings import face_the_way
from planner.lattice import MICRO
from planner.ompl_path import EFFORTS, BodyQuery, BodyWay, Effort, Limits, find_way
from planner.options import PlannerOptions
from planner.plan import PlanStatus
from planner.request import Request, Result
from planner.window import (
    corridor_along,
    into_frame,
    out_of_frame,
    search_window,
    window_around,
)

FloatArray = NDArray[np.float64]
_NEAR_M = 0.5  # how far from the start the body's path may begin
_GAP_EXPANSIONS = 20_000
_GAP_MARGIN_M = 1.0
# Points of the path (each 2.5 cm or 3 degrees on) that are walked back before a gap and on behind.
_GAPS = ((8, 24), (24, 60), (60, 140))
_CORRIDOR_M = 0.5  # room beside the body on both sides


@dataclass(frozen=True, kw_only=True)
class _Job:
    request: Request
    options: PlannerOptions
    began: float
    stance: Stance
    goal: FloatArray
    outline: Outline

    @property
    def is_late(self) -> bool:
        """Whether the time is over."""
        limit_s = self.options.time_limit_s
        return limit_s is not None and time.perf_counter() - self.began >= limit_s


def plan_by_sampling(request: Request, options: PlannerOptions, began: float) -> Result:
    """The backend of all names in `ompl_path.EFFORTS`; see `backends.py`."""
    # One expansion: enough for the checks that come before, and for a goal one step away.
    glance = plan_ara(request, replace(options, name="ara", max_expansions=1), began)
    if glance.status is not PlanStatus.TIMED_OUT:
        return glance
    job = _job(request, options, began)
    way = _find_way(job)
    if not len(way.corners):
        return _failure(job, way)
    path = dense(face_the_way(request.space.terrain, job.outline, request.model, way.corners))
    steps = _walk(job, path)
    first_s = time.perf_counter() - began
    searched = 0
    if steps is None or not options.stop_at_first:
        steps, searched = _improve(job, path, steps)
        first_s = min(first_s, time.perf_counter() - began)
    if steps is None:
        return _failure(job, way)
    return _result(job, steps, way.iterations + searched, first_s)


def _job(request: Request, options: PlannerOptions, began: float) -> _Job:
    x, y, cos, sin = request.space.frame
    goal = np.array([x, y, math.atan2(sin, cos)])
    margin_m = 0.0 if request.stands else request.model.body_margin_m
    stance = Stance(
        feet=out_of_frame(request.feet_lattice, goal),
        feet_m=request.feet_m,
        first_side=request.first_side,
        pair_margin_m=margin_m,
    )
    return _Job(
        request=request,
        options=options,
        began=began,
        stance=stance,
        goal=goal,
        outline=outline_of(request.model),
    )


def _find_way(job: _Job) -> BodyWay:
    """A path of the body from where it is, or from near there if it stands too near to walls."""
    terrain, options = job.request.space.terrain, job.options
    left, right = job.stance.feet
    turn = math.remainder(right[2] - left[2], 2 * math.pi)
    pair = np.array([*(left[:2] + right[:2]) / 2, left[2] + turn / 2])
    start = nearest_standing(terrain, job.outline, pair, _NEAR_M)
    if start is None:
        return BodyWay(corners=np.zeros((0, 3)), iterations=0)
    most, more = EFFORTS[options.name]
    limit_s = options.time_limit_s
    limits = Limits(
        effort=Effort(min(most, options.max_expansions), more),
        until_s=None if limit_s is None else job.began + limit_s,
    )
    query = BodyQuery(terrain=terrain, outline=job.outline, start=start, goal=job.goal)
    return find_way(options.name, query, limits, options.seed)


def _walk(job: _Job, path: FloatArray) -> Footsteps | None:
    """Steps along a path (n, 3), led over its gaps by the lattice; None where a gap is too wide."""
    request, stance = job.request, job.stance
    walked, at = NO_STEPS, 0
    while True:
        strand = Strand(request.space, request.model, path[at:], stance)
        rest = strand.to_end()
        if rest is not None:
            return walked.then(rest)
        bridge = _bridge(job, path[at:], strand, stance)
        if bridge is None:
            return None
        walked, at = walked.then(bridge[0]), at + bridge[1]
        if at == len(path) - 1:
            return walked
        stance = bridge[0].stance_after(stance, request.model.body_margin_m)


def _bridge(
    job: _Job, path: FloatArray, strand: Strand, stance: Stance
) -> tuple[Footsteps, int] | None:
    """Steps along a path and over the gap in which its strand ends, and the point that they reach.

    Both feet then stand beside that point.
    """
    model, terrain = job.request.model, job.request.space.terrain
    options = replace(job.options, name="ara", stop_at_first=True, max_expansions=_GAP_EXPANSIONS)
    for back, on in _GAPS:
        if job.is_late:
            break
        left_at, lead = strand.to_point(strand.end - back)
        reached = min(max(strand.end, 0) + on, len(path) - 1)
        leaving = lead.stance_after(stance, model.body_margin_m)
        points = np.concatenate([leaving.feet, path[max(left_at, 0) : reached + 1]])[:, :2]
        window = window_around(terrain, points, _GAP_MARGIN_M)
        steps, _ = search_window(window, model, leaving, path[reached], options, job.began)
        if steps is not None:
            return lead.then(steps), reached
    return None


def _improve(job: _Job, path: FloatArray, steps: Footsteps | None) -> tuple[Footsteps | None, int]:
    """The cheaper of these steps and those of ARA* in a corridor; and the expansions spent."""
    request = job.request
    radius_m = math.hypot(*job.outline.body)
    window = corridor_along(request.space.terrain, path[:, :2], radius_m + _CORRIDOR_M)
    options = replace(job.options, name="ara")
    found, result = search_window(window, request.model, job.stance, job.goal, options, job.began)
    if found is not None and (steps is None or _cost(job, found) < _cost(job, steps)):
        steps = found
    return steps, result.expansions


def _cost(job: _Job, steps: Footsteps) -> int:
    return cost_of(job.request.space, job.request.model, job.stance, steps)


def _result(job: _Job, steps: Footsteps, expansions: int, first_s: float) -> Result:
    return Result(
        status=PlanStatus.FOUND,
        side=steps.side,
        pose_lattice=into_frame(steps.pose, job.goal),
        z_m=steps.z_m,
        cost_m=_cost(job, steps) / MICRO,
        expansions=expansions,
        time_to_first_s=first_s,
    )


def _failure(job: _Job, way: BodyWay) -> Result:
    """Proven that there is no way, or out of time."""
    proof = how_enclosed(job.request)
    name = job.options.name
    if proof:
        status, reason = PlanStatus.NO_PATH, f"the goal cannot be reached: {proof}"
    else:
        status = PlanStatus.TIMED_OUT
        limit = f"{way.iterations} iterations"
        if job.is_late:
            limit = f"{job.options.time_limit_s:g} s"
        what = "steps along its path" if len(way.corners) else "path of the body"
        reason = f"{name} found no {what} within {limit}; another seed or planner may"
    return Result(
        status=status,
        reason=reason,
        side=np.zeros(0, np.int8),
        pose_lattice=np.zeros((0, 3)),
        z_m=np.zeros(0),
        expansions=way.iterations,
    )
