"""Where the body can be and move, compiled: what a path of the body asks of the map.

All poses are x_m, y_m, yaw_rad in the grid frame.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.collision import Terrain, box_free, point_clearance
from planner.jit import lean
from planner.lattice.steps import MICRO
from planner.robot_model import BodyShape, FootShape, StepModel

# A body this near to an obstacle is looked at this often on its way; footsteps are checked exactly.
_STRIDE_M = 0.03


class Outline(NamedTuple):
    """Boxes of a robot that stands at a pair pose, as half lengths and half widths with margins.

    body: centred on the pose. feet: each half_stance_m beside it. climb_um: how far one step may
    fall and rise.
    """

    body: tuple[float, float]
    feet: tuple[float, float]
    half_stance_m: float
    climb_um: tuple[int, int]


def outline_of(model: StepModel) -> Outline:
    """The outline of a step model."""
    return Outline(
        body=_half_box(model.body, model.body_margin_m),
        feet=_half_box(model.foot, model.foot_margin_m),
        half_stance_m=model.stance_width_m / 2,
        climb_um=(round(model.limits.z_m[0] * MICRO), round(model.limits.z_m[1] * MICRO)),
    )


def _half_box(shape: BodyShape | FootShape, margin_m: float) -> tuple[float, float]:
    return shape.length_m / 2 + margin_m, shape.width_m / 2 + margin_m


@lean
def can_stand(terrain: Terrain, outline: Outline, x: float, y: float, yaw: float) -> bool:
    """Whether body and both feet are free at a pair pose."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    if not box_free(terrain, x, y, cos, sin, outline.body[0], outline.body[1]):
        return False
    dx, dy = -sin * outline.half_stance_m, cos * outline.half_stance_m
    half_l, half_w = outline.feet
    return box_free(terrain, x + dx, y + dy, cos, sin, half_l, half_w) and box_free(
        terrain, x - dx, y - dy, cos, sin, half_l, half_w
    )


@lean
def can_move(
    terrain: Terrain,
    outline: Outline,
    start: tuple[float, float, float],
    end: tuple[float, float, float],
) -> bool:
    """Whether the body is free all along a straight motion that turns evenly the shorter way.

    Strides are as long as the clearance allows, and short near obstacles. Where the floor is not
    flat they are short everywhere, and none may climb more than a step does.
    """
    turn = (end[2] - start[2] + math.pi) % (2 * math.pi) - math.pi
    half_l, half_w = outline.body
    radius = math.sqrt(half_l * half_l + half_w * half_w)
    length = max(math.hypot(end[0] - start[0], end[1] - start[1]), abs(turn) * radius)
    done = 0.0
    uneven = len(terrain.height_um) > 0
    below = _height(terrain, start[0], start[1]) if uneven else 0
    while True:
        share = done / length if length > 0.0 else 1.0
        x, y = start[0] + share * (end[0] - start[0]), start[1] + share * (end[1] - start[1])
        room = point_clearance(terrain, x, y) - radius
        if room <= 0.0:
            yaw = start[2] + share * turn
            if not box_free(terrain, x, y, math.cos(yaw), math.sin(yaw), half_l, half_w):
                return False
        if uneven:
            height = _height(terrain, x, y)
            if height - below < outline.climb_um[0] or height - below > outline.climb_um[1]:
                return False
            below = height
        if done >= length:
            return True
        done = min(length, done + (_STRIDE_M if uneven else max(room, _STRIDE_M)))


@lean
def _height(terrain: Terrain, x: float, y: float) -> int:
    """Height of the floor in micrometres at a point; at the edge's cell off the map."""
    rows, cols = terrain.blocked.shape
    row = min(max(math.floor(y / terrain.resolution_m), 0), rows - 1)
    col = min(max(math.floor(x / terrain.resolution_m), 0), cols - 1)
    return terrain.height_um[row, col]


def nearest_standing(
    terrain: Terrain, outline: Outline, pose: NDArray[np.float64], reach_m: float
) -> NDArray[np.float64] | None:
    """The pose (3,) with the same heading nearest to one (3,) at which the robot can stand.

    On rings up to reach_m; None if there is none.
    """
    x, y, yaw = (float(v) for v in pose)
    for radius_m in np.arange(0.0, reach_m + 1e-9, 0.05):
        for angle in np.arange(16) * (math.pi / 8) if radius_m else (0.0,):
            there = x + radius_m * math.cos(angle), y + radius_m * math.sin(angle), yaw
            if can_stand(terrain, outline, *there):
                return np.array(there)
    return None
