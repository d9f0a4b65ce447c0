"""What the planner did, drawn where it did it: margins that shut out, narrow places, cells."""

from __future__ import annotations

import math

import cv2
import numpy as np
import viser
from numpy.typing import NDArray

from app.navigation.live_navigator import Notice
from app.navigation.planner_process import Answer, World
from app.viewer.scene import Rgb
from app.viewer.sheet import Sheet
from maps.boxes import plates_of
from maps.grid import Cell, OccupancyGrid
from planner.robot_model import BodyShape, FootShape, Side, StepModel, rounded_box
from planner.search.search_record import SearchRecord
from sim.scene import WALL_HEIGHT_M

MARGIN_RGB: Rgb = (214, 69, 65)
NARROW_RGB: Rgb = (253, 126, 20)
# From the cells in which one state was expanded to those with the most.
EXPANDED_RGB: tuple[Rgb, ...] = ((199, 233, 180), (127, 205, 187), (65, 182, 196), (34, 94, 168))
# Below the footprints.
_MARGIN_Z_M, _EXPANDED_Z_M = 0.003, 0.002
_EXPANDED_OPACITY = 0.8
_MARGIN_OPACITY, _NARROW_OPACITY = 0.35, 0.45
# Above the walls beside it, which it runs into.
_NARROW_HEIGHT_M = WALL_HEIGHT_M + 0.1


def shut_out(
    grid: OccupancyGrid, model: StepModel, yaw_rad: float, *, unknown_is_free: bool
) -> NDArray[np.bool_]:
    """The free cells (H, W) on which no pair pose of this heading can be, up to half a cell.

    There a foot or the body, each with its margin, would touch an obstacle or the map's edge.
    """
    blocked = grid.cells == Cell.OCCUPIED
    if not unknown_is_free:
        blocked |= grid.cells == Cell.UNKNOWN
    footprint = _footprint(model, yaw_rad - grid.origin[2], grid.resolution_m)
    reach = len(footprint) // 2
    padded = np.pad(blocked.astype(np.uint8), reach, constant_values=1)
    touched = cv2.dilate(padded, footprint)[reach:-reach, reach:-reach]
    return (touched > 0) & ~blocked


def _footprint(model: StepModel, yaw_rad: float, cell_m: float) -> NDArray[np.uint8]:
    """The cells (n, n) round a pair pose in the middle one that feet and body need, as 1."""
    half_width_m = model.stance_width_m / 2
    shapes: list[tuple[FootShape | BodyShape, float, float]] = [
        (model.body, model.body_margin_m, 0.0),
        *((model.foot, model.foot_margin_m, side.outward * half_width_m) for side in Side),
    ]
    reach_m = max(
        math.hypot(shape.length_m / 2, abs(aside_m) + shape.width_m / 2) + margin_m
        for shape, margin_m, aside_m in shapes
    )
    reach = math.ceil(reach_m / cell_m) + 1
    y_m, x_m = np.mgrid[-reach : reach + 1, -reach : reach + 1] * cell_m
    ahead_m = math.cos(yaw_rad) * x_m + math.sin(yaw_rad) * y_m
    left_m = math.cos(yaw_rad) * y_m - math.sin(yaw_rad) * x_m
    needed = np.zeros(x_m.shape, bool)
    for shape, margin_m, aside_m in shapes:
        half_length, half_width, radius_m = rounded_box(shape, margin_m)
        away_x = np.maximum(np.abs(ahead_m) - half_length, 0)
        away_y = np.maximum(np.abs(left_m - aside_m) - half_width, 0)
        needed |= np.hypot(away_x, away_y) <= radius_m + cell_m / 2
    return needed.astype(np.uint8)


class PlannerMarks:
    """Drawn while a refusal stands: the margins for its heading, and what is too narrow."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._margins = Sheet(scene, "/margins", _MARGIN_Z_M, MARGIN_RGB, opacity=_MARGIN_OPACITY)
        self._narrow = scene.add_cylinder(
            "/narrow",
            height=_NARROW_HEIGHT_M,
            color=NARROW_RGB,
            opacity=_NARROW_OPACITY,
            cast_shadow=False,
            visible=False,
        )
        self._word = scene.add_label(
            "/narrow/word", "", position=(0.0, 0.0, _NARROW_HEIGHT_M / 2), anchor="bottom-center"
        )
        self._shown: Notice | None = None

    def show(self, notice: Notice | None, world: World) -> None:
        """Shows what there is to a notice in this world; that of the last time stays."""
        if notice == self._shown:
            return
        self._shown = notice
        self._show_margins(notice, world)
        place = None if notice is None else notice.narrow_place
        self._narrow.visible = place is not None
        if place is not None:
            ground_m = float(world.grid.height_m((place.x, place.y)))
            self._narrow.radius = place.needed_m / 2
            self._narrow.position = (place.x, place.y, ground_m + _NARROW_HEIGHT_M / 2)
            self._word.text = f"{place.width_m:.2f} m wide, {place.needed_m:.2f} m needed"

    def _show_margins(self, notice: Notice | None, world: World) -> None:
        refused = None if notice is None or notice.narrow_place else notice.refused
        plates = np.zeros((0, 5))
        if refused is not None:
            grid, options = world.grid, world.options
            cells = shut_out(grid, world.model, refused[2], unknown_is_free=options.unknown_is_free)
            plates = plates_of(grid, cells)
        to_corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        corners = plates[:, None, :2] + to_corners * plates[:, None, 2:4]
        self._margins.show(world.grid.grid_to_world(corners), plates[:, 4])


class SearchMarks:
    """The cells of the lattice in which the search expanded states, darker where it were more."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._sheets = [
            Sheet(scene, f"/expanded/{shade}", _EXPANDED_Z_M, rgb, opacity=_EXPANDED_OPACITY)
            for shade, rgb in enumerate(EXPANDED_RGB)
        ]
        self._shown: SearchRecord | None = None

    def show(self, answer: Answer | None, world: World) -> None:
        """Shows what is recorded of an answer in this world; that of the last time stays."""
        record = None if answer is None else answer.record
        if answer is None or record is self._shown:
            return
        self._shown = record
        expanded = np.zeros((0, 3)) if record is None else record.expanded
        shade = shades_of(expanded[:, 2])
        half_m = world.model.cell_m / 2
        corners = half_m * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        # The lattice lies along the goal.
        cos, sin = math.cos(answer.plan.goal[2]), math.sin(answer.plan.goal[2])
        corners = corners @ np.array([[cos, sin], [-sin, cos]])
        for number, sheet in enumerate(self._sheets):
            places = expanded[shade == number, :2]
            heights_m = np.array([float(world.grid.height_m(place)) for place in places])
            sheet.show(places[:, None] + corners, heights_m)


def shades_of(counts: np.ndarray) -> NDArray[np.int64]:
    """Which of EXPANDED_RGB each cell has, (n,), evenly over the logarithms of its counts (n,)."""
    shades = len(EXPANDED_RGB)
    share = np.log(np.maximum(counts, 1)) / math.log(max(2.0, counts.max(initial=1)) + 1)
    return np.minimum((shades * share).astype(np.int64), shades - 1)
