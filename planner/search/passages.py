"""Narrow passages: where the widest way from start to goal is narrowest, and whether steps pass.

The widest way is the one whose least clearance is greatest. Where a body is too wide for its
narrowest place at any heading that steps allow, a search finds out only after it has expanded all
that lies before it. So a flood of the lattice over the surroundings of that place alone tells
whether any steps lead through. If not, the place is closed and the next widest way is looked at,
until none is left.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from planner.collision import Terrain
from planner.compiled import njit_no_refcount, zeros
from planner.lattice.frame import points_from_grid, poses_to_grid
from planner.lattice.lattice import Floats, Int64s, Lattice
from planner.lattice.steps import moved_cells
from planner.plan import NarrowPlace
from planner.robot_model import StepModel
from planner.search.problem import Request
from planner.search.reachability import BACKWARD, FORWARD, flood, nodes_free

Cells = NDArray[np.int64]

_BISECTIONS = 12
_ANGLES, _RAY_M, _RAY_STEP_M = 64, 3.0, 1e-3
# The flood covers what lies nearer to the place than _AROUND_M. It begins with all poses that are
# farther than _BEFORE_M on the near side, and has passed when it comes as far as _BEHIND_M.
_AROUND_M, _BEFORE_M, _BEHIND_M = 1.0, 0.5, 0.35
_MOST_PLACES = 4
_OUTSIDE, _NEAR_SIDE, _START, _FAR_SIDE, _PASSED = range(5)


@dataclass(frozen=True, kw_only=True)
class Passage:
    """The narrowest place of a way, in the grid frame.

    ends_m (2, 2): the points x, y where its width meets obstacles. before, behind (n, 2): rows and
    columns of the way on either side, from the place outward.
    """

    ends_m: Floats
    before: Cells
    behind: Cells

    @property
    def width_m(self) -> float:
        """Distance of the obstacles on both sides."""
        return math.dist(self.ends_m[0], self.ends_m[1])


def narrowest_passage(
    clearance_m: NDArray[np.float32], size_m: float, start: tuple[int, int], goal: tuple[int, int]
) -> Passage | None:
    """The narrowest place of the widest way between two cells (row, col) of a field (H, W).

    None where no way leads, or where an end is as narrow as any place between.
    """
    low, high = 0.0, float(min(clearance_m[start], clearance_m[goal]))
    if not _is_way(clearance_m, low, start, goal) or _is_way(clearance_m, high, start, goal):
        return None
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        if _is_way(clearance_m, middle, start, goal):
            low = middle
        else:
            high = middle
    way = _widest_way(clearance_m, low, high, start, goal)
    is_narrow = clearance_m[way[:, 0], way[:, 1]] <= high
    first = int(np.argmax(is_narrow))
    last = first + int(np.argmin(np.append(is_narrow[first:], False))) - 1
    at = (first + last) // 2
    row, col = (int(v) for v in way[at])
    ends_m = _shortest_chord(clearance_m, size_m, row, col)
    if ends_m is None:
        return None
    return Passage(ends_m=ends_m, before=way[:at][::-1], behind=way[at + 1 :])


def narrow_place(
    terrain: Terrain, model: StepModel, start: tuple[int, int], goal: tuple[int, int]
) -> NarrowPlace | None:
    """That place, x and y in the grid frame, where the robot cannot walk through facing ahead."""
    passage = narrowest_passage(terrain.clearance_m, terrain.resolution_m, start, goal)
    # What a box touches blocks it.
    if passage is None or passage.width_m > needed_m(model) + 2 * _RAY_STEP_M:
        return None
    x_m, y_m = (float(v) for v in passage.ends_m.mean(axis=0))
    width_m = round(passage.width_m, 2)
    return NarrowPlace(x=x_m, y=y_m, width_m=width_m, needed_m=round(needed_m(model), 3))


def needed_m(model: StepModel) -> float:
    """Width of a passage through which the robot can walk facing ahead."""
    return model.body.width_m + 2 * model.body_margin_m


def is_shut(request: Request) -> bool:
    """Whether narrow passages shut the goal's own pose off from the first steps; True is proven.

    Only floors that are flat are looked at.
    """
    lattice, reach_m = request.lattice, request.context.tables.potential.reach_m
    terrain = lattice.terrain
    if reach_m <= 0 or not terrain.is_flat or not request.context.region.is_point:
        return False
    if _longest_move_m(request) > _AROUND_M - _BEFORE_M:
        return False  # a step might skip the poses that the flood begins with
    bodies = np.unique(request.context.body_cells(request.first_steps[0]))
    points_m = _to_grid(lattice, bodies)
    size_m, clearance_m = terrain.resolution_m, terrain.clearance_m.copy()
    starts, (goal,) = _cells_at(terrain, points_m), _cells_at(terrain, _origin_m(lattice)[None])
    start = tuple(starts[np.argmax(clearance_m[starts[:, 0], starts[:, 1]])])
    ends_m = np.vstack([points_m, _origin_m(lattice)])
    closed: list[Passage] = []
    while len(closed) < _MOST_PLACES:
        passage = narrowest_passage(clearance_m, size_m, start, tuple(goal))
        # Poses on the lattice may miss the middle of a passage by half a cell, and must not touch.
        if passage is None or passage.width_m > needed_m(request.model) + 2 * lattice.cell_m:
            return False
        middle_m = passage.ends_m.mean(axis=0)
        if np.linalg.norm(ends_m - middle_m, axis=1).min() < _AROUND_M + size_m:
            return False
        if _leads_through(request, passage, passage.before, passage.behind):
            return False
        closed.append(passage)
        _close(clearance_m, size_m, passage)
        if not _is_way(clearance_m, reach_m - size_m, start, tuple(goal)):
            # With several places a plan might pass one the other way round.
            return len(closed) == 1 or not any(
                _leads_through(request, place, place.behind, place.before) for place in closed
            )
    return False


def _longest_move_m(request: Request) -> float:
    """How far a step moves the cell of the body at most."""
    table, potential = request.context.tables.steps, request.context.tables.potential
    moves = moved_cells(table, potential.body_cell)[table.cost_um > 0]
    return float(np.hypot(*moves.T).max()) * request.lattice.cell_m


def _is_way(
    clearance_m: NDArray[np.float32], radius_m: float, start: tuple[int, ...], goal: tuple[int, ...]
) -> bool:
    """Whether a way between two cells keeps more than a clearance."""
    _, label = cv2.connectedComponents((clearance_m > radius_m).astype(np.uint8), connectivity=4)
    return bool(label[start] == label[goal] > 0)


def _widest_way(
    clearance_m: NDArray[np.float32],
    low_m: float,
    high_m: float,
    start: tuple[int, int],
    goal: tuple[int, int],
) -> Cells:
    """Cells (n, 2) of a way of more than low_m, as few of them as can be with no more than high_m.

    There must be such a way.
    """
    rows, cols = clearance_m.shape
    parent = np.full(rows * cols, -1, np.int32)
    stacks = np.empty((2, rows * cols + 1), np.int32)
    first, last = start[0] * cols + start[1], goal[0] * cols + goal[1]
    _flood_widest(clearance_m.reshape(-1), cols, low_m, high_m, first, parent, stacks)
    way = [last]
    while way[-1] != first:
        way.append(int(parent[way[-1]]))
    return np.column_stack(np.divmod(np.array(way[::-1], np.int64), cols))


@njit_no_refcount
def _flood_widest(
    clearance_m: NDArray[np.float32],
    cols: int,
    low_m: float,
    high_m: float,
    first: int,
    parent: NDArray[np.int32],
    stacks: NDArray[np.int32],
) -> None:
    """Fills in the parents, -1 where none leads, by 0-1 breadth-first search: narrow cells cost 1.

    The field's outermost cells count as no ground to go on.
    """
    rows = len(clearance_m) // cols
    parent[first] = first
    stacks[0, 0] = first
    now, size = 0, 1
    while size > 0:
        later = 0
        while size > 0:
            size -= 1
            cell: int = np.int64(stacks[now, size])  # type: ignore[assignment]
            row, col = cell // cols, cell % cols
            if row == 0 or col == 0 or row == rows - 1 or col == cols - 1:
                continue
            for k in range(4):
                to = cell + (1, -1, cols, -cols)[k]
                if parent[to] >= 0 or clearance_m[to] <= low_m:
                    continue
                parent[to] = cell
                if clearance_m[to] > high_m:
                    stacks[now, size] = to
                    size += 1
                else:
                    stacks[1 - now, later] = to
                    later += 1
        now, size = 1 - now, later


def _shortest_chord(
    clearance_m: NDArray[np.float32], size_m: float, row: int, col: int
) -> Floats | None:
    """Ends (2, 2) x, y of the shortest line through a cell from obstacle to obstacle."""
    x, y = (col + 0.5) * size_m, (row + 0.5) * size_m
    angle = np.arange(2 * _ANGLES) * (math.pi / _ANGLES)
    ray = np.arange(0.0, _RAY_M, _RAY_STEP_M)
    cols = np.floor((x + np.cos(angle)[:, None] * ray) / size_m).astype(int)
    rows = np.floor((y + np.sin(angle)[:, None] * ray) / size_m).astype(int)
    height, width = clearance_m.shape
    inside = (rows >= 0) & (rows < height) & (cols >= 0) & (cols < width)
    hit = ~inside | (clearance_m[rows.clip(0, height - 1), cols.clip(0, width - 1)] <= 0.0)
    length_m = np.where(hit.any(axis=1), ray[hit.argmax(axis=1)], np.inf)
    both_m = length_m[:_ANGLES] + length_m[_ANGLES:]
    best = int(np.argmin(both_m))
    if not np.isfinite(both_m[best]):
        return None
    ends = [best, best + _ANGLES]
    return np.array([x, y]) + length_m[ends, None] * np.column_stack(
        [np.cos(angle[ends]), np.sin(angle[ends])]
    )


def _close(clearance_m: NDArray[np.float32], size_m: float, passage: Passage) -> None:
    """Takes the cells on the line across a place out of the field."""
    corners = np.rint((passage.ends_m / size_m - 0.5) * 256).astype(int)
    shut = np.zeros(clearance_m.shape, np.uint8)
    # So wide that no way slips through between two cells.
    cv2.line(shut, corners[0].tolist(), corners[1].tolist(), 1, thickness=3, shift=8)
    clearance_m[shut > 0] = 0.0


def _leads_through(request: Request, passage: Passage, before: Cells, behind: Cells) -> bool:
    """Whether steps may lead through a place, from the way before it to that behind; else proven.

    Every pose before the place is taken for one that can be reached.
    """
    lattice = request.lattice
    zone, first = _zones(request, passage, before, behind)
    if zone is None:
        return True
    body_cell = request.context.tables.potential.cell_offsets(lattice.cols)
    rows = 2 * lattice.headings

    def nodes_in(*zones: int) -> Int64s:
        """All nodes (n,) whose body's cell is in one of these zones."""
        up, across = np.nonzero(np.isin(zone, zones)) + np.array([[first[1]], [first[0]]])
        inside = (up >= 0) & (up < lattice.rows) & (across >= 0) & (across < lattice.cols)
        cell = up[inside] * lattice.cols + across[inside]
        nodes = ((cell[:, None] - body_cell) * rows + np.arange(rows)).reshape(-1)
        return np.asarray(nodes[(nodes >= 0) & (nodes < lattice.nodes)])

    seen = zeros(lattice.nodes, np.uint8)
    seen[nodes_in(_OUTSIDE)] = FORWARD  # so that the flood leaves them alone
    seen[nodes_in(_PASSED)] = BACKWARD
    seeds = nodes_in(_START)
    seeds = seeds[nodes_free(lattice, seeds)]
    seen[seeds] = FORWARD
    stack = np.empty(zone.size * rows, np.int32)
    stack[: len(seeds)] = seeds
    ends = np.array([len(seeds), len(seeds)])
    return flood(lattice, seen, stack, lattice.steps, FORWARD, ends, 0, zone.size * rows)


