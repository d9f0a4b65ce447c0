"""Refinement off the lattice: what it may not break, what it must gain, its parts by numbers."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from shapely import affinity

from maps.grid import Cell, OccupancyGrid
from planner.api import Planner, plan_footsteps
from planner.barrier import add, new_work, note_costs, note_rules, take_block
from planner.chain import build_rules, chain_cost_um, foot_height_um, gap_axis, step_between
from planner.collision import terrain_of
from planner.keep_off import WAYS, room_off_blocked
from planner.lattice import feet_apart
from planner.model import Side, StepLimits
from planner.options import PlannerOptions
from planner.plan import FootstepPlan, feet_at, relative_step
from planner.relax import _solve
from planner.through import plan_through
from planner.verify import violations
from tests.planner_oracle import small_model

REFINED = PlannerOptions(refine=True)
LATTICE = PlannerOptions(refine=False)
FLOOR = OccupancyGrid(cells=np.zeros((40, 60), np.uint8), resolution_m=0.1)
SHY = {
    "cell_m": 0.05,
    "headings": 16,
    "turn_cost_m": 0.05,
    "side_cost_m": 0.2,
    "back_cost_m": 0.2,
    "foot_margin_m": 0.01,
    "body_margin_m": 0.02,
    "clearance_m": 0.2,
    "clearance_cost_m": 0.1,
}


def random_floor(seed, cells=60):
    rng = np.random.default_rng(seed)
    floor = np.zeros((cells, cells), np.uint8)
    for row, col in rng.integers(0, cells, (6, 2)):
        floor[row : row + rng.integers(1, 9), col : col + rng.integers(1, 9)] = Cell.OCCUPIED
    origin = (*rng.uniform(-3, 3, 2), rng.uniform(-3, 3)) if seed % 2 else (0.0, 0.0, 0.0)
    return OccupancyGrid(cells=floor, resolution_m=0.05, origin=origin), rng


def both(grid, model, **query):
    """The plan on the lattice, and the refined one."""
    plans = [plan_footsteps(grid, model, options=o, **query) for o in (LATTICE, REFINED)]
    return plans[0], plans[1]


def steps_of(plan: FootstepPlan):
    """Steps (N, 3) of a plan as the limits count them."""
    support = plan.start_feet_world[Side(int(plan.side[0])).other]
    steps = []
    for side, pose in zip(plan.side, plan.pose_world, strict=True):
        steps.append(relative_step(support, pose, Side(int(side))))
        support = pose
    return np.array(steps)


def assert_laws(grid, model, before, after, stood_freely=True):
    assert after.found == before.found
    if not before.found:
        return
    assert before.cost_before_refinement_m is None
    assert after.cost_before_refinement_m == before.cost_m
    assert after.cost_m <= before.cost_m
    assert after.epsilon == before.epsilon
    assert len(after) <= len(before)
    assert violations(after, grid, model, stood_freely=stood_freely) == []
    steps = steps_of(after)
    assert model.limits.contain(steps, 1e-9).all()
    assert feet_apart(steps, model.foot, model.foot_gap_m - 1e-9).all()
    np.testing.assert_array_equal(after.start_feet_world, before.start_feet_world)
    goal = feet_at(after.goal, model.stance_width_m)
    assert after.pose_world[-2:, [0, 1, 3]].tolist() == goal[after.side[-2:]][:, [0, 1, 3]].tolist()
    assert set(after.side[-2:].tolist()) == {0, 1}


@pytest.mark.parametrize("seed", range(8))
def test_plans_among_random_obstacles_keep_all_laws_and_get_cheaper(seed):
    grid, rng = random_floor(seed)
    model = small_model(**(SHY if seed % 3 else {"cell_m": 0.05, "headings": 16}))
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
    model = small_model(**SHY)
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


def test_what_the_polygon_check_refuses_is_not_taken(monkeypatch):
    start, goal = (1.0, 1.0, 0.3), (4.6, 2.9, 2.0)
    before, after = both(FLOOR, small_model(), start=start, goal=goal)
    assert after.cost_m < before.cost_m
    monkeypatch.setattr(
        "planner.api.violations", lambda *_, **__: ["step 3: the foot hits something"]
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


def test_a_robot_that_stands_too_near_to_a_wall_gets_away():
    cells = np.zeros((60, 60), np.uint8)
    cells[:, :2] = Cell.OCCUPIED
    grid = OccupancyGrid(cells=cells, resolution_m=0.05)
    model = small_model(**{**SHY, "body_margin_m": 0.1, "foot_margin_m": 0.0})
    feet = feet_at((0.3, 1.5, math.pi / 2), 0.2)
    before, after = both(grid, model, start_feet_world=feet, goal=(2.2, 1.0, -0.5))
    assert after.found
    assert len(violations(after, grid, model, stood_freely=True)) > 0
    assert_laws(grid, model, before, after, stood_freely=False)


def test_the_cost_of_a_chain_is_that_of_the_search():
    grid, rng = random_floor(2)
    model = small_model(**{**SHY, "clearance_cost_m": 0.0})
    compared = 0
    while compared < 4:
        start, goal = rng.uniform((0.2, 0.2, -3.1), (2.8, 2.8, 3.1), (2, 3))
        planner = Planner(grid, model, LATTICE)
        plan = planner.plan(start=start, goal=goal)
        if not plan.found or not len(plan) or planner._toward is None:
            continue
        rules, poses, outward = chain_of(planner, plan)
        assert chain_cost_um(rules, poses, outward) == pytest.approx(plan.cost_m * 1e6, abs=2)
        # A foot in a wall, or a step too far, is no chain.
        poses[1, 0] += 1.0
        assert chain_cost_um(rules, poses, outward) == -1
        compared += 1


def chain_of(planner, plan):
    """Rules of a planner's space, and a plan as a chain on a map whose origin is 0."""
    feet = plan.start_feet_world[:, [0, 1, 3]].copy()
    rules = build_rules(
        planner._toward[1].space,
        planner.model,
        feet,
        np.zeros(2, np.int64),
        planner.model.body_margin_m,
    )
    poses = np.vstack([feet[1 - plan.side[0]], plan.pose_world[:, [0, 1, 3]]])
    return rules, poses, float(Side(int(plan.side[0])).outward)


