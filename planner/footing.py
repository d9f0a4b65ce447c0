"""Which ground a robot's feet stand on, for those who place it and watch it walk."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from maps.grid import OccupancyGrid
from planner.collision import Terrain, terrain_of
from planner.ground_heights import heights_below, resting_heights
from planner.plan import feet_at
from planner.robot_model import StepModel

FloatArray = NDArray[np.float64]


class Footing:
    """The ground of one map under the feet of one robot; z is 0 where the map is flat."""

    def __init__(self, grid: OccupancyGrid, model: StepModel, unknown_is_free: bool) -> None:
        self._grid, self._model = grid, model
        self._terrain: Terrain | None = None
        if grid.elevation_m is not None:
            self._terrain = terrain_of(grid, unknown_is_free)

    def at_rest(self, feet_world: FloatArray) -> FloatArray:
        """Feet (n, 4) x, y, z, yaw with z the height of the ground that each rests on."""
        feet = np.array(feet_world, dtype=float)
        feet[:, 2] = 0.0
        if self._terrain is not None:
            feet[:, 2] = resting_heights(self._grid, self._terrain, self._model, feet_world)
        return feet

    def stand_m(self, pose: ArrayLike) -> float:
        """Height of the ground at which a robot stands at a pair pose: the higher of two feet."""
        if self._terrain is None:
            return 0.0
        feet = feet_at(pose, self._model.stance_width_m)
        return float(heights_below(self._grid, self._terrain, self._model, feet)[:, 1].max())
