"""What is seen of a live robot at one moment."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from app.navigation.live_navigator import Notice
from app.navigation.planner_process import Answer
from app.navigation.route import Waypoint
from app.viewer.obstacles import Obstacle
from planner.plan import FootstepPlan, Pose


@dataclass(frozen=True, kw_only=True)
class Snapshot:
    """The robot, its plan and its walk so far; times in s, of the simulation unless said.

    `start` is where a reset puts the robot, `goal` where it walks or has walked to, `requested` a
    goal that is being planned for. `done` steps of `plan` have been taken.
    placed_side (N,), placed_world (N, 4) and foot_error_m (N,) tell of the steps of this walk;
    path_world (T, 2) of the body, four points a second. `speed` is simulated over real time as it
    is reached; `gait` how a walk went that is over; `loading` what there is to wait for before the
    first plan; `answer_s` the real time from question to plan. `walk` counts the walks begun,
    `restores` how often an edit was taken back or made again, which sets `obstacles` too.
    `waypoints` are those that are ahead. `answer` is the planner's latest.
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
    gait: str = ""
    loading: str = ""
    notice: Notice | None = None
    obstacles: tuple[Obstacle, ...] = ()
    restores: int = 0
    waypoints: tuple[Waypoint, ...] = ()
    answer: Answer | None = None
