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
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.heuristics.potential import Potential
from planner.jit import lean
from planner.lattice.lattice import Int64s
from planner.lattice.steps import MICRO, StepTable
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


@lean
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


def rounded_steps(model: StepModel, table: StepTable, guide: Potential, spacing_m: float) -> Int64s:
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
    along = _ALONG * guide.rate * move_m / np.maximum(length_m, _SHORT_M)
    low = np.floor(move_m / spacing_m + NOTHING)
    part = np.maximum(move_m / spacing_m - low, 0.0)
    ends = low + np.array(list(np.ndindex(2, 2)))[:, None, :]
    chance = np.abs(ends - low - 1.0 + part).prod(axis=2)
    gained_m = ends * spacing_m - move_m
    any_m = _ANY * guide.rate * np.linalg.norm(gained_m, axis=2)
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
