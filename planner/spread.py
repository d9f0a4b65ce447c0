"""Path costs that spread over the body's cells: one flood for all who ask for them, compiled."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planner.collision import Terrain, point_clearance
from planner.guide import MOVES, Potential
from planner.space import Int64s, Space, to_grid

NOWHERE_UM = 1 << 30
# Cost 0 means not reached, so costs are stored one micrometre up.
SHUT_CELL = -1
EVERYWHERE = np.zeros(0, np.uint8)
NO_CELLS = np.zeros(0, np.int64)
_RIM = 2  # cells at the edge of the lattice where no body is


class Ahead(NamedTuple):
    """The straight way from a cell to one at col, row, by what moves cost over free cells.

    slack_um: by how much less the whole counts.
    """

    col: int
    row: int
    level_um: int
    diagonal_um: int
    knight_um: int
    slack_um: int


NOT_DRAWN = Ahead(0, 0, 0, 0, 0, 0)


def moves_of(space: Space, guide: Potential) -> tuple[Int64s, Int64s, float]:
    """The moves (16,) between cells, what each costs, and the reach of a body."""
    return MOVES[:, 1] * space.cols + MOVES[:, 0], guide.move_um, guide.reach_m


@njit(cache=True)
def ahead_um(ahead: Ahead, cols: int, cell: int) -> int:
    """Cost of the straight way from a cell, less the slack."""
    if ahead.level_um == 0:
        return 0
    across, up = abs(cell % cols - ahead.col), abs(cell // cols - ahead.row)
    far, near = max(across, up), min(across, up)
    if 2 * near <= far:
        cost = near * ahead.knight_um + (far - 2 * near) * ahead.level_um
    else:
        cost = (far - near) * ahead.knight_um + (2 * near - far) * ahead.diagonal_um
    return max(cost - ahead.slack_um, 0)


@njit(cache=True)
def spread_costs(
    space: Space,
    cost_um: NDArray[np.int32],
    seeds: Int64s,
    seed_um: Int64s,
    moves: tuple[Int64s, Int64s, float],
    wanted: Int64s,
    beyond: int,
    mask: NDArray[np.uint8],
    ahead: Ahead,
) -> int:
    """Path costs + 1 from the seeds (n,), each with its own cost, in order of cost and way ahead.

    cost_um (rows * cols,): filled in, SHUT_CELL where no body can be; what is SHUT_CELL already
    stays so. moves: of `moves_of`. wanted (k,): ends `beyond` buckets, each one least move wide,
    after the first of these has its cost; with none it goes everywhere. mask (rows * cols,): cells
    that costs may spread to, all for (0,). ahead: NOT_DRAWN for Dijkstra's search, else A*.

    Returns NOWHERE_UM once no cell is left; else what the cost and the way ahead of any cell that
    was not done add up to at least.
    """
    d_cell, move_um, reach_m = moves
    cols = space.cols
    width = move_um.min()
    head, cells, after, waiting, bucket = _queue_seeds(space, cost_um, seeds, seed_um, moves, ahead)
    ring, used, last = len(head), waiting, -1
    while waiting > 0:
        if last < 0:
            for i in range(len(wanted)):
                if cost_um[wanted[i]] > 0:
                    last = bucket + beyond - 1
        elif bucket > last:
            return bucket * width
        entry = head[bucket % ring]
        head[bucket % ring] = -1
        while entry >= 0:
            cell = cells[entry]
            entry = after[entry]
            waiting -= 1
            here = cost_um[cell] - 1
            if (here + ahead_um(ahead, cols, cell)) // width != bucket:
                continue
            for move in range(len(d_cell)):
                near = cell + d_cell[move]
                there = here + move_um[move] + 1
                old = cost_um[near]
                if old == 0 and (
                    (len(mask) > 0 and mask[near] == 0) or cell_shut(space, near, reach_m)
                ):
                    cost_um[near] = SHUT_CELL
                    continue
                if old == SHUT_CELL or (old != 0 and old <= there):
                    continue
                cost_um[near] = there
                if used == len(cells):
                    cells = np.concatenate((cells, np.empty_like(cells)))
                    after = np.concatenate((after, np.empty_like(after)))
                slot = (there - 1 + ahead_um(ahead, cols, near)) // width % ring
                cells[used], after[used], head[slot] = near, head[slot], used
                if slot == bucket % ring:
                    # It is due in this very turn.
                    after[used], entry = entry, used
                    head[slot] = -1
                used += 1
                waiting += 1
        bucket += 1
    return NOWHERE_UM


@njit(cache=True)
def _queue_seeds(
    space: Space,
    cost_um: NDArray[np.int32],
    seeds: Int64s,
    seed_um: Int64s,
    moves: tuple[Int64s, Int64s, float],
    ahead: Ahead,
) -> tuple[Int64s, Int64s, Int64s, int, int]:
    """Ring of buckets, their entries' cells and next entries, how many, and the first bucket."""
    _, move_um, reach_m = moves
    width = move_um.min()
    key_um = np.empty(len(seeds), np.int64)
    low, high = NOWHERE_UM, 0
    for i in range(len(seeds)):
        key_um[i] = seed_um[i] + ahead_um(ahead, space.cols, seeds[i])
        low, high = min(low, key_um[i]), max(high, key_um[i])
    # The way ahead changes by no more than a move costs.
    ring = int(2 * move_um.max() // width) + 3 + max(high - low, 0) // width
    head = np.full(ring, -1, np.int64)
    room = max(1 << 13, len(seeds))
    after, cells = np.empty(room, np.int64), np.empty(room, np.int64)
    used = 0
    for i in range(len(seeds)):
        cell, slot = seeds[i], key_um[i] // width % ring
        if cost_um[cell] == SHUT_CELL or cell_shut(space, cell, reach_m):
            continue
        cost_um[cell] = seed_um[i] + 1
        cells[used], after[used], head[slot] = cell, head[slot], used
        used += 1
    return head, cells, after, used, low // width


@njit(cache=True)
def cell_shut(space: Space, cell: int, reach_m: float) -> bool:
    """Whether no body can be at this cell: an obstacle is nearer than reach_m."""
    row, col = cell // space.cols, cell % space.cols
    if min(row, col) < _RIM or row >= space.rows - _RIM or col >= space.cols - _RIM:
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
