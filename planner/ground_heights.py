"""Heights of the ground under boxes and along the way of a swinging foot, compiled."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from maps.grid import OccupancyGrid
from planner.collision import CONTACT_M, NO_GROUND_UM, Terrain
from planner.jit import lean
from planner.robot_model import StepModel

FloatArray = NDArray[np.float64]


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
    margin_m = model.level_margin_m if margin_m is None else margin_m
    half_l, half_w = model.foot.length_m / 2 + margin_m, model.foot.width_m / 2 + margin_m
    heights = np.empty((len(feet_world), 2))
    for i, (x_m, y_m, z_m, yaw_rad) in enumerate(feet_world):
        x, y = (float(v) for v in grid.world_to_grid((x_m, y_m)))
        yaw = yaw_rad - grid.origin[2]
        low, high = box_heights(terrain, x, y, math.cos(yaw), math.sin(yaw), half_l, half_w)
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


@lean
def box_heights(
    terrain: Terrain, x: float, y: float, cos: float, sin: float, half_l: float, half_w: float
) -> tuple[int, int]:
    """Lowest and highest floor in micrometres of the cells that a box touches.

    Blocked cells and what is off the map do not count; both are NO_GROUND_UM where nothing else is
    under the box. The terrain must not be flat.
    """
    rows, cols = terrain.blocked.shape
    size = terrain.resolution_m
    reach_x = abs(cos) * half_l + abs(sin) * half_w + CONTACT_M
    reach_y = abs(sin) * half_l + abs(cos) * half_w + CONTACT_M
    row0, row1 = math.floor((y - reach_y) / size), math.floor((y + reach_y) / size)
    col0, col1 = math.floor((x - reach_x) / size), math.floor((x + reach_x) / size)
    cell_reach = 0.5 * size * (abs(cos) + abs(sin)) + CONTACT_M
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
                low = height if low == NO_GROUND_UM else min(low, height)
                high = max(high, height)
    return low, high


@lean
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
    _, high = box_heights(terrain, x, y, along_x, along_y, 0.5 * length, half_w)
    return high
