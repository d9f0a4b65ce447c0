"""One step of a walk: where it was asked for, and where the foot came to rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.plan import wrap_angle
from planner.robot_model import Side


@dataclass(frozen=True, kw_only=True)
class Placed:
    """One step as it was asked for and as the foot came to rest: poses x, y, z, yaw (4,).

    z is the height of the ground on which the foot stands.
    `time_s` is when the step's period ended, in simulated time since the start of the walk.
    """

    side: Side
    asked_world: np.ndarray
    placed_world: np.ndarray
    time_s: float

    @property
    def error_m(self) -> float:
        """Horizontal distance between the two."""
        return float(np.hypot(*(self.placed_world - self.asked_world)[:2]))

    @property
    def error_rad(self) -> float:
        """Difference of heading, not negative."""
        return abs(float(wrap_angle(self.placed_world[3] - self.asked_world[3])))
