"""The boxes that people put on the map, as drawn, and what a drag or a click does to them."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import viser

from app.viewer.obstacles import Obstacle, snapped
from app.viewer.pointer import on_floor
from maps.grid import OccupancyGrid
from sim.scene import WALL_HEIGHT_M

BOX_RGB = (214, 126, 36)
MOST_BOXES = 50


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
            self._listen(number, drawn)
            obstacle = self._obstacles[number]
            # Whoever was dragging it has let go.
            drawn.position = (obstacle.x_m, obstacle.y_m, self._middle_m(obstacle))

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

    def _changed(self) -> None:
        self._on_change(tuple(self._obstacles.values()))

    def _draw(self, obstacle: Obstacle) -> None:
        number = obstacle.number
        drawn = self._scene.add_box(
            f"/map/box_{number}",
            color=BOX_RGB,
            dimensions=(obstacle.size_x_m, obstacle.size_y_m, WALL_HEIGHT_M),
            position=(obstacle.x_m, obstacle.y_m, self._middle_m(obstacle)),
        )
        self._drawn[number] = drawn

        drawn.on_click(self._on_click)
        self._listen(number, drawn)

    def _listen(self, number: int, drawn: viser.BoxHandle) -> None:
        if not self._can_move:
            drawn.remove_drag_callback("all")
            return

        async def dragged(event: viser.SceneNodeDragEvent) -> None:
            if number in self._obstacles:
                self._dragged(number, event)

        drawn.on_drag("left")(dragged)

    def _middle_m(self, obstacle: Obstacle) -> float:
        """Height of the middle of a box that stands on the floor."""
        place = self._grid.grid_to_world((obstacle.x_m, obstacle.y_m))
        return float(self._grid.height_m(place)) + WALL_HEIGHT_M / 2

    def _dragged(self, number: int, event: viser.SceneNodeDragEvent) -> None:
        """Follows the pointer; the box counts at its new place when it is let go."""
        self._on_drag(event.client.client_id)
        drawn, before = self._drawn[number], self._obstacles[number]
        # The grab point is somewhere on the box; the pointer is followed at that height.
        height_m = np.array([0.0, 0.0, event.start_position[2]])
        eye = np.asarray(event.client.camera.position)
        point = on_floor(eye - height_m, np.asarray(event.end_position) - eye)
        if point is None:
            return
        if event.phase == "start":
            self._grab = self._grid.world_to_grid(event.start_position[:2]) - np.array(
                [before.x_m, before.y_m]
            )
        x_m, y_m = (float(value) for value in self._grid.world_to_grid(point) - self._grab)
        moved = snapped(before.moved_to(x_m, y_m), self._grid)
        if event.phase != "end":
            drawn.position = (x_m, y_m, self._middle_m(before))
            return
        # At the map's edge a box keeps its size, so that it is the same when it comes back.
        moved = replace(moved, size_x_m=before.size_x_m, size_y_m=before.size_y_m)
        if why := self._is_refused(moved):
            self._on_refused(why)
            moved = before
        drawn.position = (moved.x_m, moved.y_m, self._middle_m(moved))
        if moved is not before:
            self._obstacles[number] = moved
            self._changed()
