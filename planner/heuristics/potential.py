"""The heuristic that knows the obstacles: 2D path cost of the body's cell, with potentials.

Each state (foot node, heading, side) has a body cell: the node nearest to the point that lies half
a stance width inward of the foot. A step moves the body cell by v whole cells. On the grid of body
cells, with moves to 16 neighbours, v has the length |v| (never below the Euclidean length, at most
2.8 % above). From the step table follow a rate r (cost per metre) and a potential p per heading and
side such that for every step of the table, from s to t,

    r * |v| + p(s) - p(t) <= cost(s, t).                                                  (1)

r is the largest for which (1) has a solution, i.e. the least cost per metre of any cycle of steps.
D is the cost at r of the shortest 16-neighbour path to the goal's cell around cells where no body
can be. Then

    h(s) = max(0, D(cell(s)) + p(s) - max over sides of p(goal)) + cost of the last step

is consistent, and so admissible: a step from s to t passes body cells that (see
`Potential.reach_m`) lie inside one of the boxes that the search itself checks for that step, so
D(s) <= r |v| + D(t).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner.lattice.steps import MICRO, IntArray, StepTable, final_cost_um, moved_cells
from planner.robot_model import Side, StepModel

FloatArray = NDArray[np.float64]
MOVES = np.array(
    [(c, r) for c in range(-2, 3) for r in range(-2, 3) if max(abs(c), abs(r)) == 1]
    + [(c, r) for c in range(-2, 3) for r in range(-2, 3) if {abs(c), abs(r)} == {1, 2}]
)
_ROUNDING = 1e-9


@dataclass(frozen=True, kw_only=True)
class Potential:
    """What the heuristic knows of a robot; made once per step model.

    Arrays (2 H, ...) have a row per heading * 2 + side. body_cell (2 H, 2): col and row of the
    body's cell from the foot's node. rate: cost per metre. potential_um (2 H,): p, the goal's part
    and the cost of the last step included.
    move_um (16,): cost of the moves of the 2D search. reach_m: radius around any cell on a step's
    way that the checked body boxes cover; negative where the boxes leave gaps.
    """

    body_cell: IntArray
    rate: float
    potential_um: IntArray
    move_um: IntArray
    reach_m: float

    @property
    def straight_um(self) -> tuple[int, int, int]:
        """What moves along an axis, along a diagonal and between the two cost."""
        level_um, diagonal_um, knight_um = np.unique(self.move_um).tolist()
        return level_um, diagonal_um, knight_um

    def cell_offsets(self, cols: int) -> IntArray:
        """The body's cell from a foot's cell (2 H,) as cell numbers of a lattice of cols."""
        return self.body_cell[:, 1] * cols + self.body_cell[:, 0]


def _body_cells(model: StepModel) -> IntArray:
    """`Potential.body_cell` of a step model."""
    yaw_rad = np.arange(model.headings)[:, None] * (2 * np.pi / model.headings)
    inward_m = -np.array([side.outward for side in Side])[None, :] * model.stance_width_m / 2
    col = -np.sin(yaw_rad) * inward_m / model.cell_m
    row = (np.cos(yaw_rad) * inward_m - inward_m) / model.cell_m
    # Rounded to the micrometre first, so a tie does not hang on the last bit of a cosine.
    cells = np.rint(np.round(np.stack([col, row], axis=-1), 6)).astype(np.int64)
    return cells.reshape(-1, 2)


def grid_length(cols: ArrayLike, rows: ArrayLike) -> FloatArray:
    """Length (...) in cells of the shortest path of 16-neighbour moves over (cols, rows)."""
    across, up = np.abs(np.asarray(cols, float)), np.abs(np.asarray(rows, float))
    far, near = np.maximum(across, up), np.minimum(across, up)
    flat = near * np.sqrt(5) + (far - 2 * near)
    steep = (far - near) * np.sqrt(5) + (2 * near - far) * np.sqrt(2)
    return np.where(2 * near <= far, flat, steep)


def straight_cost(
    cols: IntArray, rows: IntArray, level_um: int, diagonal_um: int, knight_um: int
) -> IntArray:
    """Cost (...) in micrometres of that path, by the cost of its moves."""
    far, near = np.maximum(abs(cols), abs(rows)), np.minimum(abs(cols), abs(rows))
    flat = near * knight_um + (far - 2 * near) * level_um
    steep = (far - near) * knight_um + (2 * near - far) * diagonal_um
    return np.where(2 * near <= far, flat, steep).astype(np.int64)


def build_potential(model: StepModel, table: StepTable) -> Potential:
    """Rate and potential of a step table, and the body's reach."""
    body_cell = _body_cells(model)
    index = np.indices(table.cost_um.shape)
    heading, side = index[0], index[1]
    to_heading = (heading + table.d_heading) % model.headings
    to_side = 1 - side
    cols, rows = np.moveaxis(moved_cells(table, body_cell), -1, 0)
    real = table.cost_um > 0
    length_m = (grid_length(cols, rows) * model.cell_m)[real]
    cost_um = table.cost_um[real]
    start, end = (heading * 2 + side)[real], (to_heading * 2 + to_side)[real]
    rate, potential = _best_rate(length_m, cost_um / MICRO, start, end, 2 * model.headings)
    potential_um = np.rint(potential * MICRO).astype(np.int64)
    # Whole micrometres must satisfy (1) as well: take off the rate what rounding may have added.
    slack_um = potential_um[start] - potential_um[end] - cost_um
    moving = length_m > 0
    rate = min(rate, float((-slack_um[moving] / MICRO / length_m[moving]).min()))
    move_um = np.floor(rate * np.linalg.norm(MOVES, axis=1) * model.cell_m * MICRO)
    return Potential(
        body_cell=body_cell,
        rate=rate,
        potential_um=potential_um - potential_um[:2].max() + final_cost_um(model),
        move_um=move_um.astype(np.int64),
        reach_m=_reach(model, table, body_cell, cols, rows),
    )


