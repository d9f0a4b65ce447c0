"""2D path cost from the goal over the body's cells: part D of the heuristic (`potential.py`)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.compiled import njit_no_refcount
from planner.heuristics.goal_table import GoalTable
from planner.heuristics.potential import Potential
from planner.heuristics.wavefront import (
    EVERYWHERE,
    NO_CELLS,
    NOT_DRAWN,
    NOWHERE_UM,
    SHUT_CELL,
    Ahead,
    ahead_of,
    ahead_um,
    all_ahead_um,
    moves_of,
    spread_costs,
)
from planner.lattice.lattice import Int64s, Lattice

_LARGE = 1 / 8
MARGIN_MOVES = 8  # with these there is room for steps


class BodyPath(NamedTuple):
    """Path costs (rows * cols,) in micrometres + 1; 0 or less where no path leads.

    frontier_um: the cost that cells without a path count as.
    """

    cost_um: NDArray[np.int32]
    frontier_um: int


class Strip(NamedTuple):
    """Path costs (rows * cols,) as in `BodyPath`, exact where they are low enough to be settled.

    ahead: the straight way to the start, by which the search was drawn there. settled_um: every
    cell whose cost and straight way add up to less has its least cost; no cell that was not come to
    costs less than this, its straight way taken off.
    """

    cost_um: NDArray[np.int32]
    settled_um: int
    cols: int
    ahead: Ahead

    @property
    def is_large(self) -> bool:
        """Whether paths lead over so much of the map that to look through it all takes long."""
        return int(np.count_nonzero(self.cost_um > 0)) > _LARGE * len(self.cost_um)

    def reaches_any(self, cells: Int64s) -> bool:
        """Whether a path leads to one of the cells (n,)."""
        return bool(np.any(self.cost_um[cells] > 0))

    def least_um(self, cells: Int64s) -> Int64s:
        """What a path from each cell (n,) costs at least."""
        cost_um = self.cost_um[cells].astype(np.int64) - 1
        away_um = all_ahead_um(self.ahead, self.cols, cells)
        unsettled = (cost_um < 0) | (cost_um + away_um >= self.settled_um)
        return np.where(unsettled, np.maximum(self.settled_um - away_um, 0), cost_um)


def path_toward(
    lattice: Lattice, potential: Potential, cells: Int64s, *, margin_moves: int = MARGIN_MOVES
) -> Strip:
    """Path costs from the goal in the strip of cells through which A* looks for the cells (n,).

    margin_moves: by how many moves the paths through the strip may be longer than need be.
    """
    ahead = ahead_of(lattice, potential, cells)
    beyond_um = ahead.slack_um + margin_moves * ahead.level_um
    cost_um = np.zeros(lattice.cols * lattice.rows, np.int32)
    seeds = np.array([lattice.origin_row * lattice.cols + lattice.origin_col]), np.array([0])
    moves = moves_of(potential)
    settled_um = spread_costs(lattice, cost_um, *seeds, moves, cells, beyond_um, EVERYWHERE, ahead)
    return Strip(cost_um, settled_um, lattice.cols, ahead)


def leads_to_goal(lattice: Lattice, potential: Potential, cells: Int64s) -> bool:
    """Whether a path leads from one of the cells (n,) to the goal, looked for from the cells.

    Where obstacles enclose them that is known at once, however large the rest of the map is.
    """
    goal = np.array([lattice.origin_row * lattice.cols + lattice.origin_col])
    cost_um, none_um = np.zeros(lattice.cols * lattice.rows, np.int32), np.zeros_like(cells)
    ahead = ahead_of(lattice, potential, goal)
    spread_costs(lattice, cost_um, cells, none_um, moves_of(potential), goal, 0, EVERYWHERE, ahead)
    return bool(cost_um[goal[0]] > 0)


@njit_no_refcount
def raise_by_arrival(
    lattice: Lattice,
    cost_um: NDArray[np.int32],
    start: int,
    ahead: Ahead,
    inside: NDArray[np.bool_],
    arrive_um: Int64s,
    exact_um: int,
) -> int:
    """Adds to all path costs what it costs to arrive from there (see `turning.py`).

    From a cell whose path to the goal is straight and within the ring of the endgame the table says
    it; up to exact_um the search looks there itself. All other ways arrive like that from the
    start, which is also what is returned.
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


@njit_no_refcount
def _is_straight(row: int, col: int, path_um: int, ahead: Ahead, inside: NDArray[np.bool_]) -> bool:
    """Whether a cell's path to the goal is straight and within the ring of the endgame."""
    reach = len(inside) // 2
    up, across = row - ahead.row + reach, col - ahead.col + reach
    if not (0 <= across <= 2 * reach and 0 <= up <= 2 * reach and inside[up, across]):
        return False
    return path_um - 1 <= ahead_um(ahead, col, row)


@njit_no_refcount
def _downhill(lattice: Lattice, cost_um: NDArray[np.int32], cell: int) -> int:
    """The cheapest cell two around; -1 where none is cheaper."""
    best = cell
    for row in range(-2, 3):
        for col in range(-2, 3):
            near = cell + row * lattice.cols + col
            if 0 < cost_um[near] < cost_um[best]:
                best = near
    return best if best != cell else -1


