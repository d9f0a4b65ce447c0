"""Narrow passages that no steps lead through.

Where a body is too wide for the narrowest place of the widest way, at any heading that steps allow,
a search finds out only after it has expanded all that lies before it. So a flood of the lattice
over the surroundings of that place alone tells whether any steps lead through. If not, the place is
closed and the next widest way is looked at, until none is left.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from planner.collision import Terrain
from planner.compiled import zeros
from planner.lattice.frame import points_from_grid, poses_to_grid
from planner.lattice.lattice import Floats, Int64s, Lattice
from planner.lattice.steps import moved_cells
from planner.search.passages import (
    Cells,
    Passage,
    close_passage,
    components,
    narrowest_passage,
    needed_m,
)
from planner.search.problem import Request
from planner.search.reachability import BACKWARD, FORWARD, flood, nodes_free
from planner.time_limit import check_time

# The flood covers what lies nearer to the places than _AROUND_M. It begins with all poses that are
# farther than _BEFORE_M on the near side, and has passed when it comes as far as _BEHIND_M.
_AROUND_M, _BEFORE_M, _BEHIND_M = 1.0, 0.5, 0.35
_MOST_PLACES = 6
_CHUNK = 1 << 12  # nodes that the flood expands between two looks at the clock
_NARROW = 2.0  # passages up to so many times as wide as the robot needs are looked at
_OUTSIDE, _BESIDE, _START, _PASSED = range(4)


@dataclass(frozen=True, kw_only=True)
class ShutPassages:
    """Narrow places that no steps lead through.

    cells (n,): the lattice's cells on the lines across them. is_proven: they shut the goal's own
    pose off from the first steps; else there are other ways, or the places are only likely shut.
    """

    cells: Int64s = field(default_factory=lambda: np.zeros(0, np.int64))
    is_proven: bool = False


def is_shut(request: Request) -> bool:
    """Whether narrow passages shut the goal's own pose off from the first steps; True is proven.

    Only floors that are flat are looked at.
    """
    return shut_passages(request).is_proven


def shut_passages(request: Request) -> ShutPassages:
    """The narrow places of the widest ways that no steps lead through, the widest way first.

    None of floors that are not flat.
    """
    lattice, terrain = request.lattice, request.lattice.terrain
    if (
        request.context.tables.potential.reach_m <= 0
        or not terrain.is_flat
        or not request.context.region.is_point
    ):
        return ShutPassages()
    if _longest_move_m(request) > _AROUND_M - _BEFORE_M:
        return ShutPassages()  # a step might skip the poses that the flood begins with
    points_m = _starts_m(request)
    size_m, clearance_m = terrain.resolution_m, terrain.clearance_m.copy()
    starts, (goal,) = _cells_at(terrain, points_m), _cells_at(terrain, _origin_m(lattice)[None])
    start = tuple(starts[np.argmax(clearance_m[starts[:, 0], starts[:, 1]])])
    closed: list[Passage] = []
    while len(closed) < _MOST_PLACES:
        passage = narrowest_passage(clearance_m, size_m, start, tuple(goal))
        if passage is None or passage.width_m > _NARROW * needed_m(request.model):
            break
        closed.append(passage)
        close_passage(clearance_m, size_m, passage)
        label = components(clearance_m, _open_m(request))
        if label[tuple(goal)] != label[start]:
            zones = _zones_between(request, closed, label, label[start])
            is_proven = zones is not None and not _leads_through(request, zones)
            return ShutPassages(cells=_cells_across(lattice, closed), is_proven=is_proven)
        zones = _zones_beside(request, closed)
        if zones is not None and _leads_through(request, zones):
            closed.pop()
            break
    return ShutPassages(cells=_cells_across(lattice, closed))


def _longest_move_m(request: Request) -> float:
    """How far a step moves the cell of the body at most."""
    table, potential = request.context.tables.steps, request.context.tables.potential
    moves = moved_cells(table, potential.body_cell)[table.cost_um > 0]
    return float(np.hypot(*moves.T).max()) * request.lattice.cell_m


def _open_m(request: Request) -> float:
    """No cell of the map has less clearance on the way of the body from cell to cell of a step.

    Discs of the potential's reach around both cells are free, and what lies between them in either.
    The field is at most 0.21 cells below the clearance of a cell's middle, which is at most 0.71
    cells below that of a point of it.
    """
    lattice, potential = request.lattice, request.context.tables.potential
    half_move_m = math.sqrt(5) / 2 * lattice.cell_m
    between_m = math.sqrt(max(potential.reach_m**2 - half_move_m**2, 0.0))
    return max(between_m - lattice.terrain.resolution_m, 0.0)


@dataclass(frozen=True, kw_only=True)
class _Zones:
    """Cells (n,) of the lattice around closed places, and the zone (n,) that each lies in."""

    cells: Int64s
    zone: NDArray[np.uint8]


def _leads_through(request: Request, zones: _Zones) -> bool:
    """Whether steps may lead from the near side of places to the far side; else proven.

    Every pose farther than _BEFORE_M before a place is taken for one that can be reached.
    """
    lattice = request.lattice
    body_cell = request.context.tables.potential.cell_offsets(lattice.cols)
    rows = 2 * lattice.headings

    def nodes_in(zone: int) -> Int64s:
        """All nodes (n,) whose body's cell is in a zone."""
        cells = zones.cells[zones.zone == zone]
        nodes = ((cells[:, None] - body_cell) * rows + np.arange(rows)).reshape(-1)
        return np.asarray(nodes[(nodes >= 0) & (nodes < lattice.nodes)])

    seen = zeros(lattice.nodes, np.uint8)
    seen[nodes_in(_OUTSIDE)] = FORWARD  # so that the flood leaves them alone
    seen[nodes_in(_PASSED)] = BACKWARD
    seen[lattice.goal_nodes] = BACKWARD
    first, _ = request.first_steps
    bodies = request.context.body_cells(first)
    seeds = np.concatenate([nodes_in(_START), first[np.isin(bodies, zones.cells)]])
    seeds = np.unique(seeds[nodes_free(lattice, seeds)])
    if np.any(seen[seeds] == BACKWARD):
        return True
    seen[seeds] = FORWARD
    stack = np.empty(len(zones.cells) * rows + len(seeds), np.int32)
    stack[: len(seeds)] = seeds
    ends = np.array([len(seeds), len(seeds)])
    while ends[0] > 0:
        check_time()
        if flood(lattice, seen, stack, lattice.steps, FORWARD, ends, 0, _CHUNK):
            return True
    return False


