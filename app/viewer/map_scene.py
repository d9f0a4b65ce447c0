"""The map in a viser scene: floor, walls, ground that nobody has seen, and boxes set down."""

from __future__ import annotations

import math

import numpy as np
import viser

from app.viewer.blocks import solid
from maps.grid import Cell, OccupancyGrid
from maps.terraces import plates_of, terraces_of
from sim.scene import WALL_HEIGHT_M

FLOOR_RGB = (205, 208, 212)
LINE_RGB = (178, 182, 188)
WALL_RGB = (150, 134, 114)
UNKNOWN_RGB = (150, 153, 158)
HIGHEST_RGB = (214, 190, 152)
_FLOOR_THICKNESS_M = 0.02
# So deep that the colour does not shine through the floor far from the camera.
_SLAB_DEPTH_M = 0.3
_UNKNOWN_HEIGHT_M = 0.02
_LINES_HEIGHT_M = 0.001
_SHADES = 24


def add_floor(scene: viser.SceneApi, grid: OccupancyGrid) -> viser.BoxHandle:
    """Draws the map; returns a slab of the size of the floor, to be clicked on.

    The slab lies out of sight below the floor, because browsers colour what the pointer is on.

    Everything hangs below the node `/map`, which is the grid frame: metres from the lower-left
    corner of the map.
    """
    x_m, y_m, yaw_rad = grid.origin
    width_m, height_m = grid.size_m
    scene.add_frame("/map", show_axes=False, position=(x_m, y_m, 0.0), wxyz=turned(yaw_rad))
    centre = (width_m / 2, height_m / 2)
    terraces = terraces_of(grid, grid.cells == Cell.OCCUPIED)
    lowest_m = terraces.lowest_m
    for name, depth_m in (("floor", _FLOOR_THICKNESS_M / 2), ("slab", _SLAB_DEPTH_M)):
        # Nobody sees the slab past the floor's edge from where nothing but the floor hides it.
        inset_m = 0.0 if name == "floor" else min(_SLAB_DEPTH_M, width_m / 4, height_m / 4)
        slab = scene.add_box(
            f"/map/{name}",
            color=FLOOR_RGB,
            dimensions=(width_m - 2 * inset_m, height_m - 2 * inset_m, _FLOOR_THICKNESS_M),
            position=(*centre, lowest_m - depth_m),
            cast_shadow=False,
        )
    scene.add_grid(
        "/map/lines",
        width=width_m,
        height=height_m,
        cell_size=0.5,
        section_size=1.0,
        cell_color=LINE_RGB,
        section_color=LINE_RGB,
        cell_thickness=0.6,
        section_thickness=1.0,
        position=(*centre, lowest_m + _LINES_HEIGHT_M),
        shadow_opacity=0.0,
    )
    unknown = plates_of(grid, grid.cells == Cell.UNKNOWN)
    _add_boxes(scene, grid, "/map/walls", terraces.walls, lowest_m, WALL_HEIGHT_M, WALL_RGB)
    _add_boxes(scene, grid, "/map/unknown", unknown, lowest_m, _UNKNOWN_HEIGHT_M, UNKNOWN_RGB)
    _add_ground(scene, grid, terraces.ground, lowest_m)
    return slab


def _add_ground(
    scene: viser.SceneApi, grid: OccupancyGrid, boxes: np.ndarray, lowest_m: float
) -> None:
    """The floor that is higher than the lowest, the higher the browner."""
    rise_m = boxes[:, 4] - lowest_m
    shades = np.ceil(_SHADES * rise_m / max(rise_m, default=1.0)).astype(int)
    for shade in range(1, _SHADES + 1):
        red, green, blue = (
            round(low + (high - low) * shade / _SHADES)
            for low, high in zip(FLOOR_RGB, HIGHEST_RGB, strict=True)
        )
        name = f"/map/ground/{shade}"
        _add_boxes(scene, grid, name, boxes[shades == shade], lowest_m, 0.0, (red, green, blue))


def _add_boxes(
    scene: viser.SceneApi,
    grid: OccupancyGrid,
    name: str,
    boxes: np.ndarray,
    lowest_m: float,
    height_m: float,
    rgb: tuple[int, int, int],
) -> None:
    """Boxes (n, 5) of `maps.terraces` that rise so much above their height, as one mesh.

    The node stays away where there are none.
    """
    if len(boxes) == 0:
        scene.remove_by_name(name)
        return
    vertices, faces = solid(boxes, base_m=lowest_m, rise_m=height_m, cell_m=grid.resolution_m)
    scene.add_mesh_simple(
        name, vertices.astype(np.float32), faces.astype(np.uint32), color=rgb, flat_shading=True
    )


def turned(yaw_rad: float) -> tuple[float, float, float, float]:
    """The quaternion w, x, y, z of a turn about the vertical."""
    return math.cos(yaw_rad / 2), 0.0, 0.0, math.sin(yaw_rad / 2)
