"""What could be had instead of what cannot: a free pose near by, or one to which a way leads."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike

from maps.grid import OccupancyGrid
from planner.collision import Terrain, terrain_of
from planner.endpoints import nearest_free_pose, what_blocks
from planner.plan import Pose, feet_at
from planner.robot_model import StepModel

# Offers must come soon: so many poses are tried, and so long.
_MOST_TRIED = 6
_LONGEST_S = 0.5
# Poses that are tried one after the other are so far apart.
_APART_M = 0.3


@dataclass(frozen=True, kw_only=True)
class Stand:
    """Why the robot cannot stand somewhere, empty if it can, and the nearest place where it can."""

    blocked: str
    alternative: Pose | None = None


def place_to_stand(
    grid: OccupancyGrid, model: StepModel, unknown_is_free: bool, pose: Pose
) -> Stand:
    """Whether the robot can be put down at a pose."""
    terrain = terrain_of(grid, unknown_is_free)
    blocked = what_blocks(grid, terrain, model, feet_at(pose, model.stance_width_m))
    if not blocked:
        return Stand(blocked="")
    return Stand(blocked=blocked, alternative=free_pose(grid, terrain, model, pose))


def free_pose(
    grid: OccupancyGrid, terrain: Terrain, model: StepModel, pose: Sequence[float]
) -> Pose | None:
    """The pose nearest to a blocked one at which the robot can stand; None within 2 m."""
    found = nearest_free_pose(grid, terrain, model, pose)
    return found and (float(found[0]), float(found[1]), float(found[2]))


def reachable_pose(
    grid: OccupancyGrid,
    terrain: Terrain,
    model: StepModel,
    start: ArrayLike,
    goal: Pose,
    has_way: Callable[[Pose], bool],
) -> Pose | None:
    """The pose nearest to a free goal without a way to which `has_way` finds one.

    Only places are tried to which a disk as wide as the body can roll from the start (x, y, ...),
    and few of them.
    """
    until_s = time.monotonic() + _LONGEST_S
    tried: list[Pose] = []
    places = _rolled_to(grid, terrain, model, start)
    for place in places[np.argsort(np.hypot(*(places - goal[:2]).T), kind="stable")]:
        pose = round(float(place[0]), 3), round(float(place[1]), 3), goal[2]
        if len(tried) == _MOST_TRIED or time.monotonic() > until_s:
            return None
        if any(math.dist(pose[:2], other[:2]) < _APART_M for other in tried):
            continue
        if what_blocks(grid, terrain, model, feet_at(pose, model.stance_width_m)):
            continue
        if has_way(pose):
            return pose
        tried.append(pose)
    return None


def _rolled_to(
    grid: OccupancyGrid, terrain: Terrain, model: StepModel, start: ArrayLike
) -> np.ndarray:
    """Centres (n, 2) in the world of cells to which the narrowest disk in the body can roll."""
    radius_m = min(model.body.length_m, model.body.width_m) / 2
    wide = (np.asarray(terrain.clearance_m) > radius_m).astype(np.uint8)
    row, col = (int(value) for value in grid.world_to_cell(np.asarray(start)[:2]))
    rows, cols = grid.shape
    if not (0 <= row < rows and 0 <= col < cols):
        return np.zeros((0, 2))
    _, labels = cv2.connectedComponents(wide, connectivity=8)
    # Whoever stands too near to a wall is in the nearest room.
    near = max(1, math.ceil(radius_m / grid.resolution_m))
    window = labels[max(0, row - near) : row + near + 1, max(0, col - near) : col + near + 1]
    counts = np.bincount(window[window > 0])
    if not len(counts):
        return np.zeros((0, 2))
    label = labels[row, col] or int(counts.argmax())
    return grid.cell_to_world(np.argwhere(labels == label))