def _cells_around(
    request: Request, places: Sequence[Passage]
) -> tuple[Int64s, Floats, Floats, tuple[int, int]]:
    """Cells of the lattice that steps from around the places lead to, in rows of a rectangle.

    Their numbers (n,), points (n, 2), distances (n,) from the nearest of the lines across the
    places, and the rows and columns of the rectangle.
    """
    lattice = request.lattice
    reach_m = _AROUND_M + _longest_move_m(request)
    ends_m = np.concatenate([place.ends_m for place in places])
    across, up = np.stack(points_from_grid(lattice.frame, *ends_m.T)) / lattice.cell_m
    reach = math.ceil(reach_m / lattice.cell_m) + 1
    col = np.arange(math.floor(across.min()) - reach, math.ceil(across.max()) + reach + 1)
    row = np.arange(math.floor(up.min()) - reach, math.ceil(up.max()) + reach + 1)
    col, row = col + lattice.origin_col, row + lattice.origin_row
    col, row = col[(col >= 0) & (col < lattice.cols)], row[(row >= 0) & (row < lattice.rows)]
    cells = (row[:, None] * lattice.cols + col).reshape(-1)
    points_m = _to_grid(lattice, cells)
    away_m = np.min([_away_m(points_m, place.ends_m) for place in places], axis=0)
    return cells, points_m, away_m, (len(row), len(col))


def _away_m(points_m: Floats, ends_m: Floats) -> Floats:
    """Distance (n,) of points (n, 2) from the line between two ends (2, 2)."""
    along = ends_m[1] - ends_m[0]
    share = np.clip((points_m - ends_m[0]) @ along / (along @ along), 0.0, 1.0)
    away: Floats = np.linalg.norm(points_m - ends_m[0] - share[:, None] * along, axis=1)
    return away


def _cells_across(lattice: Lattice, places: Sequence[Passage]) -> Int64s:
    """Cells (n,) of the lattice on the lines across places."""
    found = [np.zeros(0, np.int64)]
    for place in places:
        length = max(2, math.ceil(2 * place.width_m / lattice.cell_m) + 1)
        share = np.linspace(0.0, 1.0, length)[:, None]
        line_m = place.ends_m[0] + share * (place.ends_m[1] - place.ends_m[0])
        x, y = points_from_grid(lattice.frame, *line_m.T)
        col = np.rint(x / lattice.cell_m).astype(np.int64) + lattice.origin_col
        row = np.rint(y / lattice.cell_m).astype(np.int64) + lattice.origin_row
        for d_col, d_row in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)):
            found.append((row + d_row) * lattice.cols + col + d_col)
    cells = np.unique(np.concatenate(found))
    return np.asarray(cells[(cells >= 0) & (cells < lattice.cols * lattice.rows)])


