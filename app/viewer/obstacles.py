"""Boxes that people put on the map: they count in whole cells, for planner and physics alike."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from maps.grid import Cell, OccupancyGrid


@dataclass(frozen=True, kw_only=True)
class Obstacle:
    """An upright box, in metres of the grid frame: its centre and its whole extents."""

    number: int
    x_m: float
    y_m: float
    size_x_m: float
    size_y_m: float

    def moved_to(self, x_m: float, y_m: float) -> Obstacle:
        """The same box elsewhere."""
        return replace(self, x_m=x_m, y_m=y_m)

    def distance_m(self, x_m: float, y_m: float) -> float:
        """How far a point of the grid frame is from the box; 0 inside."""
        away_x = max(abs(x_m - self.x_m) - self.size_x_m / 2, 0.0)
        away_y = max(abs(y_m - self.y_m) - self.size_y_m / 2, 0.0)
        return float(np.hypot(away_x, away_y))


def snapped(obstacle: Obstacle, grid: OccupancyGrid) -> Obstacle:
    """The box moved and grown by less than a cell, so that it covers whole cells of the map.

    At least one cell stays on the map, wherever the box was put.
    """
    rows, cols = cells_below(obstacle, grid)
    x0, x1, y0, y1 = cols.start, cols.stop, rows.start, rows.stop
    side_m = grid.resolution_m
    return replace(
        obstacle,
        x_m=(x0 + x1) / 2 * side_m,
        y_m=(y0 + y1) / 2 * side_m,
        size_x_m=(x1 - x0) * side_m,
        size_y_m=(y1 - y0) * side_m,
    )


def with_obstacles(grid: OccupancyGrid, obstacles: Iterable[Obstacle]) -> OccupancyGrid:
    """The map with the cells below the boxes occupied."""
    cells = np.array(grid.cells)
    for obstacle in obstacles:
        cells[cells_below(obstacle, grid)] = Cell.OCCUPIED
    return grid.with_cells(cells)


def cells_below(obstacle: Obstacle, grid: OccupancyGrid) -> tuple[slice, slice]:
    """Rows and columns of the cells that the box covers."""
    rows, cols = grid.shape
    x0, x1 = _cells(obstacle.x_m, obstacle.size_x_m, grid.resolution_m, cols)
    y0, y1 = _cells(obstacle.y_m, obstacle.size_y_m, grid.resolution_m, rows)
    return slice(y0, y1), slice(x0, x1)


def _cells(centre_m: float, size_m: float, side_m: float, count: int) -> tuple[int, int]:
    """First cell and the one after the last that an interval touches, within the map."""
    # A box that was snapped before must not grow by a rounding error.
    slack = 1e-6
    first = int(np.floor((centre_m - size_m / 2) / side_m + slack))
    after = int(np.ceil((centre_m + size_m / 2) / side_m - slack))
    first = int(np.clip(first, 0, count - 1))
    return first, int(np.clip(after, first + 1, count))
