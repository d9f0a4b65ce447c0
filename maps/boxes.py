"""A map as boxes: obstacles into its cells and out of them, floor and walls with their heights."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from maps.grid import Cell, OccupancyGrid

FloatArray = NDArray[np.float64]

# Heights that differ by less make one box.
_LEVEL_M = 0.001
# A wall rises from the highest floor within this distance, so that no robot steps over it.
_BESIDE_WALL_M = 0.5


def merge_rectangles(blocked: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Rectangles (n, 4) as row0, col0, row1, col1 (ends excluded) that tile the blocked cells.

    No two overlap, and together they cover exactly the blocked cells. Greedy: the first cell left
    over, scanning rows, grows to the larger of two maximal rectangles, wide first or tall first.
    """
    left = np.array(blocked, dtype=bool)
    rectangles: list[tuple[int, int, int, int]] = []
    rows = left.shape[0]
    for row in range(rows):
        while left[row].any():
            col = int(np.argmax(left[row]))
            wide = _grow(left[row:, col:])
            tall = _grow(left[row:, col:].T)[::-1]
            height, width = max(wide, tall, key=lambda size: size[0] * size[1])
            left[row : row + height, col : col + width] = False
            rectangles.append((row, col, row + height, col + width))
    return np.array(rectangles, dtype=np.int64).reshape(-1, 4)


def _grow(cells: NDArray[np.bool_]) -> tuple[int, int]:
    """Height and width of the rectangle at (0, 0) that takes its whole first run, then rows."""
    width = int(np.argmin(np.append(cells[0], False)))
    return int(np.argmin(np.append(cells[:, :width].all(axis=1), False))), width


def obstacle_boxes(blocked: NDArray[np.bool_], resolution_m: float) -> NDArray[np.float64]:
    """Boxes (n, 4) as centre x, centre y, half extent x, half extent y, metres in the grid frame.

    Their union is exactly the area of the blocked cells.
    """
    row0, col0, row1, col1 = merge_rectangles(blocked).T * resolution_m
    return np.stack(
        [(col0 + col1) / 2, (row0 + row1) / 2, (col1 - col0) / 2, (row1 - row0) / 2], axis=1
    )


def with_boxes(grid: OccupancyGrid, boxes: NDArray[np.float64]) -> OccupancyGrid:
    """The map with every cell occupied whose centre lies in a box.

    boxes (k, 5): x_m, y_m of the centre in the world, length_m, width_m, yaw_rad.
    """
    cells = np.array(grid.cells)
    for x_m, y_m, length_m, width_m, yaw_rad in boxes:
        reach_m = math.hypot(length_m, width_m) / 2
        col, row = grid.world_to_grid((x_m, y_m)) / grid.resolution_m
        reach = reach_m / grid.resolution_m + 1
        row0, row1 = (int(np.clip(v, 0, grid.shape[0])) for v in (row - reach, row + reach + 1))
        col0, col1 = (int(np.clip(v, 0, grid.shape[1])) for v in (col - reach, col + reach + 1))
        index = np.moveaxis(np.mgrid[row0:row1, col0:col1], 0, -1)
        away = grid.cell_to_world(index) - (x_m, y_m)
        cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
        along = np.abs(away @ (cos, sin)) <= length_m / 2
        across = np.abs(away @ (-sin, cos)) <= width_m / 2
        cells[row0:row1, col0:col1][along & across] = Cell.OCCUPIED
    return grid.with_cells(cells)


@dataclass(frozen=True, kw_only=True)
class Terraces:
    """Boxes (n, 5): centre x, centre y, half extent x, half extent y, height, in the grid frame.

    ground: floor that is higher than lowest_m, solid from there up to its height. walls: blocked
    cells, with the height of the floor that they rise from. lowest_m: the floor everywhere else.
    origin: pose x_m, y_m, yaw_rad of the grid frame in the world.
    """

    ground: FloatArray = field(default_factory=lambda: np.zeros((0, 5)))
    walls: FloatArray = field(default_factory=lambda: np.zeros((0, 5)))
    lowest_m: float = 0.0
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)


def terraces_of(grid: OccupancyGrid, blocked: NDArray[np.bool_]) -> Terraces:
    """Floor and walls of a map whose cells (H, W) are blocked or not."""
    if grid.elevation_m is None:
        flat = obstacle_boxes(blocked, grid.resolution_m)
        return Terraces(walls=np.column_stack([flat, np.zeros(len(flat))]), origin=grid.origin)
    heights_m = _levels(grid.elevation_m)
    lowest_m = float(heights_m[~blocked].min()) if not blocked.all() else 0.0
    # Walls rise from their own heights in the map, or from those of higher floor beside them.
    side = 2 * math.ceil(_BESIDE_WALL_M / grid.resolution_m) + 1
    floor_m = np.where(blocked, lowest_m, heights_m)
    beside_m = cv2.dilate(floor_m, np.ones((side, side), np.uint8))
    feet_m = np.maximum(np.maximum(heights_m, lowest_m), beside_m)
    return Terraces(
        ground=_boxes(~blocked & (heights_m > lowest_m), heights_m, grid.resolution_m),
        walls=_boxes(blocked, feet_m, grid.resolution_m),
        lowest_m=lowest_m,
        origin=grid.origin,
    )


def plates_of(grid: OccupancyGrid, cells: NDArray[np.bool_]) -> FloatArray:
    """Boxes (n, 5), as in `Terraces`, that tile the chosen cells (H, W) at their own heights."""
    heights_m = np.zeros(grid.shape) if grid.elevation_m is None else _levels(grid.elevation_m)
    return _boxes(cells, heights_m, grid.resolution_m)


def _levels(heights_m: FloatArray) -> FloatArray:
    levels: FloatArray = np.round(np.round(heights_m / _LEVEL_M) * _LEVEL_M, 6)
    return levels


def _boxes(cells: NDArray[np.bool_], heights_m: FloatArray, resolution_m: float) -> FloatArray:
    """Boxes (n, 5) that tile the chosen cells (H, W), each over cells of one height."""
    found = [np.zeros((0, 5))]
    row, col = np.nonzero(cells)
    order = np.argsort(heights_m[row, col], kind="stable")
    row, col = row[order], col[order]
    levels, starts = np.unique(heights_m[row, col], return_index=True)
    ends = np.append(starts, len(row))[1:]
    for height_m, start, end in zip(levels, starts, ends, strict=True):
        rows, cols = row[start:end], col[start:end]
        row0, col0 = rows.min(), cols.min()
        window = np.zeros((np.ptp(rows) + 1, np.ptp(cols) + 1), bool)
        window[rows - row0, cols - col0] = True
        boxes = obstacle_boxes(window, resolution_m)
        boxes[:, :2] += np.array([col0, row0]) * resolution_m
        found.append(np.column_stack([boxes, np.full(len(boxes), height_m)]))
    return np.concatenate(found)
