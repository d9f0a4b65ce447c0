"""What a change of the map changes on a lattice: which nodes and steps may have seen it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from planner.collision import Terrain, radius_of
from planner.compiled import njit_no_refcount, slot_of
from planner.lattice.frame import points_from_grid
from planner.lattice.lattice import D_COL, D_ROW, UNKNOWN, Int64s, Lattice


@dataclass(frozen=True, kw_only=True)
class Change:
    """Lattice cells near to what changed: the feet of all nodes and steps that may have seen it.

    shut (n,): with a foot in one of these a node or a step may no longer be allowed, or cost more.
    freed (m,): a step that begins in one of these may be allowed now, or cost less.
    """

    shut: Int64s
    freed: Int64s


def change_between(lattice: Lattice, old: Terrain, new: Terrain) -> Change | None:
    """What is different on a lattice over another terrain of the same size; None if nothing is."""
    differs = old.blocked != new.blocked
    shut, freed = differs & new.blocked, differs & old.blocked
    if not new.is_flat:
        # Ground that shows or is hidden may make a place level or not, and a way high or not.
        shut = freed = differs | (old.height_um != new.height_um)
    if not (shut.any() or freed.any()):
        return None
    node_m, pair_m, step_m = _sights_m(lattice)
    return Change(
        shut=_cells_around(lattice, shut, max(node_m, pair_m)),
        freed=_cells_around(lattice, freed, max(step_m + node_m, pair_m)),
    )


def over(lattice: Lattice, terrain: Terrain, change: Change) -> Lattice:
    """The lattice over the terrain with that change; takes the old one's arrays for its own."""
    _forget(lattice, change.shut)
    _forget(lattice, change.freed)
    lattice.pair_key.fill(0)
    return lattice._replace(terrain=terrain)


@njit_no_refcount
def _forget(lattice: Lattice, cells: Int64s) -> None:
    """Nodes in the cells (n,) are to be checked again."""
    rows = 2 * lattice.headings
    for i in range(len(cells)):
        for row in range(rows):
            slot = slot_of(lattice.slots, cells[i] * rows + row)
            lattice.node_state[slot] = UNKNOWN


def _cells_around(lattice: Lattice, changed: NDArray[np.bool_], sight_m: float) -> Int64s:
    """Lattice cells (n,) no farther than that from the changed cells of the map."""
    row, col = np.nonzero(changed)
    if not len(row):
        return np.zeros(0, np.int64)
    size = lattice.terrain.resolution_m
    centres = (np.array([col, row], float) + 0.5) * size
    x, y = points_from_grid(lattice.frame, centres[0], centres[1])
    across = np.rint(x / lattice.cell_m).astype(np.int64) + lattice.origin_col
    up = np.rint(y / lattice.cell_m).astype(np.int64) + lattice.origin_row
    # The distance field counts a blocked cell as nearer by up to its diagonal, to the point and to
    # the centre; and half the diagonal of the lattice's cell, for the rounding.
    reach = (sight_m + 1.5 * size) / lattice.cell_m + 1
    rim = math.ceil(reach)
    first = max(up.min() - rim, 0), max(across.min() - rim, 0)
    last = min(up.max() + rim, lattice.rows - 1), min(across.max() + rim, lattice.cols - 1)
    away = np.ones((last[0] - first[0] + 1, last[1] - first[1] + 1), np.uint8)
    away[up - first[0], across - first[1]] = 0
    cells_away = cv2.distanceTransform(away, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    row, col = np.nonzero(cells_away <= reach)
    cells: Int64s = (row + first[0]) * lattice.cols + col + first[1]
    return cells


def _sights_m(lattice: Lattice) -> tuple[float, float, float]:
    """How far from a foot's cell what concerns it may lie, and the longest step between cells.

    The first is for the checks of the foot, with the body over it and at the end with the other
    foot beside; the second for those of a step from or to it, with the body halfway.
    """
    step_m = (
        float(np.hypot(lattice.steps[..., D_COL], lattice.steps[..., D_ROW]).max()) * lattice.cell_m
    )
    body_m, side_m = radius_of(lattice.body), lattice.half_stance_m
    foot_m = max(radius_of(lattice.foot), radius_of(lattice.tread))
    node_m = max(2 * side_m + body_m, 3 * side_m + foot_m)
    pair_m = step_m / 2 + max(body_m, lattice.clearance[0])
    if not lattice.terrain.is_flat:
        pair_m = max(pair_m, step_m + 2 * side_m + lattice.swing_reach_m)
    return node_m, pair_m, step_m
