"""What the plots and the footprints show of a walk: kept short, whatever the page is open for."""

from __future__ import annotations

from collections import deque

import numpy as np

from app.navigation.navigator import Navigator
from controller.gait import CONTROL_PERIOD_S
from sim.clearance import min_clearance_m

FORCE_WINDOW_S = 6.0
_PATH_EVERY_TICKS = 10


class Record:
    """Filled by the physics; the arrays are replaced, never changed, so any thread may read them.

    placed_side (N,), placed_world (N, 4), foot_error_m (N,): the steps of this walk.
    path_world (T, 2): the way of the body, four points a second. walk: how many have begun.
    """

    def __init__(self) -> None:
        self._forces: deque[tuple[float, float, float]] = deque(
            maxlen=round(FORCE_WINDOW_S / CONTROL_PERIOD_S)
        )
        self._ticks = 0
        self.walk = 0
        self.clearance_m: float | None = None
        self.placed_side = np.zeros(0, np.int8)
        self.placed_world = np.zeros((0, 4))
        self.foot_error_m = np.zeros(0)
        self.path_world = np.zeros((0, 2))

    def begin(self, navigator: Navigator) -> None:
        """A new walk: what is known of the one before is forgotten."""
        self.walk += 1
        self.clearance_m = None
        self.landed(navigator)

    def ticked(self, navigator: Navigator) -> None:
        """Notes the forces on the feet."""
        self._ticks += 1
        sensors = navigator.scene.sensors.ground_force_world[:, 2]
        left, right = navigator.walker.sim.sensors[0, :, sensors].mean(axis=-1)
        self._forces.append((self._ticks * CONTROL_PERIOD_S, float(left), float(right)))

    def landed(self, navigator: Navigator) -> None:
        """Notes a step that was taken, and how near a wall the robot is."""
        placed = navigator.placed
        self.placed_side = np.array([step.side for step in placed], np.int8)
        self.placed_world = np.array([step.placed_world for step in placed]).reshape(-1, 4)
        self.foot_error_m = np.array([step.error_m for step in placed])
        self.path_world = np.array([qpos[:2] for qpos in navigator.qpos[::_PATH_EVERY_TICKS]])
        near = min_clearance_m(navigator.scene, navigator.qpos[-1][None])
        if near is not None:
            self.clearance_m = min(near, self.clearance_m or near)

    def forces(self) -> np.ndarray:
        """Time in s and upward force on the left and right foot in N, (3, T), the latest last."""
        return np.array(list(self._forces) or [(0.0, 0.0, 0.0)]).T
