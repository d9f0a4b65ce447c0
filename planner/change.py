"""What a change of the map changes on a lattice: which nodes and steps may have seen it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from planner.collision import Terrain
from planner.space import D_COL, D_ROW, UNKNOWN, Int64s, Space


@dataclass(frozen=True, kw_only=True)
class Change:
    """Lattice cells (n,) around all that changed, and whether anything may be cheaper for it.

    No check of a node or a step whose feet stand in other cells reads what changed.
    """

    cells: Int64s
    frees: bool


def change_between(space: Space, old: Terrain, new: Terrain) -> Change | None:
    """What is different on a lattice over another terrain of the same size; None if nothing is."""
    differs = old.blocked != new.blocked
    frees = bool(np.any(differs & old.blocked))
    if not new.is_flat:
        moved = old.height_um != new.height_um
        frees |= bool(np.any(moved & ~differs))
        differs = differs | moved
    row, col = np.nonzero(differs)
    if not len(row):
        return None
    return Change(cells=_cells_around(space, row, col), frees=frees)


def over(space: Space, terrain: Terrain, change: Change) -> Space:
    """The lattice over the terrain with that change; takes the old one's arrays for its own."""
    space.node_state.reshape(-1, 2 * space.headings)[change.cells] = UNKNOWN
    # Distances change far from what is near to them, and are quickly measured again.
    space.half_clear_m.fill(0.0)
    space.pair_key.fill(0)
    return space._replace(terrain=terrain)


def _cells_around(space: Space, row: Int64s, col: Int64s) -> Int64s:
    """Lattice cells (n,) near enough to cells of the map for any check to read those."""
    ox, oy, cos, sin = space.frame
    size = space.terrain.resolution_m
    dx, dy = (col + 0.5) * size - ox, (row + 0.5) * size - oy
    x, y = cos * dx + sin * dy, cos * dy - sin * dx
    marks = np.zeros((space.rows, space.cols), np.uint8)
    across = np.rint(x / space.cell_m).astype(np.int64) + space.origin_col
    up = np.rint(y / space.cell_m).astype(np.int64) + space.origin_row
    marks[up, across] = 1
    # Half a cell of either grid on top, for the rounding.
    reach = math.ceil((_sight_m(space) + size) / space.cell_m) + 1
    near = cv2.dilate(marks, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8))
    return np.flatnonzero(near)


def _sight_m(space: Space) -> float:
    """How far from a foot's cell the checks of the foot and of its steps look at most."""
    hops = max(int(np.abs(space.steps[..., k]).max()) for k in (D_COL, D_ROW))
    hop_m = math.sqrt(2) * hops * space.cell_m
    body_m = math.hypot(*space.body) + 2 * space.half_stance_m
    foot_m = math.hypot(*np.maximum(space.foot, space.tread)) + 3 * space.half_stance_m
    swing_m = 0.0 if space.terrain.is_flat else space.swing_reach_m + 2 * space.half_stance_m
    return hop_m + max(body_m, foot_m, swing_m, space.clearance[0])
