"""A bound that knows the heading and the obstacles: plans rounded at random to a coarse grid.

The exact table of the empty map knows no obstacles, and on fine cells it does not reach far; the
path of the body's cells knows nothing of headings. This bound knows both, from a grid of points for
the body so coarse that all its states can be searched, with the headings and sides of the lattice.

Let b be the body's points along a plan and o an offset drawn from [0, a) along both axes, the same
for the whole plan, where a is the spacing of the grid. Rounded down, (b + o) / a is a way over the
grid from near the start to the goal, which lies on it. A step that moves the body by v then moves
it by D = floor(v / a), or by one more along either axis, with the chance frac(v / a), wherever it
begins. Let a step by D cost w(D) on the grid, such that

    sum over D of chance(D) w(D) <= cost of the step.                                         (1)

Then the mean cost of the rounded ways, over o, is at most that of the plan. None of them costs less
than V, the least from where it begins, so

    h(s) = mean over o of V(floor((b(s) + o) / a)) <= cost:

V interpolated between the four points around b(s). With the step's own cost for every D, V would be
far too low, since ways on the grid would always take the D that brings them farthest. So with
z = a D - v, what the rounding adds to the way,

    w(D) = cost + r z + q |z| - mean of q |z|:

r, along v, charges for the way that is gained, q for any rounding.

A point of the grid is open in a heading if the body's box is free anywhere within a of it along
both axes; for that the box that all those have in common must be.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from planner.collision import box_free
from planner.compiled import njit_no_refcount, with_room, zeros
from planner.heuristics.potential import Potential
from planner.heuristics.wavefront import NOWHERE_UM
from planner.lattice.lattice import BLOCKED, FREE, UNKNOWN, Int32s, Int64s, Lattice, to_grid
from planner.lattice.steps import MICRO, StepTable, final_cost_um
from planner.robot_model import StepModel

FloatArray = NDArray[np.float64]
# |r| and q in costs of a metre of way; steps that move the body by less than so much count for
# less. Tried on the benchmark's maps, where others prove less.
_ALONG, _ANY, _SHORT_M = 0.9, 0.4, 0.15
_MOST_OFF = 0.9  # of a step's cost
NOTHING = 1e-9  # a share or chance so small is taken for none


class Rounded(NamedTuple):
    """V in micrometres at the points of the grid, (rows * cols * 2 H,); 0 where it is not known.

    Point col, row lies at ((col - origin_col) * a, (row - origin_row) * a) in the lattice frame.
    body (2 H, 2): x, y of the body's point from the foot's node in units of a. fine: the lattice's
    cell in the same. frontier_um: what V counts as where it is not known.
    """

    cost_um: NDArray[np.int32]
    body: FloatArray
    fine: float
    cols: int
    origin_col: int
    origin_row: int
    frontier_um: int


NOT_ROUNDED = Rounded(np.zeros(0, np.int32), np.zeros((0, 2)), 0.0, 0, 0, 0, 0)


@njit_no_refcount
def rounded_bound(rounded: Rounded, col: int, row: int, state: int) -> int:
    """The bound of the node at col, row from the goal's cell, heading * 2 + side; 0 without any."""
    cost_um, body = rounded.cost_um, rounded.body
    if len(cost_um) == 0:
        return 0
    x = col * rounded.fine + body[state, 0] + rounded.origin_col
    y = row * rounded.fine + body[state, 1] + rounded.origin_row
    across, up = math.floor(x), math.floor(y)
    x, y = x - across, y - up
    mean = 0.0
    for corner in range(4):
        right, above = corner & 1, corner >> 1
        share = (x if right else 1.0 - x) * (y if above else 1.0 - y)
        if share > NOTHING:
            at = ((up + above) * rounded.cols + across + right) * len(body) + state
            cost: int = np.int64(cost_um[at])  # type: ignore[assignment]
            mean += share * (cost if cost > 0 else rounded.frontier_um)
    return int(mean)