def test_slopes_of_rules_and_costs_are_those_of_differences():
    grid, rng = random_floor(4)
    model = small_model(**{**SHY, "clearance_cost_m": 0.0})
    planner = Planner(grid, model, LATTICE)
    plan = planner.plan(start=(0.4, 0.5, 0.2), goal=(2.5, 2.4, 1.0))
    assert plan.found
    rules, chain, first = chain_of(planner, plan)
    space = rules.space
    seen = 0
    for _ in range(10):
        poses = chain + rng.uniform(-0.02, 0.02, chain.shape)
        i = int(rng.integers(1, len(poses) - 3))
        outward = first * (-1) ** i
        work = new_work(space, len(poses) - 1)
        note_rules(rules, work, poses, first)
        value, slope, active = work.value[i].copy(), work.slope[i].copy(), work.active[i].copy()
        work.block[:] = 0.0
        note_costs(rules.weights, i, work.step, work.along, work.block)
        for k in range(6):
            nudged = poses.copy()
            nudged[i + k // 3, k % 3] += 1e-7
            note_rules(rules, work, nudged, first)
            same = active & work.active[i]
            rate = (work.value[i] - value)[same] / 1e-7
            np.testing.assert_allclose(rate, slope[same, k], atol=2e-5)
            seen += int(same.sum())
            # The last column of the block is minus the gradient of the cost.
            costs = []
            for sign in (1, -1):
                nudged = poses.copy()
                nudged[i + k // 3, k % 3] += sign * 1e-5
                x, y, yaw = step_between(nudged[i], nudged[i + 1], outward)
                costs.append(math.hypot(x, y) + smooth(0.05, yaw) + smooth(0.2, y - 0.2))
                costs[-1] += 0.5 * (smooth(0.2, x) - 0.2 * x)
            gradient = (costs[0] - costs[1]) / 2e-5
            assert work.block[k, 6] == pytest.approx(-gradient, abs=1e-4)
    assert seen > 300


def smooth(rate, value):
    return rate * math.sqrt(value * value + 1e-6)


def test_room_around_a_box_is_right_by_polygons():
    grid, rng = random_floor(6)
    terrain = terrain_of(grid, False)
    row, col = np.nonzero(grid.blocked())
    walls = shapely.union_all(
        shapely.box(col * 0.05, row * 0.05, (col + 1) * 0.05, (row + 1) * 0.05)
    )
    room = np.zeros((WAYS, 4))
    touched = 0
    for _ in range(300):
        x, y, yaw = rng.uniform((0.4, 0.4, -3.2), (2.6, 2.6, 3.2))
        near = room_off_blocked(terrain, x, y, yaw, 0.15, 0.08, 0.1, room)
        box = affinity.rotate(
            shapely.box(-0.15, -0.08, 0.15, 0.08), yaw, origin=(0, 0), use_radians=True
        )
        distance_m = affinity.translate(box, x, y).distance(walls)
        if not near:
            assert distance_m > 0.1
            continue
        # Along its axis a gap is at most the distance; corner to corner it may be smaller.
        least = room[:, 0].min()
        assert least <= distance_m + 1e-4
        assert (least > -1.1e-5) or distance_m == 0
        assert distance_m == 0 or least >= distance_m / math.sqrt(2) - 1e-4 or distance_m > 0.1
        touched += least < 0.1
    assert touched > 50


def test_the_gap_between_feet_is_that_of_the_lattice():
    model = small_model(foot_gap_m=0.02)
    rng = np.random.default_rng(0)
    half_l, half_w = model.foot.length_m / 2 + 0.01, model.foot.width_m / 2 + 0.01
    steps = rng.uniform((-0.3, 0.0, -1.0), (0.3, 0.3, 1.0), (400, 3))
    gaps = [gap_axis(x, y, yaw, half_l, half_w)[0] for x, y, yaw in steps]
    assert (np.array(gaps) >= 0).tolist() == feet_apart(steps, model.foot, 0.02).tolist()


def test_the_banded_system_is_solved_as_a_dense_one():
    planner = Planner(FLOOR, small_model(), LATTICE)
    plan = planner.plan(start=(0.4, 0.5, 0.2), goal=(2.5, 2.4, 1.0))
    assert planner._toward is not None
    rng = np.random.default_rng(1)
    work = new_work(planner._toward[1].space, len(plan))
    size = len(work.right)
    dense, right = np.eye(size), np.zeros(size)
    work.matrix[:, 0] = 1.0
    for i in range(len(work.value)):
        along = rng.normal(size=6)
        work.block[:] = 0.0
        add(work.block, 2.0, along[None, None], 0, 0, 3.0)
        take_block(work.block, i, work.matrix, work.right)
        whole = np.zeros(size + 6)
        whole[3 * i : 3 * i + 6] = along
        whole = whole[3 : size + 3]
        dense += 2.0 * np.outer(whole, whole)
        right += 3.0 * whole
    assert _solve(work.matrix, work.right)
    np.testing.assert_allclose(work.right, np.linalg.solve(dense, right), rtol=1e-9, atol=1e-9)


def test_on_stairs_every_foot_stays_on_its_tread():
    heights = np.zeros((40, 80))
    for k in range(4):
        heights[:, 30 + 6 * k :] = 0.05 * (k + 1)
    grid = OccupancyGrid(cells=np.zeros((40, 80), np.uint8), resolution_m=0.05, elevation_m=heights)
    limits = replace(small_model().limits, z_m=(-0.08, 0.08))
    model = small_model(limits=limits, cell_m=0.05, headings=16)
    before, after = both(grid, model, start=(0.8, 1.0, 0.4), goal=(3.4, 1.1, 0.0))
    assert_laws(grid, model, before, after)
    assert after.cost_m < before.cost_m
    assert after.pose_world[-1, 2] == pytest.approx(0.2)
    assert len(np.unique(np.round(after.pose_world[:, 2], 6))) >= 4


def test_feet_that_stand_on_a_stair_stay_there_while_the_rest_is_moved():
    heights = np.zeros((40, 80))
    for k in range(4):
        heights[:, 30 + 6 * k :] = 0.05 * (k + 1)
    grid = OccupancyGrid(cells=np.zeros((40, 80), np.uint8), resolution_m=0.05, elevation_m=heights)
    limits = replace(small_model().limits, z_m=(-0.08, 0.08))
    model = small_model(limits=limits, cell_m=0.05, headings=16)
    # One foot on the first tread, the other on the second: 1.5..1.8 m and 1.8..2.1 m.
    feet = np.array([[1.93, 1.07, 0.1, 0.05], [1.66, 0.9, 0.05, 0.0]])
    before, after = both(
        grid, model, start_feet_world=feet, first_side=Side.RIGHT, goal=(3.4, 1.1, 0.0)
    )
    assert_laws(grid, model, before, after, stood_freely=False)
    assert after.side[0] == Side.RIGHT
    assert after.cost_m < before.cost_m


def test_height_under_a_foot_is_that_of_its_tread_or_none():
    heights = np.zeros((20, 20))
    heights[:, 10:] = 0.1
    grid = OccupancyGrid(cells=np.zeros((20, 20), np.uint8), resolution_m=0.1, elevation_m=heights)
    planner = Planner(grid, small_model(), LATTICE)
    planner.plan(start=(0.4, 0.5, 0.0), goal=(0.5, 1.2, 0.0))
    assert planner._toward is not None
    space = planner._toward[1].space
    # The foot is 0.2 m long and wants 0.02 m of level ground around it; the edge is at x = 1.
    assert foot_height_um(space, np.array([0.87, 1.0, 0.0])) == 0
    assert foot_height_um(space, np.array([1.13, 1.0, 0.0])) == 100_000
    assert foot_height_um(space, np.array([0.93, 1.0, 0.0])) < -1_000_000
    assert foot_height_um(space, np.array([0.93, 1.0, math.pi / 2])) < -1_000_000
    assert foot_height_um(space, np.array([0.92, 1.0, math.pi / 2])) == 0
