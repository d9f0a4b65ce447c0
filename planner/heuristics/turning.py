"""What turning costs: a bound that looks from a state to the rim of a circle around it.

The 2D path cost D does not know which way the robot faces. But every plan whose goal lies farther
than R from the body's cell must leave the circle of radius R around it, at some cell n of the rim
and in some state t there, and goes on from there at no less than D(n) + p(t). So

    h(s) = min over n of [ min over t at n of (c(s, t) - W(n) + p(t)) + W(n) + D(n) ]

never exceeds the cost, where c is the exact cost on an empty map and W the cost of the straight way
at the rate of D: the first part is what facing the wrong way costs, the second the detour. Rim
cells are gathered in sectors, with the least of either part in each: the first depends on heading,
side and sector only and is made once per step model, the second on cell and sector and is made
when a cell is first asked for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.compiled import in_tiles, njit_inner, njit_no_refcount, tiled, zeros
from planner.heuristics.goal_table import (
    FAR_UM,
    GoalTable,
    backward_steps,
    least_step,
    longest_move,
)
from planner.heuristics.potential import Potential, grid_length, straight_cost
from planner.lattice.steps import IntArray, StepTable

SECTORS = 16
_RADIUS_CELLS = 14
_RING_CELLS = 2.3  # a path does not pass over so many
_NO_DETOUR_UM = (1 << 30) + 1


@dataclass(frozen=True, kw_only=True)
class ExitTable:
    """The part of the exit bound that belongs to a step model.

    turn_um (2 H, SECTORS): the first part, per heading * 2 + side. rim (n, 4): col, row, sector
    and cost W in micrometres of the cells of the rim, from the circle's centre. ring (m, 4): the
    nearest of them, enough for an estimate. radius_cells: R.
    """

    turn_um: IntArray
    rim: IntArray
    ring: IntArray
    radius_cells: int


def build_exit_table(table: StepTable, potential: Potential) -> ExitTable:
    """The table of a step model."""
    hop = longest_move(table, potential)
    reach = _RADIUS_CELLS + 2 * hop + 2
    cells = np.arange(-reach, reach + 1)
    col, row = np.meshgrid(cells, cells)
    length = grid_length(col, row)
    # A step moves the body's cell by at most hop along either axis.
    on_rim = (length > _RADIUS_CELLS) & (np.maximum(abs(col), abs(row)) <= _RADIUS_CELLS + hop)
    angle = np.arctan2(row, col) / (2 * np.pi) % 1.0
    sector = np.where(on_rim, np.floor(angle * SECTORS).astype(np.int64) % SECTORS, -1)
    straight_um = straight_cost(col, row, *potential.straight_um)
    turn_um = np.empty((len(potential.body_cell), SECTORS), np.int64)
    steps = backward_steps(table)
    for number in range(SECTORS):
        cost_um = np.full((*col.shape, len(turn_um)), FAR_UM, np.int64)
        _leave(
            turn_um[:, number],
            cost_um,
            length <= _RADIUS_CELLS,
            sector == number,
            straight_um,
            potential.body_cell,
            potential.potential_um,
            steps,
        )
    rim = np.column_stack([v[on_rim] for v in (col, row, sector, straight_um)])
    ring = rim[length[on_rim] <= _RADIUS_CELLS + _RING_CELLS]
    return ExitTable(turn_um=turn_um, rim=rim, ring=ring, radius_cells=_RADIUS_CELLS)


@njit_no_refcount
def _leave(
    turn_um: IntArray,
    cost_um: IntArray,
    inside: NDArray[np.bool_],
    rim: NDArray[np.bool_],
    straight_um: IntArray,
    body: IntArray,
    potential_um: IntArray,
    steps: IntArray,
) -> None:
    """Least c - W + p over the ways out through one sector, for each row at the centre (2 H,).

    Dijkstra's search backward from all states on the rim, in buckets one least step wide.
    cost_um (size, size, 2 H): room for it, `FAR_UM` everywhere.
    """
    rows, most, _ = steps.shape
    size = len(inside)
    low, high = FAR_UM, -FAR_UM
    for r in range(size):
        for c in range(size):
            if rim[r, c]:
                for row in range(rows):
                    cost_um[r, c, row] = potential_um[row] - straight_um[r, c]
                    low, high = min(low, cost_um[r, c, row]), max(high, cost_um[r, c, row])
    width = least_step(steps)
    # A scan of everything finds all that is in a bucket, as in `goal_table.py`.
    while low <= high:
        for r in range(size):
            for c in range(size):
                for row in range(rows):
                    here = cost_um[r, c, row]
                    if here < low or here >= low + width:
                        continue
                    for k in range(most):
                        if steps[row, k, 3] == 0:
                            continue
                        source = steps[row, k, 0]
                        # Cells here are the body's; steps are between feet.
                        to_c = c - steps[row, k, 1] - body[row, 0] + body[source, 0]
                        to_r = r - steps[row, k, 2] - body[row, 1] + body[source, 1]
                        if not (0 <= to_c < size and 0 <= to_r < size and inside[to_r, to_c]):
                            continue
                        cost = here + steps[row, k, 3]
                        if cost < cost_um[to_r, to_c, source]:
                            cost_um[to_r, to_c, source] = cost
                            high = max(high, cost)
        low += width
    for row in range(rows):
        turn_um[row] = cost_um[size // 2, size // 2, row]


def no_detours(cols: int, rows: int) -> NDArray[np.int32]:
    """Room (n, SECTORS), in tiles, for the second part of the bound + 1 of a lattice's cells."""
    return zeros(tiled(cols, rows) * SECTORS, np.int32).reshape(-1, SECTORS)


