"""The heuristics and the quick search against exact costs of a slow oracle."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from shapely import affinity

from planner.heuristics.heuristic import Tables, tables_of
from planner.heuristics.potential import union_depths
from planner.options import HEURISTICS, PlannerOptions
from planner.planner import Planner
from planner.search.first_plan import find_first_plan
from planner.search.problem import heuristic_to_start
from tests.planner_floor import (
    CASES,
    LATTICE,
    estimated_m,
    least_cost_m,
    least_costs_m,
    oracle_of,
    request_of,
)
from tests.planner_oracle import oracle_node, small_model


@pytest.mark.parametrize("name", CASES)
def test_the_heuristic_is_never_above_the_exact_cost(name):
    grid, _, goal = CASES[name]
    model = small_model()
    context = Planner(grid, model, LATTICE).goal_context(goal)
    exact = least_costs_m(name)
    estimates = {node: estimated_m(context.lattice, context.heuristic, node) for node in exact}
    tight = 0
    for node, cost_m in exact.items():
        assert estimates[node] <= cost_m + 1e-5
        tight += estimates[node] > 0.8 * cost_m
    assert tight > 0.5 * len(exact)
    for side in (0, 1):
        assert estimates[0, 0, 0, side] == pytest.approx(0.3)


def test_the_2d_part_alone_is_consistent_and_knows_the_wall():
    # Without the table near the goal, which would hide an error of the body's path.
    grid, _, goal = CASES["wall"]
    model = small_model()
    tables = tables_of(model)
    goal_table = replace(
        tables.goal_table,
        cost_um=np.full_like(tables.goal_table.cost_um, 0),
        cap_um=0,
        ring=np.zeros((0, 3), np.int64),
    )
    # Nor the bound that looks to the rim of a circle.
    exits = replace(tables.exits, radius_cells=10**6)
    blind = Tables(**{**tables._asdict(), "goal_table": goal_table, "exits": exits})
    context = replace(Planner(grid, model, LATTICE).goal_context(goal), tables=blind)
    lattice, heuristic = context.lattice, context.heuristic
    oracle, exact = oracle_of("wall"), least_costs_m("wall")
    detours = []
    for node, cost_m in exact.items():
        estimate = estimated_m(lattice, heuristic, node)
        assert estimate <= cost_m + 1e-5
        for step, to in oracle.edges(node):
            assert estimate <= step + estimated_m(lattice, heuristic, to) + 1e-5
        straight_m = math.hypot(node[0], node[1]) * model.cell_m
        detours.append(estimate - tables.potential.rate * straight_m)
    # Left of the wall the way around its end costs that much more than straight through it.
    assert max(detours) > 0.6


@pytest.mark.parametrize("reach_m", [0.0, 0.15])
@pytest.mark.parametrize("heuristic", HEURISTICS[1:])
@pytest.mark.parametrize("name", ["wall", "slanted map"])
def test_simpler_heuristics_are_consistent_and_below_the_exact_cost(name, heuristic, reach_m):
    grid, _, goal = CASES[name]
    model = small_model()
    options = PlannerOptions(heuristic=heuristic, goal_reach_m=reach_m, refine=False)
    context = Planner(grid, model, options).goal_context(goal)
    oracle, exact = oracle_of(name), least_costs_m(name)
    ends = {oracle_node(context.lattice, int(node)) for node in context.ends}
    assert len(ends) == 2 if reach_m == 0 else len(ends) > 2
    values_m = {node: estimated_m(context.lattice, context.heuristic, node) for node in exact}
    for node, cost_m in exact.items():
        # The goal itself is one of the ends.
        assert values_m[node] <= cost_m + 1e-5
        for step_m, to in oracle.edges(node):
            to_m = estimated_m(context.lattice, context.heuristic, to)
            assert values_m[node] <= step_m + to_m + 1e-5
    for node in ends & exact.keys():
        assert values_m[node] <= 0.3 + 1e-6
    assert max(values_m.values()) > 1.0


def test_the_more_a_heuristic_knows_the_fewer_states_a_star_expands():
    grid, start, goal = CASES["wall"]
    options = [PlannerOptions(name="astar", heuristic=name, refine=False) for name in HEURISTICS]
    plans = [Planner(grid, small_model(), o).plan(start=start, goal=goal) for o in options]
    expansions = [plan.expansions for plan in plans]
    assert expansions == sorted(expansions)
    assert 2 * expansions[0] < expansions[-1]
    assert {plan.epsilon for plan in plans} == {1.0}
    assert len({round(plan.cost_m, 9) for plan in plans}) == 1


def test_euclidean_heuristics_by_hand():
    grid, _, goal = CASES["empty"]
    # At 45 degrees the feet of a step to the side are a cell's diagonal apart, and the body moves
    # by as much: the least cost of a metre is 1. The longest steps move it by 0.3 and 0.1 m.
    for name, metre_m in (("euclidean", 1.0), ("steps", 1.0 + 0.1 / math.hypot(0.3, 0.1))):
        options = PlannerOptions(heuristic=name, refine=False)
        context = Planner(grid, small_model(step_cost_m=0.1), options).goal_context(goal)
        lattice, heuristic = context.lattice, context.heuristic
        # The last step costs the stance width of 0.2 m and 0.1 m as every step does.
        far_m = estimated_m(lattice, heuristic, (-6, 0, 0, 0))
        assert far_m == pytest.approx(0.3 + 0.6 * metre_m, abs=1e-5)
        diagonal_m = estimated_m(lattice, heuristic, (3, -4, 0, 1))
        assert diagonal_m == pytest.approx(0.3 + 0.5 * metre_m, abs=1e-5)


@pytest.mark.parametrize("further_um", [None, 0, 500_000])
@pytest.mark.parametrize("name", CASES)
def test_the_heuristic_toward_the_start_is_never_above_the_exact_cost(name, further_um):
    grid, start, goal = CASES[name]
    model = small_model()
    oracle = oracle_of(name)
    request = request_of(grid, model, start, goal)
    nodes, _ = request.first_steps
    heuristic = heuristic_to_start(request, further_um)
    known = {oracle_node(request.lattice, int(node)) for node in nodes}
    # The search keeps the feet a little farther apart in the first step than the oracle does.
    cost_m = oracle.costs_from(
        [(m, node) for m, node in oracle.first_steps(start) if node in known]
    )
    assert len(cost_m) > 500
    for node, exact_m in cost_m.items():
        assert estimated_m(request.lattice, heuristic, node) <= exact_m + 1e-5


@pytest.mark.parametrize("name", CASES)
def test_the_quick_search_gives_a_valid_plan_and_a_true_bound(name):
    grid, start, goal = CASES[name]
    model = small_model()
    best_m = least_cost_m(name)
    request = request_of(grid, model, start, goal)
    quick = find_first_plan(request, PlannerOptions(refine=False))
    assert quick is not None
    assert quick.lower_bound_um / 1e6 <= best_m + 1e-5
    assert quick.cost_um / 1e6 >= best_m - 1e-5


@pytest.mark.parametrize("is_aligned", [False, True])
def test_the_depth_in_a_union_of_boxes_is_the_distance_from_its_rim(is_aligned):
    rng = np.random.default_rng(3)
    half, count = np.array([0.12, 0.18]), 60
    points = rng.uniform(-0.25, 0.25, (count, 2))
    centres, yaws = rng.uniform(-0.25, 0.25, (count, 3, 2)), rng.uniform(-3, 3, (count, 3))
    if is_aligned:  # as in straight walks: sides lie on one line
        centres[..., 1], yaws[:] = centres[:, :1, 1], 0.3
        centres @= np.array([[np.cos(0.3), np.sin(0.3)], [-np.sin(0.3), np.cos(0.3)]])
    depths, inside = union_depths(points, centres, yaws, half), 0
    box = shapely.box(*-half, *half)
    for k, (x, y) in enumerate(points):
        parts = [
            affinity.translate(affinity.rotate(box, yaw, (0, 0), use_radians=True), *centre)
            for centre, yaw in zip(centres[k], yaws[k], strict=True)
        ]
        # Rounding may leave a hair between sides that lie on one line.
        union = shapely.union_all(parts, grid_size=1e-9)
        if union.contains(shapely.Point(x, y)):
            assert depths[k] == pytest.approx(
                union.boundary.distance(shapely.Point(x, y)), abs=1e-6
            )
            inside += 1
        else:
            assert depths[k] == pytest.approx(-union.distance(shapely.Point(x, y)), abs=1e-6)
    assert inside > 15
