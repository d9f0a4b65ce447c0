"""Wavefront propagation of path costs over the body's cells: Dijkstra's search or A*, compiled."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.collision import Terrain, clearance_at, point_clearance
from planner.compiled import njit_inner, njit_no_refcount, with_room
from planner.heuristics.potential import MOVES, Potential, straight_cost
from planner.lattice.lattice import Int64s, Lattice, out_of_frame
from planner.time_limit import check_time

NOWHERE_UM = 1 << 30
SHUT_CELL = -1  # cost 0 means not reached, so costs are stored one micrometre up
NO_CELLS = np.zeros(0, np.int64)
_RIM = 2  # cells at the edge of the lattice where no body is
_CLOCK_CELLS = 1 << 15  # entered in the queue between two looks at the clock


class StraightCost(NamedTuple):
    """Cost of the straight path to the cell at col, row over free cells, by the costs of moves.

    slack_um: by how much less it counts.
    """

    col: int
    row: int
    level_um: int
    diagonal_um: int
    knight_um: int
    slack_um: int


NO_COST_AHEAD = StraightCost(0, 0, 0, 0, 0, 0)  # the heuristic of Dijkstra's search


class Queue(NamedTuple):
    """A ring of buckets, each a stack, of cells to expand.

    head (2^k,): first entry of each bucket; cells, costs, after (n,): of the entries the cell, its
    cost + 1 and the next entry. at: see the constants below.
    """

    head: Int64s
    cells: Int64s
    costs: Int64s
    after: Int64s
    at: Int64s


# Entries of Queue.at: a bucket is 1 << SHIFT micrometres wide; the bucket in work and the last one
# to expand, -1 while unknown; entries in use and entries that wait.
SHIFT, BUCKET, LAST, USED, WAITING = range(5)


class Moves(NamedTuple):
    """Moves around a cell (16, 2), columns and rows, what each costs, and the reach of a body."""

    around: Int64s
    cost_um: Int64s
    reach_m: float


def moves_of(potential: Potential) -> Moves:
    """How paths of a robot's body move, and what that costs."""
    return Moves(MOVES, potential.move_um, potential.reach_m)


@njit_inner
def straight_um(ahead: StraightCost, col: int, row: int) -> int:
    """Cost of the straight path from a cell, less the slack."""
    if ahead.level_um == 0:
        return 0
    across, up = abs(col - ahead.col), abs(row - ahead.row)
    far, near = max(across, up), min(across, up)
    if 2 * near <= far:
        cost = near * ahead.knight_um + (far - 2 * near) * ahead.level_um
    else:
        cost = (far - near) * ahead.knight_um + (2 * near - far) * ahead.diagonal_um
    return max(cost - ahead.slack_um, 0)


def all_straight_um(ahead: StraightCost, cols: int, cells: Int64s) -> Int64s:
    """`straight_um` of cells (n,).

    Not compiled: it is asked for few cells, and would take longer to load.
    """
    row, col = np.divmod(cells, cols)
    moves_um = ahead.level_um, ahead.diagonal_um, ahead.knight_um
    cost_um = straight_cost(col - ahead.col, row - ahead.row, *moves_um)
    return np.maximum(cost_um - ahead.slack_um, 0)


