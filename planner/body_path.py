"""2D path cost from the goal over the body's cells: the part D of the heuristic of `guide.py`."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planner.collision import Terrain, point_clearance
from planner.endgame import Endgame
from planner.guide import MOVES, Potential
from planner.space import Space, to_grid

# Cost 0 means not reached, so costs are stored one micrometre up.
_CLOSED_CELL = -1
_NOWHERE_UM = 1 << 30
_MARGIN_MOVES = 8


class BodyPath(NamedTuple):
    """Path costs (rows * cols,) in micrometres + 1; 0 or less where no path leads.

    frontier_um: the cost that cells without a path count as.
    """

    cost_um: NDArray[np.int32]
    frontier_um: int


class Strip(NamedTuple):
    """Path costs (rows * cols,) as in `BodyPath`, exact where they are low enough to be settled.

    ahead_um: cost of the straight way to the start, by which the search was drawn there.
    settled_um: every cell whose cost and straight way add up to less has its least cost; no cell
    that was not come to costs less than this, its straight way taken off.
    """

    cost_um: NDArray[np.int32]
    settled_um: int
    start: tuple[int, int]
    slack_um: int
    cols: int
    straight_um: tuple[int, int, int]

    def least_um(self, cells: NDArray[np.int64]) -> NDArray[np.int64]:
        """What a path from each cell (n,) costs at least."""
        cost_um = self.cost_um[cells].astype(np.int64) - 1
        away_um = _all_ahead(cells, self.cols, self.start, self.straight_um, self.slack_um)
        unsettled = (cost_um < 0) | (cost_um + away_um >= self.settled_um)
        return np.where(unsettled, np.maximum(self.settled_um - away_um, 0), cost_um)


def path_toward(space: Space, guide: Potential, cells: NDArray[np.int64]) -> Strip:
    """Path costs from the goal in the strip of cells through which A* looks for the cells (n,)."""
    d_cell = MOVES[:, 1] * space.cols + MOVES[:, 0]
    goal = space.origin_row * space.cols + space.origin_col
    middle = (
        round(float(np.median(cells % space.cols))),
        round(float(np.median(cells // space.cols))),
    )
    level_um, diagonal_um, knight_um = (int(v) for v in np.unique(guide.move_um))
    straight_um = level_um, diagonal_um, knight_um
    # By how much the straight way to one of the cells may be shorter than that to their middle.
    slack_um = int(_all_ahead(cells, space.cols, middle, straight_um, 0).max())
    cost_um = np.zeros(space.cols * space.rows, np.int32)
    rules = straight_um, slack_um, d_cell, guide.move_um, guide.reach_m
    settled_um = _draw_near(space, cost_um, goal, cells, middle, *rules)
    return Strip(cost_um, settled_um, middle, slack_um, space.cols, straight_um)


@njit(cache=True)
def _ahead(
    cell: int, cols: int, start: tuple[int, int], straight_um: tuple[int, int, int], slack_um: int
) -> int:
    """Cost of the straight way from a cell to the start over free cells, less the slack."""
    across, up = abs(cell % cols - start[0]), abs(cell // cols - start[1])
    far, near = max(across, up), min(across, up)
    level, diagonal, knight = straight_um
    if 2 * near <= far:
        cost = near * knight + (far - 2 * near) * level
    else:
        cost = (far - near) * knight + (2 * near - far) * diagonal
    return max(cost - slack_um, 0)


@njit(cache=True)
def _all_ahead(
    cells: NDArray[np.int64],
    cols: int,
    start: tuple[int, int],
    straight_um: tuple[int, int, int],
    slack_um: int,
) -> NDArray[np.int64]:
    """`_ahead` of cells (n,)."""
    ahead_um = np.empty(len(cells), np.int64)
    for i in range(len(cells)):
        ahead_um[i] = _ahead(cells[i], cols, start, straight_um, slack_um)
    return ahead_um


@njit(cache=True)
def _draw_near(
    space: Space,
    cost_um: NDArray[np.int32],
    goal: int,
    wanted: NDArray[np.int64],
    start: tuple[int, int],
    straight_um: tuple[int, int, int],
    slack_um: int,
    d_cell: NDArray[np.int64],
    move_um: NDArray[np.int64],
    reach_m: float,
) -> int:
    """A* from the goal until the wanted cells are settled; see `Strip`.

    Buckets one least move wide in a ring; within one, cells may lower one another and are then done
    again.
    """
    width = move_um.min()
    ring = int(2 * move_um.max() // width) + 3
    head = np.full(ring, -1, np.int64)
    after = np.empty(1 << 14, np.int64)
    cells = np.empty(1 << 14, np.int64)
    if _cell_shut(space, goal, reach_m):
        return _NOWHERE_UM
    cost_um[goal] = 1
    bucket = _ahead(goal, space.cols, start, straight_um, slack_um) // width
    cells[0], after[0], head[bucket % ring] = goal, -1, 0
    used, waiting, last = 1, 1, -1
    while waiting > 0:
        if last < 0:
            for i in range(len(wanted)):
                if cost_um[wanted[i]] > 0:
                    # What else is wanted lies at most twice the slack behind the first of it.
                    last = bucket + 2 * slack_um // width + _MARGIN_MOVES
        elif bucket > last:
            return bucket * width
        entry = head[bucket % ring]
        head[bucket % ring] = -1
        while entry >= 0:
            cell = cells[entry]
            entry = after[entry]
            waiting -= 1
            here = cost_um[cell] - 1
            if (here + _ahead(cell, space.cols, start, straight_um, slack_um)) // width != bucket:
                continue
            for move in range(len(d_cell)):
                near = cell + d_cell[move]
                there = here + move_um[move] + 1
                old = cost_um[near]
                if old == 0 and _cell_shut(space, near, reach_m):
                    cost_um[near] = _CLOSED_CELL
                    continue
                if old == _CLOSED_CELL or (old != 0 and old <= there):
                    continue
                cost_um[near] = there
                if used == len(cells):
                    cells = np.concatenate((cells, np.empty_like(cells)))
                    after = np.concatenate((after, np.empty_like(after)))
                key = there - 1 + _ahead(near, space.cols, start, straight_um, slack_um)
                slot = key // width % ring
                cells[used], after[used], head[slot] = near, head[slot], used
                if slot == bucket % ring:
                    # It is due in this very turn.
                    after[used], entry = entry, used
                    head[slot] = -1
                used += 1
                waiting += 1
        bucket += 1
    return bucket * width


@njit(cache=True)
def raise_by_arrival(
    space: Space,
    cost_um: NDArray[np.int32],
    start: int,
    straight_um: tuple[int, int, int],
    inside: NDArray[np.bool_],
    arrive_um: NDArray[np.int64],
) -> int:
    """Adds to all path costs what it costs to arrive from there (see `facing.py`).

    From a cell whose path to the goal is straight and within the ring of the endgame the table says
    it. All other ways arrive like that from the start, which is also what is returned.
    """
    far_um = 0
    cell = start
    while cell >= 0:
        place = _straight_place(space, cell, cost_um[cell], straight_um, inside)
        if place[0] >= 0:
            far_um = arrive_um[place]
            break
        cell = _downhill(space, cost_um, cell)
    for cell in range(len(cost_um)):
        if cost_um[cell] > 0:
            place = _straight_place(space, cell, cost_um[cell], straight_um, inside)
            cost_um[cell] += arrive_um[place] if place[0] >= 0 else far_um
    return far_um


@njit(cache=True)
def _straight_place(
    space: Space,
    cell: int,
    path_um: int,
    straight_um: tuple[int, int, int],
    inside: NDArray[np.bool_],
) -> tuple[int, int]:
    """Row and column in the endgame's tables of a cell whose path is straight; else -1, -1."""
    reach = len(inside) // 2
    col = cell % space.cols - space.origin_col + reach
    row = cell // space.cols - space.origin_row + reach
    if not (0 <= col <= 2 * reach and 0 <= row <= 2 * reach and inside[row, col]):
        return -1, -1
    goal = space.origin_col, space.origin_row
    if path_um - 1 > _ahead(cell, space.cols, goal, straight_um, 0):
        return -1, -1
    return row, col


