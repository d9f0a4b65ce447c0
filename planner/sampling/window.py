"""Lattice searches on a part of the map: across a gap in a walk, or in a corridor along a line.

A window is a rectangle of the map's cells. What is free in it is free on the map, so its plans hold
there; what is proven in it is not. All poses are x_m, y_m, yaw_rad in the grid frame of the map.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from maps.distance import distance_field
from maps.grid import OccupancyGrid
from planner.collision import Terrain
from planner.heuristics.tables import tables_of
from planner.lattice.footsteps import Footsteps, Stance
from planner.lattice.lattice import build_space
from planner.options import PlannerOptions
from planner.plan import PlanStatus, wrap_angle
from planner.robot_model import StepModel
from planner.search.ara import plan_ara
from planner.search.problem import Request, Result
from planner.search.toward import Toward

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Window:
    """Terrain of some rows and columns; corner_m (2,): their first corner in the grid frame."""

    terrain: Terrain
    corner_m: FloatArray


def window_around(terrain: Terrain, points: FloatArray, margin_m: float) -> Window:
    """The window that holds points (n, 2) and as much around them."""
    size = terrain.resolution_m
    low = np.floor((points.min(axis=0) - margin_m) / size).astype(int)
    high = np.ceil((points.max(axis=0) + margin_m) / size).astype(int)
    col0, row0 = (int(v) for v in np.maximum(low, 0))
    rows, cols = terrain.blocked.shape
    cut = np.s_[row0 : min(int(high[1]), rows), col0 : min(int(high[0]), cols)]
    parts: dict[str, Any] = {
        name: np.ascontiguousarray(part[cut])
        for name, part in terrain._asdict().items()
        if isinstance(part, np.ndarray) and part.shape == terrain.blocked.shape
    }
    return Window(terrain=terrain._replace(**parts), corner_m=np.array([col0, row0]) * size)


def corridor_along(terrain: Terrain, line: FloatArray, half_width_m: float) -> Window:
    """The window along a line (n, 2) in which all is blocked but what lies near the line."""
    window = window_around(terrain, line, half_width_m + terrain.resolution_m)
    size = terrain.resolution_m
    cells = np.floor((line - window.corner_m) / size).astype(np.int32)
    near = np.zeros(window.terrain.blocked.shape, np.uint8)
    thickness = max(1, round(2 * half_width_m / size))
    cv2.polylines(near, [cells.reshape(-1, 1, 2)], False, 1, thickness)
    blocked = window.terrain.blocked | (near == 0)
    narrow = window.terrain._replace(blocked=blocked, clearance_m=distance_field(blocked, size))
    return replace(window, terrain=narrow)


def search_window(
    window: Window,
    model: StepModel,
    stance: Stance,
    goal: FloatArray,
    options: PlannerOptions,
    began: float,
) -> tuple[Footsteps | None, Result]:
    """Steps by ARA* from a stance to both feet beside a pose (3,), if the window has any."""
    terrain, tables = window.terrain, tables_of(model)
    floor = OccupancyGrid(
        cells=np.zeros(terrain.blocked.shape, np.uint8), resolution_m=terrain.resolution_m
    )
    x_m, y_m = (float(v) for v in goal[:2] - window.corner_m)
    space = build_space(floor, terrain, model, tables.steps, (x_m, y_m, float(goal[2])))
    result = plan_ara(
        Request(
            toward=Toward(space=space, model=model, tables=tables),
            feet_lattice=into_frame(stance.feet, goal),
            feet_m=stance.feet_m,
            stands=stance.pair_margin_m < model.body_margin_m,
            first_side=stance.first_side,
        ),
        options,
        began,
    )
    if result.status is not PlanStatus.FOUND:
        return None, result
    poses = out_of_frame(result.pose_lattice, goal)
    return Footsteps(side=result.side, pose=poses, z_m=result.z_m), result


def into_frame(poses: FloatArray, frame: FloatArray) -> FloatArray:
    """Poses (n, 3) as seen from a frame (3,)."""
    cos, sin = math.cos(frame[2]), math.sin(frame[2])
    x, y = (poses[:, :2] - frame[:2]).T
    return np.column_stack(
        [cos * x + sin * y, cos * y - sin * x, wrap_angle(poses[:, 2] - frame[2])]
    )


def out_of_frame(poses: FloatArray, frame: FloatArray) -> FloatArray:
    """The inverse of `into_frame`."""
    cos, sin = math.cos(frame[2]), math.sin(frame[2])
    x, y = poses[:, :2].T
    return np.column_stack(
        [
            frame[0] + cos * x - sin * y,
            frame[1] + sin * x + cos * y,
            wrap_angle(poses[:, 2] + frame[2]),
        ]
    )
