"""Plans on floors that are not flat: against the oracle, by hand, and the laws of height."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from maps.grid import Cell, OccupancyGrid
from maps.reader import load_map
from planner.api import Planner, plan_footsteps
from planner.collision import NO_GROUND_UM, terrain_of
from planner.flood import Verdict, new_flood, spread
from planner.ground import box_heights, heights_below, highest_between, resting_heights
from planner.model import Side, StepLimits
from planner.picture import draw_plan
from planner.plan import PlanStatus, feet_at
from planner.verify import violations
from sim.robots import get_robot
from tests.planner_oracle import Oracle, small_model

LIMITS = StepLimits(x_m=(-0.2, 0.3), y_m=(0.14, 0.4), yaw_rad=(-0.4, 0.8), z_m=(-0.1, 0.1))
CLIMBER = small_model(limits=LIMITS, level_margin_m=0.0)


def floor(*treads, rows=24, cols=24, boxes=(), origin=(0.0, 0.0, 0.0), resolution_m=0.1):
    """A floor at 0 with treads (row0, col0, row1, col1, height) and blocked boxes."""
    heights = np.zeros((rows, cols))
    for row0, col0, row1, col1, height in treads:
        heights[row0:row1, col0:col1] = height
    cells = np.zeros((rows, cols), np.uint8)
    for row0, col0, row1, col1 in boxes:
        cells[row0:row1, col0:col1] = Cell.OCCUPIED
    return OccupancyGrid(cells=cells, resolution_m=resolution_m, origin=origin, elevation_m=heights)


STAIRS = ((0, 9, 24, 24, 0.1), (0, 12, 24, 24, 0.2), (0, 15, 24, 24, 0.3))
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


@pytest.mark.parametrize("name", CASES)
def test_the_cost_is_the_oracles_optimum(name):
    grid, start, goal = CASES[name]
    plan = plan_footsteps(grid, CLIMBER, start=start, goal=goal)
    best = Oracle(grid, CLIMBER, goal).best_cost(start)
    assert plan.found == math.isfinite(best)
    if plan.found:
        assert plan.epsilon == 1.0
        assert plan.cost_m == pytest.approx(best, abs=1e-5)
    assert violations(plan, grid, CLIMBER) == (
        [] if plan.found else ["status is no_path, not found"]
    )


def test_heights_only_make_plans_dearer_and_some_do():
    dearer = 0
    for grid, start, goal in CASES.values():
        with_heights = plan_footsteps(grid, CLIMBER, start=start, goal=goal)
        flat = plan_footsteps(replace(grid, elevation_m=None), CLIMBER, start=start, goal=goal)
        if with_heights.found:
            assert with_heights.cost_m >= flat.cost_m - 1e-9
            dearer += with_heights.cost_m > flat.cost_m + 0.1
    assert dearer >= 3


def test_a_kerb_is_stepped_over_if_the_swing_clears_it():
    grid, start, goal = CASES["a kerb to go around"]
    around = plan_footsteps(grid, CLIMBER, start=start, goal=goal)
    high = small_model(limits=LIMITS, level_margin_m=0.0, swing_clear_m=0.08, cell_m=0.05)
    over = plan_footsteps(grid, high, start=start, goal=goal)
    assert max(around.pose_world[:, 1]) > 1.5
    assert max(over.pose_world[:, 1]) < 1.2
    assert not over.pose_world[:, 2].any()
    assert violations(over, grid, high) == []
    # Who clears less is told so by the independent check.
    low = replace(high, swing_clear_m=0.079)
    assert any("swings over ground at z 0.080" in line for line in violations(over, grid, low))


@pytest.mark.parametrize("height_m", [0.0, 0.37, -1.25])
def test_on_a_level_floor_the_plan_is_the_flat_one_but_for_its_height(height_m):
    flat = OccupancyGrid(cells=floor(boxes=((0, 11, 15, 12),)).cells, resolution_m=0.1)
    level = replace(flat, elevation_m=np.full(flat.shape, height_m))
    for start, goal in (((0.55, 0.6, 0.3), (1.8, 0.7, -1.2)), ((0.5, 2.0, 0.0), (2.0, 2.0, 3.0))):
        one = plan_footsteps(flat, small_model(), start=start, goal=goal)
        other = plan_footsteps(level, small_model(), start=start, goal=goal)
        assert len(one) > 3
        np.testing.assert_array_equal(one.pose_world[:, [0, 1, 3]], other.pose_world[:, [0, 1, 3]])
        assert not one.pose_world[:, 2].any()
        assert (other.pose_world[:, 2] == height_m).all()
        assert (other.start_feet_world[:, 2] == height_m).all()
        assert (one.cost_m, one.expansions) == (other.cost_m, other.expansions)


def test_lifting_the_floor_lifts_the_plan():
    grid, start, goal = CASES["walls on the treads"]
    lifted = replace(grid, elevation_m=grid.elevation_m - 2.5)
    plan = plan_footsteps(grid, CLIMBER, start=start, goal=goal)
    lower = plan_footsteps(lifted, CLIMBER, start=start, goal=goal)
    assert len(plan) > 3
    np.testing.assert_allclose(lower.pose_world, plan.pose_world - (0, 0, 2.5, 0), atol=1e-9)


def test_heights_below_walls_mean_nothing():
    grid, start, goal = CASES["walls on the treads"]
    heights = np.where(grid.blocked(), 9.0, grid.elevation_m)
    plan = plan_footsteps(grid, CLIMBER, start=start, goal=goal)
    other = plan_footsteps(replace(grid, elevation_m=heights), CLIMBER, start=start, goal=goal)
    np.testing.assert_array_equal(plan.pose_world, other.pose_world)


def test_rise_and_fall_have_limits_of_their_own():
    grid = floor((0, 12, 24, 24, 0.1))
    low, high = (0.55, 1.2, 0.0), (1.95, 1.2, 0.0)
    up_only = replace(CLIMBER, limits=replace(LIMITS, z_m=(-0.05, 0.1)))
    assert plan_footsteps(grid, up_only, start=low, goal=high).found
    down = plan_footsteps(grid, up_only, start=high, goal=low)
    assert down.status is PlanStatus.NO_PATH
    assert down.reason.endswith("steps go from -0.05 to 0.1 m")


@pytest.mark.parametrize("z_m", [(0.01, 0.1), (-0.1, -0.01), (0.1, -0.1)])
def test_limits_without_level_steps_are_refused(z_m):
    with pytest.raises(ValueError, match="step limits z_m"):
        replace(LIMITS, z_m=z_m)


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
    box = x, y, math.cos(yaw), math.sin(yaw), half_l, half_w
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


def test_planning_goes_on_from_feet_measured_on_the_stairs():
    grid, start, goal = CASES["stairs"]
    plan = plan_footsteps(grid, CLIMBER, start=start, goal=goal)
    feet = plan.start_feet_world.copy()
    feet[plan.side[0]] = plan.pose_world[0]
    feet[plan.side[1]] = plan.pose_world[1]
    exact = plan_footsteps(grid, CLIMBER, start_feet_world=feet, goal=goal)
    feet[:, 2] += (0.015, -0.012)
    rough = plan_footsteps(grid, CLIMBER, start_feet_world=feet, goal=goal)
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
    model = small_model(limits=LIMITS, level_margin_m=0.0, stance_width_m=0.3)
    blocked = plan_footsteps(grid, model, start=(1.8, 0.7, 0.0), goal=goal)
    assert blocked.status is PlanStatus.GOAL_BLOCKED
    assert blocked.reason.startswith(reason)
    there = tuple(float(v) for v in blocked.reason.rsplit(" ", 1)[1].split(","))
    assert math.dist(there[:2], goal[:2]) < 0.3
    again = plan_footsteps(grid, model, start=(1.8, 0.7, 0.0), goal=there)
    assert again.status is not PlanStatus.GOAL_BLOCKED
    start = plan_footsteps(grid, model, start=goal, goal=(1.8, 0.7, 0.0))
    assert start.status is PlanStatus.START_BLOCKED
    assert start.reason.startswith(reason.replace("goal:", "start:"))


@pytest.mark.parametrize("name", CASES)
def test_the_floods_meet_just_where_there_is_a_plan(name):
    grid, start, goal = CASES[name]
    planner = Planner(grid, CLIMBER)
    plan = planner.plan(start=start, goal=goal)
    assert planner._toward is not None
    space, oracle = planner._toward[1].space, Oracle(grid, CLIMBER, goal)

    def number(node):
        col, row, heading, side = node
        cell = (row + space.origin_row) * space.cols + col + space.origin_col
        return (cell * space.headings + heading) * 2 + side

    seeds = np.array([number(node) for _, node in oracle.first_steps(start)], np.int64)
    goals = np.array([number((0, 0, 0, side)) for side in (0, 1)])
    flood, verdict = new_flood(space, seeds, goals), Verdict.OPEN
    while verdict is Verdict.OPEN:
        flood, verdict = spread(space, flood, 7)
    assert (verdict is Verdict.MET) == plan.found


STAIRS_MAP = load_map("maps/stairs.yaml")


@pytest.mark.parametrize(
    ("start", "goal", "z_m"),
    [
        ((0.0, 0.0, 0.0), (8.0, 0.0, 0.0), 0.0),
        ((8.5, -1.2, 2.0), (-0.6, 1.1, -1.3), 0.0),
        ((0.3, 0.9, 1.0), (4.1, 0.1, 1.57), 0.6),
        ((4.1, 0.0, 0.0), (8.3, 1.0, -2.0), 0.0),
    ],
)
@pytest.mark.parametrize("name", ["jvrc1", "hrp5p"])
def test_stairs_are_walked_with_feet_well_inside_the_treads(name, start, goal, z_m):
    model = get_robot(name).step_model
    plan = plan_footsteps(STAIRS_MAP, model, start=start, goal=goal)
    assert plan.found
    assert violations(plan, STAIRS_MAP, model) == []
    assert (plan.pose_world[-2:, 2] == z_m).all()
    assert np.ptp(plan.pose_world[:, 2]) >= 0.5
    rises = np.abs(np.diff(plan.pose_world[:, 2]))
    assert rises.max() == pytest.approx(0.1)
    # Corners of the soles keep off the edges at x = 2.0, 2.3 ... 3.5 and 4.7 ... 6.2.
    edges_m = np.concatenate([2.0 + 0.3 * np.arange(6), 4.7 + 0.3 * np.arange(6)])
    x, half_l, half_w = plan.pose_world[:, 0], model.foot.length_m / 2, model.foot.width_m / 2
    yaw = plan.pose_world[:, 3]
    reach = np.abs(np.cos(yaw)) * half_l + np.abs(np.sin(yaw)) * half_w
    gaps = np.abs(x[:, None] - edges_m) - reach[:, None]
    assert gaps.min() >= model.level_margin_m - 1e-6


def test_a_robot_that_does_not_climb_is_told_so():
    model = replace(get_robot("jvrc1").step_model, limits=replace(LIMITS, z_m=(-0.01, 0.01)))
    model = replace(model, steps=((0.3, 0.2, 0.0), (0.0, 0.2, 0.0), (0.0, 0.2, 0.3)))
    plan = plan_footsteps(STAIRS_MAP, model, start=(0, 0, 0), goal=(8, 0, 0))
    assert plan.status is PlanStatus.NO_PATH
    assert plan.reason.endswith("steps go from -0.01 to 0.01 m")


def test_the_independent_check_finds_wrong_heights():
    model = get_robot("jvrc1").step_model
    plan = plan_footsteps(STAIRS_MAP, model, start=(0, 0, 0), goal=(4.1, 0, 0))
    poses = plan.pose_world.copy()
    poses[-5, 2] += 0.01
    lines = violations(replace(plan, pose_world=poses), STAIRS_MAP, model)
    assert any("is not the height of the ground" in line for line in lines)
    assert any("rise 0.1100 is outside" in line for line in lines)
    poses = plan.pose_world.copy()
    poses[-5, 0] += 0.06
    assert any(
        "is not level" in line
        for line in violations(replace(plan, pose_world=poses), STAIRS_MAP, model)
    )
    flat = replace(STAIRS_MAP, elevation_m=None)
    assert any("flat floor" in line for line in violations(plan, flat, model))


def test_the_picture_shades_the_floor_by_its_height():
    model = get_robot("jvrc1").step_model
    plan = plan_footsteps(STAIRS_MAP, model, start=(0, 0, 0), goal=(0.5, 0, 0))
    image = draw_plan(plan, STAIRS_MAP, model)
    scale = image.shape[1] / STAIRS_MAP.size_m[0]

    def shade(x_m):
        return int(image[round((2.5 - 0.55) * scale), round((x_m + 2.0) * scale)].sum())

    shades = [shade(1.85 + 0.3 * i) for i in range(7)]
    assert all(np.diff(shades) < 0)
    assert shade(-1.15) == shades[0]


def test_feet_may_stand_at_two_heights_where_the_robot_has_got_to_but_not_at_a_goal():
    grid = floor((0, 0, 12, 24, 0.1))
    feet = feet_at((0.7, 1.2, 0.0), 0.2)
    feet[Side.RIGHT, 2] = 0.1
    plan = plan_footsteps(grid, CLIMBER, start_feet_world=feet, goal=(1.7, 1.6, 0.0))
    assert plan.found
    assert plan.start_feet_world[:, 2].tolist() == [0.0, 0.1]
    assert violations(plan, grid, CLIMBER, stood_freely=False) == []
    across = plan_footsteps(grid, CLIMBER, start_feet_world=feet, goal=(1.7, 1.2, 0.0))
    assert across.status is PlanStatus.GOAL_BLOCKED
    assert "the right foot would stand 0.10 m higher than the other" in across.reason
