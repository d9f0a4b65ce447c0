"""The room that a box has among the cells around it, as eight distances that may not shrink.

Each cell that a box must keep off is separated from it along one of four axes, those of the map and
those of the box (two rectangles overlap unless one of the four does); it counts toward the axis on
which it lies farthest off. The least distance on either side of each axis bounds where the box may
move, and turning changes it smoothly.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.collision import NO_GROUND_UM, Terrain, point_clearance
from planner.jit import lean

FloatArray = NDArray[np.float64]
WAYS = 8  # ahead, back, left, right of the box, then +x, -x, +y, -y of the map
SPARE_M = 1e-5  # kept from all limits, so that what is left of an iteration's error breaks none


class _Box(NamedTuple):
    """A box as the compiled checks see it; reach_x, reach_y: how far it goes along the map's axes.

    cell_reach: how far a cell goes from its centre along the box's axes. by_yaw_*: how the three
    change with the yaw.
    """

    x: float
    y: float
    cos: float
    sin: float
    half_l: float
    half_w: float
    reach_x: float
    reach_y: float
    cell_reach: float
    by_yaw_x: float
    by_yaw_y: float
    by_yaw_cell: float


@lean
def _box(x: float, y: float, yaw: float, half_l: float, half_w: float, size: float) -> _Box:
    cos, sin = math.cos(yaw), math.sin(yaw)
    cos_sign, sin_sign = (1.0 if cos >= 0 else -1.0), (1.0 if sin >= 0 else -1.0)
    return _Box(
        x,
        y,
        cos,
        sin,
        half_l,
        half_w,
        abs(cos) * half_l + abs(sin) * half_w + SPARE_M,
        abs(sin) * half_l + abs(cos) * half_w + SPARE_M,
        0.5 * size * (abs(cos) + abs(sin)) + SPARE_M,
        half_w * cos * sin_sign - half_l * sin * cos_sign,
        half_l * cos * sin_sign - half_w * sin * cos_sign,
        0.5 * size * (cos * sin_sign - sin * cos_sign),
    )


@lean
def room_off_blocked(
    terrain: Terrain,
    x: float,
    y: float,
    yaw: float,
    half_l: float,
    half_w: float,
    reach_m: float,
    room: FloatArray,
) -> bool:
    """Fills room (WAYS, 4): distance in metres, and its derivatives by x, y and yaw of the box.

    The distance is reach_m where nothing is nearer, and negative where box and cells overlap.
    Returns False, with nothing filled, if nothing at all is near.
    """
    radius = math.sqrt(half_l * half_l + half_w * half_w) + reach_m
    if point_clearance(terrain, x, y) > radius:
        return False
    size = terrain.resolution_m
    box = _box(x, y, yaw, half_l, half_w, size)
    room[:, 0] = reach_m
    _note_edges(terrain, box, room)
    row0, row1, col0, col1 = _window(terrain, box, reach_m)
    for row in range(row0, row1 + 1):
        dy = (row + 0.5) * size - box.y
        col = col0
        while col <= col1:
            if terrain.blocked[row, col]:
                _note_cell(box, (col + 0.5) * size - box.x, dy, 0.5 * size, room)
                col += 1
            else:
                # No blocked ground within this distance, so the next cells are free as well.
                col += max(1, int(terrain.clearance_m[row, col] / size + 0.499))
    return True


@lean
def room_on_level(
    terrain: Terrain,
    x: float,
    y: float,
    yaw: float,
    half_l: float,
    half_w: float,
    level_um: int,
    reach_m: float,
    room: FloatArray,
) -> bool:
    """As `room_off_blocked`, from floor at another height than that below the box's centre.

    Floor that is at most level_um higher or lower counts as the same. Returns False where the
    centre is on no floor at all.
    """
    size = terrain.resolution_m
    rows, cols = terrain.blocked.shape
    row, col = math.floor(y / size), math.floor(x / size)
    if row < 0 or col < 0 or row >= rows or col >= cols:
        return False
    own_um = terrain.height_um[row, col]
    if own_um == NO_GROUND_UM:
        return False
    box = _box(x, y, yaw, half_l, half_w, size)
    room[:, 0] = reach_m
    row0, row1, col0, col1 = _window(terrain, box, reach_m)
    for row in range(row0, row1 + 1):
        dy = (row + 0.5) * size - box.y
        for col in range(col0, col1 + 1):
            height_um = terrain.height_um[row, col]
            if height_um != NO_GROUND_UM and abs(height_um - own_um) > level_um:
                _note_cell(box, (col + 0.5) * size - box.x, dy, 0.5 * size, room)
    return True


@lean
def _window(terrain: Terrain, box: _Box, reach_m: float) -> tuple[int, int, int, int]:
    """First and last row and column of the cells that may lie within reach of a box."""
    rows, cols = terrain.blocked.shape
    size = terrain.resolution_m
    return (
        max(0, math.floor((box.y - box.reach_y - reach_m) / size)),
        min(rows - 1, math.floor((box.y + box.reach_y + reach_m) / size)),
        max(0, math.floor((box.x - box.reach_x - reach_m) / size)),
        min(cols - 1, math.floor((box.x + box.reach_x + reach_m) / size)),
    )


@lean
def _note_edges(terrain: Terrain, box: _Box, room: FloatArray) -> None:
    """Notes the edges of the map, which no box may cross."""
    rows, cols = terrain.blocked.shape
    size = terrain.resolution_m
    for way, gap in (
        (4, cols * size - box.x - box.reach_x),
        (5, box.x - box.reach_x),
        (6, rows * size - box.y - box.reach_y),
        (7, box.y - box.reach_y),
    ):
        if gap < room[way, 0]:
            _note_on_map_axis(box, way, gap, room)


@lean
def _note_cell(box: _Box, dx: float, dy: float, half: float, room: FloatArray) -> None:
    """Notes a cell whose centre is at (dx, dy) from that of the box, if it is the nearest yet."""
    along, across = box.cos * dx + box.sin * dy, box.cos * dy - box.sin * dx
    way, gap = (0 if along >= 0 else 1), abs(along) - box.half_l - box.cell_reach
    if abs(across) - box.half_w - box.cell_reach > gap:
        way, gap = (2 if across >= 0 else 3), abs(across) - box.half_w - box.cell_reach
    if abs(dx) - box.reach_x - half > gap:
        way, gap = (4 if dx >= 0 else 5), abs(dx) - box.reach_x - half
    if abs(dy) - box.reach_y - half > gap:
        way, gap = (6 if dy >= 0 else 7), abs(dy) - box.reach_y - half
    if gap >= room[way, 0]:
        return
    if way >= 4:
        _note_on_map_axis(box, way, gap, room)
        return
    room[way, 0] = gap
    sign = 1.0 if way % 2 == 0 else -1.0
    if way < 2:
        room[way, 1], room[way, 2] = -sign * box.cos, -sign * box.sin
        room[way, 3] = sign * across - box.by_yaw_cell
    else:
        room[way, 1], room[way, 2] = sign * box.sin, -sign * box.cos
        room[way, 3] = -sign * along - box.by_yaw_cell


@lean
def _note_on_map_axis(box: _Box, way: int, gap: float, room: FloatArray) -> None:
    sign = -1.0 if way % 2 == 0 else 1.0
    room[way, 0] = gap
    room[way, 1], room[way, 2] = (sign, 0.0) if way < 6 else (0.0, sign)
    room[way, 3] = -box.by_yaw_x if way < 6 else -box.by_yaw_y
