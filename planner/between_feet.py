"""Plans that end with the feet at any two poses, and not only side by side."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner.lattice.steps import MICRO, step_cost_um
from planner.plan import FootstepPlan, PlanStatus, feet_at, pair_pose, relative_steps, wrap_angle
from planner.planner import Planner
from planner.robot_model import Side, StepModel
from planner.verify import violations

_SAME = 1e-6  # metres or radians


def plan_between_feet(
    planner: Planner, start_feet_world: ArrayLike, goal_feet_world: ArrayLike
) -> FootstepPlan:
    """A plan from two feet as they stand to two feet (2, 4) x_m, y_m, z_m, yaw_rad, to the bit.

    It leads to where the feet stand side by side around the middle of the goal's; then the last two
    steps are moved to the goal's feet, or where that cannot be two or three more are taken. The
    status is NO_PATH if no such steps are within the limits and free.
    """
    goal = np.asarray(goal_feet_world, dtype=float)
    plan = planner.plan(goal=pair_pose(goal), start_feet_world=start_feet_world)
    if not plan.found or _is_same(goal, feet_at(plan.goal, planner.model.stance_width_m)):
        return plan
    for ended in _endings(plan, goal):
        # Checked as a first part: the feet of the end need not stand side by side.
        part = replace(ended, status=PlanStatus.TIMED_OUT)
        if not violations(
            part,
            planner.grid,
            planner.model,
            unknown_is_free=planner.options.unknown_is_free,
            stood_freely=False,
        ):
            more_m = _cost_m(ended, planner.model) - _cost_m(plan, planner.model)
            return replace(ended, cost_m=plan.cost_m + more_m)
    return replace(
        plan,
        status=PlanStatus.NO_PATH,
        reason="no two steps lead from standing at the goal to the feet that it asks for",
        side=np.zeros(0, np.int8),
        pose_world=np.zeros((0, 4)),
        cost_m=0.0,
    )


def _endings(plan: FootstepPlan, goal: NDArray[np.float64]) -> Iterator[FootstepPlan]:
    """The plan with its end moved to the goal's feet (2, 4), and with two or three more steps."""
    if not len(plan):
        for first in Side:
            pair = [first, first.other]
            yield replace(plan, side=np.array(pair, np.int8), pose_world=goal[pair])
        return
    yield replace(plan, pose_world=np.vstack([plan.pose_world[:-2], goal[plan.side[-2:]]]))
    last = Side(int(plan.side[-1]))
    stands, feet = plan.pose_world[-2], [last.other, last]
    yield _with_more(plan, feet, goal[feet])
    # The other foot comes first, after a step on the spot.
    yield _with_more(plan, [last.other, *feet[::-1]], np.vstack([stands, goal[feet[::-1]]]))


def _with_more(plan: FootstepPlan, side: list[Side], poses: NDArray[np.float64]) -> FootstepPlan:
    return replace(
        plan,
        side=np.concatenate([plan.side, np.array(side, np.int8)]),
        pose_world=np.vstack([plan.pose_world, poses]),
    )


def _is_same(feet: NDArray[np.float64], others: NDArray[np.float64]) -> bool:
    off = feet - others
    off[:, 3] = wrap_angle(off[:, 3])
    return bool(np.abs(off[:, [0, 1, 3]]).max() < _SAME)


def _cost_m(plan: FootstepPlan, model: StepModel) -> float:
    """Cost of a plan's steps, but for clearance."""
    if not len(plan):
        return 0.0
    support = np.vstack([plan.start_feet_world[Side(int(plan.side[0])).other], plan.pose_world])
    outward = np.array([Side(int(side)).outward for side in plan.side])
    steps = relative_steps(support[:-1, [0, 1, 3]], plan.pose_world[:, [0, 1, 3]], outward)
    return float(step_cost_um(steps, model).sum()) / MICRO
