"""The map in a viser scene: floor, walls, ground that nobody has seen, and boxes set down."""

from __future__ import annotations

import math

import numpy as np
import trimesh
import viser

from maps.grid import Cell, OccupancyGrid
from maps.obstacles import obstacle_boxes
from sim.scene import WALL_HEIGHT_M

FLOOR_RGB = (205, 208, 212)
LINE_RGB = (178, 182, 188)
WALL_RGB = (150, 134, 114)
UNKNOWN_RGB = (150, 153, 158)
_FLOOR_THICKNESS_M = 0.02
# So deep that the colour does not shine through the floor far from the camera.
_SLAB_DEPTH_M = 0.3
_UNKNOWN_HEIGHT_M = 0.02
_LINES_HEIGHT_M = 0.001
_FIELD_OF_VIEW_RAD = math.radians(50)


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
    for name, depth_m in (("floor", _FLOOR_THICKNESS_M / 2), ("slab", _SLAB_DEPTH_M)):
        # Nobody sees the slab past the floor's edge from where nothing but the floor hides it.
        inset_m = 0.0 if name == "floor" else min(_SLAB_DEPTH_M, width_m / 4, height_m / 4)
        slab = scene.add_box(
            f"/map/{name}",
            color=FLOOR_RGB,
            dimensions=(width_m - 2 * inset_m, height_m - 2 * inset_m, _FLOOR_THICKNESS_M),
            position=(*centre, -depth_m),
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
        position=(*centre, _LINES_HEIGHT_M),
        shadow_opacity=0.0,
    )
    _add_boxes(scene, "/map/walls", grid, Cell.OCCUPIED, WALL_HEIGHT_M, WALL_RGB)
    _add_boxes(scene, "/map/unknown", grid, Cell.UNKNOWN, _UNKNOWN_HEIGHT_M, UNKNOWN_RGB)
    return slab


def _add_boxes(
    scene: viser.SceneApi,
    name: str,
    grid: OccupancyGrid,
    kind: Cell,
    height_m: float,
    rgb: tuple[int, int, int],
) -> None:
    """All cells of one kind as one mesh; the node stays away where there are none."""
    boxes = obstacle_boxes(grid.cells == kind, grid.resolution_m)
    if len(boxes) == 0:
        scene.remove_by_name(name)
        return
    box = trimesh.creation.box(extents=(1, 1, 1))
    sizes = np.column_stack([2 * boxes[:, 2:], np.full(len(boxes), height_m)])
    centres = np.column_stack([boxes[:, :2], np.full(len(boxes), height_m / 2)])
    vertices = (box.vertices * sizes[:, None] + centres[:, None]).reshape(-1, 3)
    faces = (box.faces + len(box.vertices) * np.arange(len(boxes))[:, None, None]).reshape(-1, 3)
    scene.add_mesh_simple(
        name, vertices.astype(np.float32), faces.astype(np.uint32), color=rgb, flat_shading=True
    )


def aim_camera(
    camera: viser.InitialCameraConfig, grid: OccupancyGrid, *, beside_panel: bool = False
) -> None:
    """Lets pages that open see the whole map from the south, above; the panel is on the right."""
    x0, y0, x1, y1 = grid.bounds_world()
    centre_x, centre_y = (x0 + x1) / 2, (y0 + y1) / 2
    far_m = max(x1 - x0, 1.4 * (y1 - y0), 3.0)
    if beside_panel:
        centre_x += 0.14 * far_m
    camera.position = (centre_x, centre_y - 0.65 * far_m, 0.75 * far_m)
    camera.look_at = (centre_x, centre_y, 0.0)
    camera.fov = _FIELD_OF_VIEW_RAD


def turned(yaw_rad: float) -> tuple[float, float, float, float]:
    """The quaternion w, x, y, z of a turn about the vertical."""
    return math.cos(yaw_rad / 2), 0.0, 0.0, math.sin(yaw_rad / 2)
