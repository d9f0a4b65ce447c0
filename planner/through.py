"""Plans by way of poses: one search a leg, each from the feet in which the last one ended."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from planner.plan import FootstepPlan
from planner.planner import Planner
from planner.robot_model import Side


def plan_through(planner: Planner, *, start: ArrayLike, poses: Sequence[ArrayLike]) -> FootstepPlan:
    """From a pair pose to the last of some, standing with both feet at each of them in between.

    start, poses: x_m, y_m, yaw_rad in the world. The bound is the worst of any leg. Where a leg
    cannot be planned there is no plan, and the reason says which leg it is.
    Raises ValueError for no pose, or numbers that are not finite.
    """
    if not len(poses):
        raise ValueError("poses is empty: give at least the goal")
    began = time.perf_counter()
    legs: list[FootstepPlan] = []
    plan = planner.plan(goal=poses[0], start=start)
    legs.append(plan)
    for number, pose in enumerate(poses[1:], start=2):
        if not plan.found:
            break
        plan = _next_leg(planner, legs, pose)
        if not plan.found:
            plan = replace(plan, reason=f"leg {number} of {len(poses)}: {plan.reason}")
        legs.append(plan)
    last, (x_m, y_m, yaw_rad) = legs[-1], np.asarray(poses[-1])
    walked = legs if last.found else []
    # None where the robot stands at the pose already, so that nothing was there to refine.
    before_m = [leg.cost_before_refinement_m for leg in walked]
    refined = any(cost_m is not None for cost_m in before_m)
    return replace(
        last,
        start_feet_world=legs[0].start_feet_world,
        start=legs[0].start,
        goal=(float(x_m), float(y_m), float(yaw_rad)),
        side=np.concatenate([leg.side for leg in walked] or [np.zeros(0, np.int8)]),
        pose_world=np.concatenate([leg.pose_world for leg in walked] or [np.zeros((0, 4))]),
        cost_m=sum(leg.cost_m for leg in walked),
        cost_before_refinement_m=sum(cost_m or 0.0 for cost_m in before_m) if refined else None,
        epsilon=max(leg.epsilon for leg in legs),
        expansions=sum(leg.expansions for leg in legs),
        time_to_first_s=sum(leg.time_to_first_s for leg in legs),
        time_s=time.perf_counter() - began,
    )


def _next_leg(planner: Planner, legs: Sequence[FootstepPlan], pose: ArrayLike) -> FootstepPlan:
    """From the feet in which the legs end, with the foot that has not just been put down."""
    feet = legs[0].start_feet_world.copy()
    first_side = None
    for leg in legs:
        for side in Side:
            placed = leg.pose_world[leg.side == side]
            if len(placed):
                feet[side] = placed[-1]
        if len(leg):
            first_side = Side(int(leg.side[-1])).other
    return planner.plan(goal=pose, start_feet_world=feet, first_side=first_side)
