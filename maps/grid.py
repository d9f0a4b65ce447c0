"""Occupancy grid: which cells of the floor are free, occupied or unknown, and where they lie.

Three frames meet here. World: the map frame of poses. Grid: metres along the columns (x) and rows
(y) of the cells, zero at the lower-left corner of cell (0, 0); the grid's origin pose takes it to
the world. Indices: (row, col), row 0 at the smallest y of the grid, so an image is flipped on load.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import IntEnum

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
HIGHEST_M = 1000.0  # so that heights in micrometres fit into 32 bits


class Cell(IntEnum):
    """State of one cell."""

    FREE = 0
    OCCUPIED = 1
    UNKNOWN = 2


@dataclass(frozen=True, kw_only=True, repr=False)
class OccupancyGrid:
    """Cells (H, W) uint8 of `Cell` values, row 0 at the smallest y; read-only.

    origin: pose x_m, y_m, yaw_rad in the world of the lower-left corner of cell (0, 0).
    elevation_m (H, W): height of the floor in each cell, to the micrometre; None where z is 0
    everywhere.
    """

    cells: NDArray[np.uint8]
    resolution_m: float
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    elevation_m: FloatArray | None = None

    def __post_init__(self) -> None:
        cells = np.array(self.cells, dtype=np.uint8, order="C")
        if cells.ndim != 2 or cells.size == 0:
            raise ValueError(f"cells {cells.shape} must be (H, W) with at least one cell")
        if cells.max() > max(Cell):
            raise ValueError(f"cell value {cells.max()} must be one of {[int(c) for c in Cell]}")
        if not (math.isfinite(self.resolution_m) and self.resolution_m > 0):
            raise ValueError(f"resolution_m {self.resolution_m} must be a finite number above 0")
        if len(self.origin) != 3 or not all(math.isfinite(v) for v in self.origin):
            raise ValueError(f"origin {self.origin} must be three finite numbers x, y, yaw")
        cells.flags.writeable = False
        object.__setattr__(self, "cells", cells)
        if self.elevation_m is not None:
            object.__setattr__(self, "elevation_m", _elevation(self.elevation_m, cells.shape))

    def __repr__(self) -> str:
        rows, cols = self.shape
        free = 100 * float(np.mean(self.cells == Cell.FREE))
        return f"OccupancyGrid({rows} x {cols} cells of {self.resolution_m:g} m, {free:.0f} % free)"

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        rows, cols = self.cells.shape
        return rows, cols

    @property
    def size_m(self) -> tuple[float, float]:
        """Extent along the grid's x and y."""
        rows, cols = self.cells.shape
        return cols * self.resolution_m, rows * self.resolution_m

    def blocked(self, unknown_is_free: bool = False) -> NDArray[np.bool_]:
        """Cells (H, W) that block a robot."""
        if unknown_is_free:
            return np.asarray(self.cells == Cell.OCCUPIED)
        return np.asarray(self.cells != Cell.FREE)

    def with_cells(self, cells: NDArray[np.uint8]) -> OccupancyGrid:
        """The same grid with other cells (H, W)."""
        return replace(self, cells=cells)

    def height_m(self, xy_world: ArrayLike) -> FloatArray:
        """Height (...) of the floor at points (..., 2) of the world; off the map that of its edge.

        On the border of two cells it is that of the one with the larger x or y of the grid.
        """
        cell = self.world_to_cell(xy_world)
        if self.elevation_m is None:
            return np.zeros(cell.shape[:-1])
        row, col = np.moveaxis(np.clip(cell, 0, np.array(self.cells.shape) - 1), -1, 0)
        heights: FloatArray = self.elevation_m[row, col]
        return heights

    def world_to_grid(self, xy_world: ArrayLike) -> FloatArray:
        """Points (..., 2) of the world in metres of the grid frame."""
        xy = np.asarray(xy_world, dtype=float) - np.array(self.origin[:2])
        cos, sin = math.cos(self.origin[2]), math.sin(self.origin[2])
        return xy @ np.array([[cos, -sin], [sin, cos]])

    def grid_to_world(self, xy_grid: ArrayLike) -> FloatArray:
        """Points (..., 2) of the grid frame in the world."""
        cos, sin = math.cos(self.origin[2]), math.sin(self.origin[2])
        turned: FloatArray = np.asarray(xy_grid, dtype=float) @ np.array([[cos, sin], [-sin, cos]])
        return turned + np.array(self.origin[:2])

    def world_to_cell(self, xy_world: ArrayLike) -> NDArray[np.int64]:
        """(row, col) (..., 2) of the cells that hold the points (..., 2); may lie off the map."""
        col_row = np.floor(self.world_to_grid(xy_world) / self.resolution_m)
        return np.asarray(col_row[..., ::-1].astype(np.int64))

    def cell_to_world(self, row_col: ArrayLike) -> FloatArray:
        """Centres (..., 2) in the world of the cells (row, col) (..., 2)."""
        col_row = np.asarray(row_col, dtype=float)[..., ::-1]
        return self.grid_to_world((col_row + 0.5) * self.resolution_m)

    def contains(self, xy_world: ArrayLike) -> NDArray[np.bool_]:
        """Whether each point (..., 2) lies on the map."""
        cell = self.world_to_cell(xy_world)
        return np.asarray(np.all((cell >= 0) & (cell < np.array(self.cells.shape)), axis=-1))

    def bounds_world(self) -> tuple[float, float, float, float]:
        """Smallest x, y and largest x, y in the world that the map reaches."""
        width_m, height_m = self.size_m
        corners = self.grid_to_world(
            np.array([[0.0, 0.0], [width_m, 0.0], [0.0, height_m], [width_m, height_m]])
        )
        x_min, y_min = corners.min(axis=0)
        x_max, y_max = corners.max(axis=0)
        return float(x_min), float(y_min), float(x_max), float(y_max)