def _zones(
    request: Request, passage: Passage, before: Cells, behind: Cells
) -> tuple[NDArray[np.uint8] | None, tuple[int, int]]:
    """Zones (n, n) of the lattice's cells around a place, and the column and row of the first.

    A step from any zone but _OUTSIDE ends in one of these cells. None where the line across the
    place does not part them.
    """
    lattice = request.lattice
    terrain, size_m = lattice.terrain, lattice.terrain.resolution_m
    middle_m = passage.ends_m.mean(axis=0)
    reach = math.ceil((_AROUND_M + _longest_move_m(request)) / lattice.cell_m) + 1
    across, up = points_from_grid(lattice.frame, *middle_m) / np.array(lattice.cell_m)
    first = (
        round(float(across)) + lattice.origin_col - reach,
        round(float(up)) + lattice.origin_row - reach,
    )
    row_of, col_of = np.indices((2 * reach + 1, 2 * reach + 1))
    cells = ((row_of + first[1]) * lattice.cols + col_of + first[0]).reshape(-1)
    points_m = _to_grid(lattice, cells)
    at = _cells_at(terrain, points_m)
    # As far as a corner of the map's cell may be nearer to obstacles than its middle.
    least_m = request.context.tables.potential.reach_m - size_m
    is_open = terrain.clearance_m[at[:, 0], at[:, 1]] > least_m
    along = passage.ends_m[1] - passage.ends_m[0]
    share = np.clip((points_m - passage.ends_m[0]) @ along / (along @ along), 0.0, 1.0)
    away_m = np.linalg.norm(points_m - passage.ends_m[0] - share[:, None] * along, axis=1)
    is_open &= (away_m <= _AROUND_M) & (np.linalg.norm(points_m - middle_m, axis=1) <= _AROUND_M)
    parted = (is_open & (away_m > 0.75 * lattice.cell_m)).reshape(row_of.shape)
    _, label = cv2.connectedComponents(parted.astype(np.uint8), connectivity=4)
    far = label.reshape(-1)[_nearest(points_m, label, _middles_m(terrain, behind), away_m)]
    near = label.reshape(-1)[_nearest(points_m, label, _middles_m(terrain, before), away_m)]
    if far == near or not (far and near):
        return None, first
    zone = np.full(len(cells), _OUTSIDE, np.uint8)
    zone[is_open] = _NEAR_SIDE
    is_far = label.reshape(-1) == far
    zone[is_open & ~is_far & (away_m > _BEFORE_M)] = _START
    zone[is_far] = _FAR_SIDE
    zone[is_far & (away_m > _BEHIND_M)] = _PASSED
    return zone.reshape(row_of.shape), first