def body_points(model: StepModel) -> FloatArray:
    """The body's point (2 H, 2), x_m, y_m, from the foot's node, in the lattice frame."""
    yaw_rad = np.repeat(np.arange(model.headings) * (2 * np.pi / model.headings), 2)
    inward_m = np.tile([-1.0, 1.0], model.headings) * model.stance_width_m / 2
    return np.column_stack([-np.sin(yaw_rad) * inward_m, (np.cos(yaw_rad) - 1.0) * inward_m])


def rounded_steps(
    model: StepModel, table: StepTable, potential: Potential, spacing_m: float
) -> Int64s:
    """Steps on the grid (2 H, K, 4) by the row that they end in: D_x, D_y, from row, w.

    w is 0 behind the last step of a row.
    """
    heading, side, number = np.nonzero(table.cost_um)
    at = heading, side, number
    start = heading * 2 + side
    end = (heading + table.d_heading[at]) % model.headings * 2 + 1 - side
    body_m = body_points(model)
    move_m = np.column_stack([table.d_col[at], table.d_row[at]]) * model.cell_m
    move_m += body_m[end] - body_m[start]
    length_m = np.linalg.norm(move_m, axis=1, keepdims=True)
    along = _ALONG * potential.rate * move_m / np.maximum(length_m, _SHORT_M)
    low = np.floor(move_m / spacing_m + NOTHING)
    part = np.maximum(move_m / spacing_m - low, 0.0)
    ends = low + np.array(list(np.ndindex(2, 2)))[:, None, :]
    chance = np.abs(ends - low - 1.0 + part).prod(axis=2)
    gained_m = ends * spacing_m - move_m
    any_m = _ANY * potential.rate * np.linalg.norm(gained_m, axis=2)
    extra_m = np.sum(along * gained_m, axis=2) + any_m - np.sum(chance * any_m, axis=0)
    step_m = table.cost_um[at] / MICRO
    # No step on the grid may cost nothing; less of it all still has the same mean.
    extra_m *= np.minimum(1.0, _MOST_OFF * step_m / np.maximum(-extra_m.min(axis=0), NOTHING))
    # Rounded down, and by a hair more for the chances that are taken for none.
    cost_um = np.floor((step_m + extra_m) * MICRO).astype(np.int64) - 1
    least: dict[tuple[int, int, int, int], int] = {}
    for more, k in np.argwhere(chance > NOTHING):
        key = int(end[k]), int(ends[more, k, 0]), int(ends[more, k, 1]), int(start[k])
        least[key] = min(int(cost_um[more, k]), least.get(key, int(cost_um[more, k])))
    by_end: list[list[tuple[int, int, int, int]]] = [[] for _ in range(2 * model.headings)]
    for (row, d_col, d_row, before), cost in least.items():
        by_end[row].append((d_col, d_row, before, cost))
    steps = np.zeros((len(by_end), max(map(len, by_end)), 4), np.int64)
    for row, found in enumerate(by_end):
        steps[row, : len(found)] = found
    return steps


# The costs V of the rounded plans: Dijkstra's search from the ends of a plan over the coarse grid.

MOST_STATES = 1 << 28  # of a grid
_TURN = 1 << 12  # states between two looks at whether to go on
_USED, _SPARE, _WAITING, _BUCKET = range(4)


class Work(NamedTuple):
    """A search on its way: a ring of buckets, one least step wide, and what it knows of the map.

    head (buckets,), node (n,), after (n,): stacks of entries; scalars (4,): how many entries were
    used, the first of those to be used again, how many wait, and the bucket that is due.
    box_state (rows * cols * H,): UNKNOWN, FREE or BLOCKED. before_um (rows * cols,): what any way
    costs at least that leads from the start to near a point.
    """

    steps: Int64s
    rows: int
    spacing_m: float
    width_um: int
    head: Int64s
    node: Int32s
    after: Int32s
    scalars: Int64s
    box_state: NDArray[np.uint8]
    before_um: NDArray[np.int32]


