"""What the page shows of a session at one moment; made by the physics, read by the page."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from planner.plan import FootstepPlan, Pose


@dataclass(frozen=True, kw_only=True)
class Notice:
    """Something that went wrong, for people, and a pose that would do instead, if one is known.

    What was refused and what is on offer are goals, or with `puts_robot` places for the robot to
    begin anew.
    """

    text: str
    refused: Pose | None = None
    offer: Pose | None = None
    puts_robot: bool = False


@dataclass(frozen=True, kw_only=True)
class Snapshot:
    """The robot, its plan and its walk so far; times in s, of the simulation unless said.

    `start` is where a reset puts the robot, `goal` where it walks or has walked to, `wished` a goal
    that somebody has set and that is being planned for. `done` steps of `plan` have been taken.
    placed_side (N,), placed_world (N, 4) and foot_error_m (N,) tell of the steps of this walk;
    path_world (T, 2) of the body. `speed` is simulated over real time as it is reached; `answer_s`
    the real time from question to plan. `walk` counts walks: another number means that a new one
    has begun.
    """

    qpos: np.ndarray
    time_s: float = 0.0
    walk: int = 0
    start: Pose = (0.0, 0.0, 0.0)
    goal: Pose | None = None
    wished: Pose | None = None
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
