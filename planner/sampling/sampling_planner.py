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

import numpy as np
from numpy.typing import NDArray

from planner.lattice.footsteps import Footsteps
from planner.lattice.steps import MICRO
from planner.options import PlannerOptions
from planner.plan import PlanStatus
from planner.sampling.body_motion import nearest_standing, outline_of
from planner.sampling.enclosed import how_enclosed, is_shut
from planner.sampling.follow import Errand, errand_of, follow, search_along
from planner.sampling.footsteps_along_path import dense
from planner.sampling.ompl_paths import EFFORTS, BodyQuery, BodyWay, Effort, Limits, find_way
from planner.sampling.path_headings import face_the_way
from planner.sampling.window import into_frame
from planner.search.problem import Request, Result, failure

FloatArray = NDArray[np.float64]
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
    space = request.space
    path = dense(face_the_way(space.terrain, outline_of(request.model), request.model, way.corners))
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
    terrain, outline = request.space.terrain, outline_of(request.model)
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