def _zones_between(
    request: Request, places: Sequence[Passage], label: NDArray[np.int32], near: int
) -> _Zones | None:
    """Zones where lines across places part the component `near` (of label (H, W)) from others.

    None where a first step or the goal lies on such a line.
    """
    terrain = request.lattice.terrain
    cells, points_m, away_m, _ = _cells_around(request, places)
    around = away_m <= _AROUND_M + _longest_move_m(request)
    cells, points_m, away_m = cells[around], points_m[around], away_m[around]
    at = _cells_at(terrain, points_m)
    here = label[at[:, 0], at[:, 1]]
    is_open = terrain.clearance_m[at[:, 0], at[:, 1]] > _open_m(request)
    ends_m = np.vstack([_starts_m(request), _origin_m(request.lattice)])
    ends = _cells_at(terrain, ends_m)
    labels = label[ends[:, 0], ends[:, 1]]
    if np.any(labels[:-1] != near) or labels[-1] in (0, near):
        return None
    return _zones_of(cells, away_m, is_open, here == near, (here != near) & (here > 0))


def _zones_of(
    cells: Int64s,
    away_m: Floats,
    is_open: NDArray[np.bool_],
    is_near: NDArray[np.bool_],
    is_far: NDArray[np.bool_],
) -> _Zones:
    """The zones of cells (n,) by their distance from the lines and the side that they are on."""
    is_open = is_open & (away_m <= _AROUND_M)
    zone = np.full(len(cells), _OUTSIDE, np.uint8)
    zone[is_open] = _BESIDE
    zone[is_open & is_near & (away_m > _BEFORE_M)] = _START
    zone[is_open & is_far & (away_m > _BEHIND_M)] = _PASSED
    return _Zones(cells=cells, zone=zone)


def _zones_beside(request: Request, places: Sequence[Passage]) -> _Zones | None:
    """Zones around the last of some places, whatever connects its sides farther off.

    None where the lines across the places do not part the way before it from that behind.
    """
    lattice, place = request.lattice, places[-1]
    terrain = lattice.terrain
    cells, points_m, away_m, shape = _cells_around(request, [place])
    for other in places[:-1]:
        away_m = np.minimum(away_m, _away_m(points_m, other.ends_m))
    at = _cells_at(terrain, points_m)
    is_open = terrain.clearance_m[at[:, 0], at[:, 1]] > _open_m(request)
    middle_m = place.ends_m.mean(axis=0)
    is_open &= np.linalg.norm(points_m - middle_m, axis=1) <= _AROUND_M
    parted = (is_open & (away_m > 0.75 * lattice.cell_m)).reshape(shape)
    _, numbers = cv2.connectedComponents(parted.astype(np.uint8), connectivity=4)
    label = np.asarray(numbers, np.int32).reshape(-1)
    far = label[_nearest(points_m, label, _middles_m(terrain, place.behind), away_m)]
    near = label[_nearest(points_m, label, _middles_m(terrain, place.before), away_m)]
    if far == near or not (far and near):
        return None
    return _zones_of(cells, away_m, is_open, label == near, label == far)


def _nearest(points_m: Floats, label: NDArray[np.int32], way_m: Floats, away_m: Floats) -> int:
    """Index of the labelled point that is nearest to where a way is well away from the place."""
    labelled = np.flatnonzero((label.reshape(-1) > 0) & (away_m > _BEHIND_M))
    if not len(labelled) or not len(way_m):
        return 0
    gaps_m = np.linalg.norm(points_m[labelled, None] - way_m[None, :200], axis=2)
    return int(labelled[np.argmin(gaps_m.min(axis=1))])


def _middles_m(terrain: Terrain, cells: Cells) -> Floats:
    return np.asarray((cells[:, ::-1] + 0.5) * terrain.resolution_m, dtype=float)


def _starts_m(request: Request) -> Floats:
    """Points (n, 2) of the body at the first steps in the grid frame."""
    bodies = np.unique(request.context.body_cells(request.first_steps[0]))
    return _to_grid(request.lattice, bodies)


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
