"""Refinement off the lattice: what it must gain, by hand, and on stairs."""

from __future__ import annotations

import math

import numpy as np
import pytest

from planner.plan import relative_step
from planner.planner import Planner
from planner.robot_model import Side, StepLimits
from tests.planner_oracle import small_model
from tests.planner_refined import (
    FLOOR,
    REFINED,
    assert_laws,
    both,
    stairs,
)


def test_uneven_steps_become_even_and_fewer_by_hand():
    # The search has no step longer than 0.2 m but the first, the robot can do 0.3 m. Three steps of
    # 0.28 m and one beside are enough: each costs hypot(0.28, 0.2) + 0.1, the last 0.2 + 0.1. Where
    # y and turning are dear they are just that; else the feet would turn out to step narrower.
    model = small_model(
        steps=((0.2, 0.2, 0.0), (0.1, 0.2, 0.0), (0.0, 0.2, 0.0)),
        side_cost_m=5.0,
        turn_cost_m=5.0,
        cell_m=0.02,
    )
    before, after = both(FLOOR, model, start=(1.0, 2.0, 0.0), goal=(1.84, 2.0, 0.0))
    assert len(before) > 4
    assert len(after) == 4
    assert after.cost_m == pytest.approx(3 * (math.hypot(0.28, 0.2) + 0.1) + 0.3, abs=2e-3)
    np.testing.assert_allclose(after.pose_world[:, 0], [1.28, 1.56, 1.84, 1.84], atol=0.01)
    np.testing.assert_allclose(np.abs(after.pose_world[:, 1] - 2.0), 0.1, atol=0.005)
    np.testing.assert_allclose(after.pose_world[:, 3], 0.0, atol=0.01)


def test_a_straight_walk_costs_what_it_must_by_hand():
    # 2.4 m ahead in steps of at most 0.31 m, and one to put the other foot beside: 8 and 1. A step
    # narrower than the stance costs 0.2 m/m and saves more, so all but the last are as narrow as
    # may be, 0.16 m: by convexity no walk without turning costs less than this one.
    least_m = 8 * (math.hypot(2.4 / 8, 0.16) + 0.1 + 0.2 * 0.04) + 0.2 + 0.1
    model = small_model(
        limits=StepLimits(x_m=(-0.15, 0.31), y_m=(0.16, 0.31), yaw_rad=(-0.16, 0.3)),
        steps=((0.3, 0.2, 0.0), (0.2, 0.2, 0.0), (0.1, 0.2, 0.0), (0.0, 0.2, 0.0)),
        turn_cost_m=0.05,
        side_cost_m=0.2,
        back_cost_m=0.2,
        cell_m=0.04,
    )
    before, after = both(FLOOR, model, start=(1.0, 2.0, 0.0), goal=(3.4, 2.0, 0.0))
    assert_laws(FLOOR, model, before, after)
    assert len(after) == 9
    assert before.cost_m > least_m + 0.1
    assert after.cost_m == pytest.approx(least_m, abs=0.01 * least_m)


def test_refining_twice_gains_little():
    # A model whose lattice is so fine that the refined plan is nearly on it again.
    grid, start, goal = FLOOR, (1.0, 1.0, 0.3), (4.6, 2.9, 2.0)
    planner = Planner(grid, small_model(), REFINED)
    plan = planner.plan(start=start, goal=goal)
    feet, costs = np.array(plan.start_feet_world), [plan.cost_m]
    for side, pose in list(zip(plan.side, plan.pose_world, strict=True))[:4]:
        # Planned again after every step, the way left costs what the first plan said.
        other = feet[1 - side]
        step = relative_step(other, pose, Side(int(side)))
        feet[side] = pose
        rest = planner.plan(start_feet_world=feet, goal=goal, first_side=Side(int(side)).other)
        left = costs[-1] - math.hypot(step[0], step[1]) - 0.1
        assert rest.cost_m <= left * 1.08
        costs.append(left)


def test_on_stairs_every_foot_stays_on_its_tread():
    grid, model = stairs()
    before, after = both(grid, model, start=(0.8, 1.0, 0.4), goal=(3.4, 1.1, 0.0))
    assert_laws(grid, model, before, after)
    assert after.cost_m < before.cost_m
    assert after.pose_world[-1, 2] == pytest.approx(0.2)
    assert len(np.unique(np.round(after.pose_world[:, 2], 6))) >= 4


def test_feet_that_stand_on_a_stair_stay_there_while_the_rest_is_moved():
    grid, model = stairs()
    # One foot on the first tread, the other on the second: 1.5..1.8 m and 1.8..2.1 m.
    feet = np.array([[1.93, 1.07, 0.1, 0.05], [1.66, 0.9, 0.05, 0.0]])
    before, after = both(
        grid, model, start_feet_world=feet, first_side=Side.RIGHT, goal=(3.4, 1.1, 0.0)
    )
    assert_laws(grid, model, before, after, stood_freely=False)
    assert after.side[0] == Side.RIGHT
    assert after.cost_m < before.cost_m
