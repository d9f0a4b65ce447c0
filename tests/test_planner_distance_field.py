"""Path costs over the body's cells: against a slow oracle, and where they are computed lazily."""

from __future__ import annotations

import heapq

import numpy as np
import pytest

from maps.grid import Cell
from planner.collision import terrain_of
from planner.heuristics import wavefront as wavefronts
from planner.heuristics.distance_field import lazy_path_costs, path_costs
from planner.heuristics.heuristic import estimates, tables_of
from planner.heuristics.potential import MOVES
from planner.heuristics.wavefront import (
    NO_CELLS,
    NO_COST_AHEAD,
    NOWHERE_UM,
    SHUT_CELL,
    StraightCost,
    cell_shut,
    moves_of,
    propagate,
)
from planner.lattice.lattice import build_lattice
from planner.options import PlannerOptions
from planner.planner import Planner
from planner.search.ad_star import heuristic_near_paths
from tests.compiled import from_python
from tests.planner_floor import (
    CASES,
    blocked_at,
    estimated_m,
    fine_model,
    least_costs_m,
    request_of,
    scatter,
    walled,
)
from tests.planner_oracle import small_model

straight_um = from_python(wavefronts.straight_um)

MODEL = small_model()
TABLES = tables_of(MODEL)
GRID = blocked_at((0, 12, 20, 14), (12, 24, 30, 26), (24, 5, 26, 12))
SPACE = build_lattice(GRID, terrain_of(GRID, False), MODEL, TABLES.steps, (0.6, 0.6, 0.2))
BODY_MOVES = moves_of(TABLES.potential)
GOAL = SPACE.origin_row * SPACE.cols + SPACE.origin_col
SIZE = SPACE.cols * SPACE.rows


def oracle(seeds):
    """Least path costs from cells with costs, by the textbook."""
    d_cell = BODY_MOVES.around[:, 1] * SPACE.cols + BODY_MOVES.around[:, 0]
    best = {}
    heap = [(cost, cell) for cell, cost in seeds]
    while heap:
        cost, cell = heapq.heappop(heap)
        if cell in best:
            continue
        best[cell] = cost
        for move, price in zip(d_cell, BODY_MOVES.cost_um, strict=True):
            near = int(cell + move)
            if not cell_shut(SPACE, near, BODY_MOVES.reach_m):
                heapq.heappush(heap, (cost + int(price), near))
    return best


def wavefront(seeds, wanted=NO_CELLS, beyond_um=0, ahead=NO_COST_AHEAD):
    cost_um = np.zeros(SIZE, np.int32)
    cells, costs = (np.array(part) for part in zip(*seeds, strict=True))
    left = propagate(SPACE, cost_um, cells, costs, BODY_MOVES, wanted, beyond_um, ahead)
    return cost_um, left


def far_cells():
    """The cell that is farthest from the goal."""
    best = oracle([(GOAL, 0)])
    return np.array([max(best, key=best.__getitem__)])


def test_without_an_end_every_cell_has_its_least_cost():
    seeds = [(GOAL, 70_000), (int(far_cells()[0]), 0)]
    cost_um, left = wavefront(seeds)
    best = oracle(seeds)
    assert left == NOWHERE_UM
    assert {int(c): int(cost_um[c]) - 1 for c in np.flatnonzero(cost_um > 0)} == best


