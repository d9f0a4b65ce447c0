"""Path costs drawn to where they are asked for: exact on the way, consistent bounds elsewhere."""

from __future__ import annotations

import numpy as np
import pytest

from maps.grid import Cell
from planner.heuristics.distance_field import draw_path, spread_from
from planner.heuristics.heuristic import estimate, estimates
from planner.heuristics.potential import MOVES
from planner.options import PlannerOptions
from planner.planner import Planner
from planner.search.ad_star import heuristic_near_paths
from tests.planner_floor import CASES, fine_model, scatter, walled
from tests.planner_oracle import Oracle, oracle_node, small_model
from tests.test_planner_heuristic import request_of


def toward_on(grid, model, start, goal):
    """What a planner knows after one plan."""
    planner = Planner(grid, model, options=PlannerOptions(refine=False))
    planner.plan(start=start, goal=goal)
    return planner.goal_context(goal)


@pytest.mark.parametrize("seed", range(4))
def test_drawn_costs_are_exact_on_the_way_and_consistent_bounds_elsewhere(seed):
    rng = np.random.default_rng(seed)
    grid = walled(100, 100, resolution_m=0.05)
    cells = np.array(grid.cells)
    scatter(rng, cells, 12, 20)
    cells[3:17, 3:17] = cells[73:87, 73:87] = Cell.FREE
    context = toward_on(grid.with_cells(cells), fine_model(), (0.5, 0.5, 0.0), (4.0, 4.0, 0.0))
    lattice, potential = context.lattice, context.tables.potential
    goal = np.array([lattice.origin_row * lattice.cols + lattice.origin_col])
    everywhere = spread_from(lattice, potential, goal, np.array([0]))
    free = np.flatnonzero(everywhere.cost_um > 0)
    lower = 0
    for _ in range(6):
        seeds, middle = rng.choice(free, 3), rng.choice(free)
        wanted = np.intersect1d(free, middle + np.array([-2, 0, 2, 2 * lattice.cols]))
        costs_um = rng.integers(0, 300_000, 3)
        exact = spread_from(lattice, potential, seeds, costs_um).cost_um[free]
        drawn_um = draw_path(lattice, potential, seeds, costs_um, wanted).cost_um
        drawn = drawn_um[free]
        assert drawn.min() > 0
        assert np.all(drawn <= exact)
        lower += int(np.count_nonzero(drawn < exact))
        nearest = wanted[np.argmin(exact[np.searchsorted(free, wanted)])]
        at = np.searchsorted(free, nearest)
        assert drawn[at] == exact[at]
        for (col, row), move_um in zip(MOVES, potential.move_um, strict=True):
            there = drawn_um[free + row * lattice.cols + col]
            off_um = np.abs(there - drawn)[there > 0]
            assert len(off_um)
            assert off_um.max() <= move_um
    assert lower > len(free)


def test_where_no_path_leads_there_are_no_costs():
    grid = walled(48, 48, boxes=((0, 22, 48, 26),), resolution_m=0.05)
    context = toward_on(grid, fine_model(), (0.5, 1.2, 0.0), (0.6, 0.6, 0.0))
    lattice = context.lattice
    row = lattice.origin_row * lattice.cols
    here, beyond = np.array([row + lattice.origin_col]), np.array([row + lattice.origin_col + 26])
    drawn = draw_path(lattice, context.tables.potential, here, np.array([0]), beyond)
    assert drawn.cost_um[here] == 1
    assert drawn.cost_um[beyond] <= 0


@pytest.mark.parametrize("name", CASES)
def test_the_heuristic_on_the_way_is_never_above_the_exact_cost(name):
    grid, start, goal = CASES[name]
    model = small_model()
    request = request_of(grid, model, start, goal)
    nodes, costs_um = request.first_nodes()
    heuristic = heuristic_near_paths(request.context, nodes)
    exact_m = Oracle(grid, model, goal).costs_to_go(start)
    seen = 0
    for node in range(request.lattice.nodes):
        cost_m = exact_m.get(oracle_node(request.lattice, node))
        if cost_m is not None:
            seen += 1
            assert estimate(request.lattice, heuristic, node) / 1e6 <= cost_m + 1e-5
    assert seen == len(exact_m) > 500
    # At the first steps it says what the one over the whole map says.
    least_um = [
        (costs_um + estimates(request.lattice, h, nodes)).min()
        for h in (heuristic, request.context.heuristic)
    ]
    assert least_um[0] >= 0.95 * least_um[1]


def test_near_the_goal_the_table_says_what_the_path_does_not():
    grid, model = walled(), small_model()
    request = request_of(grid, model, (1.2, 1.2, 0.0), (1.5, 1.3, 0.0))
    nodes, _ = request.first_nodes()
    drawn_um, exact_um = (
        estimates(request.lattice, h, nodes)
        for h in (heuristic_near_paths(request.context, nodes), request.context.heuristic)
    )
    np.testing.assert_array_equal(drawn_um, exact_um)
