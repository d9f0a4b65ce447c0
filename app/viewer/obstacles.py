"""Boxes that people put on the map: the cells below them, and what drags and clicks do to them."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import viser

from app.viewer.scene import on_floor
from maps.grid import Cell, OccupancyGrid
from sim.scene import WALL_HEIGHT_M

BOX_RGB = (214, 126, 36)
MOST_BOXES = 50
# Boxes in the world may be told to the millimetre: so much is taken off each side again.
_ROUNDED_M = 0.001


@dataclass(frozen=True, kw_only=True)
class Obstacle:
    """An upright box, in metres of the grid frame: its centre and its whole extents."""

    number: int
    x_m: float
    y_m: float
    size_x_m: float
    size_y_m: float

    def distance_m(self, x_m: float, y_m: float) -> float:
        """How far a point of the grid frame is from the box; 0 inside."""
        away_x = max(abs(x_m - self.x_m) - self.size_x_m / 2, 0.0)
        away_y = max(abs(y_m - self.y_m) - self.size_y_m / 2, 0.0)
        return float(np.hypot(away_x, away_y))


class Box(NamedTuple):
    """A box in metres: its middle in the world, and its extents along x and y of the grid frame."""

    x_m: float
    y_m: float
    size_x_m: float
    size_y_m: float


def boxes_of(obstacles: Iterable[Obstacle], grid: OccupancyGrid) -> tuple[Box, ...]:
    """The boxes as they stand in the world."""
    found = []
    for obstacle in obstacles:
        x_m, y_m = (float(v) for v in grid.grid_to_world((obstacle.x_m, obstacle.y_m)))
        found.append(Box(x_m, y_m, obstacle.size_x_m, obstacle.size_y_m))
    return tuple(found)


def obstacles_of(boxes: Iterable[Box], grid: OccupancyGrid) -> tuple[Obstacle, ...]:
    """The boxes on the map, whole cells of it; those of `boxes_of` cover the same cells again."""
    found = []
    for number, box in enumerate(boxes):
        x_m, y_m = (float(value) for value in grid.world_to_grid((box.x_m, box.y_m)))
        size_x_m, size_y_m = (max(size_m - 2 * _ROUNDED_M, 0.0) for size_m in box[2:])
        obstacle = Obstacle(number=number, x_m=x_m, y_m=y_m, size_x_m=size_x_m, size_y_m=size_y_m)
        found.append(snapped(obstacle, grid))
    return tuple(found)


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


class ObstacleEditor:
    """Adds, moves and removes boxes; `on_change` gets all of them whenever they change.

    `is_refused(obstacle)` says why a box cannot stand somewhere, or nothing; a box that is dragged
    to such a place goes back to where it was. `on_click(event)` is awaited for a click on a box,
    `on_drag(client_id)` called for each piece of a drag.
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        grid: OccupancyGrid,
        *,
        on_change: Callable[[Sequence[Obstacle]], None],
        is_refused: Callable[[Obstacle], str],
        on_refused: Callable[[str], None],
        on_click: Callable[[viser.SceneNodePointerEvent], Coroutine[Any, Any, None]],
        on_drag: Callable[[int], None] = lambda _client_id: None,
    ) -> None:
        self._scene, self._grid = scene, grid
        self._on_change, self._is_refused, self._on_refused = on_change, is_refused, on_refused
        self._on_click, self._on_drag = on_click, on_drag
        self._obstacles: dict[int, Obstacle] = {}
        self._drawn: dict[int, viser.BoxHandle] = {}
        self._can_move = False

    def use(self, *, can_move: bool) -> None:
        """Says whether a drag on a box moves it; otherwise it is none of the boxes' business."""
        if can_move == self._can_move:
            return
        self._can_move = can_move
        for number, drawn in self._drawn.items():
            self._listen(number)
            # Whoever was dragging it has let go.
            drawn.position = self._middle(self._obstacles[number])

    def add(self, xy_world: Sequence[float], size_m: tuple[float, float]) -> None:
        """Sets a box down at a point of the world."""
        free = [number for number in range(MOST_BOXES) if number not in self._obstacles]
        if not free:
            self._on_refused(f"{MOST_BOXES} boxes are as many as there can be")
            return
        x_m, y_m = (float(value) for value in self._grid.world_to_grid(xy_world))
        obstacle = snapped(
            Obstacle(number=free[0], x_m=x_m, y_m=y_m, size_x_m=size_m[0], size_y_m=size_m[1]),
            self._grid,
        )
        if why := self._is_refused(obstacle):
            self._on_refused(why)
            return
        self._obstacles[obstacle.number] = obstacle
        self._draw(obstacle)
        self._changed()

    def put(self, obstacles: Iterable[Obstacle]) -> None:
        """Shows these boxes and no others, which somebody else has set."""
        wanted = {obstacle.number: obstacle for obstacle in obstacles}
        for number in set(self._drawn) - set(wanted):
            self._drawn.pop(number).remove()
        # Their order says which was added last.
        self._obstacles = wanted
        for number, obstacle in wanted.items():
            if number not in self._drawn:
                self._draw(obstacle)
                continue
            drawn = self._drawn[number]
            drawn.position = self._middle(obstacle)
            drawn.dimensions = obstacle.size_x_m, obstacle.size_y_m, WALL_HEIGHT_M

    def remove_last(self) -> None:
        """Takes the box away that was added last."""
        if self._obstacles:
            self.remove(next(reversed(self._obstacles)))

    def clear(self) -> None:
        """Takes all boxes away."""
        for drawn in self._drawn.values():
            drawn.remove()
        self._obstacles.clear()
        self._drawn.clear()
        self._changed()

    def remove(self, number: int) -> None:
        """Takes the box of this number away, if it is there."""
        if self._obstacles.pop(number, None) is not None:
            self._drawn.pop(number).remove()
            self._changed()

    def _draw(self, obstacle: Obstacle) -> None:
        drawn = self._scene.add_box(
            f"/map/box_{obstacle.number}",
            color=BOX_RGB,
            dimensions=(obstacle.size_x_m, obstacle.size_y_m, WALL_HEIGHT_M),
            position=self._middle(obstacle),
        )
        drawn.on_click(self._on_click)
        self._drawn[obstacle.number] = drawn
        self._listen(obstacle.number)

    def _changed(self) -> None:
        self._on_change(tuple(self._obstacles.values()))

    def _listen(self, number: int) -> None:
        drawn = self._drawn[number]
        if not self._can_move:
            drawn.remove_drag_callback("all")
            return

        async def dragged(event: viser.SceneNodeDragEvent) -> None:
            if number in self._obstacles:
                self._dragged(number, event)

        drawn.on_drag("left")(dragged)

    def _middle(self, obstacle: Obstacle) -> tuple[float, float, float]:
        """Of a box that stands on the floor."""
        place = self._grid.grid_to_world((obstacle.x_m, obstacle.y_m))
        z_m = float(self._grid.height_m(place)) + WALL_HEIGHT_M / 2
        return obstacle.x_m, obstacle.y_m, z_m

    def _dragged(self, number: int, event: viser.SceneNodeDragEvent) -> None:
        """Follows the pointer; the box counts at its new place when it is let go."""
        self._on_drag(event.client.client_id)
        drawn, before = self._drawn[number], self._obstacles[number]
        # The grab point is somewhere on the box; the pointer is followed at that height.
        eye = np.asarray(event.client.camera.position)
        point = on_floor(eye, np.asarray(event.end_position) - eye, event.start_position[2])
        if point is None:
            return
        if event.phase == "start":
            middle = np.array([before.x_m, before.y_m])
            self._grab = self._grid.world_to_grid(event.start_position[:2]) - middle
        x_m, y_m = (float(value) for value in self._grid.world_to_grid(point) - self._grab)
        moved = snapped(replace(before, x_m=x_m, y_m=y_m), self._grid)
        if event.phase != "end":
            drawn.position = (x_m, y_m, drawn.position[2])
            return
        # At the map's edge a box keeps its size, so that it is the same when it comes back.
        moved = replace(moved, size_x_m=before.size_x_m, size_y_m=before.size_y_m)
        if why := self._is_refused(moved):
            self._on_refused(why)
            moved = before
        drawn.position = self._middle(moved)
        if moved is not before:
            self._obstacles[number] = moved
            self._changed()