def _best_rate(
    length_m: FloatArray, cost_m: FloatArray, start: IntArray, end: IntArray, nodes: int
) -> tuple[float, FloatArray]:
    """Largest rate with a potential p (nodes,) such that rate * length + p[start] - p[end] <= cost.

    A rate is possible if the graph has no cycle of negative cost - rate * length; bisection, with
    Bellman-Ford for each rate.
    """
    low, high = 0.0, float((cost_m[length_m > 0] / length_m[length_m > 0]).max()) + 1.0
    best = np.zeros(nodes)
    for _ in range(40):
        rate = (low + high) / 2
        distance = _shortest(cost_m - rate * length_m, start, end, nodes)
        if distance is None:
            high = rate
        else:
            low, best = rate, -distance
    return low, best


def _shortest(weight: FloatArray, start: IntArray, end: IntArray, nodes: int) -> FloatArray | None:
    """Distance d with d[end] <= d[start] + weight everywhere, or None at a negative cycle."""
    distance = np.zeros(nodes)
    for _ in range(nodes + 1):
        better = distance.copy()
        np.minimum.at(better, end, distance[start] + weight)
        if np.all(better >= distance - 1e-12):
            return distance
        distance = better
    return None


def _reach(
    model: StepModel, table: StepTable, body_cell: IntArray, cols: IntArray, rows: IntArray
) -> float:
    """Least depth over all steps of the cells on its way inside the boxes checked for it."""
    half_m = np.array([model.body.length_m, model.body.width_m]) / 2
    bin_rad = 2 * np.pi / model.headings
    points, centres, yaws = [], [], []
    for heading, side, k in np.argwhere(table.cost_um > 0):
        index = heading, side, k
        foot = np.array([0.0, Side(side).outward * model.stance_width_m / 2])
        swing = np.array([table.d_col[index], table.d_row[index]]) * model.cell_m - foot
        yaw = (heading + np.array([0.0, 0.5, 1.0]) * table.d_heading[index]) * bin_rad
        inward = Side(side).outward * model.stance_width_m / 2
        beside = inward * np.column_stack([np.sin(yaw), -np.cos(yaw)])
        way = body_cell[heading * 2 + side] + _way(int(cols[index]), int(rows[index]))
        points.append(way * model.cell_m)
        middles = np.array([foot + beside[0], (foot + swing) / 2, swing - beside[2]])
        centres.append(np.broadcast_to(middles, (len(way), 3, 2)))
        yaws.append(np.broadcast_to(yaw, (len(way), 3)))
    boxes = np.concatenate(centres), np.concatenate(yaws)
    # Boxes widened by a disc reach as much farther as its radius.
    depths_m = union_depths(np.concatenate(points), *boxes, half_m)
    return float(depths_m.min()) + model.body_margin_m


