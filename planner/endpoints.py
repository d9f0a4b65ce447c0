"""Whether the robot can stand at the start and at the goal, and if not, why and where it could."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from maps.grid import OccupancyGrid
from planner.collision import (
    Terrain,
    box_free,
    heights_below,
    highest_between,
    resting_heights,
    terrain_of,
)
from planner.plan import FootstepPlan, feet_at, pair_pose
from planner.robot_model import Side, StepModel, rounded_box
from planner.time_limit import OutOfTime, check_time

FloatArray = NDArray[np.float64]
_SEARCH_RADIUS_M = 2.0
_ROUNDING_M = 5e-7  # heights are whole micrometres


def what_blocks(
    grid: OccupancyGrid, terrain: Terrain, model: StepModel, feet: FloatArray, margins: bool = True
) -> str:
    """Names the foot or body that cannot be at feet (2, 4), and where; empty if all is free.

    With margins the robot is about to stand there, so the ground must be level too. Without, it
    stands there already, wherever that is.
    """
    blocked = what_obstructs(grid, terrain, model, feet, margins)
    if blocked or not margins or terrain.is_flat:
        return blocked
    return _what_is_uneven(grid, terrain, model, feet)


def what_obstructs(
    grid: OccupancyGrid, terrain: Terrain, model: StepModel, feet: FloatArray, margins: bool = True
) -> str:
    """As `what_blocks`, but for obstacles only."""
    foot = rounded_box(model.foot, model.foot_margin_m if margins else 0.0)
    body = rounded_box(model.body, model.body_margin_m if margins else 0.0)
    boxes = [(f"the {side.name.lower()} foot", feet[side], foot) for side in Side]
    for name, pose, box in [*boxes, ("the body", pair_pose(feet), body)]:
        x, y = (float(v) for v in grid.world_to_grid(pose[:2]))
        yaw = float(pose[-1]) - grid.origin[2]
        if not box_free(terrain, x, y, math.cos(yaw), math.sin(yaw), box):
            where = f"{name} at {pose[0]:z.2f},{pose[1]:z.2f}"
            if not grid.contains(pose[:2]):
                return f"{where} would be off the map"
            return f"{where} would touch an obstacle, unknown ground or the map's edge"
    return ""


def _what_is_uneven(
    grid: OccupancyGrid, terrain: Terrain, model: StepModel, feet: FloatArray
) -> str:
    """Says under which foot of (2, 4) the ground is not level, or higher than under the other."""
    heights = heights_below(grid, terrain, model, feet)
    for side in Side:
        low_m, high_m = heights[side]
        if high_m - low_m > model.level_m + _ROUNDING_M:
            x_m, y_m = feet[side, :2]
            return (
                f"the ground under the {side.name.lower()} foot at {x_m:z.2f},{y_m:z.2f} is not "
                f"level: it rises by {high_m - low_m:.2f} m"
            )
    rise_m = abs(float(heights[0, 1] - heights[1, 1]))
    if rise_m > min(-model.limits.z_m[0], model.limits.z_m[1], model.level_m) + _ROUNDING_M:
        higher = Side.LEFT if heights[0, 1] > heights[1, 1] else Side.RIGHT
        return f"the {higher.name.lower()} foot would stand {rise_m:.2f} m higher than the other"
    return ""


def nearest_free_pose(
    grid: OccupancyGrid, terrain: Terrain, model: StepModel, pose: ArrayLike
) -> tuple[float, float, float] | None:
    """The pose nearest to a blocked one, on rings 5 cm apart, at which the robot can stand.

    The heading is kept if any place allows it, else turned by quarter turns. None within 2 m.
    Raises OutOfTime where a limit passes on the way.
    """
    x_m, y_m, yaw_rad = (float(v) for v in np.asarray(pose, dtype=float))
    steps = np.arange(-_SEARCH_RADIUS_M, _SEARCH_RADIUS_M + 0.01, 0.05)
    away = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    away = away[np.argsort(np.hypot(away[:, 0], away[:, 1]), kind="stable")]
    places = np.round(away + np.array([x_m, y_m]), 3)
    places = places[_may_hold_body(grid, terrain, model, places)]
    for turn in (0.0, math.pi / 2, -math.pi / 2, math.pi):
        yaw = round(math.remainder(yaw_rad + turn, 2 * math.pi), 4)
        for x, y in places.tolist():
            check_time()
            there = x, y, yaw
            if not what_blocks(grid, terrain, model, feet_at(there, model.stance_width_m)):
                return there
    return None


def _may_hold_body(
    grid: OccupancyGrid, terrain: Terrain, model: StepModel, places: FloatArray
) -> NDArray[np.bool_]:
    """False (n,) for points (n, 2) of the world too near to an obstacle for any heading.

    The distance field is that of the middles of cells, and at most 0.21 cells too low.
    """
    size_m = terrain.resolution_m
    col, row = np.floor(grid.world_to_grid(places) / size_m).astype(int).T
    rows, cols = terrain.blocked.shape
    on_map = (col >= 0) & (row >= 0) & (col < cols) & (row < rows)
    clearance_m = terrain.clearance_m[row.clip(0, rows - 1), col.clip(0, cols - 1)]
    body_m = min(model.body.length_m, model.body.width_m) / 2 + model.body_margin_m
    return np.asarray(on_map & (clearance_m >= body_m - size_m))


def suggestion(grid: OccupancyGrid, terrain: Terrain, model: StepModel, pose: ArrayLike) -> str:
    """Half a sentence that names the nearest free pose; empty where there is no time for it."""
    try:
        there = nearest_free_pose(grid, terrain, model, pose)
    except OutOfTime:
        return ""
    if there is None:
        return f"; no pose within {_SEARCH_RADIUS_M:g} m is free"
    return f"; the nearest free pose is {there[0]:zg},{there[1]:zg},{there[2]:zg}"


class Footing:
    """The ground of one map under the feet of one robot; z is 0 where the map is flat."""

    def __init__(self, grid: OccupancyGrid, model: StepModel, unknown_is_free: bool) -> None:
        self._grid, self._model, self._unknown_is_free = grid, model, unknown_is_free
        self._terrain: Terrain | None = None
        if grid.elevation_m is not None:
            self._terrain = terrain_of(grid, unknown_is_free)

    @cached_property
    def _obstacles(self) -> Terrain:
        return self._terrain or terrain_of(self._grid, self._unknown_is_free)

    def may_stand(self, feet_world: FloatArray) -> bool:
        """Whether feet (2, 4) and body are free there, and the ground level and of one height."""
        return not what_blocks(self._grid, self._obstacles, self._model, feet_world)

    def at_rest(self, feet_world: FloatArray) -> FloatArray:
        """Feet (n, 4) x, y, z, yaw with z the height of the ground that each rests on."""
        feet = np.array(feet_world, dtype=float)
        feet[:, 2] = 0.0
        if self._terrain is not None:
            feet[:, 2] = resting_heights(self._grid, self._terrain, self._model, feet_world)
        return feet

    def swing_over_z_m(self, plan: FootstepPlan) -> FloatArray:
        """Top (N,) of what each step swings over, -inf where nothing is higher than its ends."""
        over_z_m = np.full(len(plan), -np.inf)
        if self._terrain is None:
            return over_z_m
        feet = plan.start_feet_world.copy()
        sole = self._model.foot.length_m / 2, self._model.foot.width_m / 2
        for k, (side, pose) in enumerate(zip(plan.side, plan.pose_world, strict=True)):
            lift_off, feet[side] = feet[side].copy(), pose
            (x0, y0), (x1, y1) = self._grid.world_to_grid([lift_off[:2], pose[:2]]).tolist()
            yaw_rad = float(pose[3]) - self._grid.origin[2]
            high_um = highest_between(
                self._terrain, (x0, y0), (x1, y1), math.cos(yaw_rad), math.sin(yaw_rad), sole
            )
            if high_um / 1e6 > max(lift_off[2], pose[2]) + self._model.level_m + _ROUNDING_M:
                over_z_m[k] = high_um / 1e6
        return over_z_m

    def stand_m(self, pose: ArrayLike) -> float:
        """Height of the ground at which a robot stands at a pair pose: the higher of two feet."""
        if self._terrain is None:
            return 0.0
        feet = feet_at(pose, self._model.stance_width_m)
        return float(heights_below(self._grid, self._terrain, self._model, feet)[:, 1].max())