def rounded_costs(
    lattice: Lattice,
    model: StepModel,
    steps: Int64s,
    spacing_m: float,
    ends: Int64s,
    start_um: NDArray[np.int32],
    limit_um: int,
    go_on: Callable[[], bool],
) -> Rounded | None:
    """The bound for plans that end at one of the nodes (n,) and cost less than limit_um.

    None where the grid would have too many states, or as soon as go_on says so. steps: see
    `rounded_steps`. start_um (rows * cols,): what any way from the start costs at least with the
    body in a cell of the lattice, NOWHERE_UM where none leads. A node that belongs to no such plan
    may have any bound that is not below what is then left of limit_um.
    """
    fine = lattice.cell_m / spacing_m
    states = 2 * lattice.headings
    # As much more on all sides as a body's point can lie off its foot's node.
    rim = math.ceil(model.stance_width_m / spacing_m) + 2
    col, row = (math.floor(v * fine) + rim for v in (lattice.origin_col, lattice.origin_row))
    cols, rows = (math.ceil(v * fine) + 2 * rim + 1 for v in (lattice.cols, lattice.rows))
    if cols * rows * states > MOST_STATES:
        return None
    body = body_points(model) / spacing_m
    rounded = Rounded(zeros(cols * rows * states, np.int32), body, fine, cols, col, row, limit_um)
    costs_um = steps[..., 3][steps[..., 3] > 0]
    width_um = int(costs_um.min())
    buckets = 1 << int(costs_um.max() // width_um + 1).bit_length()
    work = Work(
        steps,
        rows,
        spacing_m,
        width_um,
        np.full(buckets, -1, np.int64),
        np.empty(0, np.int32),
        np.empty(0, np.int32),
        np.array([0, -1, 0, 0]),
        zeros(cols * rows * lattice.headings, np.uint8),
        _near_points(lattice, rounded, rows, start_um),
    )
    seeds = _points_around(lattice, rounded, ends)
    work = _with_entries(work, len(seeds))
    _seed(rounded, work, seeds, final_cost_um(model))
    while work.scalars[_WAITING] > 0:
        if not go_on():
            return None
        work = _with_entries(work, _TURN * steps.shape[1])
        _spread(lattice, rounded, work, _TURN)
    return rounded


def _points_around(lattice: Lattice, rounded: Rounded, nodes: Int64s) -> Int64s:
    """The grid's states (m,) that nodes (n,) may be rounded to."""
    states = 2 * lattice.headings
    state, cell = nodes % states, nodes // states
    x = (cell % lattice.cols - lattice.origin_col) * rounded.fine + rounded.body[state, 0]
    y = (cell // lattice.cols - lattice.origin_row) * rounded.fine + rounded.body[state, 1]
    found = []
    for up, right in np.ndindex(2, 2):
        # What lies on the grid is rounded to one point only.
        col = np.floor(x + (1.0 - NOTHING if right else NOTHING)) + rounded.origin_col
        row = np.floor(y + (1.0 - NOTHING if up else NOTHING)) + rounded.origin_row
        found.append((row * rounded.cols + col).astype(np.int64) * states + state)
    return np.unique(np.concatenate(found))


def _near_points(
    lattice: Lattice, rounded: Rounded, rows: int, start_um: NDArray[np.int32]
) -> NDArray[np.int32]:
    """The least of costs (space.rows * space.cols,) of body cells within a of each grid point."""
    reach = math.ceil(1 / rounded.fine) + 1  # the body's cell is rounded, and so is the point
    square = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    least_um = cv2.erode(
        start_um.reshape(lattice.rows, lattice.cols).astype(np.float64),
        square,
        borderType=cv2.BORDER_CONSTANT,
        borderValue=NOWHERE_UM,
    )
    col = np.rint((np.arange(rounded.cols) - rounded.origin_col) / rounded.fine).astype(np.int64)
    row = np.rint((np.arange(rows) - rounded.origin_row) / rounded.fine).astype(np.int64)
    col, row = col + lattice.origin_col, row + lattice.origin_row
    col_on, row_on = (col >= 0) & (col < lattice.cols), (row >= 0) & (row < lattice.rows)
    near_um = np.full((rows, rounded.cols), NOWHERE_UM, np.int32)
    near_um[np.ix_(row_on, col_on)] = least_um[np.ix_(row[row_on], col[col_on])]
    return near_um.reshape(-1)


def _with_entries(work: Work, entries: int) -> Work:
    """The search with room for so many more entries."""
    used = int(work.scalars[_USED])
    return work._replace(
        node=with_room(work.node, used, entries), after=with_room(work.after, used, entries)
    )


@njit_no_refcount
def _seed(rounded: Rounded, work: Work, seeds: Int64s, seed_um: int) -> None:
    """Begins with states (n,) at a cost."""
    for i in range(len(seeds)):
        rounded.cost_um[seeds[i]] = seed_um
        _put(work, seeds[i], seed_um)
    work.scalars[_BUCKET] = seed_um // work.width_um


@njit_no_refcount
def _put(work: Work, state: int, cost_um: int) -> None:
    """Adds an entry for a state; there must be room for it."""
    scalars = work.scalars
    entry = scalars[_SPARE]
    if entry >= 0:
        scalars[_SPARE] = work.after[entry]
    else:
        entry = scalars[_USED]
        scalars[_USED] = entry + 1
    at = cost_um // work.width_um & len(work.head) - 1
    work.node[entry], work.after[entry] = state, work.head[at]
    work.head[at] = entry
    scalars[_WAITING] += 1


@njit_no_refcount
def _spread(lattice: Lattice, rounded: Rounded, work: Work, budget: int) -> None:
    """Goes on for so many states, or until none waits."""
    cost_um, cols, limit_um = rounded.cost_um, rounded.cols, rounded.frontier_um
    steps, scalars, box_state, before_um = work.steps, work.scalars, work.box_state, work.before_um
    states = len(rounded.body)
    while scalars[_WAITING] > 0 and budget > 0:
        bucket = scalars[_BUCKET]
        entry = work.head[bucket & len(work.head) - 1]
        if entry < 0:
            scalars[_BUCKET] = bucket + 1
            continue
        state: int = np.int64(work.node[entry])  # type: ignore[assignment]
        work.head[bucket & len(work.head) - 1] = work.after[entry]
        work.after[entry] = scalars[_SPARE]
        scalars[_SPARE] = entry
        scalars[_WAITING] -= 1
        here = np.int64(cost_um[state])
        if here // work.width_um != bucket:
            continue  # it came to cost less
        budget -= 1
        point = state // states
        row = state - point * states
        up = point // cols
        across = point - up * cols
        for k in range(steps.shape[1]):
            cost = here + steps[row, k, 3]
            if cost == here:
                break
            col, line = across - steps[row, k, 0], up - steps[row, k, 1]
            if col < 0 or line < 0 or col >= cols or line >= work.rows:
                continue
            at = line * cols + col
            before = at * states + steps[row, k, 2]
            old = np.int64(cost_um[before])
            if old != 0 and cost >= old:
                continue
            if cost + before_um[at] >= limit_um:
                continue
            if old == 0:
                if box_state[before >> 1] == UNKNOWN:
                    box_state[before >> 1] = _box_state(lattice, rounded, work, at, before)
                if box_state[before >> 1] == BLOCKED:
                    continue
            cost_um[before] = cost
            _put(work, before, cost)


@njit_no_refcount
def _box_state(lattice: Lattice, rounded: Rounded, work: Work, point: int, state: int) -> int:
    """FREE unless what the body's boxes within a of a point all have in common is not."""
    turn = state % len(rounded.body) & ~1  # in half bins
    angle = turn * (math.pi / lattice.headings)
    shrink_m = work.spacing_m * (abs(math.cos(angle)) + abs(math.sin(angle)))
    half_l, half_w = lattice.body[0] - shrink_m, lattice.body[1] - shrink_m
    if half_l <= 0.0 or half_w <= 0.0:
        return FREE
    x = (point % rounded.cols - rounded.origin_col) * work.spacing_m
    y = (point // rounded.cols - rounded.origin_row) * work.spacing_m
    x, y = to_grid(lattice, x, y)
    if box_free(lattice.terrain, x, y, lattice.cos[turn], lattice.sin[turn], half_l, half_w):
        return FREE
    return BLOCKED
