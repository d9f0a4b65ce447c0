"""The laws that every plan obeys, plans by hand, and plans through via poses."""

from __future__ import annotations

import math

import numpy as np
import pytest

from planner.options import PlannerOptions
from planner.plan import PlanStatus, PlanWaypoint, feet_at, wrap_angle
from planner.planner import Planner, plan_through
from planner.robot_model import Side
from planner.verify import violations
from tests.planner_floor import (
    CASES,
    LATTICE,
    fine_model,
    plan_on_lattice,
    repeatable,
    scatter,
    walled,
)
from tests.planner_oracle import small_model


@pytest.mark.parametrize("seed", range(8))
def test_plans_among_random_obstacles_are_right_and_repeat(seed):
    rng = np.random.default_rng(seed)
    grid = walled(60, 60, resolution_m=0.05)
    cells = np.array(grid.cells)
    scatter(rng, cells, 5, 9)
    grid = grid.with_cells(cells)
    model = fine_model()
    found = 0
    while found < 3:
        start, goal = rng.uniform((0.2, 0.2, -3.1), (2.8, 2.8, 3.1), (2, 3))
        plan = plan_on_lattice(grid, model, start=start, goal=goal)
        if plan.found:
            found += 1
            assert violations(plan, grid, model) == []
            again = plan_on_lattice(grid, model, start=start, goal=goal)
            assert repeatable(again) == repeatable(plan)


def test_a_plan_ends_with_the_goal_feet_to_the_bit_and_begins_where_the_robot_stands():
    grid, start, goal = CASES["wall"]
    model = small_model()
    plan = plan_on_lattice(grid, model, start=start, goal=goal)
    feet = feet_at(goal, model.stance_width_m)
    for side, pose in zip(plan.side[-2:], plan.pose_world[-2:], strict=True):
        assert pose.tolist() == feet[side].tolist()
    assert set(plan.side[-2:].tolist()) == {0, 1}
    np.testing.assert_array_equal(plan.start_feet_world, feet_at(start, model.stance_width_m))


def test_straight_ahead_by_hand():
    # 0.9 m ahead at 0.3 m a step: first foot 0.3, second 0.6, third 0.9, fourth beside it. Each
    # of the three costs hypot(0.3, 0.2) + 0.1, the last 0.2 + 0.1.
    grid = walled(20, 30)
    plan = plan_on_lattice(grid, small_model(), start=(1.0, 1.0, 0.0), goal=(1.9, 1.0, 0.0))
    assert len(plan) == 4
    assert plan.cost_m == pytest.approx(3 * (math.hypot(0.3, 0.2) + 0.1) + 0.3, abs=1e-5)
    np.testing.assert_allclose(plan.pose_world[:, 0], [1.3, 1.6, 1.9, 1.9], atol=1e-9)
    np.testing.assert_allclose(np.abs(plan.pose_world[:, 1] - 1.0), 0.1, atol=1e-9)


def test_the_mirrored_problem_costs_the_same():
    grid, start, goal = CASES["wall"]
    mirrored = grid.with_cells(grid.cells[::-1])

    def flip(pose):
        return pose[0], 2.4 - pose[1], -pose[2]

    model = small_model()
    one = plan_on_lattice(grid, model, start=start, goal=goal)
    other = plan_on_lattice(mirrored, model, start=flip(start), goal=flip(goal))
    assert other.cost_m == pytest.approx(one.cost_m, abs=1e-5)
    assert len(other) == len(one)


@pytest.mark.parametrize("side", list(Side))
def test_the_first_foot_can_be_forced_and_is_else_the_cheaper_one(side):
    grid, start, goal = CASES["empty"]
    model = small_model()
    free = plan_on_lattice(grid, model, start=start, goal=goal)
    forced = plan_on_lattice(grid, model, start=start, goal=goal, first_side=side)
    assert forced.side[0] == side
    assert violations(forced, grid, model) == []
    assert free.cost_m <= forced.cost_m + 1e-9
    if free.side[0] == side:
        assert free.cost_m == forced.cost_m


@pytest.mark.parametrize(("name", "case"), [("ara", "wall"), ("rrtconnect", "slanted map")])
def test_planning_goes_on_from_feet_anywhere(name, case):
    grid, start, goal = CASES[case]
    model = small_model()
    planner = Planner(grid, model, PlannerOptions(name=name, refine=False))
    plan = planner.plan(start=start, goal=goal)
    feet = np.array(plan.start_feet_world)
    rng = np.random.default_rng(5)
    steps = list(zip(plan.side, plan.pose_world, strict=True))[:-2]
    assert len(steps) > 3
    for side, pose in steps:
        # The robot steps, and misses by a little.
        feet[side] = pose + rng.uniform(-1, 1, 4) * (0.03, 0.03, 0.0, 0.05)
        rest = planner.plan(start_feet_world=feet, goal=goal, first_side=Side(int(side)).other)
        assert rest.found
        assert rest.side[0] != side
        assert violations(rest, grid, model, stood_freely=False) == []
        np.testing.assert_array_equal(rest.start_feet_world, feet)