def _nearest(points_m: Floats, label: NDArray[np.int32], way_m: Floats, away_m: Floats) -> int:
    """Index of the labelled point that is nearest to where a way is well away from the place."""
    labelled = np.flatnonzero((label.reshape(-1) > 0) & (away_m > _BEHIND_M))
    if not len(labelled) or not len(way_m):
        return 0
    gaps_m = np.linalg.norm(points_m[labelled, None] - way_m[None, :200], axis=2)
    return int(labelled[np.argmin(gaps_m.min(axis=1))])


def _middles_m(terrain: Terrain, cells: Cells) -> Floats:
    return np.asarray((cells[:, ::-1] + 0.5) * terrain.resolution_m, dtype=float)


def _origin_m(lattice: Lattice) -> Floats:
    return np.array(lattice.frame[:2])


def _to_grid(lattice: Lattice, cells: Int64s) -> Floats:
    """Points (n, 2) of lattice cells (n,) in the grid frame."""
    col, row = cells % lattice.cols - lattice.origin_col, cells // lattice.cols - lattice.origin_row
    points = np.column_stack([col, row, np.zeros(len(cells))]) * lattice.cell_m
    return poses_to_grid(lattice.frame, points)[:, :2]


def _cells_at(terrain: Terrain, points_m: Floats) -> Cells:
    """Rows and columns (n, 2) of points (n, 2) on the map, those off it moved to its rim."""
    cells = np.floor(points_m[:, ::-1] / terrain.resolution_m).astype(np.int64)
    return cells.clip(0, np.array(terrain.blocked.shape) - 1)