def search_body_path(lattice: Lattice, potential: Potential, goal_table: GoalTable) -> BodyPath:
    """Path costs of the body's cells to the goal, over the whole map.

    The larger of two bounds: the cost of the path to the goal's cell, and outside the ring of the
    endgame the least cost of a path to a cell of the ring plus what is exact from there.
    """
    goal = lattice.origin_row * lattice.cols + lattice.origin_col
    cost_um = _spread_everywhere(lattice, potential, np.array([goal]), np.array([0]))
    cells, costs_um = ring_on_map(lattice, goal_table)
    if len(cells):
        # Cells that are shut are known by now.
        shut_um = np.where(cost_um == SHUT_CELL, cost_um, np.int32(0))
        ring_um = _spread_everywhere(lattice, potential, cells, costs_um, shut_um)
        _raise_outside(lattice, cost_um, ring_um, goal_table.inside)
    return BodyPath(cost_um, NOWHERE_UM)


def least_in_cells(cells: Int64s, values_um: Int64s) -> tuple[Int64s, Int64s]:
    """Each of the cells (n,) once, in rising order, and the least of the values (n,) there."""
    once, index = np.unique(cells, return_inverse=True)
    least_um = np.full(len(once), np.iinfo(np.int64).max)
    np.minimum.at(least_um, index, values_um)
    return once, least_um


def spread_from(
    lattice: Lattice, potential: Potential, cells: Int64s, costs_um: Int64s
) -> BodyPath:
    """Path costs of the body's cells from any of the cells (n,), each with its own cost."""
    return BodyPath(_spread_everywhere(lattice, potential, cells, costs_um), NOWHERE_UM)


def _spread_everywhere(
    lattice: Lattice,
    potential: Potential,
    cells: Int64s,
    costs_um: Int64s,
    shut_um: NDArray[np.int32] | None = None,
) -> NDArray[np.int32]:
    """Path costs (rows * cols,) from cells (n,), in the array given, where shut cells are known."""
    cost_um = np.zeros(lattice.cols * lattice.rows, np.int32) if shut_um is None else shut_um
    moves = moves_of(potential)
    spread_costs(lattice, cost_um, cells, costs_um, moves, NO_CELLS, 0, EVERYWHERE, NOT_DRAWN)
    return cost_um


def ring_on_map(lattice: Lattice, goal_table: GoalTable) -> tuple[Int64s, Int64s]:
    """Cells (n,) of the endgame's ring that lie on the lattice, and their costs."""
    col = goal_table.ring[:, 0] + lattice.origin_col
    row = goal_table.ring[:, 1] + lattice.origin_row
    on_map = (col >= 0) & (row >= 0) & (col < lattice.cols) & (row < lattice.rows)
    return (row * lattice.cols + col)[on_map], goal_table.ring[on_map, 2]


@njit_no_refcount
def _raise_outside(
    lattice: Lattice,
    cost_um: NDArray[np.int32],
    ring_um: NDArray[np.int32],
    inside: NDArray[np.bool_],
) -> None:
    """Raises costs outside the ring to those by way of the ring."""
    reach = len(inside) // 2
    for row in range(lattice.rows):
        up = row - lattice.origin_row + reach
        for col in range(lattice.cols):
            cell, across = row * lattice.cols + col, col - lattice.origin_col + reach
            if 0 <= up <= 2 * reach and 0 <= across <= 2 * reach and inside[up, across]:
                continue
            if cost_um[cell] > 0:
                cost_um[cell] = max(cost_um[cell], ring_um[cell])


# Path costs of the body, exact on the way to where they are asked for and bounds elsewhere.
#
# A* with the straight way s to the cells asked for, stopped once every path with cost D and D + s
# below S is known. A cell c that was not settled has D(c) + s(c) >= S, so S - s(c) never exceeds
# D(c). A move changes D and s by no more than it costs, so D where it is settled and S - s
# elsewhere, taken together, do not change by more either: they are a consistent heuristic, wherever
# the search for steps goes. The nearer it comes to what is asked for the fewer cells there are.

FURTHER_UM = 500_000


def draw_path(
    lattice: Lattice,
    potential: Potential,
    cells: Int64s,
    costs_um: Int64s,
    wanted: Int64s,
    further_um: int = FURTHER_UM,
) -> BodyPath:
    """Path costs of the body's cells from the cells (n,), each with its own cost.

    Exact where paths pass that lead to one of the wanted cells (k,) for further_um more than the
    cheapest; elsewhere they may be too low. Nowhere if no wanted cell can be reached.
    """
    ahead = ahead_of(lattice, potential, wanted)
    cost_um = np.zeros(lattice.cols * lattice.rows, np.int32)
    # The way to the last of what is wanted may be longer than to the first by twice the slack.
    beyond_um = 2 * ahead.slack_um + further_um + int(potential.move_um.max())
    moves = moves_of(potential)
    settled_um = spread_costs(
        lattice, cost_um, cells, costs_um, moves, wanted, beyond_um, EVERYWHERE, ahead
    )
    if settled_um < NOWHERE_UM:
        _bound_unsettled(cost_um, lattice.cols, settled_um, ahead)
    return BodyPath(cost_um, NOWHERE_UM)


@njit_no_refcount
def _bound_unsettled(cost_um: NDArray[np.int32], cols: int, settled_um: int, ahead: Ahead) -> None:
    """Puts the bound in place of costs that are not known to be the least."""
    for cell in range(len(cost_um)):
        if cost_um[cell] == SHUT_CELL:
            continue
        row = cell // cols
        least_um = settled_um - ahead_um(ahead, cell - row * cols, row)
        if cost_um[cell] == 0 or cost_um[cell] - 1 >= least_um:
            cost_um[cell] = max(least_um, 0) + 1