@njit_inner
def measure_detours(
    best_um: NDArray[np.int32],
    col: int,
    row: int,
    cols: int,
    path_um: NDArray[np.int32],
    frontier_um: int,
    rim: IntArray,
) -> None:
    """Notes the second part of the bound + 1 of the body at col, row for all sectors (SECTORS,)."""
    for sector in range(len(best_um)):
        best_um[sector] = _NO_DETOUR_UM
    rows = len(path_um) // cols
    for i in range(len(rim)):
        c, r = col + rim[i, 0], row + rim[i, 1]
        if c < 0 or r < 0 or c >= cols or r >= rows:
            continue
        path: int = np.int64(path_um[r * cols + c])  # type: ignore[assignment]
        if path < 0:
            continue
        path = min(path - 1, frontier_um) if path > 0 else frontier_um
        best_um[rim[i, 2]] = min(best_um[rim[i, 2]], path + rim[i, 3] + 1)


@njit_inner
def exit_bound(
    detour_um: NDArray[np.int32],
    turn_um: IntArray,
    path_um: NDArray[np.int32],
    frontier_um: int,
    rim: IntArray,
    circle: tuple[int, int, int, int],
    body: int,
    row: int,
) -> int:
    """The bound of a state, given the body's cell; 0 where the goal is within the circle.

    detour_um: see `no_detours`. circle: its radius in cells, the lattice's number of columns, and
    the goal's col and row.
    """
    radius, cols, goal_col, goal_row = circle
    up = body // cols
    across = body - up * cols
    # A cell is farther than R along the grid whenever it is along an axis.
    if max(abs(across - goal_col), abs(up - goal_row)) <= radius:
        return 0
    place = in_tiles(across, up, cols)
    if detour_um[place, 0] == 0:
        measure_detours(detour_um[place], across, up, cols, path_um, frontier_um, rim)
    least = FAR_UM
    for sector in range(SECTORS):
        least = min(least, turn_um[row, sector] + detour_um[place, sector])
    return least - 1


_AWAY_CELLS = 50
_EXACT = 0.45  # of the cap of the table


@dataclass(frozen=True, kw_only=True)
class TurnEstimate:
    """Estimated turning costs at either end of a plan, not bounds, for a first plan.

    Both are differences in micrometres between the goal table and the straight path at the rate of
    the 2D path. depart_um (2 H, SECTORS): to leave toward the middle of a sector, per heading * 2 +
    side, the cost of the last step included. arrive_um (2 n + 1, 2 n + 1): to arrive from a body
    cell (goal in the middle), facing the goal there. exact_um: up to here the goal table itself
    knows nearly all headings.
    """

    depart_um: IntArray
    arrive_um: IntArray
    exact_um: int


def build_turn_estimate(potential: Potential, goal_table: GoalTable) -> TurnEstimate:
    """The estimate of a step model."""
    rows = len(potential.body_cell)
    level_um = int(potential.move_um.min())
    along_um = _costs_at(
        potential, goal_table, np.array(-_AWAY_CELLS), np.array(0), np.arange(rows)
    )
    along_um -= _AWAY_CELLS * level_um
    headings = rows // 2
    heading, side = np.arange(rows) // 2, np.arange(rows) % 2
    middle = np.rint((np.arange(SECTORS) + 0.5) / SECTORS * headings).astype(np.int64)
    turned = (heading[:, None] - middle[None, :]) % headings
    return TurnEstimate(
        depart_um=along_um[turned * 2 + side[:, None]],
        arrive_um=_arrivals(potential, goal_table, int(along_um[:2].min())),
        exact_um=int(_EXACT * goal_table.cap_um),
    )


def _arrivals(potential: Potential, goal_table: GoalTable, aligned_um: int) -> IntArray:
    """`TurnEstimate.arrive_um`; aligned_um: the cost of turning of a walk along a line."""
    headings = len(potential.body_cell) // 2
    reach = len(goal_table.cost_um) // 2
    cells = np.arange(-reach, reach + 1)
    col, row = np.meshgrid(cells, cells)
    toward = np.rint(np.arctan2(-row, -col) / (2 * np.pi) * headings).astype(np.int64) % headings
    sides = [_costs_at(potential, goal_table, col, row, 2 * toward + side) for side in range(2)]
    straight_um = straight_cost(col, row, *potential.straight_um)
    arrive_um = np.minimum(*sides) - straight_um - aligned_um
    return np.maximum(arrive_um, 0)


def _costs_at(
    potential: Potential, goal_table: GoalTable, col: IntArray, row: IntArray, state: IntArray
) -> IntArray:
    """Exact costs (...) with the body in cells (...) in states heading * 2 + side."""
    reach = len(goal_table.cost_um) // 2
    foot_col = np.clip(col - potential.body_cell[state, 0] + reach, 0, 2 * reach)
    foot_row = np.clip(row - potential.body_cell[state, 1] + reach, 0, 2 * reach)
    return goal_table.cost_um[foot_row, foot_col, state].astype(np.int64)
