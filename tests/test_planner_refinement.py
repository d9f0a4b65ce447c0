"""Refinement off the lattice: what it must keep, and what it must gain, by hand and on stairs."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from maps.grid import Cell, OccupancyGrid
from planner.plan import feet_at, relative_step
from planner.planner import Planner, plan_footsteps, plan_through
from planner.robot_model import Side, StepLimits
from planner.verify import violations
from tests.planner_floor import LATTICE, first_quick
from tests.planner_oracle import small_model
from tests.planner_refinement import (
    FLOOR,
    REFINED,
    assert_laws,
    both,
    random_floor,
    shy_model,
    stairs,
    steps_of,
)


@pytest.mark.parametrize("seed", first_quick(range(8)))
def test_plans_among_random_obstacles_keep_all_laws_and_get_cheaper(seed):
    grid, rng = random_floor(seed)
    model = shy_model() if seed % 3 else small_model(cell_m=0.05, headings=16)
    saved: list[float] = []
    while len(saved) < 5:
        start, goal = rng.uniform((0.2, 0.2, -3.1), (2.8, 2.8, 3.1), (2, 3))
        start[:2], goal[:2] = grid.grid_to_world([start[:2], goal[:2]])
        before, after = both(grid, model, start=start, goal=goal)
        assert_laws(grid, model, before, after)
        if before.found and len(before) > 2:
            saved.append(1 - after.cost_m / before.cost_m)
    assert np.mean(saved) > 0.05


def test_the_same_query_gives_the_same_bytes():
    grid, _ = random_floor(3)
    model = shy_model()
    start, goal = (*grid.grid_to_world([0.4, 0.4]), 0.3), (*grid.grid_to_world([2.4, 2.3]), 2.0)
    texts = {
        plan_footsteps(grid, model, start=start, goal=goal, options=REFINED)
        .to_json()
        .split('"time_to')[0]
        for _ in range(2)
    }
    assert len(texts) == 1


def test_the_reported_cost_is_that_of_the_steps():
    grid, start, goal = FLOOR, (1.0, 1.0, 0.3), (4.6, 2.9, 2.0)
    model = small_model(turn_cost_m=0.05, side_cost_m=0.2, back_cost_m=0.3)
    plan = plan_footsteps(grid, model, start=start, goal=goal, options=REFINED)
    cost_m = 0.0
    for x, y, yaw in steps_of(plan):
        cost_m += math.sqrt(x * x + y * y) + 0.1 + 0.05 * abs(yaw) + 0.2 * abs(y - 0.2)
        cost_m += 0.3 * max(0.0, -x)
    assert plan.cost_m == pytest.approx(cost_m, abs=1e-6 * len(plan))


def test_what_the_polygon_check_refuses_is_not_taken(monkeypatch):
    start, goal = (1.0, 1.0, 0.3), (4.6, 2.9, 2.0)
    before, after = both(FLOOR, small_model(), start=start, goal=goal)
    assert after.cost_m < before.cost_m
    monkeypatch.setattr(
        "planner.planner.violations", lambda *_, **__: ["step 3: the foot hits something"]
    )
    kept = plan_footsteps(FLOOR, small_model(), options=REFINED, start=start, goal=goal)
    assert kept.cost_m == kept.cost_before_refinement_m == before.cost_m
    assert np.array_equal(kept.pose_world, before.pose_world)
    assert np.array_equal(kept.side, before.side)


def test_a_plan_to_a_region_ends_where_the_search_ended_it():
    grid, model = FLOOR, small_model()
    options = (replace(o, goal_reach_m=0.3, goal_reach_rad=0.8) for o in (LATTICE, REFINED))
    before, after = (
        plan_footsteps(grid, model, start=(1.0, 1.0, 0.3), goal=(4.6, 2.9, 2.0), options=o)
        for o in options
    )
    assert after.cost_m < before.cost_m
    assert after.cost_before_refinement_m == before.cost_m
    assert violations(after, grid, model, goal_reach=(0.3, 0.8)) == []
    ends = [dict(zip(p.side[-2:], p.pose_world[-2:], strict=True)) for p in (before, after)]
    for side in Side:
        np.testing.assert_allclose(ends[1][side], ends[0][side], atol=1e-12)
    assert violations(after, grid, model) == ["the last two feet are not the goal's"]


def test_every_leg_of_a_way_through_poses_is_refined():
    grid, model = FLOOR, small_model()
    poses = [(3.0, 1.5, 0.5), (3.0, 1.5, 0.5), (4.6, 2.9, 2.0)]
    plans = [
        plan_through(Planner(grid, model, options), start=(1.0, 1.0, 0.3), poses=poses)
        for options in (LATTICE, REFINED)
    ]
    assert plans[1].found
    assert violations(plans[1], grid, model) == []
    # The robot stands at the second pose already: that leg has no steps and no cost.
    assert plans[1].cost_m < (plans[1].cost_before_refinement_m or 0.0)
    legs = [
        plan_footsteps(grid, model, start=(1.0, 1.0, 0.3), goal=poses[0], options=options)
        for options in (LATTICE, REFINED)
    ]
    first = plans[1].pose_world[: len(legs[1])]
    assert first.tolist() == legs[1].pose_world.tolist()
    assert legs[1].cost_m < legs[0].cost_m
    assert plans[1].cost_m - legs[1].cost_m < plans[0].cost_m - legs[0].cost_m
    assert plans[0].cost_before_refinement_m is None


def test_fewer_steps_alternate_from_either_foot():
    model = small_model()
    for side in Side:
        before, after = both(
            FLOOR, model, start=(1.0, 1.0, 0.0), goal=(4.55, 3.1, 1.0), first_side=side
        )
        assert_laws(FLOOR, model, before, after)
        assert len(after) < len(before)
        assert after.side[0] == side
        assert np.all(np.diff(after.side.astype(int)) != 0)


def test_a_robot_that_stands_too_near_to_a_wall_gets_away():
    cells = np.zeros((60, 60), np.uint8)
    cells[:, :2] = Cell.OCCUPIED
    grid = OccupancyGrid(cells=cells, resolution_m=0.05)
    model = shy_model(body_margin_m=0.1, foot_margin_m=0.0)
    feet = feet_at((0.3, 1.5, math.pi / 2), 0.2)
    before, after = both(grid, model, start_feet_world=feet, goal=(2.2, 1.0, -0.5))
    assert after.found
    assert len(violations(after, grid, model, stood_freely=True)) > 0
    assert_laws(grid, model, before, after, stood_freely=False)


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