def straight_to(lattice: Lattice, potential: Potential, cells: Int64s) -> StraightCost:
    """Lower bound on the straight path to the nearest of some cells (n,)."""
    col, row = (int(v.min() + v.max()) // 2 for v in (cells % lattice.cols, cells // lattice.cols))
    ahead = StraightCost(col, row, *potential.straight_um, 0)
    # By how much the straight path to one of the cells may be shorter than that to their middle.
    return ahead._replace(slack_um=int(all_straight_um(ahead, lattice.cols, cells).max()))


def propagate(
    lattice: Lattice,
    cost_um: NDArray[np.int32],
    seeds: Int64s,
    seed_um: Int64s,
    moves: Moves,
    wanted: Int64s,
    beyond_um: int,
    ahead: StraightCost,
) -> int:
    """Path costs + 1 from the seeds (n,), each with its own cost, in order of cost + `ahead`.

    cost_um (rows * cols,): filled in, SHUT_CELL where no body can be; what is SHUT_CELL already
    stays so. wanted (k,): it ends so much beyond the cost of the first of these; with none it
    covers the map. In one bucket cells are expanded in any order.

    Returns NOWHERE_UM once no cell is left; else a lower bound on cost + ahead of all cells that
    were not expanded. Raises OutOfTime where a limit passes on the way.
    """
    queue = _queue_with(lattice, cost_um, seeds, seed_um, moves, ahead)
    while not _expand(lattice, cost_um, moves, wanted, beyond_um, ahead, queue):
        check_time()
        used = len(queue.cells)
        if queue.at[USED] > used - len(moves.cost_um):
            queue = queue._replace(
                cells=with_room(queue.cells, used, 1),
                costs=with_room(queue.costs, used, 1),
                after=with_room(queue.after, used, 1),
            )
    return NOWHERE_UM if queue.at[WAITING] == 0 else int(queue.at[BUCKET] << queue.at[SHIFT])


@njit_no_refcount
def _expand(
    lattice: Lattice,
    cost_um: NDArray[np.int32],
    moves: Moves,
    wanted: Int64s,
    beyond_um: int,
    ahead: StraightCost,
    queue: Queue,
) -> bool:
    """As `propagate` from what is in the queue; whether it came to the end.

    It stops where the queue is full, and after so many cells that the clock is to be looked at.
    """
    # In local names: taken from the tuples in the loop they cost more than the loop itself.
    around, move_um, reach_m = moves.around, moves.cost_um, moves.reach_m
    head, cells, costs, after, at = queue.head, queue.cells, queue.costs, queue.after, queue.at
    cols, ring, shift, bucket = lattice.cols, len(head) - 1, at[SHIFT], at[BUCKET]
    clearance_m, size_m = lattice.terrain.clearance_m, lattice.terrain.resolution_m
    plane = lattice.frame, lattice.cell_m, lattice.origin_col, lattice.origin_row
    used, waiting, room = at[USED], at[WAITING], len(cells) - len(move_um)
    room = min(room, used + _CLOCK_CELLS)
    while waiting > 0:
        if 0 <= at[LAST] < bucket:
            break
        if at[LAST] < 0 and _any_reached(cost_um, wanted):
            at[LAST] = bucket + (beyond_um >> shift)
        entry = head[bucket & ring]
        while entry >= 0 and used <= room:
            cell, here = cells[entry], costs[entry]
            entry = after[entry]
            waiting -= 1
            if cost_um[cell] != here:
                continue  # it came to cost less
            row = cell // cols
            col = cell - row * cols
            for move in range(len(move_um)):
                to_col, to_row = col + around[move, 0], row + around[move, 1]
                near, there = to_row * cols + to_col, here + move_um[move]
                old = np.int64(cost_um[near])
                if 0 != old <= there:
                    continue  # as it is if it is shut
                if old == 0:
                    x, y = _on_map(plane, to_col, to_row)
                    is_near = clearance_at(clearance_m, size_m, x, y) <= max(reach_m, 0.0)
                    if is_near and _is_shut(lattice, to_col, to_row, reach_m):
                        cost_um[near] = SHUT_CELL
                        continue
                cost_um[near] = there
                slot = (there - 1 + straight_um(ahead, to_col, to_row)) >> shift & ring
                cells[used], costs[used] = near, there
                if slot == bucket & ring:
                    # It is due in this very turn.
                    after[used], entry = entry, used
                else:
                    after[used], head[slot] = head[slot], used
                used += 1
                waiting += 1
        head[bucket & ring] = entry
        at[BUCKET], at[USED], at[WAITING] = bucket, used, waiting
        if entry >= 0:
            return False
        bucket += 1
        at[BUCKET] = bucket
    return True


def _queue_with(
    lattice: Lattice,
    cost_um: NDArray[np.int32],
    seeds: Int64s,
    seed_um: Int64s,
    moves: Moves,
    ahead: StraightCost,
) -> Queue:
    """The queue with the seeds in it."""
    least_um, most_um = int(moves.cost_um.min()), int(moves.cost_um.max())
    shift = max(least_um.bit_length() - 1, 0)
    key_um = all_straight_um(ahead, lattice.cols, seeds) + seed_um
    low, high = int(key_um.min(initial=NOWHERE_UM)), int(key_um.max(initial=0))
    # The straight path changes by no more than a move costs.
    span = (2 * most_um + max(high - low, 0) >> shift) + 2
    room = max(1 << 13, 2 * len(seeds))
    queue = Queue(
        head=np.full(1 << (span - 1).bit_length(), -1, np.int64),
        cells=np.empty(room, np.int64),
        costs=np.empty(room, np.int64),
        after=np.empty(room, np.int64),
        at=np.array([shift, low >> shift, -1, 0, 0]),
    )
    _insert_seeds(lattice, cost_um, seeds, seed_um, key_um, moves.reach_m, queue)
    return queue


@njit_no_refcount
def _insert_seeds(
    lattice: Lattice,
    cost_um: NDArray[np.int32],
    seeds: Int64s,
    seed_um: Int64s,
    key_um: Int64s,
    reach_m: float,
    queue: Queue,
) -> None:
    """Puts those seeds (n,) into an empty queue where a body can be."""
    head, at = queue.head, queue.at
    used = 0
    for i in range(len(seeds)):
        cell, slot = seeds[i], key_um[i] >> at[SHIFT] & len(head) - 1
        if cost_um[cell] == SHUT_CELL or cell_shut(lattice, cell, reach_m):
            continue
        cost_um[cell] = seed_um[i] + 1
        queue.cells[used], queue.costs[used] = cell, seed_um[i] + 1
        queue.after[used], head[slot] = head[slot], used
        used += 1
    at[USED] = at[WAITING] = used


@njit_inner
def _any_reached(cost_um: NDArray[np.int32], cells: Int64s) -> bool:
    highest_um = 0
    for i in range(len(cells)):
        highest_um = max(highest_um, cost_um[cells[i]])
    return highest_um > 0


@njit_inner
def _on_map(
    plane: tuple[tuple[float, float, float, float], float, int, int], col: int, row: int
) -> tuple[float, float]:
    """A cell's point in the grid frame."""
    frame, cell_m, origin_col, origin_row = plane
    return out_of_frame(frame, (col - origin_col) * cell_m, (row - origin_row) * cell_m)


@njit_no_refcount
def cell_shut(lattice: Lattice, cell: int, reach_m: float) -> bool:
    """Whether no body can be at this cell: an obstacle is nearer than reach_m."""
    row = cell // lattice.cols
    return _is_shut(lattice, cell - row * lattice.cols, row, reach_m)


@njit_inner
def _is_shut(lattice: Lattice, col: int, row: int, reach_m: float) -> bool:
    if min(row, col) < _RIM or row >= lattice.rows - _RIM or col >= lattice.cols - _RIM:
        return True
    plane = lattice.frame, lattice.cell_m, lattice.origin_col, lattice.origin_row
    x, y = _on_map(plane, col, row)
    return is_nearer(lattice.terrain, x, y, reach_m)


@njit_inner
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
