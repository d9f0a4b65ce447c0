"""Floors that are not flat: heights under boxes by hand, plans against the oracle."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from planner.collision import (
    NO_GROUND_UM,
    box_heights,
    heights_below,
    highest_between,
    resting_heights,
    terrain_of,
)
from planner.plan import PlanStatus, feet_at
from planner.planner import Planner
from planner.robot_model import Side
from planner.verify import violations
from tests.planner_floor import (
    CLIMBING,
    LATTICE,
    STAIRS,
    first_quick,
    floods_meet,
    plan_on_lattice,
    walled,
)
from tests.planner_oracle import Oracle, small_model

CLIMBER = small_model(limits=CLIMBING, level_margin_m=0.0)


def floor(*treads, **others):
    return walled(treads=treads, **others)


CLIFF = ((0, 11, 24, 24, 0.2), (15, 8, 24, 11, 0.1))
KERB = ((0, 11, 15, 12, 0.08),)
CASES = {
    "stairs": (floor(*STAIRS), (0.45, 1.13, 0.1), (1.93, 1.22, 0.0)),
    "stairs that no foot fits": (floor(*STAIRS), (0.45, 1.13, 0.1), (1.95, 1.22, 0.4)),
    "down": (floor(*STAIRS), (1.95, 1.22, 2.9), (0.45, 1.13, 3.0)),
    "slanted stairs": (
        floor(*STAIRS, origin=(-1.0, 2.0, 0.6)),
        (-1.28, 3.17, 0.7),
        (-0.09, 4.09, 0.8),
    ),
    "a cliff with a step beside it": (floor(*CLIFF), (0.5, 0.6, 0.3), (1.75, 0.7, 0.0)),
    "a kerb to go around": (floor(*KERB), (0.52, 0.6, 0.3), (1.83, 0.71, -0.3)),
    "a trench": (
        floor((0, 24, 48, 25, -0.4), rows=48, cols=48, resolution_m=0.05),
        (0.52, 1.1, 0.0),
        (1.86, 1.2, 0.0),
    ),
    "walls on the treads": (
        floor(*STAIRS, boxes=((0, 10, 7, 14),)),
        (0.45, 0.6, 0.1),
        (1.93, 0.82, 0.0),
    ),
}

# Heights by hand: a floor of 4 x 4 m in cells of 0.1 m, 0.3 m high from x = 2 on, a post 1 m high
# on the cell [1, 1.1) x [1, 1.1), a blocked cell beside it.
HAND = floor(
    (0, 20, 40, 40, 0.3), (10, 10, 11, 11, 1.0), rows=40, cols=40, boxes=((10, 11, 11, 12),)
)


@pytest.mark.parametrize(
    ("x", "y", "yaw", "half_l", "half_w", "expected_m"),
    [
        (1.5, 3.0, 0.0, 0.3, 0.2, (0.0, 0.0)),
        (2.5, 3.0, 0.0, 0.3, 0.2, (0.3, 0.3)),
        (1.95, 3.0, 0.0, 0.3, 0.2, (0.0, 0.3)),
        (1.79, 3.0, 0.0, 0.2, 0.1, (0.0, 0.0)),  # ends at 1.99
        (1.81, 3.0, 0.0, 0.2, 0.1, (0.0, 0.3)),  # ends at 2.01
        (1.81, 3.0, math.pi / 2, 0.2, 0.1, (0.0, 0.0)),  # turned it ends at 1.91
        (1.84, 3.0, math.pi / 4, 0.2, 0.01, (0.0, 0.0)),  # 0.21 cos 45 = 0.149: ends at 1.989
        (1.86, 3.0, math.pi / 4, 0.2, 0.01, (0.0, 0.3)),
        (1.05, 1.05, 0.0, 0.04, 0.04, (1.0, 1.0)),
        (1.05, 1.05, 0.0, 0.06, 0.04, (0.0, 1.0)),
        (1.13, 1.05, 0.0, 0.02, 0.04, None),  # blocked ground only
        (0.1, 0.1, 0.3, 0.5, 0.5, (0.0, 0.0)),  # partly off the map
        (-9.0, 0.1, 0.0, 0.5, 0.5, None),
    ],
)
def test_heights_under_a_box_by_hand(x, y, yaw, half_l, half_w, expected_m):
    box = x, y, math.cos(yaw), math.sin(yaw), (half_l, half_w, 0.0)
    expected = (NO_GROUND_UM,) * 2 if expected_m is None else tuple(1e6 * v for v in expected_m)
    assert box_heights(terrain_of(HAND, False), *box) == expected


@pytest.mark.parametrize(
    ("start", "end", "yaw", "expected_m"),
    [
        # A sole of 0.2 x 0.1 m, walking along x past the post at y 1.0 to 1.1.
        ((0.5, 1.17), (1.5, 1.17), 0.0, 0.0),  # its side is at 1.12
        ((0.5, 1.14), (1.5, 1.14), 0.0, 1.0),  # at 1.09
        ((0.5, 1.19), (1.5, 1.19), math.pi / 2, 1.0),  # walking sideways, its toes are at 1.09
        ((0.5, 1.05), (0.95, 1.05), 0.0, 0.0),  # the strip ends at the foot's centre
        ((1.5, 3.0), (1.95, 3.0), 0.0, 0.0),
        ((1.5, 3.0), (2.05, 3.0), 0.0, 0.3),
        ((1.05, 1.05), (1.05, 1.05), 0.0, None),  # no way at all
    ],
)
def test_ground_on_the_way_of_a_foot_by_hand(start, end, yaw, expected_m):
    top = highest_between(
        terrain_of(HAND, False), start, end, math.cos(yaw), math.sin(yaw), (0.1, 0.05)
    )
    assert top == (NO_GROUND_UM if expected_m is None else expected_m * 1e6)


def test_a_measured_foot_rests_on_what_is_nearest_to_its_own_height():
    terrain = terrain_of(HAND, False)
    # Soles of 0.2 x 0.1 m: on the floor, on the step, across its edge, and beside the map.
    feet = np.array(
        [
            [1.0, 3.0, 0.02, 0.0],
            [2.5, 3.0, 0.28, 0.0],
            [2.05, 3.0, 0.29, 0.0],
            [1.95, 3.0, 0.01, 0.0],
            [-5.0, 3.0, 0.7, 0.0],
        ]
    )
    rests = resting_heights(HAND, terrain, CLIMBER, feet)
    assert rests.tolist() == [0.0, 0.3, 0.3, 0.0, 0.7]
    assert heights_below(HAND, terrain, CLIMBER, feet)[2].tolist() == [0.0, 0.3]


@pytest.mark.parametrize("name", first_quick(CASES))
def test_the_cost_is_the_oracles_optimum(name):
    grid, start, goal = CASES[name]
    plan = plan_on_lattice(grid, CLIMBER, start=start, goal=goal)
    best = Oracle(grid, CLIMBER, goal).best_cost(start)
    assert plan.found == math.isfinite(best)
    if plan.found:
        assert plan.epsilon == 1.0
        assert plan.cost_m == pytest.approx(best, abs=1e-5)
    assert violations(plan, grid, CLIMBER) == (
        [] if plan.found else ["status is no_path, not found"]
    )


def test_a_kerb_is_stepped_over_if_the_swing_clears_it():
    grid, start, goal = CASES["a kerb to go around"]
    around = plan_on_lattice(grid, CLIMBER, start=start, goal=goal)
    high = small_model(limits=CLIMBING, level_margin_m=0.0, swing_clear_m=0.08, cell_m=0.05)
    over = plan_on_lattice(grid, high, start=start, goal=goal)
    assert max(around.pose_world[:, 1]) > 1.5
    assert max(over.pose_world[:, 1]) < 1.2
    assert not over.pose_world[:, 2].any()
    assert violations(over, grid, high) == []
    # Who clears less is told so by the independent check.
    low = replace(high, swing_clear_m=0.079)
    assert any("swings over ground at z 0.080" in line for line in violations(over, grid, low))


@pytest.mark.parametrize("height_m", [0.0, 0.37, -1.25])
def test_on_a_level_floor_the_plan_is_the_flat_one_but_for_its_height(height_m):
    flat = walled(boxes=((0, 11, 15, 12),))
    level = replace(flat, elevation_m=np.full(flat.shape, height_m))
    for start, goal in (((0.55, 0.6, 0.3), (1.8, 0.7, -1.2)), ((0.5, 2.0, 0.0), (2.0, 2.0, 3.0))):
        one = plan_on_lattice(flat, small_model(), start=start, goal=goal)
        other = plan_on_lattice(level, small_model(), start=start, goal=goal)
        assert len(one) > 3
        np.testing.assert_array_equal(one.pose_world[:, [0, 1, 3]], other.pose_world[:, [0, 1, 3]])
        assert not one.pose_world[:, 2].any()
        assert (other.pose_world[:, 2] == height_m).all()
        assert (other.start_feet_world[:, 2] == height_m).all()
        assert (one.cost_m, one.expansions) == (other.cost_m, other.expansions)


def test_lifting_the_floor_lifts_the_plan():
    grid, start, goal = CASES["walls on the treads"]
    lifted = replace(grid, elevation_m=grid.elevation_m - 2.5)
    plan = plan_on_lattice(grid, CLIMBER, start=start, goal=goal)
    lower = plan_on_lattice(lifted, CLIMBER, start=start, goal=goal)
    assert len(plan) > 3
    np.testing.assert_allclose(lower.pose_world, plan.pose_world - (0, 0, 2.5, 0), atol=1e-9)


def test_heights_below_walls_mean_nothing():
    grid, start, goal = CASES["walls on the treads"]
    heights = np.where(grid.blocked(), 9.0, grid.elevation_m)
    plan = plan_on_lattice(grid, CLIMBER, start=start, goal=goal)
    other = plan_on_lattice(replace(grid, elevation_m=heights), CLIMBER, start=start, goal=goal)
    np.testing.assert_array_equal(plan.pose_world, other.pose_world)


def test_rise_and_fall_have_limits_of_their_own():
    grid = floor((0, 12, 24, 24, 0.1))
    low, high = (0.55, 1.2, 0.0), (1.95, 1.2, 0.0)
    up_only = replace(CLIMBER, limits=replace(CLIMBING, z_m=(-0.05, 0.1)))
    assert plan_on_lattice(grid, up_only, start=low, goal=high).found
    down = plan_on_lattice(grid, up_only, start=high, goal=low)
    assert down.status is PlanStatus.NO_PATH
    assert down.reason.endswith("steps go from -0.05 to 0.1 m")


@pytest.mark.parametrize("z_m", [(0.01, 0.1), (-0.1, -0.01), (0.1, -0.1)])
def test_limits_without_level_steps_are_refused(z_m):
    with pytest.raises(ValueError, match="step limits z_m"):
        replace(CLIMBING, z_m=z_m)


def test_planning_goes_on_from_feet_measured_on_the_stairs():
    grid, start, goal = CASES["stairs"]
    plan = plan_on_lattice(grid, CLIMBER, start=start, goal=goal)
    feet = plan.start_feet_world.copy()
    feet[plan.side[0]] = plan.pose_world[0]
    feet[plan.side[1]] = plan.pose_world[1]
    exact = plan_on_lattice(grid, CLIMBER, start_feet_world=feet, goal=goal)
    feet[:, 2] += (0.015, -0.012)
    rough = plan_on_lattice(grid, CLIMBER, start_feet_world=feet, goal=goal)
    assert max(feet[:, 2]) > 0.08
    assert exact.found
    np.testing.assert_array_equal(exact.pose_world, rough.pose_world)


@pytest.mark.parametrize(
    ("goal", "reason"),
    [
        ((1.2, 1.2, 0.0), "goal: the ground under the left foot at 1.20,1.35 is not level: it"),
        (
            (1.1, 1.2, math.pi / 2),
            "goal: the right foot would stand 0.20 m higher than the other; the nearest",
        ),
    ],
)
def test_a_place_that_is_not_level_is_refused_and_another_offered(goal, reason):
    grid = floor((0, 11, 24, 24, 0.2), (0, 0, 24, 11, 0.0))
    model = small_model(limits=CLIMBING, level_margin_m=0.0, stance_width_m=0.3)
    blocked = plan_on_lattice(grid, model, start=(1.8, 0.7, 0.0), goal=goal)
    assert blocked.status is PlanStatus.GOAL_BLOCKED
    assert blocked.reason.startswith(reason)
    there = tuple(float(v) for v in blocked.reason.rsplit(" ", 1)[1].split(","))
    assert math.dist(there[:2], goal[:2]) < 0.3
    again = plan_on_lattice(grid, model, start=(1.8, 0.7, 0.0), goal=there)
    assert again.status is not PlanStatus.GOAL_BLOCKED
    start = plan_on_lattice(grid, model, start=goal, goal=(1.8, 0.7, 0.0))
    assert start.status is PlanStatus.START_BLOCKED
    assert start.reason.startswith(reason.replace("goal:", "start:"))


@pytest.mark.parametrize("name", CASES)
def test_the_floods_meet_just_where_there_is_a_plan(name):
    grid, start, goal = CASES[name]
    planner = Planner(grid, CLIMBER, LATTICE)
    plan = planner.plan(start=start, goal=goal)
    lattice = planner.goal_context(goal).lattice
    assert floods_meet(lattice, Oracle(grid, CLIMBER, goal), start) == plan.found


def test_feet_may_stand_at_two_heights_where_the_robot_has_got_to_but_not_at_a_goal():
    grid = floor((0, 0, 12, 24, 0.1))
    feet = feet_at((0.7, 1.2, 0.0), 0.2)
    feet[Side.RIGHT, 2] = 0.1
    plan = plan_on_lattice(grid, CLIMBER, start_feet_world=feet, goal=(1.7, 1.6, 0.0))
    assert plan.found
    assert plan.start_feet_world[:, 2].tolist() == [0.0, 0.1]
    assert violations(plan, grid, CLIMBER, stood_freely=False) == []
    across = plan_on_lattice(grid, CLIMBER, start_feet_world=feet, goal=(1.7, 1.2, 0.0))
    assert across.status is PlanStatus.GOAL_BLOCKED
    assert "the right foot would stand 0.10 m higher than the other" in across.reason
