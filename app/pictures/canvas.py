"""Drawing on a map in metres of the world, with OpenCV: soles, paths, poses, whole plans."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from maps.grid import Cell, OccupancyGrid
from planner.plan import FootstepPlan, NarrowPlace, PlanWaypoint, feet_at, pair_pose
from planner.robot_model import FootShape, Side, StepModel

Colour = tuple[int, int, int]  # blue, green, red
Picture = NDArray[np.uint8]
FloatArray = NDArray[np.float64]

# The palette of all pictures. The two feet differ in lightness too, for the colour-blind.
LEFT: Colour = (200, 110, 30)
RIGHT: Colour = (40, 120, 240)
START: Colour = (90, 150, 50)
GOAL: Colour = (60, 40, 200)
WAYPOINT: Colour = (90, 125, 46)
PATH: Colour = (150, 130, 120)
BODY: Colour = (150, 60, 112)
PLANNED: Colour = (50, 50, 50)
NARROW: Colour = (30, 30, 200)
INK: Colour = (54, 48, 45)
PAPER: Colour = (255, 255, 255)
_FLOOR: Colour = (250, 250, 250)
_WALL: Colour = (70, 65, 62)
_UNKNOWN: Colour = (205, 205, 205)
_GRID: Colour = (232, 232, 232)
# The higher the free floor, the darker; a rise of more than _EDGE_M between cells gets a line.
_LOWEST, _HIGHEST, _EDGE = _FLOOR, (172, 204, 222), (140, 166, 182)
_EDGE_M = 0.02
_SUB = 4  # bits of a pixel's fraction in OpenCV's drawing calls
_LONGEST_PX, _MOST_PX_PER_M = 1600, 240
LARGE_MAP_M = 12.0


def hex_of(colour: Colour) -> str:
    """The colour as matplotlib takes it, such as #1e6ec8."""
    return "#{:02x}{:02x}{:02x}".format(*colour[::-1])


def height_range(grid: OccupancyGrid) -> tuple[float, float]:
    """Lowest and highest free floor of a map in metres."""
    if grid.elevation_m is None:
        return 0.0, 0.0
    heights = grid.elevation_m[grid.cells == Cell.FREE]
    return (float(heights.min()), float(heights.max())) if heights.size else (0.0, 0.0)


def height_colour(height_m: float, extremes_m: tuple[float, float]) -> Colour:
    """The colour of floor at a height on a map whose floor is within these extremes."""
    blue, green, red = (int(v) for v in _shades(np.array([height_m]), extremes_m)[0])
    return blue, green, red


def _shades(heights_m: FloatArray, extremes_m: tuple[float, float]) -> Picture:
    """Colours (..., 3) of floor at heights (...)."""
    low_m, high_m = extremes_m
    share = np.clip((heights_m - low_m) / max(high_m - low_m, 1e-9), 0, 1)[..., None]
    return np.rint((1 - share) * _LOWEST + share * np.array(_HIGHEST)).astype(np.uint8)


