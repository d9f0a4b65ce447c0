"""A plan through waypoints: leg by leg from each pose to the next, joined into one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from planner.endpoints import Footing
from planner.plan import (
    FootstepPlan,
    PlanWaypoint,
    Pose,
    feet_at,
    finite_pose,
    from_frame,
    pair_pose,
)
from planner.robot_model import Side


@dataclass(frozen=True, kw_only=True)
class Waypoint:
    """A pose on the way, at which the robot stands for a moment or which it walks through."""

    pose: Pose
    stands: bool = False


class FootstepPlanner(Protocol):
    """What the navigator asks for plans; `planner.planner.Planner` is one."""

    def plan(
        self, *, goal: Sequence[float], start_feet_world: np.ndarray, first_side: Side | None
    ) -> FootstepPlan:
        """A plan from both feet (2, 4) as they stand to a pair pose, as `Planner.plan` makes it."""
        ...


def first_leg(waypoints: Sequence[Waypoint], goal: Pose) -> tuple[tuple[Pose, ...], Pose]:
    """The poses to walk through, and where the robot stands next: at a waypoint or the goal."""
    poses = tuple(waypoint.pose for waypoint in waypoints)
    for number, waypoint in enumerate(waypoints):
        if waypoint.stands:
            return poses[:number], waypoint.pose
    return poses, goal


def plan_through(
    planner: FootstepPlanner,
    *,
    goal: Sequence[float],
    start_feet_world: np.ndarray,
    first_side: Side | None,
    via: Sequence[Pose] = (),
    stands: bool = False,
) -> FootstepPlan:
    """The plan of `Planner.plan` that passes the poses `via` in order, with both feet on each.

    stands: the goal is a waypoint, at which the robot stands for a moment.

    At a joint the feet go on in turn: the foot that stepped last stands while the other one steps.
    Where there is no way to a pose, that leg's plan tells why, and its goal is that pose. The cost
    is at most epsilon times that of the best plan which puts both feet on the poses.
    """
    if not via and not stands:
        return planner.plan(goal=goal, start_feet_world=start_feet_world, first_side=first_side)
    legs: list[FootstepPlan] = []
    feet, side = start_feet_world, first_side
    for number, pose in enumerate((*via, goal), start=1):
        leg = planner.plan(goal=pose, start_feet_world=feet, first_side=side)
        if not leg.found:
            reason = leg.reason
            if number <= len(via) or stands:
                reason = f"waypoint {number}: {reason.removeprefix('goal: ')}"
            return replace(leg, goal=finite_pose(pose), reason=reason)
        legs.append(leg)
        feet = feet_after(leg)
        side = Side(int(leg.side[-1])).other if len(leg) else side
    return _joined(legs, via, stands)


def feet_after(plan: FootstepPlan) -> np.ndarray:
    """Where the feet (2, 4), left and right, stand when all steps have been taken."""
    feet = np.array(plan.start_feet_world)
    for side in Side:
        taken = np.flatnonzero(plan.side == side)
        if len(taken):
            feet[side] = plan.pose_world[taken[-1]]
    return feet


def _joined(legs: Sequence[FootstepPlan], via: Sequence[Pose], stands: bool) -> FootstepPlan:
    first, last = legs[0], legs[-1]
    ends = zip((*via, last.goal), np.cumsum([len(leg) for leg in legs]).tolist(), strict=True)
    points = [PlanWaypoint(pose=finite_pose(pose), step=step) for pose, step in ends]
    goal = (replace(points[-1], stands=True),) if stands else ()
    before_m = [leg.cost_before_refinement_m for leg in legs]
    known_m = [cost_m for cost_m in before_m if cost_m is not None]
    return FootstepPlan(
        start_feet_world=first.start_feet_world,
        start=first.start,
        goal=last.goal,
        side=np.concatenate([leg.side for leg in legs]),
        pose_world=np.concatenate([leg.pose_world for leg in legs]),
        robot=first.robot,
        map=first.map,
        cost_m=sum(leg.cost_m for leg in legs),
        cost_before_refinement_m=sum(known_m) if len(known_m) == len(legs) else None,
        epsilon=max(leg.epsilon for leg in legs),
        expansions=sum(leg.expansions for leg in legs),
        time_to_first_s=sum(leg.time_to_first_s for leg in legs),
        time_s=sum(leg.time_s for leg in legs),
        planner=first.planner,
        waypoints=(*points[:-1], *goal),
    )


def halting_plan(
    footing: Footing, width_m: float, feet_world: np.ndarray, side: Side
) -> FootstepPlan:
    """One step of that foot to beside the other one, from feet (2, 4), so far from it."""
    support = feet_world[side.other]
    middle = np.array([[0.0, side.outward * width_m / 2, 0.0]])
    feet = feet_at(from_frame(middle, support[[0, 1, 3]])[0], width_m)
    feet[:, 2] = support[2]
    feet = footing.at_rest(feet)
    return FootstepPlan(
        start_feet_world=feet_world,
        start=finite_pose(pair_pose(feet_world).tolist()),
        goal=finite_pose(pair_pose(feet).tolist()),
        side=np.array([side], np.int8),
        pose_world=feet[side][None],
    )