def _elevation(values: ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    """Heights (H, W) in whole micrometres, so that sums and differences of them repeat exactly."""
    heights: FloatArray = np.round(np.array(values, dtype=float, order="C"), 6) + 0.0
    if heights.shape != shape:
        raise ValueError(f"elevation_m {heights.shape} must have the shape of the cells {shape}")
    if not np.all(np.abs(heights) <= HIGHEST_M):
        raise ValueError(f"elevation_m must be finite and within +-{HIGHEST_M:g} m")
    heights.flags.writeable = False
    return heights


# Up to this distance the squares of the transform are accurate to less than a half.
_FAR_CELLS = 1000


def distance_field(blocked: NDArray[np.bool_], resolution_m: float) -> NDArray[np.float32]:
    """Lower bound (H, W) in metres on the distance from each cell's centre to blocked ground.

    Everything outside the map counts as blocked. Blocked cells are 0. The nearest point of a
    blocked cell is at most half a cell's diagonal nearer than its centre, and never nearer than
    half a cell; so the value never exceeds the true distance to the blocked squares. The same map
    has the same field to the bit.
    """
    rows, cols = blocked.shape
    free = np.zeros((rows + 2, cols + 2), np.uint8)
    free[1:-1, 1:-1] = ~blocked
    # Distances between centres, in cells. The last bits of OpenCV's exact transform differ from one
    # call to the next; the squares are whole numbers, so to round them makes it exact.
    near = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    field = np.ascontiguousarray(near, np.float32)
    del near, free
    # In place: large maps have tens of millions of cells.
    np.minimum(field, np.float32(_FAR_CELLS), out=field)
    np.square(field, out=field)
    np.rint(field, out=field)
    np.sqrt(field, out=field)
    field -= np.float32(np.sqrt(0.5) + 1e-4)
    np.maximum(field, np.float32(0.5), out=field)
    field *= np.float32(resolution_m)
    field[blocked] = 0.0
    return field
