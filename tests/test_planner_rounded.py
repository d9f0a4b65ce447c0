"""The bound of plans rounded to a coarse grid: its law, exact costs, and a search with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from maps.grid import OccupancyGrid
from planner.heuristics import rounded_plans
from planner.heuristics.heuristic import tables_of
from planner.heuristics.rounded_plans import (
    Rounded,
    body_points,
    rounded_bound,
    rounded_costs,
    rounded_steps,
)
from planner.options import PlannerOptions
from planner.planner import plan_footsteps
from planner.search import ara_star
from planner.search.ara_star import with_rounded_bound
from planner.search.problem import forward_task
from tests.planner_floor import CASES, fine_model, request_of, scatter
from tests.planner_oracle import Oracle, oracle_node, small_model

FAR_UM = 100_000_000


def all_costs(request, spacing_m, limit_um=FAR_UM, start_um=None):
    """The bound toward the goal, of all plans unless a limit and costs from a start are given."""
    model, tables, lattice = request.model, request.context.tables, request.lattice
    steps = rounded_steps(model, tables.steps, tables.potential, spacing_m)
    if start_um is None:
        start_um = np.zeros(lattice.cols * lattice.rows, np.int32)
    rounded = rounded_costs(
        lattice, model, steps, spacing_m, request.context.ends, start_um, limit_um, lambda: True
    )
    assert rounded is not None
    return rounded


def bound_m(rounded, node):
    col, row, heading, side = node
    return rounded_bound(rounded, col, row, heading * 2 + side) / 1e6


@pytest.mark.parametrize("spacing_m", [0.03, 0.05, 0.13])
@pytest.mark.parametrize("model", [small_model(), fine_model()], ids=["coarse", "fine"])
def test_rounded_steps_cost_what_the_step_does_in_the_mean_over_all_offsets(model, spacing_m):
    tables = tables_of(model)
    table, body_m = tables.steps, body_points(model)
    steps = rounded_steps(model, table, tables.potential, spacing_m)
    cost_of = {
        (row, *step[:3]): step[3] for row in range(len(steps)) for step in steps[row].tolist()
    }
    parts = (np.arange(200) + 0.5) / 200
    offset = np.stack(np.meshgrid(parts, parts), axis=-1).reshape(-1, 2)
    checked = 0
    for heading, side, k in np.argwhere(table.cost_um > 0)[::7]:
        at = heading, side, k
        start = heading * 2 + side
        end = (heading + table.d_heading[at]) % model.headings * 2 + 1 - side
        move_m = np.array([table.d_col[at], table.d_row[at]]) * model.cell_m
        move = (move_m + body_m[end] - body_m[start]) / spacing_m
        moved = np.floor(offset + move + 1e-9).astype(int)
        ways, count = np.unique(moved, axis=0, return_counts=True)
        costs_um = [cost_of[(end, int(way[0]), int(way[1]), start)] for way in ways]
        mean_um = np.dot(costs_um, count) / len(offset)
        # As near as so many offsets come to all that there are.
        assert mean_um <= table.cost_um[at] * 1.002
        assert mean_um >= 0.5 * table.cost_um[at]
        assert min(costs_um) > 0
        checked += len(ways) > 1
    assert checked > 5


def test_the_body_stands_half_a_stance_inward_of_the_foot():
    model = small_model()
    body_m = body_points(model)
    # Facing along x the lattice's own shift of the feet is all there is.
    np.testing.assert_allclose(body_m[[0, 1]], 0.0, atol=1e-12)
    # Facing along y, heading 2 of 8: the left foot's body is to its right, that is at +x.
    np.testing.assert_allclose(body_m[[4, 5]], [(0.1, 0.1), (-0.1, -0.1)], atol=1e-12)


def test_between_the_points_of_the_grid_the_bound_is_interpolated():
    cost_um = np.zeros(9 * 2, np.int32)
    cost_um[1::2] = [0, 0, 0, 0, 100, 200, 0, 300, 0]  # of side 1, at points of three columns
    rounded = Rounded(cost_um, np.zeros((2, 2)), 0.25, 3, 1, 1, 1000)
    assert rounded_bound(rounded, 0, 0, 1) == 100
    assert rounded_bound(rounded, 3, 0, 1) == 175
    # A quarter on toward 200, half on toward 300, and where nothing is known it is 1000.
    assert rounded_bound(rounded, 1, 2, 1) == 0.5 * (75 + 50) + 0.5 * (225 + 250)
    assert rounded_bound(rounded, 0, 0, 0) == 1000


@pytest.mark.parametrize("spacing_m", [0.05, 0.1, 0.17])
@pytest.mark.parametrize("name", CASES)
def test_the_bound_is_never_above_the_exact_cost(name, spacing_m):
    grid, start, goal = CASES[name]
    model = small_model()
    rounded = all_costs(request_of(grid, model, start, goal), spacing_m)
    exact = Oracle(grid, model, goal).costs_to_go(start)
    assert len(exact) > 500
    share = []
    for node, cost_m in exact.items():
        assert bound_m(rounded, node) <= cost_m + 1e-5
        share.append(bound_m(rounded, node) / cost_m)
    assert np.median(share) > {0.05: 0.8, 0.1: 0.65, 0.17: 0.5}[spacing_m]
    for side in (0, 1):
        assert bound_m(rounded, (0, 0, 0, side)) == pytest.approx(0.3)


@pytest.mark.parametrize("seed", range(6))
def test_no_bound_is_too_high_for_plans_below_the_limit_on_random_floors(seed):
    rng = np.random.default_rng(seed)
    cells = np.zeros((24, 24), np.uint8)
    scatter(rng, cells[8:16, 8:16], 6, 4)
    grid = OccupancyGrid(cells=cells, resolution_m=0.1, origin=(0.0, 0.0, 0.0))
    model = small_model()
    start, goal = (0.4, 0.5, rng.uniform(-3, 3)), (1.9, 1.9, rng.uniform(-3, 3))
    oracle, request = Oracle(grid, model, goal), request_of(grid, model, start, goal)
    nodes, costs_um = request.first_nodes()
    known = {oracle_node(request.lattice, int(node)) for node in nodes}
    firsts = [(m, node) for m, node in oracle.first_steps(start) if node in known]
    from_m, to_m = oracle.costs_from(firsts), oracle.costs_to_go(start)
    limit_m = 1.2 * min(from_m[node] + to_m[node] for node in from_m.keys() & to_m.keys())
    task = forward_task(request, nodes, costs_um)
    sharp = with_rounded_bound(request, task, round(limit_m * 1e6), lambda: True)
    assert sharp is not None
    below = 0
    for node in from_m.keys() & to_m.keys():
        if from_m[node] + to_m[node] < limit_m - 1e-5:
            assert bound_m(sharp.heuristic.rounded, node) <= to_m[node] + 1e-5
            below += 1
    assert below > 20


def test_a_with_rounded_bound_search_finds_the_optimum_with_fewer_states(monkeypatch):
    model = fine_model(clearance_cost_m=0.0, clearance_m=0.0)
    options = PlannerOptions(epsilon=1.2, improve_expansions=None, refine=False)
    blunt, sharp = 0, 0
    for seed in range(6):
        rng = np.random.default_rng(seed)
        cells = np.zeros((32, 32), np.uint8)
        scatter(rng, cells[8:24, 8:24], 7, 5)
        grid = OccupancyGrid(cells=cells, resolution_m=0.1, origin=(0.0, 0.0, 0.0))
        start, goal = (0.5, 0.5, rng.uniform(-3, 3)), (2.7, 2.6, rng.uniform(-3, 3))
        for reach_m in (0.0, 0.15):
            asked = replace(options, goal_reach_m=reach_m)
            monkeypatch.setattr(ara_star, "ROUNDED_AFTER", 10**9)
            first = plan_footsteps(grid, model, start=start, goal=goal, options=asked)
            monkeypatch.setattr(ara_star, "ROUNDED_AFTER", 0)
            second = plan_footsteps(grid, model, start=start, goal=goal, options=asked)
            assert first.epsilon == second.epsilon == 1.0
            assert second.cost_m == pytest.approx(first.cost_m, abs=1e-9)
            blunt, sharp = blunt + first.expansions, sharp + second.expansions
    assert sharp < 0.5 * blunt


def test_a_grid_that_would_be_too_large_and_one_that_takes_too_long_are_left(monkeypatch):
    grid, start, goal = CASES["wall"]
    request = request_of(grid, small_model(), start, goal)
    task = forward_task(request, *request.first_nodes())
    assert with_rounded_bound(request, task, FAR_UM, lambda: True) is not None
    assert with_rounded_bound(request, task, FAR_UM, lambda: False) is None
    monkeypatch.setattr(rounded_plans, "MOST_STATES", 1000)
    assert with_rounded_bound(request, task, FAR_UM, lambda: True) is None
