"""What a ray from somebody's eye meets first: the floor, a wall, or one of the boxes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.viewer.obstacles import Obstacle, cells_below
from maps.grid import Cell, OccupancyGrid
from maps.terraces import terraces_of
from sim.scene import WALL_HEIGHT_M

# What a ray may meet; a box is told by its number.
ROBOT, FLOOR, WALL = -3, -2, -1
FloatArray = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Met:
    """A point of the world that a ray met, and what is there: FLOOR, WALL or a box's number.

    Of the ROBOT it is the point on the ground where that stands.
    """

    x_m: float
    y_m: float
    z_m: float
    on: int


@dataclass(frozen=True, kw_only=True)
class Surface:
    """The map as it is drawn, from above.

    top_m (H, W): how high what stands on each cell reaches; on (H, W): FLOOR, WALL, or the number
    of the box there.
    """

    grid: OccupancyGrid
    top_m: FloatArray
    on: NDArray[np.int64]

    def with_boxes(self, obstacles: Iterable[Obstacle]) -> Surface:
        """The same with boxes on it."""
        top_m, on = self.top_m.copy(), self.on.copy()
        for obstacle in obstacles:
            place = cells_below(obstacle, self.grid)
            centre = self.grid.grid_to_world((obstacle.x_m, obstacle.y_m))
            reach_m = float(self.grid.height_m(centre)) + WALL_HEIGHT_M
            on[place] = np.where(top_m[place] > reach_m, on[place], obstacle.number)
            top_m[place] = np.maximum(top_m[place], reach_m)
        return Surface(grid=self.grid, top_m=top_m, on=on)

    def height_m(self, place: Sequence[float]) -> float:
        """How high what is at a point x, y of the world reaches; beyond the edge, the lowest."""
        row, col = (int(value) for value in self.grid.world_to_cell(np.asarray(place)[:2]))
        rows, cols = self.grid.shape
        inside = 0 <= row < rows and 0 <= col < cols
        return float(self.top_m[row, col] if inside else self.top_m.min())

    def met(self, origin: ArrayLike, direction: ArrayLike) -> Met | None:
        """What a ray from a point (3,) of the world meets first; None if it never does.

        Beyond the map's edge there is floor as low as the lowest. What the ray begins in is glass.
        """
        begin, along = self._in_grid(origin, direction)
        cuts = self._cuts(begin, along)
        if len(cuts) > 1:
            middle = begin[:2] + (cuts[:-1, None] + cuts[1:, None]) / 2 * along[:2]
            last = np.array(self.on.shape[::-1]) - 1
            cells = np.clip(np.floor(middle / self.grid.resolution_m).astype(int), 0, last)
            cols, rows = cells.T
            top_m, z_m = self.top_m[rows, cols], begin[2] + cuts * along[2]
            is_face = z_m[:-1] <= top_m
            is_met = is_face | (z_m[1:] <= top_m)
            if cuts[0] == 0.0:
                is_met &= ~np.logical_and.accumulate(is_face)
            if is_met.any():
                cell = int(is_met.argmax())
                share = cuts[cell] if is_face[cell] else (top_m[cell] - begin[2]) / along[2]
                return self._at(begin + share * along, int(self.on[rows[cell], cols[cell]]))
        if along[2] >= -1e-9:
            return None
        share = (float(self.top_m.min()) - begin[2]) / along[2]
        return self._at(begin + share * along, FLOOR)

    def _in_grid(self, origin: ArrayLike, direction: ArrayLike) -> tuple[FloatArray, FloatArray]:
        begin, end = np.array(origin, float), np.add(origin, direction)
        for point in (begin, end):
            point[:2] = self.grid.world_to_grid(point[:2])
        return begin, end - begin

    def _cuts(self, begin: FloatArray, along: FloatArray) -> FloatArray:
        """Where the ray, as seen from above, enters and leaves cells of the map, in its lengths."""
        enter, leave, crossings = 0.0, np.inf, []
        for axis, size_m in enumerate(self.grid.size_m):
            if abs(along[axis]) < 1e-12:
                if not 0 <= begin[axis] <= size_m:
                    return np.zeros(0)
                continue
            count = round(size_m / self.grid.resolution_m)
            lines = (np.arange(count + 1) * self.grid.resolution_m - begin[axis]) / along[axis]
            enter, leave = max(enter, float(lines.min())), min(leave, float(lines.max()))
            crossings.append(lines)
        if not crossings:  # Straight down, or up.
            lowest = (float(self.top_m.min()) - begin[2]) / (along[2] or 1.0)
            return np.array([0.0, lowest]) if lowest > 0 else np.zeros(0)
        lines = np.concatenate(crossings)
        inner = np.unique(lines[(lines > enter) & (lines < leave)])
        return np.concatenate([[enter], inner, [leave]]) if enter < leave else np.zeros(0)

    def _at(self, point: FloatArray, on: int) -> Met:
        x_m, y_m = (float(value) for value in self.grid.grid_to_world(point[:2]))
        return Met(x_m=x_m, y_m=y_m, z_m=float(point[2]), on=on)


def surface_of(grid: OccupancyGrid) -> Surface:
    """The map without boxes."""
    top_m = np.zeros(grid.shape) if grid.elevation_m is None else np.array(grid.elevation_m)
    on = np.full(grid.shape, FLOOR)
    walls = terraces_of(grid, grid.cells == Cell.OCCUPIED).walls
    for x_m, y_m, half_x_m, half_y_m, foot_m in walls:
        x0, x1, y0, y1 = (
            round(edge_m / grid.resolution_m)
            for edge_m in (x_m - half_x_m, x_m + half_x_m, y_m - half_y_m, y_m + half_y_m)
        )
        top_m[y0:y1, x0:x1], on[y0:y1, x0:x1] = foot_m + WALL_HEIGHT_M, WALL
    return Surface(grid=grid, top_m=top_m, on=on)
