"""2D path cost over the body's cells: part D of the heuristic (`potential.py`).

Path costs (rows * cols,) int32 are in micrometres + 1; 0 or less where no path leads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.compiled import njit_inner, njit_no_refcount
from planner.heuristics.goal_table import GoalTable
from planner.heuristics.potential import Potential
from planner.heuristics.wavefront import (
    NO_CELLS,
    NO_COST_AHEAD,
    NOWHERE_UM,
    SHUT_CELL,
    StraightCost,
    all_straight_um,
    moves_of,
    propagate,
    straight_to,
    straight_um,
)
from planner.lattice.lattice import Int64s, Lattice

Int32s = NDArray[np.int32]
_LARGE = 1 / 8
MARGIN_MOVES = 8  # with these there is room for steps
FURTHER_UM = 500_000


def path_costs(
    lattice: Lattice,
    potential: Potential,
    cells: Int64s,
    costs_um: Int64s,
    cost_um: Int32s | None = None,
) -> Int32s:
    """Path costs over the whole map from any of the cells (n,), each with its own cost.

    cost_um: the array to fill, in which shut cells are known.
    """
    if cost_um is None:
        cost_um = np.zeros(lattice.cols * lattice.rows, np.int32)
    moves = moves_of(potential)
    propagate(lattice, cost_um, cells, costs_um, moves, NO_CELLS, 0, NO_COST_AHEAD)
    return cost_um


def least_in_cells(cells: Int64s, values_um: Int64s) -> tuple[Int64s, Int64s]:
    """Each of the cells (n,) once, in rising order, and the least of the values (n,) there."""
    once, index = np.unique(cells, return_inverse=True)
    least_um = np.full(len(once), np.iinfo(np.int64).max)
    np.minimum.at(least_um, index, values_um)
    return once, least_um


def path_costs_to_goal(lattice: Lattice, potential: Potential, goal_table: GoalTable) -> Int32s:
    """Path costs to the goal over the whole map.

    The larger of two bounds: the cost of the path to the goal's cell, and outside the ring of the
    goal table the least cost of a path to a cell of the ring plus the exact cost from there.
    """
    cost_um = path_costs(lattice, potential, lattice.goal_cell, np.array([0]))
    cells, costs_um = ring_on_map(lattice, goal_table)
    if len(cells):
        # Cells that are shut are known by now.
        shut_um = np.where(cost_um == SHUT_CELL, cost_um, np.int32(0))
        ring_um = path_costs(lattice, potential, cells, costs_um, shut_um)
        _raise_outside(lattice, cost_um, ring_um, goal_table.inside)
    return cost_um


def ring_on_map(lattice: Lattice, goal_table: GoalTable) -> tuple[Int64s, Int64s]:
    """Cells (n,) of the goal table's ring that lie on the lattice, and their costs."""
    col = goal_table.ring[:, 0] + lattice.origin_col
    row = goal_table.ring[:, 1] + lattice.origin_row
    on_map = (col >= 0) & (row >= 0) & (col < lattice.cols) & (row < lattice.rows)
    return (row * lattice.cols + col)[on_map], goal_table.ring[on_map, 2]


def _raise_outside(
    lattice: Lattice, cost_um: Int32s, ring_um: Int32s, inside: NDArray[np.bool_]
) -> None:
    """Raises costs outside the ring to those by way of the ring."""
    outside, size = np.ones((lattice.rows, lattice.cols), np.bool_), len(inside)
    row, col = lattice.origin_row - size // 2, lattice.origin_col - size // 2
    on_map = np.s_[max(-row, 0) : lattice.rows - row, max(-col, 0) : lattice.cols - col]
    outside[max(row, 0) : row + size, max(col, 0) : col + size] = ~inside[on_map]
    np.copyto(cost_um, ring_um, where=outside.reshape(-1) & (cost_um > 0) & (ring_um > cost_um))


class Strip(NamedTuple):
    """Path costs found by A* toward the start, exact where they are low enough to be settled.

    ahead: its heuristic. settled_um: every cell whose cost + heuristic is less has its least cost;
    no cell that was not reached costs less than this minus its heuristic.
    """

    cost_um: Int32s
    settled_um: int
    cols: int
    ahead: StraightCost

    @property
    def is_large(self) -> bool:
        """Whether paths lead over so much of the map that to search through it all takes long."""
        return int(np.count_nonzero(self.cost_um > 0)) > _LARGE * len(self.cost_um)

    def reaches_any(self, cells: Int64s) -> bool:
        """Whether a path leads to one of the cells (n,)."""
        return bool(np.any(self.cost_um[cells] > 0))

    def least_um(self, cells: Int64s) -> Int64s:
        """Lower bound on the cost of a path from each cell (n,)."""
        cost_um = self.cost_um[cells].astype(np.int64) - 1
        away_um = all_straight_um(self.ahead, self.cols, cells)
        unsettled = (cost_um < 0) | (cost_um + away_um >= self.settled_um)
        return np.where(unsettled, np.maximum(self.settled_um - away_um, 0), cost_um)


