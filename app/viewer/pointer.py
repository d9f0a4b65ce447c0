"""What a click or a drag on the map means: goal, place of the robot, or a box."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np
import viser
from numpy.typing import ArrayLike, NDArray

from app.viewer.obstacles import Obstacle, cells_below
from app.viewer.scene import on_floor
from maps.boxes import terraces_of
from maps.grid import Cell, OccupancyGrid
from planner.plan import Pose
from sim.scene import WALL_HEIGHT_M

# A drag shorter than this does not say where to look.
_SHORTEST_DRAG_M = 0.12
# What a ray may meet; a box is told by its number.
ROBOT, FLOOR, WALL = -3, -2, -1
FloatArray = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class SurfaceHit:
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

    def met(self, origin: ArrayLike, direction: ArrayLike) -> SurfaceHit | None:
        """What a ray from a point (3,) of the world meets first; None if it never does.

        Beyond the map's edge there is floor as low as the lowest. What the ray begins in is glass.
        """
        begin, end = np.array(origin, float), np.add(origin, direction)
        for point in (begin, end):
            point[:2] = self.grid.world_to_grid(point[:2])
        along = end - begin
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

    def _at(self, point: FloatArray, on: int) -> SurfaceHit:
        x_m, y_m = (float(value) for value in self.grid.grid_to_world(point[:2]))
        return SurfaceHit(x_m=x_m, y_m=y_m, z_m=float(point[2]), on=on)


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


class Tool(StrEnum):
    """What the pointer does on the floor."""

    GOAL = "Goal"
    BOX = "Box"
    ROBOT = "Robot"
    LOOK = "Look"


class Pointed(NamedTuple):
    """A place on the floor, and which way to look there unless that was left open."""

    x_m: float
    y_m: float
    yaw_rad: float | None = None


class FloorPointer:
    """Turns clicks and drags on the map into poses; with the tool LOOK a drag turns the camera.

    `on_pose(pointed, on, is_final)` is called also while a drag goes on; a click leaves the heading
    open. `on` says what was hit, see `SurfaceHit`. `on_drag(client_id)` is called for each piece of
    a drag, `on_waypoint(pointed, on)` for a click with Shift held. `meets_robot(origin, direction)`
    says how far along a ray the robot is met, and where it stands; `surface` is what else it may
    meet.
    """

    def __init__(
        self,
        floor: viser.BoxHandle,
        surface: Surface,
        *,
        on_pose: Callable[[Pointed, int, bool], None],
        meets_robot: Callable[[ArrayLike, ArrayLike], tuple[float, SurfaceHit]],
        on_drag: Callable[[int], None] = lambda _client_id: None,
        on_waypoint: Callable[[Pointed, int], None] = lambda _pointed, _on: None,
    ) -> None:
        self._on_pose, self._on_drag, self._meets_robot = on_pose, on_drag, meets_robot
        self._on_waypoint = on_waypoint
        # What the drag of each page began on.
        self._begun: dict[int, SurfaceHit | None] = {}
        self.surface = surface
        self._floor, self._drags = floor, False
        floor.on_click(self.clicked)
        floor.on_click(modifier="shift")(self._shift_clicked)
        self.use(Tool.GOAL)

    def use(self, tool: Tool) -> None:
        """Chooses what a drag is for."""
        self._tool = tool
        wanted = tool in (Tool.GOAL, Tool.ROBOT)
        if wanted == self._drags:
            return
        self._drags = wanted
        if wanted:
            self._floor.on_drag("left")(self._dragged)
        else:
            self._floor.remove_drag_callback("all")

    # Coroutines are awaited one after the other; functions could overtake one another.
    async def clicked(self, event: viser.SceneNodePointerEvent) -> None:
        """Takes a click on anything; what it meets first counts, whoever tells of it."""
        met = self._met(event.ray_origin, event.ray_direction)
        if met is not None and self._tool is not Tool.LOOK:
            self._on_pose(Pointed(met.x_m, met.y_m), met.on, True)

    async def _shift_clicked(self, event: viser.SceneNodePointerEvent) -> None:
        met = self._met(event.ray_origin, event.ray_direction)
        if met is not None and self._tool is Tool.GOAL:
            self._on_waypoint(Pointed(met.x_m, met.y_m), met.on)

    async def _dragged(self, event: viser.SceneNodeDragEvent) -> None:
        page = event.client.client_id
        self._on_drag(page)
        eye = np.asarray(event.client.camera.position)
        if event.phase == "start" or page not in self._begun:
            # The robot may walk into the way, or out of it, while somebody drags.
            self._begun[page] = self._met(eye, np.asarray(event.start_position) - eye)
        met = self._begun[page]
        if event.phase == "end":
            del self._begun[page]
        if met is None or event.phase == "start":
            return
        # The end only says where to look: what stands there hides nothing of that.
        point = on_floor(eye, np.asarray(event.end_position) - eye, met.z_m)
        if point is not None:
            self._on_pose(toward((met.x_m, met.y_m), point), met.on, event.phase == "end")

    def _met(self, origin: ArrayLike, direction: ArrayLike) -> SurfaceHit | None:
        met = self.surface.met(origin, direction)
        away_m, robot = self._meets_robot(origin, direction)
        if met is None:
            return robot if math.isfinite(away_m) else None
        return robot if away_m < math.dist(np.ravel(origin), (met.x_m, met.y_m, met.z_m)) else met


def toward(place: tuple[float, float], point: tuple[float, float]) -> Pointed:
    """A place and the way to a point from there; no heading if the two are too near to tell."""
    away_x, away_y = point[0] - place[0], point[1] - place[1]
    if math.hypot(away_x, away_y) < _SHORTEST_DRAG_M:
        return Pointed(*place)
    return Pointed(*place, math.atan2(away_y, away_x))


def facing(pointed: Pointed, robot_xy: Sequence[float], robot_yaw_rad: float) -> Pose:
    """The pose, looking the way the robot comes if that was left open, or as it does if it is near.

    `robot_xy` and `robot_yaw_rad` say where the robot is now.
    """
    x_m, y_m, yaw_rad = pointed
    if yaw_rad is None:
        away_x, away_y = x_m - robot_xy[0], y_m - robot_xy[1]
        far = math.hypot(away_x, away_y) > 0.5
        yaw_rad = math.atan2(away_y, away_x) if far else robot_yaw_rad
    return round(x_m, 3), round(y_m, 3), round(yaw_rad, 3)
