"""2D path cost from the goal over the body's cells: the part D of the heuristic of `guide.py`."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planner.collision import Terrain
from planner.guide import MOVES, Potential
from planner.space import Space, to_grid

# Cost 0 means not reached, so costs are stored one micrometre up.
_CLOSED_CELL = -1


class BodyPath(NamedTuple):
    """Path costs (rows * cols,) in micrometres + 1; 0 where the search did not get to.

    frontier_um: no cell that the search did not get to costs less.
    """

    cost_um: NDArray[np.int32]
    frontier_um: int


def search_body_path(
    space: Space, guide: Potential, targets: NDArray[np.int64], margin_um: int
) -> BodyPath:
    """Path costs from the goal's cell outward, until some target cell (n,) is reached.

    Goes on for margin_um after the first target, for the heuristic of cells behind the start.
    """
    cost_um = np.zeros(space.cols * space.rows, np.int32)
    is_target = np.zeros(space.cols * space.rows, np.bool_)
    is_target[targets] = True
    d_cell = MOVES[:, 1] * space.cols + MOVES[:, 0]
    frontier_um = _spread(
        space, cost_um, is_target, d_cell, guide.move_um, guide.reach_m, margin_um
    )
    return BodyPath(cost_um, int(frontier_um))


@njit(cache=True)
def _cell_shut(space: Space, cell: int, reach_m: float) -> bool:
    """Whether no body can be at this cell: an obstacle is surely nearer than reach_m."""
    row, col = cell // space.cols, cell % space.cols
    if row < 2 or col < 2 or row >= space.rows - 2 or col >= space.cols - 2:
        return True
    x, y = to_grid(
        space, (col - space.origin_col) * space.cell_m, (row - space.origin_row) * space.cell_m
    )
    return farthest_clearance(space.terrain, x, y) < reach_m


@njit(cache=True)
def farthest_clearance(terrain: Terrain, x: float, y: float) -> float:
    """Upper bound in metres on a point's distance to blocked ground; negative off the map."""
    size = terrain.resolution_m
    rows, cols = terrain.blocked.shape
    col, row = math.floor(x / size), math.floor(y / size)
    if row < 0 or col < 0 or row >= rows or col >= cols:
        return -1.0
    if terrain.blocked[row, col]:
        return 0.0
    off_x, off_y = x - (col + 0.5) * size, y - (row + 0.5) * size
    # The field is at most half a diagonal below the distance between centres, and the square of
    # the nearest blocked cell begins at least half a cell before its centre.
    between_centres = terrain.clearance_m[row, col] + 0.7073 * size
    return between_centres - 0.5 * size + math.sqrt(off_x * off_x + off_y * off_y)


@njit(cache=True)
def _spread(
    space: Space,
    cost_um: NDArray[np.int32],
    is_target: NDArray[np.bool_],
    d_cell: NDArray[np.int64],
    move_um: NDArray[np.int64],
    reach_m: float,
    margin_um: int,
) -> int:
    """Dijkstra's search with a ring of buckets, one least move wide.

    Within a bucket no cell can lower another, so each bucket is done in any order. Returns the
    cost below which all cells are final.
    """
    width = move_um.min()
    ring = int(move_um.max() // width) + 2
    head = np.full(ring, -1, np.int64)
    after = np.empty(1 << 16, np.int64)
    cells = np.empty(1 << 16, np.int64)
    used, waiting, bucket = 0, 0, 0
    goal = space.origin_row * space.cols + space.origin_col
    if _cell_shut(space, goal, reach_m):
        return 1 << 30
    cost_um[goal] = 1
    cells[0], after[0], head[0] = goal, -1, 0
    used, waiting = 1, 1
    stop = 1 << 30
    while waiting > 0:
        if bucket * width > stop:
            return bucket * width
        entry = head[bucket % ring]
        head[bucket % ring] = -1
        while entry >= 0:
            cell = cells[entry]
            entry = after[entry]
            waiting -= 1
            here = cost_um[cell] - 1
            if here // width != bucket:
                continue
            if is_target[cell] and stop == 1 << 30:
                stop = here + margin_um
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
    return 1 << 30