def union_depths(
    points: FloatArray, centres: FloatArray, yaws: FloatArray, half: FloatArray
) -> FloatArray:
    """Radius (n,) of the largest disc around a point (n, 2) inside the union of its b boxes.

    centres (n, b, 2), yaws (n, b): where the boxes lie; half (2,): half length and half width.
    For a point outside all boxes its distance from the nearest, negative.
    """
    along = np.stack([np.cos(yaws), np.sin(yaws)], axis=-1)
    axes = np.stack([along, np.stack([-along[..., 1], along[..., 0]], axis=-1)], axis=-2)
    off = np.einsum("nbij,nbj->nbi", axes, points[:, None] - centres)
    beyond = np.abs(off) - half
    outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1)
    alone = (-outside - np.minimum(beyond.max(axis=-1), 0.0)).max(axis=-1)
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * half
    corners = centres[:, :, None] + np.einsum("ki,nbij->nbkj", corners, axes)
    starts = corners.reshape(len(points), -1, 2)
    edges = np.roll(corners, -1, axis=2).reshape(starts.shape) - starts
    # Of each edge the part inside each other box, from and to a share of its length; none where
    # low is not below high.
    in_box = np.einsum("nbij,nbej->nebi", axes, starts[:, None] - centres[:, :, None])
    run = np.einsum("nbij,nej->nebi", axes, edges)
    parallel = np.abs(run) < _ROUNDING
    cuts = np.sort(np.stack([-half - in_box, half - in_box]) / np.where(parallel, 1.0, run), axis=0)
    # An edge along a side of a box is on its rim, not inside, as those of its own are.
    is_beside = (parallel & (np.abs(in_box) > half - _ROUNDING)).any(axis=-1)
    low = np.where(is_beside, np.inf, np.where(parallel, -np.inf, cuts[0]).max(axis=-1))
    high = np.where(is_beside, -np.inf, np.where(parallel, np.inf, cuts[1]).min(axis=-1))
    # The rim of the union is what no box has in its inside. The nearest of it to the point lies
    # at its foot on the edge, or at the end of a part.
    foot = np.einsum("nej,nej->ne", points[:, None] - starts, edges) / (edges**2).sum(axis=-1)
    shares = np.clip(np.concatenate([foot[..., None], low, high], axis=-1), 0.0, 1.0)
    covered = (low[..., None, :] + _ROUNDING < shares[..., None]) & (
        shares[..., None] < high[..., None, :] - _ROUNDING
    )
    at = starts[:, :, None] + shares[..., None] * edges[:, :, None]
    away = np.where(
        covered.any(axis=-1), np.inf, np.linalg.norm(at - points[:, None, None], axis=-1)
    )
    return np.where(alone > 0.0, away.min(axis=(1, 2)), alone)


def _way(col: int, row: int) -> IntArray:
    """Cells (n, 2) of a shortest 16-neighbour path from (0, 0) to (col, row), near the line."""
    goal = np.array([col, row])
    line = np.array([-row, col])
    path = [np.zeros(2, np.int64)]
    while np.any(path[-1] != goal):
        left = goal - path[-1]
        total = grid_length(left[0], left[1])
        ends = path[-1] + MOVES
        rest = goal - ends
        cost = np.linalg.norm(MOVES, axis=1) + grid_length(rest[:, 0], rest[:, 1])
        shortest = np.abs(cost - total) < 1e-9
        off_line = np.where(shortest, np.abs(ends @ line), np.iinfo(np.int64).max)
        path.append(ends[int(np.argmin(off_line))])
    return np.array(path)
