"""Exact collision check of oriented rounded boxes against the blocked cells of a map, compiled."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from maps.grid import OccupancyGrid, distance_field
from planner.compiled import njit_inner, njit_no_refcount
from planner.robot_model import RoundedBox, StepModel, level_box, rounded_box

# A box that touches a cell counts as hitting it, so that rounding never makes a check optimistic.
CONTACT_M = 1e-9
# Height of ground that nobody can tread on; far below any that a map may have.
NO_GROUND_UM = -(1 << 31) + 1
NEAR_M = 1.0
FloatArray = NDArray[np.float64]


class Terrain(NamedTuple):
    """What the compiled checks read of a map, in the grid frame.

    blocked (H, W): cells that no box may touch. clearance_m (H, W): lower bound on the distance
    from each cell's centre to blocked ground, the map's outside included.
    height_um (H, W): height of the floor in micrometres, NO_GROUND_UM in blocked cells; (0, 0)
    where the floor is flat. highest_um: for each cell the highest floor of any cell that comes
    nearer than NEAR_M along both axes.
    """

    blocked: NDArray[np.bool_]
    clearance_m: NDArray[np.float32]
    resolution_m: float
    height_um: NDArray[np.int32]
    highest_um: NDArray[np.int32]

    @property
    def is_flat(self) -> bool:
        """Whether the floor is at z = 0 everywhere."""
        return self.height_um.size == 0


def terrain_of(grid: OccupancyGrid, unknown_is_free: bool) -> Terrain:
    """The terrain of an occupancy grid."""
    blocked = grid.blocked(unknown_is_free)
    height_um = np.zeros((0, 0), np.int32)
    highest_um = height_um
    if grid.elevation_m is not None:
        height_um = np.rint(grid.elevation_m * 1e6).astype(np.int32)
        height_um[blocked] = NO_GROUND_UM
        side = 2 * math.ceil(NEAR_M / grid.resolution_m) + 1
        # Doubles hold these numbers exactly; OpenCV does not dilate whole numbers of 32 bits.
        square = np.ones((side, side), np.uint8)
        highest_um = cv2.dilate(height_um.astype(np.float64), square).astype(np.int32)
    return Terrain(
        blocked,
        distance_field(blocked, grid.resolution_m),
        grid.resolution_m,
        height_um,
        highest_um,
    )


@njit_no_refcount
def point_clearance(terrain: Terrain, x: float, y: float) -> float:
    """Lower bound in metres on the distance from a point to blocked ground; 0 off the map."""
    return clearance_at(terrain.clearance_m, terrain.resolution_m, x, y)


@njit_inner
def clearance_at(clearance_m: NDArray[np.float32], size_m: float, x: float, y: float) -> float:
    """`point_clearance` for loops that have the field (H, W) and its cells' size at hand."""
    rows, cols = clearance_m.shape
    col, row = math.floor(x / size_m), math.floor(y / size_m)
    if row < 0 or col < 0 or row >= rows or col >= cols:
        return 0.0
    off_x, off_y = x - (col + 0.5) * size_m, y - (row + 0.5) * size_m
    return max(0.0, clearance_m[row, col] - math.sqrt(off_x * off_x + off_y * off_y))


@njit_no_refcount
def radius_of(box: RoundedBox) -> float:
    """Radius of the circle around a rounded box, a hair more."""
    return math.sqrt(box[0] * box[0] + box[1] * box[1]) + box[2] + 1e-6


@njit_inner
def corner_gap(
    dx: float, dy: float, half: float, cos: float, sin: float, half_l: float, half_w: float
) -> tuple[int, float, float]:
    """Which corner of a box, seen from its centre, faces a corner of a cell, and the gap x, y.

    The cell's centre is at (dx, dy) from that of the box, half is half its size. -1, 0, 0 unless
    box and cell are nearest to each other at two corners: each is the other shape's nearest point
    to it, which for convex shapes holds nowhere else. Corner k is ahead unless k & 1, on the left
    unless k & 2.
    """
    for k in range(4):
        ahead, left = 1.0 - 2.0 * (k & 1), 1.0 - (k & 2)
        x = cos * ahead * half_l - sin * left * half_w
        y = sin * ahead * half_l + cos * left * half_w
        if abs(dx - x) <= half or abs(dy - y) <= half:
            continue
        gap_x = dx - x - (half if dx > x else -half)
        gap_y = dy - y - (half if dy > y else -half)
        along, across = cos * gap_x + sin * gap_y, cos * gap_y - sin * gap_x
        if ahead * along >= 0.0 and left * across >= 0.0:
            return k, gap_x, gap_y
    return -1, 0.0, 0.0


