"""What the Gymnasium environments share: spaces, ways of walking, and the ends of episodes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from gymnasium import spaces

from controller.curriculum import Stage
from controller.env import WalkTask
from controller.observation import SCALED_LIMIT, policy_fields
from controller.stairs import STAIR_MODES
from controller.step_sequences import MODES
from controller.task_config import TaskConfig
from sim.robot import Robot
from sim.robots import get_robot

# Further from half-sitting the joint targets are held there: beyond every joint that a leg has,
# or so far that the servo gives all its torque.
ACTION_LIMIT_RAD = 2.0
# What a transition tells of a foot that has just landed.
LANDING_ERRORS = ("landing_error_m", "landing_height_error_m", "landing_heading_error_rad")


def observation_space(robot: Robot) -> spaces.Box:
    """Scaled observations (N,), cut off where training cuts them off."""
    width = sum(field.width for field in policy_fields(robot))
    return spaces.Box(-SCALED_LIMIT, SCALED_LIMIT, (width,), np.float32)


def action_space(robot: Robot) -> spaces.Box:
    """Offsets (J,) in rad of the joint targets from half-sitting."""
    return spaces.Box(-ACTION_LIMIT_RAD, ACTION_LIMIT_RAD, (len(robot.joints),), np.float32)


def within_space(observation: np.ndarray) -> np.ndarray:
    """A new array of observations (B, N) in float32 and within the space.

    A simulation that broke down may end in numbers that are not finite; they read 0.
    """
    limited = np.clip(np.nan_to_num(observation), -SCALED_LIMIT, SCALED_LIMIT)
    return limited.astype(np.float32)


def checked_action(action: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """The action in float64, within its bounds.

    Raises:
        ValueError: it has another shape, or numbers that are not finite.
    """
    action = np.asarray(action, dtype=np.float64)
    if action.shape != shape:
        raise ValueError(f"the action has shape {action.shape}, it must have {shape}")
    if not np.isfinite(action).all():
        raise ValueError("the action has numbers that are not finite")
    return np.clip(action, -ACTION_LIMIT_RAD, ACTION_LIMIT_RAD)


@dataclass(frozen=True, kw_only=True)
class Moment:
    """What a picture needs of all robots at one moment.

    `qpos` is (B, nq), `window` (B, 2, 4) the present and the next step in the world, `side` (B,)
    the foot of the present one. `ground` is as `SimBatch.ground_pose` gives it.
    """

    qpos: np.ndarray
    window: np.ndarray
    side: np.ndarray
    ground: tuple[np.ndarray, np.ndarray] | None


class EpisodeTask(WalkTask):
    """The walking task, which also keeps how episodes ended.

    A `WalkTask` starts the next episode within the step that ends one; `last_observation` (B, N)
    and `last_moment` are from between the two.
    """

    last_observation: np.ndarray
    last_moment: Moment

    def reset(self, rows: np.ndarray) -> None:
        """Start new episodes for the robots `rows`, after a look at the old ones."""
        if len(rows):
            self.last_observation, self.last_moment = self.observe(), self.moment()
        super().reset(rows)

    def moment(self) -> Moment:
        """The robots as they are now."""
        cursor = self.walker.cursor
        return Moment(
            qpos=self.walker.sim.qpos.copy(),
            window=cursor.window,
            side=cursor.side,
            ground=self.walker.sim.ground_pose,
        )


def make_task(
    robot: str,
    *,
    count: int,
    threads: int = 1,
    mode: str | None,
    config: TaskConfig | None,
    stage: Stage | None,
    render_mode: str | None,
) -> EpisodeTask:
    """The task that an environment runs.

    Raises:
        ValueError: there is no such robot, way of walking or render mode, or no robot at all.
    """
    if render_mode not in (None, "rgb_array"):
        raise ValueError(f"render_mode {render_mode!r}: choose 'rgb_array' or None")
    modes = (*MODES, *STAIR_MODES, "standing")
    if mode is not None and mode not in modes:
        raise ValueError(f"mode {mode!r}: choose one of {', '.join(modes)}, or None for a mix")
    if count < 1:
        raise ValueError(f"num_envs {count} must be at least 1")
    return EpisodeTask(
        get_robot(robot),
        count=count,
        seed=0,
        threads=threads,
        mode=mode,
        config=config,
        stage=stage,
    )


def refuse_options(options: dict[str, object] | None) -> None:
    """Takes no options.

    Raises:
        ValueError: there are some.
    """
    if options:
        raise ValueError(f"reset takes no options here, but got {', '.join(options)}")