@njit(cache=True)
def _downhill(space: Space, cost_um: NDArray[np.int32], cell: int) -> int:
    """The cheapest cell two around; -1 where none is cheaper."""
    best = cell
    for row in range(-2, 3):
        for col in range(-2, 3):
            near = cell + row * space.cols + col
            if 0 < cost_um[near] < cost_um[best]:
                best = near
    return best if best != cell else -1


def search_body_path(space: Space, guide: Potential, endgame: Endgame) -> BodyPath:
    """Path costs of the body's cells to the goal, over the whole map.

    The larger of two bounds: the cost of the path to the goal's cell, and outside the ring of the
    endgame the least cost of a path to a cell of the ring plus what is exact from there.
    """
    d_cell = MOVES[:, 1] * space.cols + MOVES[:, 0]
    goal = space.origin_row * space.cols + space.origin_col
    rules = d_cell, guide.move_um, guide.reach_m
    cost_um = np.zeros(space.cols * space.rows, np.int32)
    _spread(space, cost_um, np.array([goal]), np.array([0]), *rules)
    cells, costs_um = _ring_on_map(space, endgame)
    if len(cells):
        # Cells that are shut are known by now.
        ring_um = np.where(cost_um == _CLOSED_CELL, cost_um, np.int32(0))
        _spread(space, ring_um, cells, costs_um, *rules)
        _raise_outside(space, cost_um, ring_um, endgame.inside)
    return BodyPath(cost_um, _NOWHERE_UM)


def spread_from(
    space: Space, guide: Potential, cells: NDArray[np.int64], costs_um: NDArray[np.int64]
) -> BodyPath:
    """Path costs of the body's cells from any of the cells (n,), each with its own cost."""
    d_cell = MOVES[:, 1] * space.cols + MOVES[:, 0]
    cost_um = np.zeros(space.cols * space.rows, np.int32)
    _spread(space, cost_um, cells, costs_um, d_cell, guide.move_um, guide.reach_m)
    return BodyPath(cost_um, _NOWHERE_UM)


