"""Obstacle boxes: rasterized into a map's cells, and blocked cells merged into few boxes."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from maps.grid import Cell, OccupancyGrid


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