def test_no_step_is_needed_where_the_robot_stands_already():
    grid, start, _ = CASES["empty"]
    plan = plan_on_lattice(grid, small_model(), start=start, goal=start)
    assert plan.found
    assert (len(plan), plan.cost_m, plan.epsilon) == (0, 0.0, 1.0)
    assert violations(plan, grid, small_model()) == []


def test_near_the_goal_no_step_is_wasted():
    # A foot's length ahead: one step and its closing step, never more.
    grid, _, _ = CASES["empty"]
    plan = plan_on_lattice(grid, small_model(), start=(1.0, 1.2, 0.0), goal=(1.2, 1.2, 0.0))
    assert len(plan) == 2


@pytest.mark.parametrize("thickness", [1, 2, 3])
def test_no_plan_steps_through_a_wall(thickness):
    # Feet could straddle 5, 10 or 15 cm sideways; the body cannot.
    grid = walled(48, 48, boxes=((0, 24, 48, 24 + thickness),), resolution_m=0.05)
    model = small_model()
    for yaw in (0.0, math.pi / 2):
        plan = plan_on_lattice(grid, model, start=(0.7, 1.2, yaw), goal=(1.9, 1.2, yaw))
        assert plan.status is PlanStatus.NO_PATH
        assert plan.reason
        # Found by the 2D search: the lattice was not searched at all.
        assert plan.expansions == 0


def test_a_door_is_used_if_the_body_fits_and_only_then():
    model = small_model()
    for cells, fits in ((5, True), (3, False)):
        # A wall across with a door of so many cells of 0.1 m; the body is 0.36 m wide.
        grid = walled(24, 24, boxes=((0, 12, 10, 13), (10 + cells, 12, 24, 13)))
        plan = plan_on_lattice(grid, model, start=(0.6, 1.2, 0.0), goal=(1.8, 1.2, 0.0))
        assert plan.found == fits


def test_clearance_draws_the_body_away_from_a_wall():
    grid = walled(24, 40, boxes=((0, 10, 6, 30),))
    start, goal = (0.6, 0.85, 0.0), (3.5, 0.85, 0.0)

    def nearest(model):
        plan = plan_on_lattice(grid, model, start=start, goal=goal)
        x, y = plan.pose_world[:, 0], plan.pose_world[:, 1]
        return y[(x > 1.0) & (x < 3.0)].min()

    plain = small_model()
    shy = small_model(clearance_m=0.3, clearance_cost_m=0.3)
    assert nearest(shy) > nearest(plain) + 0.1


def test_headings_count_from_the_goal_and_wrap():
    grid, start, goal = CASES["empty"]
    plan = plan_on_lattice(grid, small_model(), start=start, goal=goal)
    off = wrap_angle(plan.pose_world[:, 3] - goal[2]) / (2 * math.pi / 8)
    np.testing.assert_allclose(off, np.round(off), atol=1e-9)
    assert np.all(np.abs(plan.pose_world[:, 3]) <= math.pi)


START, VIA, GOAL = (0.5, 0.5, 0.0), (1.5, 0.6, 1.0), (0.8, 1.8, 2.5)


def test_the_robot_stands_at_every_pose_and_steps_alternate():
    grid, model = walled(), small_model()
    plan = plan_through(Planner(grid, model, options=LATTICE), start=START, poses=[VIA, GOAL])
    assert plan.found
    assert plan.goal == GOAL
    assert np.all(np.diff(plan.side) != 0)
    assert violations(plan, grid, model) == []
    stood = [
        set(plan.side[k : k + 2]) == {0, 1}
        and np.allclose(
            plan.pose_world[k : k + 2], feet_at(VIA, model.stance_width_m)[plan.side[k : k + 2]]
        )
        for k in range(len(plan) - 1)
    ]
    assert sum(stood) == 1
    (point,) = plan.waypoints
    assert point == PlanWaypoint(pose=VIA, step=stood.index(True) + 2)


def test_a_way_through_poses_begins_with_the_plan_to_the_first():
    planner = Planner(walled(), small_model(), options=LATTICE)
    first = planner.plan(goal=VIA, start=START)
    alone = plan_through(planner, start=START, poses=[VIA])
    plan = plan_through(planner, start=START, poses=[VIA, GOAL])
    assert alone.cost_m == first.cost_m < plan.cost_m
    assert np.array_equal(plan.pose_world[: len(first)], first.pose_world)


def test_a_waypoint_without_a_way_is_named():
    grid, model = walled(boxes=((13, 0, 14, 24),)), small_model()
    beyond = (0.8, 1.95, 2.5)

    def plan(*poses):
        return plan_through(Planner(grid, model, options=LATTICE), start=START, poses=poses)

    at_goal, on_the_way = plan(VIA, beyond), plan(VIA, beyond, VIA)
    for refused in (at_goal, on_the_way):
        assert refused.status is PlanStatus.NO_PATH
        assert len(refused) == len(refused.waypoints) == 0
    assert "waypoint" not in at_goal.reason
    assert on_the_way.reason == f"waypoint 2: {at_goal.reason.removeprefix('goal: ')}"


def test_no_pose_is_an_error():
    with pytest.raises(ValueError, match="poses is empty"):
        plan_through(Planner(walled(), small_model(), options=LATTICE), start=START, poses=[])