def _ring_on_map(space: Space, endgame: Endgame) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Cells (n,) of the endgame's ring that lie on the lattice, and their costs."""
    col = endgame.ring[:, 0] + space.origin_col
    row = endgame.ring[:, 1] + space.origin_row
    on_map = (col >= 0) & (row >= 0) & (col < space.cols) & (row < space.rows)
    return (row * space.cols + col)[on_map], endgame.ring[on_map, 2]


@njit(cache=True)
def _raise_outside(
    space: Space,
    cost_um: NDArray[np.int32],
    ring_um: NDArray[np.int32],
    inside: NDArray[np.bool_],
) -> None:
    """Raises costs outside the ring to those by way of the ring."""
    reach = len(inside) // 2
    for row in range(space.rows):
        up = row - space.origin_row + reach
        for col in range(space.cols):
            cell, across = row * space.cols + col, col - space.origin_col + reach
            if 0 <= up <= 2 * reach and 0 <= across <= 2 * reach and inside[up, across]:
                continue
            if cost_um[cell] > 0:
                cost_um[cell] = max(cost_um[cell], ring_um[cell])


@njit(cache=True)
def _cell_shut(space: Space, cell: int, reach_m: float) -> bool:
    """Whether no body can be at this cell: an obstacle is nearer than reach_m."""
    row, col = cell // space.cols, cell % space.cols
    if row < 2 or col < 2 or row >= space.rows - 2 or col >= space.cols - 2:
        return True
    x, y = to_grid(
        space, (col - space.origin_col) * space.cell_m, (row - space.origin_row) * space.cell_m
    )
    return is_nearer(space.terrain, x, y, reach_m)


@njit(cache=True)
def is_nearer(terrain: Terrain, x: float, y: float, reach_m: float) -> bool:
    """Whether blocked ground or the map's edge is nearer to a point than reach_m, exactly.

    Never for a reach of 0 or less.
    """
    if reach_m <= 0.0 or point_clearance(terrain, x, y) >= reach_m:
        return False
    size = terrain.resolution_m
    rows, cols = terrain.blocked.shape
    if min(x, y, cols * size - x, rows * size - y) < reach_m:
        return True
    for row in range(math.floor((y - reach_m) / size), math.floor((y + reach_m) / size) + 1):
        dy = max(row * size - y, y - (row + 1) * size, 0.0)
        for col in range(math.floor((x - reach_m) / size), math.floor((x + reach_m) / size) + 1):
            if row < rows and col < cols and terrain.blocked[row, col]:
                dx = max(col * size - x, x - (col + 1) * size, 0.0)
                if dx * dx + dy * dy < reach_m * reach_m:
                    return True
    return False


@njit(cache=True)
def _spread(
    space: Space,
    cost_um: NDArray[np.int32],
    seeds: NDArray[np.int64],
    seed_um: NDArray[np.int64],
    d_cell: NDArray[np.int64],
    move_um: NDArray[np.int64],
    reach_m: float,
) -> None:
    """Dijkstra's search with a ring of buckets, one least move wide.

    Within a bucket no cell can lower another, so each bucket is done in any order.
    """
    width = move_um.min()
    ring = int(move_um.max() // width) + 2 + int((seed_um.max() - seed_um.min()) // width)
    head = np.full(ring, -1, np.int64)
    after = np.empty(1 << 16, np.int64)
    cells = np.empty(1 << 16, np.int64)
    used = 0
    bucket = seed_um.min() // width
    for i in range(len(seeds)):
        if cost_um[seeds[i]] == _CLOSED_CELL or _cell_shut(space, seeds[i], reach_m):
            continue
        cost_um[seeds[i]] = seed_um[i] + 1
        slot = seed_um[i] // width % ring
        cells[used], after[used], head[slot] = seeds[i], head[slot], used
        used += 1
    waiting = used
    while waiting > 0:
        entry = head[bucket % ring]
        head[bucket % ring] = -1
        while entry >= 0:
            cell = cells[entry]
            entry = after[entry]
            waiting -= 1
            here = cost_um[cell] - 1
            if here // width != bucket:
                continue
            for move in range(len(d_cell)):
                near = cell + d_cell[move]
                there = here + move_um[move] + 1
                old = cost_um[near]
                if old == 0 and _cell_shut(space, near, reach_m):
                    cost_um[near] = _CLOSED_CELL
                    continue
                if old == _CLOSED_CELL or (old != 0 and old <= there):
                    continue
                cost_um[near] = there
                if used == len(cells):
                    cells = np.concatenate((cells, np.empty_like(cells)))
                    after = np.concatenate((after, np.empty_like(after)))
                slot = (there - 1) // width % ring
                cells[used], after[used], head[slot] = near, head[slot], used
                used += 1
                waiting += 1
        bucket += 1
