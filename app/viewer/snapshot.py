"""What the page shows of a session at one moment; made by the physics, read by the page."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from app.navigation.navigator import Navigator
from controller.gait import CONTROL_PERIOD_S
from planner.plan import FootstepPlan, Pose
from sim.scene import min_clearance_m

FORCE_WINDOW_S = 6.0
_PATH_EVERY_TICKS = 10


@dataclass(frozen=True, kw_only=True)
class Notice:
    """Something that went wrong, in words, and a pose that would do instead, if one is known.

    Both poses are goals, or with `puts_robot` places for the robot to begin anew.
    """

    text: str
    refused: Pose | None = None
    alternative: Pose | None = None
    puts_robot: bool = False


@dataclass(frozen=True, kw_only=True)
class Snapshot:
    """The robot, its plan and its walk so far; times in s, of the simulation unless said.

    `start` is where a reset puts the robot, `goal` where it walks or has walked to, `requested` a
    goal that is being planned for. `done` steps of `plan` have been taken.
    placed_side (N,), placed_world (N, 4) and foot_error_m (N,) tell of the steps of this walk;
    path_world (T, 2) of the body, four points a second. `speed` is simulated over real time as it
    is reached; `answer_s` the real time from question to plan. `walk` counts the walks begun.
    """

    qpos: np.ndarray
    time_s: float = 0.0
    walk: int = 0
    start: Pose = (0.0, 0.0, 0.0)
    goal: Pose | None = None
    requested: Pose | None = None
    plan: FootstepPlan | None = None
    done: int = 0
    placed_side: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int8))
    placed_world: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))
    foot_error_m: np.ndarray = field(default_factory=lambda: np.zeros(0))
    path_world: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    status: str = "standing"
    replans: int = 0
    answer_s: float | None = None
    clearance_m: float | None = None
    goal_error: tuple[float, float] | None = None
    speed: float = 0.0
    notice: Notice | None = None


class WalkHistory:
    """What plots and footprints show of a walk, filled by the physics; arrays as in `Snapshot`.

    They are replaced, never changed, so any thread may read them.
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
