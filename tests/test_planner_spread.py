"""Path costs that spread over the body's cells, against a slow oracle."""

import heapq

import numpy as np
import pytest

from planner.collision import terrain_of
from planner.heuristics.heuristic import tables_of
from planner.heuristics.wavefront import (
    EVERYWHERE,
    NO_CELLS,
    NOT_DRAWN,
    NOWHERE_UM,
    SHUT_CELL,
    Ahead,
    ahead_um,
    cell_shut,
    moves_of,
    spread_costs,
)
from planner.lattice.lattice import build_lattice
from tests.planner_floor import blocked_at
from tests.planner_oracle import small_model

MODEL = small_model()
TABLES = tables_of(MODEL)
GRID = blocked_at((0, 12, 20, 14), (12, 24, 30, 26), (24, 5, 26, 12))
SPACE = build_lattice(GRID, terrain_of(GRID, False), MODEL, TABLES.steps, (0.6, 0.6, 0.2))
MOVES = moves_of(TABLES.potential)
GOAL = SPACE.origin_row * SPACE.cols + SPACE.origin_col
SIZE = SPACE.cols * SPACE.rows


def oracle(seeds, mask=None):
    """Least path costs from cells with costs, by the textbook."""
    d_cell = MOVES.around[:, 1] * SPACE.cols + MOVES.around[:, 0]
    best = {}
    heap = [(cost, cell) for cell, cost in seeds]
    while heap:
        cost, cell = heapq.heappop(heap)
        if cell in best:
            continue
        best[cell] = cost
        for move, price in zip(d_cell, MOVES.cost_um, strict=True):
            near = int(cell + move)
            if (mask is None or mask[near]) and not cell_shut(SPACE, near, MOVES.reach_m):
                heapq.heappush(heap, (cost + int(price), near))
    return best


def flood(seeds, wanted=NO_CELLS, beyond_um=0, mask=EVERYWHERE, ahead=NOT_DRAWN):
    cost_um = np.zeros(SIZE, np.int32)
    cells, costs = (np.array(part) for part in zip(*seeds, strict=True))
    left = spread_costs(SPACE, cost_um, cells, costs, MOVES, wanted, beyond_um, mask, ahead)
    return cost_um, left


def far_cells():
    """The cell that is farthest from the goal."""
    best = oracle([(GOAL, 0)])
    return np.array([max(best, key=best.__getitem__)])


def test_without_an_end_every_cell_has_its_least_cost():
    seeds = [(GOAL, 70_000), (int(far_cells()[0]), 0)]
    cost_um, left = flood(seeds)
    best = oracle(seeds)
    assert left == NOWHERE_UM
    assert {int(c): int(cost_um[c]) - 1 for c in np.flatnonzero(cost_um > 0)} == best


def test_within_a_mask_costs_spread_over_the_mask_and_no_farther():
    mask = (np.arange(SIZE) % SPACE.cols < SPACE.origin_col + 25).astype(np.uint8)
    cost_um, left = flood([(GOAL, 0)], mask=mask)
    best = oracle([(GOAL, 0)], mask)
    assert left == NOWHERE_UM
    assert {int(c): int(cost_um[c]) - 1 for c in np.flatnonzero(cost_um > 0)} == best
    assert len(best) < len(oracle([(GOAL, 0)]))


@pytest.mark.parametrize("is_drawn", [False, True])
def test_it_ends_when_the_wanted_cell_is_known_and_says_what_others_cost_at_least(is_drawn):
    wanted = far_cells() if is_drawn else np.array([GOAL + 12])
    level, diagonal, knight = (int(v) for v in np.unique(TABLES.potential.move_um))
    end = int(wanted[0] % SPACE.cols), int(wanted[0] // SPACE.cols)
    drawn = Ahead(*end, level, diagonal, knight, slack_um=0)
    ahead = drawn if is_drawn else NOT_DRAWN
    cost_um, left = flood([(GOAL, 0)], wanted=wanted, beyond_um=100_000, ahead=ahead)
    best = oracle([(GOAL, 0)])
    assert cost_um[wanted[0]] - 1 == best[int(wanted[0])]
    late = 0
    for cell, least in best.items():
        if least + ahead_um(ahead, cell % SPACE.cols, cell // SPACE.cols) < left:
            assert cost_um[cell] - 1 == least
        elif cost_um[cell] == 0:
            late += 1
    assert left < NOWHERE_UM
    assert late > 0


def test_cells_known_to_be_shut_stay_shut():
    cost_um = np.zeros(SIZE, np.int32)
    cost_um[GOAL + 1] = SHUT_CELL
    seeds = np.array([GOAL]), np.array([0])
    spread_costs(SPACE, cost_um, *seeds, MOVES, NO_CELLS, 0, EVERYWHERE, NOT_DRAWN)
    assert cost_um[GOAL + 1] == SHUT_CELL
    assert cost_um[GOAL + 2] > 0