@njit_no_refcount
def box_free(terrain: Terrain, x: float, y: float, cos: float, sin: float, box: RoundedBox) -> bool:
    """Whether a rounded box with its centre at (x, y) keeps off blocked cells and the map's edge.

    Exact: cells and box are compared along the axes of both. The distance of two rectangles is the
    greatest of their gaps along these four axes, unless they are nearest at two corners. Cells that
    the distance field proves free are skipped.
    """
    if point_clearance(terrain, x, y) > radius_of(box):
        return True
    half_l, half_w, radius = box[0], box[1], box[2] + CONTACT_M
    rows, cols = terrain.blocked.shape
    size = terrain.resolution_m
    reach_x = abs(cos) * half_l + abs(sin) * half_w + radius
    reach_y = abs(sin) * half_l + abs(cos) * half_w + radius
    row0, row1 = math.floor((y - reach_y) / size), math.floor((y + reach_y) / size)
    col0, col1 = math.floor((x - reach_x) / size), math.floor((x + reach_x) / size)
    if row0 < 0 or col0 < 0 or row1 >= rows or col1 >= cols:
        return False
    cell_reach = 0.5 * size * (abs(cos) + abs(sin)) + radius
    for row in range(row0, row1 + 1):
        dy = (row + 0.5) * size - y
        col = col0
        while col <= col1:
            if terrain.blocked[row, col]:
                dx = (col + 0.5) * size - x
                along = abs(cos * dx + sin * dy)
                across = abs(cos * dy - sin * dx)
                if along <= half_l + cell_reach and across <= half_w + cell_reach:
                    _, gap_x, gap_y = corner_gap(dx, dy, 0.5 * size, cos, sin, half_l, half_w)
                    if gap_x * gap_x + gap_y * gap_y <= radius * radius:
                        return False
                col += 1
            else:
                # No blocked ground within this distance, so the next cells are free as well.
                col += max(1, int(terrain.clearance_m[row, col] / size + 0.499))
    return True


def heights_below(
    grid: OccupancyGrid,
    terrain: Terrain,
    model: StepModel,
    feet_world: FloatArray,
    margin_m: float | None = None,
) -> FloatArray:
    """Lowest and highest ground (n, 2) in metres under feet (n, 4) and the margin around them.

    The margin is that on which the ground must be level, unless another is given. Where there is no
    ground at all below a foot it is the foot's own z.
    """
    if terrain.is_flat:
        return np.zeros((len(feet_world), 2))
    box = level_box(model) if margin_m is None else rounded_box(model.foot, margin_m)
    heights = np.empty((len(feet_world), 2))
    for i, (x_m, y_m, z_m, yaw_rad) in enumerate(feet_world):
        x, y = (float(v) for v in grid.world_to_grid((x_m, y_m)))
        yaw = yaw_rad - grid.origin[2]
        low, high = box_heights(terrain, x, y, math.cos(yaw), math.sin(yaw), box)
        heights[i] = (z_m, z_m) if low == NO_GROUND_UM else (low / 1e6, high / 1e6)
    return heights


def resting_heights(
    grid: OccupancyGrid, terrain: Terrain, model: StepModel, feet_world: FloatArray
) -> FloatArray:
    """Height (n,) in metres of the ground on which feet (n, 4) rest that stand somewhere.

    A foot that stands partly over an edge rests on what is nearer to its own z.
    """
    low, high = heights_below(grid, terrain, model, feet_world, 0.0).T
    z_m = feet_world[:, 2]
    return np.where(np.abs(z_m - low) < np.abs(high - z_m), low, high)


@njit_no_refcount
def box_heights(
    terrain: Terrain, x: float, y: float, cos: float, sin: float, box: RoundedBox
) -> tuple[int, int]:
    """Lowest and highest floor in micrometres of the cells that a rounded box touches.

    Blocked cells and what is off the map do not count; both are NO_GROUND_UM where nothing else is
    under the box. The terrain must not be flat.
    """
    half_l, half_w, radius = box[0], box[1], box[2] + CONTACT_M
    rows, cols = terrain.blocked.shape
    size = terrain.resolution_m
    reach_x = abs(cos) * half_l + abs(sin) * half_w + radius
    reach_y = abs(sin) * half_l + abs(cos) * half_w + radius
    row0, row1 = math.floor((y - reach_y) / size), math.floor((y + reach_y) / size)
    col0, col1 = math.floor((x - reach_x) / size), math.floor((x + reach_x) / size)
    cell_reach = 0.5 * size * (abs(cos) + abs(sin)) + radius
    low, high = NO_GROUND_UM, NO_GROUND_UM
    for row in range(max(row0, 0), min(row1, rows - 1) + 1):
        dy = (row + 0.5) * size - y
        for col in range(max(col0, 0), min(col1, cols - 1) + 1):
            height = terrain.height_um[row, col]
            if height == NO_GROUND_UM or (height >= low and height <= high and low > NO_GROUND_UM):
                continue
            dx = (col + 0.5) * size - x
            along = abs(cos * dx + sin * dy)
            across = abs(cos * dy - sin * dx)
            if along <= half_l + cell_reach and across <= half_w + cell_reach:
                _, gap_x, gap_y = corner_gap(dx, dy, 0.5 * size, cos, sin, half_l, half_w)
                if gap_x * gap_x + gap_y * gap_y > radius * radius:
                    continue
                low = height if low == NO_GROUND_UM else min(low, height)
                high = max(high, height)
    return low, high


@njit_no_refcount
def highest_between(
    terrain: Terrain,
    start: tuple[float, float],
    end: tuple[float, float],
    cos: float,
    sin: float,
    sole: tuple[float, float],
) -> int:
    """Highest floor in micrometres that a sole passes on the straight way between two points.

    cos, sin: of the sole's heading; sole: its half length and half width. The way is a strip from
    point to point, as wide as the sole is seen along it; at its ends stands the foot itself.
    """
    dx, dy = end[0] - start[0], end[1] - start[1]
    length = math.sqrt(dx * dx + dy * dy)
    if length < 1e-6:
        return NO_GROUND_UM
    along_x, along_y = dx / length, dy / length
    half_w = abs(cos * along_y - sin * along_x) * sole[0]
    half_w += abs(cos * along_x + sin * along_y) * sole[1]
    x, y = 0.5 * (start[0] + end[0]), 0.5 * (start[1] + end[1])
    _, high = box_heights(terrain, x, y, along_x, along_y, (0.5 * length, half_w, 0.0))
    return high
