"""Walking along a path of the body from feet anywhere, led over its gaps by the lattice search.

For whatever has a path: poses (n, 3) x_m, y_m, yaw_rad in the grid frame, which end at the goal.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planner.lattice.footsteps import NO_STEPS, Footsteps, Stance, cost_of
from planner.options import PlannerOptions
from planner.sampling.footsteps_along_path import Strand
from planner.sampling.window import corridor_along, out_of_frame, search_window, window_around
from planner.search.problem import Request

FloatArray = NDArray[np.float64]
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
        return cost_of(self.request.space, self.request.model, self.stance, steps)


def errand_of(request: Request, options: PlannerOptions, began: float) -> Errand:
    """A request as an errand."""
    x, y, cos, sin = request.space.frame
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
        strand = Strand(request.space, request.model, path[at:], stance)
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
    model, terrain = errand.request.model, errand.request.space.terrain
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
    radius_m = math.hypot(*request.space.body)
    options = replace(errand.options, name="ara")
    for room_m in _CORRIDORS_M:
        window = corridor_along(request.space.terrain, path[:, :2], radius_m + room_m)
        steps, result = search_window(
            window, request.model, errand.stance, errand.goal, options, errand.began
        )
        expansions += result.expansions
        if steps is not None or errand.is_late:
            break
    return steps, expansions
