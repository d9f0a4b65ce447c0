"""Plans that end with the feet where they are asked for, one by one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planner.between_feet import plan_between_feet
from planner.plan import PlanStatus, feet_at
from planner.planner import Planner
from planner.robot_model import Side
from planner.verify import violations
from tests.planner_floor import FLOOR
from tests.planner_oracle import small_model

MODEL = small_model()
START = feet_at((1.0, 1.0, 0.2), MODEL.stance_width_m)


def feet_beside(pose, left_ahead_m, right_ahead_m):
    """Feet of a pair pose, each moved ahead."""
    feet = feet_at(pose, MODEL.stance_width_m)
    ahead = np.array([np.cos(pose[2]), np.sin(pose[2]), 0.0, 0.0])
    return feet + np.array([left_ahead_m, right_ahead_m])[:, None] * ahead


@pytest.mark.parametrize("ahead_m", [(0.0, 0.0), (0.02, -0.02), (-0.03, 0.03), (0.04, 0.0)])
@pytest.mark.parametrize("where", [(2.5, 1.5, 0.5), (1.0, 1.0, 0.2)])
def test_the_last_two_steps_are_the_goal_feet_and_all_are_right(where, ahead_m):
    planner = Planner(FLOOR, MODEL)
    goal = feet_beside(where, *ahead_m)
    plan = plan_between_feet(planner, START, goal)
    assert plan.found, plan.reason
    ends = START.copy()
    for side, pose in zip(plan.side, plan.pose_world, strict=True):
        ends[Side(int(side))] = pose
    assert ends == pytest.approx(goal, abs=1e-9)
    if len(plan):
        part = replace(plan, status=PlanStatus.TIMED_OUT)
        assert violations(part, FLOOR, MODEL, stood_freely=False) == []
    # Every step costs its length and step_cost_m at least.
    assert plan.cost_m >= len(plan) * MODEL.step_cost_m


def test_feet_that_no_step_can_reach_are_refused_with_a_reason():
    planner = Planner(FLOOR, MODEL)
    plan = plan_between_feet(planner, START, feet_beside((2.5, 1.5, 0.5), 0.5, -0.5))
    assert plan.status is PlanStatus.NO_PATH
    assert "feet that it asks for" in plan.reason
    assert len(plan) == 0


def test_what_the_planner_refuses_is_refused_alike():
    plan = plan_between_feet(Planner(FLOOR, MODEL), START, feet_beside((9.0, 9.0, 0.0), 0, 0))
    assert plan.status is PlanStatus.OFF_MAP