def shade_floor(
    image: Picture,
    elevation_m: FloatArray,
    free: NDArray[np.bool_],
    extremes_m: tuple[float, float],
) -> None:
    """Colours the free floor of a picture (h, w, 3) by the heights of its cells (H, W).

    Both have their first row at the top.
    """
    size = image.shape[1], image.shape[0]
    shown = cv2.resize(free.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    heights = cv2.resize(elevation_m, size, interpolation=cv2.INTER_NEAREST).astype(np.float64)
    image[shown] = _shades(heights, extremes_m)[shown]
    level_m = np.where(shown, heights, np.nan)
    for axis in (0, 1):
        edge = np.abs(np.diff(level_m, axis=axis, prepend=np.nan)) > _EDGE_M
        if image.shape[0] > 2 * len(free):
            # One pixel is hard to see where a cell has several.
            edge |= np.roll(edge, 1, axis=axis)
        image[edge & shown] = _EDGE


class Canvas:
    """A map drawn to scale, and drawing on it in metres of the world.

    The picture shows the grid with its rows level; if `around_world` points (n, 2) are given, only
    their surroundings of margin_m.
    """

    def __init__(
        self,
        grid: OccupancyGrid,
        *,
        around_world: ArrayLike | None = None,
        margin_m: float = 1.0,
    ) -> None:
        self.grid = grid
        size = np.array(grid.size_m)
        low, high = np.zeros(2), size
        if around_world is not None:
            points = grid.world_to_grid(around_world)
            low = np.clip(points.min(axis=0) - margin_m, 0, size)
            high = np.clip(points.max(axis=0) + margin_m, 0, size)
        # Whole cells, so that the picture's edge is a cell's edge.
        first = np.floor(low / grid.resolution_m).astype(int)
        last = np.maximum(np.ceil(high / grid.resolution_m).astype(int), first + 1)
        last = np.minimum(last, np.array(grid.shape[::-1]))
        self._low_m, extent = first * grid.resolution_m, (last - first) * grid.resolution_m
        self.px_per_m = min(_LONGEST_PX / extent.max(), _MOST_PX_PER_M)
        width, height = (max(1, round(v * self.px_per_m)) for v in extent)
        cells = grid.cells[first[1] : last[1], first[0] : last[0]][::-1]
        colours = np.array([_FLOOR, _WALL, _UNKNOWN], np.uint8)
        shrink = width < cells.shape[1]
        how = cv2.INTER_AREA if shrink else cv2.INTER_NEAREST
        self.image: Picture = np.asarray(
            cv2.resize(colours[cells], (width, height), interpolation=how), np.uint8
        )
        if grid.elevation_m is not None:
            heights = grid.elevation_m[first[1] : last[1], first[0] : last[0]][::-1]
            shade_floor(self.image, heights, cells == Cell.FREE, height_range(grid))
        self.grid_m = 1.0 if extent.max() <= 25 else 5.0
        self._lines_every_metre(cells, extent)
        self._bare = self.image.copy()

    def _lines_every_metre(self, cells: NDArray[np.uint8], extent: FloatArray) -> None:
        height, width = self.image.shape[:2]
        floor = (
            cv2.resize((cells == Cell.FREE).astype(np.uint8), (width, height), None, 0, 0, 0) > 0
        )
        every_m = self.grid_m
        lines = np.zeros((height, width), bool)
        for axis, length in enumerate((width, height)):
            first = math.ceil(self._low_m[axis] / every_m) * every_m
            at = np.arange(first, self._low_m[axis] + extent[axis], every_m) - self._low_m[axis]
            px = np.minimum(np.round(at * self.px_per_m).astype(int), length - 1)
            if axis == 0:
                lines[:, px] = True
            else:
                lines[height - 1 - px, :] = True
        self.image[lines & floor] = _GRID

    def pixels(self, xy_world: ArrayLike) -> NDArray[np.int32]:
        """Pixels (..., 2) of points (..., 2), with _SUB bits of fraction."""
        away = (self.grid.world_to_grid(xy_world) - self._low_m) * self.px_per_m
        away[..., 1] = self.image.shape[0] - away[..., 1]
        result: NDArray[np.int32] = np.round((away - 0.5) * (1 << _SUB)).astype(np.int32)
        return result

    def line(self, xy_world: ArrayLike, colour: Colour, width_m: float) -> None:
        """An open line through points (n, 2)."""
        thickness = max(1, round(width_m * self.px_per_m))
        points = [self.pixels(xy_world)]
        cv2.polylines(self.image, points, False, colour, thickness, cv2.LINE_AA, _SUB)

    def polygon(
        self, xy_world: ArrayLike, colour: Colour, *, opacity: float = 0.0, width_m: float = 0.012
    ) -> None:
        """A closed outline through corners (n, 2), filled if opacity is above 0."""
        points = [self.pixels(xy_world)]
        if opacity > 0:
            filled = self.image.copy()
            cv2.fillPoly(filled, points, colour, cv2.LINE_AA, _SUB)
            cv2.addWeighted(filled, opacity, self.image, 1 - opacity, 0, self.image)
        thickness = max(1, round(width_m * self.px_per_m))
        cv2.polylines(self.image, points, True, colour, thickness, cv2.LINE_AA, _SUB)

    def _fill(self, xy_world: ArrayLike, colour: Colour) -> None:
        cv2.fillPoly(self.image, [self.pixels(xy_world)], colour, cv2.LINE_AA, _SUB)

    def foot(self, pose_world: ArrayLike, side: Side, model: StepModel, opacity: float) -> None:
        """A sole with a mark at its toe. pose_world: x_m, y_m, z_m, yaw_rad."""
        colour = LEFT if side == Side.LEFT else RIGHT
        self.polygon(sole_corners(pose_world, model.foot), colour, opacity=opacity)
        half_m = model.foot.length_m / 2, model.foot.width_m / 2
        toe = np.array([[0.85, 0.0], [0.3, 0.6], [0.3, -0.6]]) * half_m
        x_m, y_m, _, yaw_rad = np.asarray(pose_world, dtype=float)
        self._fill(_placed(toe, x_m, y_m, yaw_rad), colour)

    def feet(self, plan: FootstepPlan, model: StepModel, opacity: float) -> None:
        """The soles of a plan, those at its start pale."""
        for side in Side:
            self.foot(plan.start_feet_world[side], side, model, 0.12)
        for number, pose in zip(plan.side, plan.pose_world, strict=True):
            self.foot(pose, Side(int(number)), model, opacity)

    def ends(
        self, start: ArrayLike, goal: ArrayLike, waypoints: Sequence[PlanWaypoint] = ()
    ) -> None:
        """Start, goal (x_m, y_m, yaw_rad) and waypoints as arrows, named where nothing else is.

        To be called when all else is drawn.
        """
        poses: list[tuple[ArrayLike, Colour, str]] = [(start, START, "start"), (goal, GOAL, "goal")]
        for number, point in enumerate(waypoints, start=1):
            if not point.stands:
                poses.append((point.pose, WAYPOINT, str(number)))
        for pose, colour, _ in poses:
            self.arrow(pose, colour)
        for pose, colour, name in poses:
            self._label_clear(name, np.asarray(pose, dtype=float)[:2], colour)

    def arrow(self, pose_world: ArrayLike, colour: Colour) -> None:
        """A pose x_m, y_m, yaw_rad as an arrow from its point along its heading."""
        x_m, y_m, yaw_rad = (float(v) for v in np.asarray(pose_world, dtype=float))
        # Never smaller than can be seen, whatever the scale.
        unit = max(1.0, 60.0 / self.px_per_m)
        shaft = np.array([[0.0, 0.0], [0.34, 0.0]]) * unit
        tip = np.array([[0.5, 0.0], [0.3, 0.1], [0.3, -0.1]]) * unit
        for colour_now, width_m in (((255, 255, 255), 0.075), (colour, 0.045)):
            self.line(_placed(shaft, x_m, y_m, yaw_rad), colour_now, width_m * unit)
        self._fill(_placed(tip, x_m, y_m, yaw_rad), colour)
        centre = self.pixels((x_m, y_m))
        radius = round(0.07 * unit * self.px_per_m * (1 << _SUB))
        cv2.circle(self.image, tuple(centre), radius, colour, -1, cv2.LINE_AA, _SUB)

    def narrow_place(self, place: NarrowPlace) -> None:
        """A ring around a narrow place, never smaller than can be seen, and its width."""
        radius_px = max(0.5 * place.width_m * self.px_per_m, 12.0)
        centre = self.pixels((place.x, place.y))
        radius = round(radius_px * (1 << _SUB))
        cv2.circle(self.image, tuple(centre), radius, NARROW, 2, cv2.LINE_AA, _SUB)
        below = (centre >> _SUB) + (0, round(radius_px) + 12)
        self._label(f"{place.width_m:.2f} m wide", below, NARROW)

    @property
    def _text_size(self) -> float:
        """So that it can be read when the whole picture is shown 800 pixels wide."""
        return 0.55 * max(1.0, self.image.shape[1] / 1000)

    def _extent_of(self, text: str) -> tuple[int, int]:
        (text_w, text_h), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, self._text_size, 1)
        return int(text_w), int(text_h)

    def _label(self, text: str, at_px: NDArray[np.int32], colour: Colour) -> None:
        """Text with its middle at a pixel, or as near as it fits."""
        height, width = self.image.shape[:2]
        text_w, text_h = self._extent_of(text)
        x = int(np.clip(at_px[0] - text_w // 2, 2, max(2, width - text_w - 2)))
        y = int(np.clip(at_px[1] + text_h // 2, text_h + 2, height - 4))
        self._text(text, (x, y), self._text_size, colour)

    def _label_clear(self, text: str, xy_world: ArrayLike, colour: Colour) -> None:
        """Text near a point: the nearest place at which it covers least of what is drawn."""
        height, width = self.image.shape[:2]
        text_w, text_h = self._extent_of(text)
        half = np.array([text_w // 2 + 6, text_h // 2 + 6])
        drawn = (self.image != self._bare).any(axis=2)
        # A wall is no good ground either, but better than what is drawn on the floor.
        cost = drawn + 0.25 * (self._bare.min(axis=2) < 150)
        total = np.pad(cost.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
        angles = np.arange(16) * (math.pi / 8)
        away = np.column_stack([np.cos(angles), np.sin(angles)])
        centre = self.pixels(xy_world) >> _SUB
        best, least = centre, math.inf
        for distance in np.arange(1, 12) * (text_h + 4):
            for direction in away:
                at = np.rint(centre + direction * (distance + half)).astype(np.int32)
                (left, top), (right, bottom) = at - half, at + half
                if left < 0 or top < 0 or right > width or bottom > height:
                    continue
                covered = total[bottom, right] - total[top, right]
                covered += total[top, left] - total[bottom, left]
                if covered < least:
                    best, least = at, covered
            if least == 0:
                break
        self._label(text, best, colour)

    def _text(self, text: str, at_px: tuple[int, int], size: float, colour: Colour) -> None:
        """Text with a white edge, so that it can be read on walls as well."""
        font = cv2.FONT_HERSHEY_SIMPLEX
        for colour_now, thickness in (((255, 255, 255), 4), (colour, 1)):
            cv2.putText(self.image, text, at_px, font, size, colour_now, thickness, cv2.LINE_AA)


def _placed(points: FloatArray, x_m: float, y_m: float, yaw_rad: float) -> FloatArray:
    """Points (n, 2) of a body frame in the world."""
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    return points @ np.array([[cos, sin], [-sin, cos]]) + (x_m, y_m)


def sole_corners(pose_world: ArrayLike, foot: FootShape) -> FloatArray:
    """Corners (4, 2) of a sole at a pose x_m, y_m, z_m, yaw_rad."""
    x_m, y_m, _, yaw_rad = np.asarray(pose_world, dtype=float)
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) / 2
    return _placed(corners * (foot.length_m, foot.width_m), x_m, y_m, yaw_rad)


def put_text(picture: Picture, text: str, left_px: int, base_px: int, *, size: float = 0.5) -> None:
    """Writes dark text on light ground."""
    place = (left_px, base_px)
    cv2.putText(picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, INK, 1, cv2.LINE_AA)


def body_path(plan: FootstepPlan) -> FloatArray:
    """Pair poses (N + 1, 3) from the start to the end of a plan."""
    feet = np.array(plan.start_feet_world)
    poses = [pair_pose(feet)]
    for side, pose in zip(plan.side, plan.pose_world, strict=True):
        feet[side] = pose
        poses.append(pair_pose(feet))
    return np.array(poses)


def surroundings(
    grid: OccupancyGrid, points_world: ArrayLike, *, is_large: bool = False
) -> FloatArray | None:
    """Those of points (n, 2) on a large map, which its picture is cut to; None shows it whole."""
    points = np.asarray(points_world, dtype=float)
    points = points[grid.contains(points)]
    return points if len(points) and (is_large or max(grid.size_m) > LARGE_MAP_M) else None


def draw_plan(
    plan: FootstepPlan,
    grid: OccupancyGrid,
    model: StepModel,
    *,
    shown_world: ArrayLike | None = None,
) -> Picture:
    """Picture (H, W, 3), BGR: the map with feet, body path, start and goal; see `plan_canvas`."""
    return plan_canvas(plan, grid, model, shown_world=shown_world).image


def plan_canvas(
    plan: FootstepPlan,
    grid: OccupancyGrid,
    model: StepModel,
    *,
    shown_world: ArrayLike | None = None,
) -> Canvas:
    """The map with feet, body path, start and goal.

    Large maps are cropped to the surroundings of the plan, and any map to those of points
    shown_world (n, 2) where they are given. A plan that was not found shows start, goal, its first
    part if there is one, and the passage that is too narrow, if any is.
    """
    if shown_world is None:
        points = np.vstack([plan.pose_world[:, :2], plan.start_feet_world[:, :2], [plan.goal[:2]]])
        if plan.narrow_place is not None:
            points = np.vstack([points, [plan.narrow_place.x, plan.narrow_place.y]])
        canvas = Canvas(grid, around_world=surroundings(grid, points), margin_m=1.5)
    else:
        around = surroundings(grid, shown_world, is_large=True)
        canvas = Canvas(grid, around_world=around, margin_m=0.8)
    if plan.found or len(plan):
        canvas.line(body_path(plan)[:, :2], PATH, 0.02)
    canvas.feet(plan, model, 0.35)
    if not plan.found:
        for side, pose in zip(Side, feet_at(plan.goal, model.stance_width_m), strict=True):
            canvas.foot(pose, side, model, 0.12)
    if plan.narrow_place is not None:
        canvas.narrow_place(plan.narrow_place)
    canvas.ends(plan.start, plan.goal, plan.waypoints)
    return canvas