@pytest.mark.parametrize("is_a_star", [False, True])
def test_it_ends_when_the_wanted_cell_is_known_and_says_what_others_cost_at_least(is_a_star):
    wanted = far_cells() if is_a_star else np.array([GOAL + 12])
    level, diagonal, knight = (int(v) for v in np.unique(TABLES.potential.move_um))
    end = int(wanted[0] % SPACE.cols), int(wanted[0] // SPACE.cols)
    straight = StraightCost(*end, level, diagonal, knight, slack_um=0)
    ahead = straight if is_a_star else NO_COST_AHEAD
    cost_um, left = wavefront([(GOAL, 0)], wanted=wanted, beyond_um=100_000, ahead=ahead)
    best = oracle([(GOAL, 0)])
    assert cost_um[wanted[0]] - 1 == best[int(wanted[0])]
    late = 0
    for cell, least in best.items():
        if least + straight_um(ahead, cell % SPACE.cols, cell // SPACE.cols) < left:
            assert cost_um[cell] - 1 == least
        elif cost_um[cell] == 0:
            late += 1
    assert left < NOWHERE_UM
    assert late > 0


def test_cells_known_to_be_shut_stay_shut():
    cost_um = np.zeros(SIZE, np.int32)
    cost_um[GOAL + 1] = SHUT_CELL
    seeds = np.array([GOAL]), np.array([0])
    propagate(SPACE, cost_um, *seeds, BODY_MOVES, NO_CELLS, 0, NO_COST_AHEAD)
    assert cost_um[GOAL + 1] == SHUT_CELL
    assert cost_um[GOAL + 2] > 0


def toward_on(grid, model, start, goal):
    """What a planner knows after one plan."""
    planner = Planner(grid, model, options=PlannerOptions(refine=False))
    planner.plan(start=start, goal=goal)
    return planner.goal_context(goal)


@pytest.mark.parametrize("seed", range(4))
def test_lazy_costs_are_exact_on_the_way_and_consistent_bounds_elsewhere(seed):
    rng = np.random.default_rng(seed)
    grid = walled(100, 100, resolution_m=0.05)
    cells = np.array(grid.cells)
    scatter(rng, cells, 12, 20)
    cells[3:17, 3:17] = cells[73:87, 73:87] = Cell.FREE
    context = toward_on(grid.with_cells(cells), fine_model(), (0.5, 0.5, 0.0), (4.0, 4.0, 0.0))
    lattice, potential = context.lattice, context.tables.potential
    goal = np.array([lattice.origin_row * lattice.cols + lattice.origin_col])
    everywhere = path_costs(lattice, potential, goal, np.array([0]))
    free = np.flatnonzero(everywhere > 0)
    lower = 0
    for _ in range(6):
        seeds, middle = rng.choice(free, 3), rng.choice(free)
        wanted = np.intersect1d(free, middle + np.array([-2, 0, 2, 2 * lattice.cols]))
        costs_um = rng.integers(0, 300_000, 3)
        exact = path_costs(lattice, potential, seeds, costs_um)[free]
        lazy_um = lazy_path_costs(lattice, potential, seeds, costs_um, wanted)
        lazy = lazy_um[free]
        assert lazy.min() > 0
        assert np.all(lazy <= exact)
        lower += int(np.count_nonzero(lazy < exact))
        nearest = wanted[np.argmin(exact[np.searchsorted(free, wanted)])]
        at = np.searchsorted(free, nearest)
        assert lazy[at] == exact[at]
        for (col, row), move_um in zip(MOVES, potential.move_um, strict=True):
            there = lazy_um[free + row * lattice.cols + col]
            off_um = np.abs(there - lazy)[there > 0]
            assert len(off_um)
            assert off_um.max() <= move_um
    assert lower > len(free)


def test_where_no_path_leads_there_are_no_costs():
    grid = walled(48, 48, boxes=((0, 22, 48, 26),), resolution_m=0.05)
    context = toward_on(grid, fine_model(), (0.5, 1.2, 0.0), (0.6, 0.6, 0.0))
    lattice = context.lattice
    row = lattice.origin_row * lattice.cols
    here, beyond = np.array([row + lattice.origin_col]), np.array([row + lattice.origin_col + 26])
    lazy = lazy_path_costs(lattice, context.tables.potential, here, np.array([0]), beyond)
    assert lazy[here] == 1
    assert lazy[beyond] <= 0


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_the_heuristic_on_the_way_is_never_above_the_exact_cost(name):
    grid, start, goal = CASES[name]
    model = small_model()
    request = request_of(grid, model, start, goal)
    nodes, costs_um = request.first_steps
    heuristic = heuristic_near_paths(request)
    for node, cost_m in least_costs_m(name).items():
        assert estimated_m(request.lattice, heuristic, node) <= cost_m + 1e-5
    # At the first steps it says what the one over the whole map says.
    least_um = [
        (costs_um + estimates(request.lattice, h, nodes)).min()
        for h in (heuristic, request.context.heuristic)
    ]
    assert least_um[0] >= 0.95 * least_um[1]


def test_near_the_goal_the_table_says_what_the_path_does_not():
    grid, model = walled(), small_model()
    request = request_of(grid, model, (1.2, 1.2, 0.0), (1.5, 1.3, 0.0))
    nodes, _ = request.first_steps
    lazy_um, exact_um = (
        estimates(request.lattice, h, nodes)
        for h in (heuristic_near_paths(request), request.context.heuristic)
    )
    np.testing.assert_array_equal(lazy_um, exact_um)