def path_toward(
    lattice: Lattice,
    potential: Potential,
    cells: Int64s,
    *,
    margin_moves: int = MARGIN_MOVES,
    shut: Int64s = NO_CELLS,
) -> Strip:
    """Path costs from the goal in the strip of cells that A* expands toward the cells (n,).

    margin_moves: by how many moves the paths through the strip may be longer than need be.
    shut (k,): cells that are counted as shut whatever is there.
    """
    ahead = straight_to(lattice, potential, cells)
    beyond_um = ahead.slack_um + margin_moves * ahead.level_um
    cost_um = np.zeros(lattice.cols * lattice.rows, np.int32)
    cost_um[shut] = SHUT_CELL
    seeds = lattice.goal_cell, np.array([0])
    settled_um = propagate(lattice, cost_um, *seeds, moves_of(potential), cells, beyond_um, ahead)
    return Strip(cost_um, settled_um, lattice.cols, ahead)


def leads_to_goal(lattice: Lattice, potential: Potential, cells: Int64s) -> bool:
    """Whether a path leads from one of the cells (n,) to the goal, searched from the cells.

    Where obstacles enclose them that is known at once, however large the rest of the map is.
    """
    cost_um, none_um = np.zeros(lattice.cols * lattice.rows, np.int32), np.zeros_like(cells)
    ahead = straight_to(lattice, potential, lattice.goal_cell)
    moves = moves_of(potential)
    propagate(lattice, cost_um, cells, none_um, moves, lattice.goal_cell, 0, ahead)
    return bool(cost_um[lattice.goal_cell[0]] > 0)


@njit_no_refcount
def raise_by_arrival(
    lattice: Lattice,
    cost_um: Int32s,
    start: int,
    ahead: StraightCost,
    inside: NDArray[np.bool_],
    arrive_um: Int64s,
    exact_um: int,
) -> int:
    """Adds to all path costs the cost of arriving from there (see `turning.py`).

    From a cell whose path to the goal is straight and within the ring of the goal table that is
    arrive_um; up to exact_um the search reads the table itself. All other paths arrive as that from
    the start does, which is also what is returned.
    """
    far_um = 0
    cols, reach = lattice.cols, len(inside) // 2
    cell = start
    while cell >= 0:
        row, col = cell // cols, cell % cols
        if _is_straight(row, col, cost_um[cell], ahead, inside):
            far_um = arrive_um[row - ahead.row + reach, col - ahead.col + reach]
            break
        cell = _downhill(lattice, cost_um, cell)
    for row in range(lattice.rows):
        for col in range(cols):
            path_um = cost_um[row * cols + col]
            if path_um <= 0:
                continue
            if not _is_straight(row, col, path_um, ahead, inside):
                cost_um[row * cols + col] += far_um
            elif path_um > exact_um:
                arrive = arrive_um[row - ahead.row + reach, col - ahead.col + reach]
                cost_um[row * cols + col] += arrive
    return far_um


@njit_inner
def _is_straight(
    row: int, col: int, path_um: int, ahead: StraightCost, inside: NDArray[np.bool_]
) -> bool:
    """Whether a cell's path to the goal is straight and within the ring of the goal table."""
    reach = len(inside) // 2
    up, across = row - ahead.row + reach, col - ahead.col + reach
    if not (0 <= across <= 2 * reach and 0 <= up <= 2 * reach and inside[up, across]):
        return False
    return path_um - 1 <= straight_um(ahead, col, row)


@njit_inner
def _downhill(lattice: Lattice, cost_um: Int32s, cell: int) -> int:
    """The cheapest cell two around; -1 where none is cheaper."""
    best = cell
    for row in range(-2, 3):
        for col in range(-2, 3):
            near = cell + row * lattice.cols + col
            if 0 < cost_um[near] < cost_um[best]:
                best = near
    return best if best != cell else -1


def lazy_path_costs(
    lattice: Lattice,
    potential: Potential,
    cells: Int64s,
    costs_um: Int64s,
    wanted: Int64s,
    further_um: int = FURTHER_UM,
) -> Int32s:
    """Path costs from the cells (n,), exact near paths to the wanted cells, lower bounds elsewhere.

    Each of the cells has its own cost. Exact where paths pass that lead to one of the wanted cells
    (k,) for further_um more than the cheapest. Nowhere if no wanted cell can be reached.

    A* with heuristic s, the straight path to the wanted cells, stops once all D with D + s below S
    are known. A cell c that was not settled has D(c) + s(c) >= S, so S - s(c) never exceeds D(c). A
    move changes D and s by at most its cost, so D where settled and S - s elsewhere are together a
    consistent heuristic.
    """
    ahead = straight_to(lattice, potential, wanted)
    cost_um = np.zeros(lattice.cols * lattice.rows, np.int32)
    # The path to the last of the wanted cells may be longer than to the first by twice the slack.
    beyond_um = 2 * ahead.slack_um + further_um + int(potential.move_um.max())
    moves = moves_of(potential)
    settled_um = propagate(lattice, cost_um, cells, costs_um, moves, wanted, beyond_um, ahead)
    if settled_um < NOWHERE_UM:
        _bound_unsettled(cost_um, lattice.cols, settled_um, ahead)
    return cost_um


@njit_no_refcount
def _bound_unsettled(cost_um: Int32s, cols: int, settled_um: int, ahead: StraightCost) -> None:
    """Puts the bound in place of costs that are not known to be the least."""
    for cell in range(len(cost_um)):
        if cost_um[cell] == SHUT_CELL:
            continue
        row = cell // cols
        least_um = settled_um - straight_um(ahead, cell - row * cols, row)
        if cost_um[cell] == 0 or cost_um[cell] - 1 >= least_um:
            cost_um[cell] = max(least_um, 0) + 1
