"""One step that the tests of the model-based controller plan: its feet, soles and pendulum."""

from __future__ import annotations

import numpy as np

from controller.step_cursor import UpcomingSteps

HALF_SOLE_M = np.array([0.10, 0.05])
FEET = np.array([[0.0, 0.1, 0.0, 0.0], [0.0, -0.1, 0.0, 0.0]])
OMEGA = np.sqrt(9.81 / 0.8)
STEP = UpcomingSteps(
    side=np.array([1]),
    pose_world=np.array([[0.2, -0.1, 0.0, 0.0]]),
    lift_off_s=np.array([0.3]),
    touch_down_s=np.array([0.9]),
)
