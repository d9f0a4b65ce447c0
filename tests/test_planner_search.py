"""The search against a slow oracle, and the laws that every plan obeys."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from maps.grid import Cell, OccupancyGrid
from planner import search
from planner.api import Planner, _to_lattice, plan_footsteps
from planner.model import Side
from planner.options import PlannerOptions
from planner.plan import PlanStatus, feet_at, wrap_angle
from planner.quick import quick_path
from planner.request import Request, first_nodes
from planner.task import heuristic_toward_start
from planner.verify import violations
from sim.robots import get_robot
from tests.planner_oracle import Oracle, small_model


def walled(rows=24, cols=24, boxes=(), origin=(0.0, 0.0, 0.0), resolution_m=0.1):
    """A free floor with blocked boxes (row0, col0, row1, col1), ends excluded."""
    cells = np.zeros((rows, cols), np.uint8)
    for row0, col0, row1, col1 in boxes:
        cells[row0:row1, col0:col1] = Cell.OCCUPIED
    return OccupancyGrid(cells=cells, resolution_m=resolution_m, origin=origin)


# A wall with a way around its upper end.
WALL = ((0, 11, 15, 12),)
CASES = {
    "empty": (walled(), (0.55, 0.6, 0.3), (1.7, 1.5, 2.0)),
    "wall": (walled(boxes=WALL), (0.55, 0.6, 0.3), (1.8, 0.7, -1.2)),
    "posts": (
        walled(boxes=((8, 8, 9, 9), (14, 12, 16, 13), (5, 15, 6, 18))),
        (0.4, 0.4, 1.0),
        (1.9, 1.9, 0.1),
    ),
    "slanted map": (
        walled(boxes=WALL, origin=(-1.0, 2.0, 0.6)),
        (-0.885, 2.806, 0.9),
        (0.09, 3.594, 2.0),
    ),
}


@pytest.mark.parametrize("planner", ["ara", "astar", "backward"])
@pytest.mark.parametrize("name", CASES)
def test_the_cost_is_the_oracles_optimum(name, planner):
    grid, start, goal = CASES[name]
    model = small_model()
    options = PlannerOptions(name=planner)
    plan = plan_footsteps(grid, model, start=start, goal=goal, options=options)
    assert plan.found
    assert plan.epsilon == 1.0
    assert plan.cost_m == pytest.approx(Oracle(grid, model, goal).best_cost(start), abs=1e-5)
    assert violations(plan, grid, model) == []


@pytest.mark.parametrize("name", CASES)
def test_the_heuristic_is_never_above_the_exact_cost(name):
    grid, start, goal = CASES[name]
    model = small_model()
    planner = Planner(grid, model)
    assert planner.plan(start=start, goal=goal).found
    assert planner._toward is not None
    space, heuristic = planner._toward[1].space, planner._toward[1].heuristic
    oracle = Oracle(grid, model, goal)
    exact = oracle.costs_to_go(start)
    assert len(exact) > 500
    estimates = {node: estimated_m(space, heuristic, node) for node in exact}
    tight = 0
    for node, cost_m in exact.items():
        assert estimates[node] <= cost_m + 1e-5
        tight += estimates[node] > 0.8 * cost_m
    assert tight > 0.5 * len(exact)
    for side in (0, 1):
        assert estimates[0, 0, 0, side] == pytest.approx(0.3)


def test_the_2d_part_alone_is_consistent_and_knows_the_wall():
    # Without the table near the goal, which would hide an error of the body's path.
    grid, start, goal = CASES["wall"]
    model = small_model()
    planner = Planner(grid, model)
    tables = planner._tables
    endgame = replace(
        tables.endgame,
        cost_um=np.full_like(tables.endgame.cost_um, 0),
        cap_um=0,
        ring=np.zeros((0, 3), np.int64),
    )
    # Nor the bound that looks to the rim of a circle.
    exits = replace(tables.exits, radius_cells=10**6)
    planner._tables = tables._replace(endgame=endgame, exits=exits)
    planner.plan(start=start, goal=goal)
    assert planner._toward is not None
    space, heuristic = planner._toward[1].space, planner._toward[1].heuristic
    oracle = Oracle(grid, model, goal)
    exact = oracle.costs_to_go(start)
    assert len(exact) > 500
    detours = []
    for node, cost_m in exact.items():
        estimate = estimated_m(space, heuristic, node)
        assert estimate <= cost_m + 1e-5
        for step, to in oracle.edges(node):
            assert estimate <= step + estimated_m(space, heuristic, to) + 1e-5
        straight_m = math.hypot(node[0], node[1]) * model.cell_m
        detours.append(estimate - tables.potential.rate * straight_m)
    # Left of the wall the way around its end costs that much more than straight through it.
    assert max(detours) > 0.6


def estimated_m(space, heuristic, node):
    col, row, heading, side = node
    cell = (row + space.origin_row) * space.cols + col + space.origin_col
    return search.estimate(space, heuristic, (cell * space.headings + heading) * 2 + side) / 1e6


@pytest.mark.parametrize("epsilon", [1.0, 1.5, 3.0, 10.0])
def test_a_first_plan_costs_no_more_than_its_bound_times_the_optimum(epsilon):
    for grid, start, goal in CASES.values():
        model = small_model()
        best = plan_footsteps(grid, model, start=start, goal=goal).cost_m
        options = PlannerOptions(epsilon=epsilon, stop_at_first=True)
        plan = plan_footsteps(grid, model, start=start, goal=goal, options=options)
        assert best - 1e-6 <= plan.cost_m <= plan.epsilon * best + 1e-6
        assert violations(plan, grid, model) == []


@pytest.mark.parametrize("seed", range(8))
def test_plans_among_random_obstacles_are_right_and_repeat(seed):
    rng = np.random.default_rng(seed)
    grid = walled(60, 60, resolution_m=0.05)
    cells = np.array(grid.cells)
    for row, col in rng.integers(0, 60, (5, 2)):
        cells[row : row + rng.integers(1, 9), col : col + rng.integers(1, 9)] = Cell.OCCUPIED
    grid = grid.with_cells(cells)
    model = small_model(
        cell_m=0.05,
        headings=16,
        foot_margin_m=0.01,
        body_margin_m=0.02,
        clearance_cost_m=0.05,
        clearance_m=0.2,
    )
    found = 0
    for _ in range(6):
        start, goal = rng.uniform((0.2, 0.2, -3.1), (2.8, 2.8, 3.1), (2, 3))
        plan = plan_footsteps(grid, model, start=start, goal=goal)
        if plan.found:
            found += 1
            assert violations(plan, grid, model) == []
            again = plan_footsteps(grid, model, start=start, goal=goal)
            assert again.to_json().split('"time_to')[0] == plan.to_json().split('"time_to')[0]
    assert found


def test_a_plan_ends_with_the_goal_feet_to_the_bit_and_begins_where_the_robot_stands():
    grid, start, goal = CASES["wall"]
    model = small_model()
    plan = plan_footsteps(grid, model, start=start, goal=goal)
    feet = feet_at(goal, model.stance_width_m)
    for side, pose in zip(plan.side[-2:], plan.pose_world[-2:], strict=True):
        assert pose.tolist() == feet[side].tolist()
    assert set(plan.side[-2:].tolist()) == {0, 1}
    np.testing.assert_array_equal(plan.start_feet_world, feet_at(start, model.stance_width_m))


def test_straight_ahead_by_hand():
    # 0.9 m ahead at 0.3 m a step: first foot 0.3, second 0.6, third 0.9, fourth beside it. Each
    # of the three costs hypot(0.3, 0.2) + 0.1, the last 0.2 + 0.1.
    grid = walled(20, 30)
    plan = plan_footsteps(grid, small_model(), start=(1.0, 1.0, 0.0), goal=(1.9, 1.0, 0.0))
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
    one = plan_footsteps(grid, model, start=start, goal=goal)
    other = plan_footsteps(mirrored, model, start=flip(start), goal=flip(goal))
    assert other.cost_m == pytest.approx(one.cost_m, abs=1e-5)
    assert len(other) == len(one)


@pytest.mark.parametrize("side", list(Side))
def test_the_first_foot_can_be_forced_and_is_else_the_cheaper_one(side):
    grid, start, goal = CASES["empty"]
    model = small_model()
    free = plan_footsteps(grid, model, start=start, goal=goal)
    forced = plan_footsteps(grid, model, start=start, goal=goal, first_side=side)
    assert forced.side[0] == side
    assert violations(forced, grid, model) == []
    assert free.cost_m <= forced.cost_m + 1e-9
    if free.side[0] == side:
        assert free.cost_m == forced.cost_m


def test_planning_goes_on_from_feet_anywhere():
    grid, start, goal = CASES["wall"]
    model = small_model()
    planner = Planner(grid, model)
    plan = planner.plan(start=start, goal=goal)
    feet = np.array(plan.start_feet_world)
    rng = np.random.default_rng(5)
    for side, pose in list(zip(plan.side, plan.pose_world, strict=True))[:-2]:
        # The robot steps, and misses by a little.
        feet[side] = pose + rng.uniform(-1, 1, 4) * (0.03, 0.03, 0.0, 0.05)
        rest = planner.plan(start_feet_world=feet, goal=goal, first_side=Side(int(side)).other)
        assert rest.found
        assert rest.side[0] != side
        assert violations(rest, grid, model, stood_freely=False) == []
        np.testing.assert_array_equal(rest.start_feet_world, feet)


def test_no_step_is_needed_where_the_robot_stands_already():
    grid, start, _ = CASES["empty"]
    plan = plan_footsteps(grid, small_model(), start=start, goal=start)
    assert plan.found
    assert (len(plan), plan.cost_m, plan.epsilon) == (0, 0.0, 1.0)
    assert violations(plan, grid, small_model()) == []


def test_near_the_goal_no_step_is_wasted():
    # A foot's length ahead: one step and its closing step, never more.
    grid, _, _ = CASES["empty"]
    plan = plan_footsteps(grid, small_model(), start=(1.0, 1.2, 0.0), goal=(1.2, 1.2, 0.0))
    assert len(plan) == 2


@pytest.mark.parametrize("thickness", [1, 2, 3])
def test_no_plan_steps_through_a_wall(thickness):
    # Feet could straddle 5, 10 or 15 cm sideways; the body cannot.
    grid = walled(48, 48, boxes=((0, 24, 48, 24 + thickness),), resolution_m=0.05)
    model = small_model()
    for yaw in (0.0, math.pi / 2):
        plan = plan_footsteps(grid, model, start=(0.7, 1.2, yaw), goal=(1.9, 1.2, yaw))
        assert plan.status is PlanStatus.NO_PATH
        assert plan.reason
        # Found by the 2D search: the lattice was not searched at all.
        assert plan.expansions == 0


def test_a_door_is_used_if_the_body_fits_and_only_then():
    model = small_model()
    for cells, fits in ((5, True), (3, False)):
        # A wall across with a door of so many cells of 0.1 m; the body is 0.36 m wide.
        grid = walled(24, 24, boxes=((0, 12, 10, 13), (10 + cells, 12, 24, 13)))
        plan = plan_footsteps(grid, model, start=(0.6, 1.2, 0.0), goal=(1.8, 1.2, 0.0))
        assert plan.found == fits


def test_clearance_draws_the_body_away_from_a_wall():
    grid = walled(24, 40, boxes=((0, 10, 6, 30),))
    start, goal = (0.6, 0.85, 0.0), (3.5, 0.85, 0.0)

    def nearest(model):
        plan = plan_footsteps(grid, model, start=start, goal=goal)
        x, y = plan.pose_world[:, 0], plan.pose_world[:, 1]
        return y[(x > 1.0) & (x < 3.0)].min()

    plain = small_model()
    shy = small_model(clearance_m=0.3, clearance_cost_m=0.3)
    assert nearest(shy) > nearest(plain) + 0.1


def test_limits_on_the_search_end_it_and_say_so():
    grid, start, goal = CASES["wall"]
    model = small_model()
    options = PlannerOptions(max_expansions=1)
    plan = plan_footsteps(grid, model, start=start, goal=goal, options=options)
    best = plan_footsteps(grid, model, start=start, goal=goal)
    assert plan.status is PlanStatus.TIMED_OUT
    assert "1 expansions" in plan.reason
    bound = float(plan.reason.split("at least ")[1].split(" m")[0])
    assert 1.0 < bound <= best.cost_m + 0.005
    assert len(plan) == 0
    options = PlannerOptions(time_limit_s=1e-6)
    plan = plan_footsteps(grid, model, start=start, goal=goal, options=options)
    assert plan.status in (PlanStatus.TIMED_OUT, PlanStatus.FOUND)


def test_a_plan_cut_short_reports_a_bound_that_holds():
    grid, start, goal = CASES["posts"]
    model = small_model(cell_m=0.05, headings=16)
    best = plan_footsteps(grid, model, start=start, goal=goal)
    bounds = set()
    for limit in (40, 200, 1000, best.expansions - 1):
        options = PlannerOptions(max_expansions=limit, epsilon=5.0)
        plan = plan_footsteps(grid, model, start=start, goal=goal, options=options)
        if plan.found:
            assert best.cost_m - 1e-6 <= plan.cost_m <= plan.epsilon * best.cost_m + 1e-6
            assert violations(plan, grid, model) == []
            bounds.add(plan.epsilon)
    assert bounds


def test_headings_count_from_the_goal_and_wrap():
    grid, start, goal = CASES["empty"]
    plan = plan_footsteps(grid, small_model(), start=start, goal=goal)
    off = wrap_angle(plan.pose_world[:, 3] - goal[2]) / (2 * math.pi / 8)
    np.testing.assert_allclose(off, np.round(off), atol=1e-9)
    assert np.all(np.abs(plan.pose_world[:, 3]) <= math.pi)


def test_a_way_far_dearer_than_the_heuristic_thinks_is_still_searched_in_order():
    # Posts 0.8 m apart let the robot through only with its shoulders turned, which the path of the
    # body does not know: keys come to lie far above those that the search began with.
    cells = np.zeros((64, 64), np.uint8)
    for row in range(10, 60, 11):
        for col in range(10, 60, 11):
            cells[row : row + 3, col : col + 3] = Cell.OCCUPIED
    grid = OccupancyGrid(cells=cells, resolution_m=0.1)
    model = get_robot("jvrc1").step_model
    plan = Planner(grid, model).plan(start=(0.55, 0.55, 0.0), goal=(3.9, 3.9, 0.0))
    assert plan.found
    assert len(plan) < 100
    assert plan.cost_m < 50
    assert violations(plan, grid, model) == []


def test_a_planner_kept_gives_the_plans_of_a_fresh_one():
    grid, model = walled(30, 40, ((0, 18, 20, 20),)), small_model()
    planner = Planner(grid, model)
    for goal in ((3, 1, 0), (3, 1, 0), (1, 2.5, 2), (3, 1, 0)):
        kept = planner.plan(start=(1, 1, 0), goal=goal)
        fresh = plan_footsteps(grid, model, start=(1, 1, 0), goal=goal)
        np.testing.assert_array_equal(kept.pose_world, fresh.pose_world)
        assert kept.expansions == fresh.expansions


@pytest.mark.parametrize("name", CASES)
def test_the_heuristic_toward_the_start_is_never_above_the_exact_cost(name):
    grid, start, goal = CASES[name]
    model = small_model()
    oracle = Oracle(grid, model, goal)
    request = request_of(grid, model, start, goal)
    nodes, costs_um = first_nodes(request)
    heuristic = heuristic_toward_start(request, nodes, costs_um)
    known = {oracle_node(request.space, int(node)) for node in nodes}
    # The search keeps the feet a little farther apart in the first step than the oracle does.
    cost_m = oracle.costs_from(
        [(m, node) for m, node in oracle.first_steps(start) if node in known]
    )
    assert len(cost_m) > 500
    for node, exact_m in cost_m.items():
        assert estimated_m(request.space, heuristic, node) <= exact_m + 1e-5


@pytest.mark.parametrize("name", CASES)
def test_the_quick_search_gives_a_valid_plan_and_a_true_bound(name):
    grid, start, goal = CASES[name]
    model = small_model()
    best_m = Oracle(grid, model, goal).best_cost(start)
    request = request_of(grid, model, start, goal)
    quick = quick_path(request, *first_nodes(request), PlannerOptions())
    assert quick is not None
    assert quick.least_um / 1e6 <= best_m + 1e-5
    assert quick.cost_um / 1e6 >= best_m - 1e-5


def oracle_node(space, node):
    cell, row = divmod(node, 2 * space.headings)
    up, across = divmod(cell, space.cols)
    return across - space.origin_col, up - space.origin_row, row // 2, row % 2


def request_of(grid, model, start, goal):
    planner = Planner(grid, model)
    planner.plan(start=start, goal=goal)
    assert planner._toward is not None
    feet = feet_at(start, model.stance_width_m)
    return Request(
        toward=planner._toward[1],
        feet_lattice=_to_lattice(feet, goal),
        feet_m=np.zeros(2),
        stands=False,
        first_side=None,
    )


def test_the_record_of_a_search_falls_in_cost_rises_in_bound_and_ends_with_the_plan():
    grid, start, goal = CASES["wall"]
    planner = Planner(grid, small_model(), PlannerOptions(record=True, improve_expansions=None))
    plan = planner.plan(start=start, goal=goal)
    record = planner.record
    assert record is not None
    assert np.all(np.diff(record.time_s) >= 0)
    assert np.all(np.diff(record.cost_m) <= 0)
    assert np.all(record.least_m <= plan.cost_m + 1e-9)
    assert record.cost_m[-1] == pytest.approx(plan.cost_m, abs=1e-6)
    assert record.least_m[-1] == pytest.approx(plan.cost_m / plan.epsilon, abs=1e-5)
    x_m, y_m, states = record.expanded.T
    # States of the quick search that goes first are not in the tree that the record shows.
    assert 0 < states.sum() <= plan.expansions
    assert np.all((x_m > -0.3) & (x_m < 2.7) & (y_m > -0.3) & (y_m < 2.7))


def test_no_record_is_kept_that_nobody_asked_for():
    grid, start, goal = CASES["wall"]
    planner = Planner(grid, small_model())
    planner.plan(start=start, goal=goal)
    assert planner.record is None
