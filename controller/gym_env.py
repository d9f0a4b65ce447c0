"""The walking task as Gymnasium environments: `import controller.gym_env` registers one a robot.

`gymnasium.make("Footfall/Jvrc1-v0")` is one robot, `gymnasium.make_vec("Footfall/Jvrc1-v0",
num_envs=256)` many in one batch of simulations. Observation, action, reward and ends of episodes
are those of `WalkTask`.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from controller.curriculum import Stage
from controller.gait import CONTROL_PERIOD_S
from controller.gym_render import Painter
from controller.gym_task import (
    LANDING_ERRORS,
    action_space,
    checked_action,
    make_task,
    observation_space,
    refuse_options,
    within_space,
)
from controller.task_config import TaskConfig
from sim.robots import robot_names

VERSION = 0


def environment_id(robot: str) -> str:
    """The id of a robot's environment, such as Footfall/Jvrc1-v0."""
    return f"Footfall/{robot.capitalize()}-v{VERSION}"


class WalkEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One robot that walks along steps drawn anew every episode.

    The observation (N,) is the policy's, scaled; the action (J,) an offset in rad of the joint
    targets from half-sitting. `info` tells whether a step has just ended (`landed`) and, if so,
    how far its foot is from where it was asked for; and the terms of the reward.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (as Gymnasium declares it)
        "render_modes": ["rgb_array"],
        "render_fps": round(1 / CONTROL_PERIOD_S),
    }

    def __init__(
        self,
        robot: str = "jvrc1",
        *,
        mode: str | None = None,
        config: TaskConfig | None = None,
        stage: Stage | None = None,
        render_mode: str | None = None,
    ):
        """Set the robot up; `mode` is a way of walking, None for a mix of all.

        `stage` says how high stairs are and how much is disturbed: nothing, unless it is given.

        Raises:
            ValueError: there is no such robot, way of walking or render mode.
            NoGlError: pictures are asked for, and no GL library works here.
        """
        self._task = make_task(
            robot, count=1, mode=mode, config=config, stage=stage, render_mode=render_mode
        )
        self.render_mode = render_mode
        self.observation_space = observation_space(self._task.robot)
        self.action_space = action_space(self._task.robot)
        self._painter = Painter(self._task.walker.scene) if render_mode else None
        self._ended = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start a new episode; the same seed gives the same episodes."""
        super().reset(seed=seed)
        refuse_options(options)
        self._task.restart(int(self.np_random.integers(2**63)))
        self._ended = False
        return within_space(self._task.observe())[0], {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Act for one control step; the observation after the last one is the episode's own."""
        (joints,) = self.action_space.shape or ()
        step = self._task.step(checked_action(action, (joints,))[None])
        terminated, truncated = bool(step.terminated[0]), bool(step.truncated[0])
        self._ended = terminated or truncated
        seen = self._task.last_observation if self._ended else step.observation
        info: dict[str, Any] = {
            "landed": bool(step.landed[0]),
            "stairs": bool(step.stairs[0]),
            "failed": bool(step.failed[0]),
            "reward_terms": step.terms,
        }
        if info["landed"]:
            info |= {name: float(getattr(step, name)[0]) for name in LANDING_ERRORS}
        return within_space(seen)[0], float(step.reward[0]), terminated, truncated, info

    def render(self) -> np.ndarray | None:
        """A picture (480, 640, 3) of the robot and its next two steps; None without render_mode."""
        if self._painter is None:
            return None
        moment = self._task.last_moment if self._ended else self._task.moment()
        return self._painter.draw(moment, 0)

    def close(self) -> None:
        """Free what drawing holds."""
        if self._painter is not None:
            self._painter.close()


def register() -> None:
    """Register an environment for every robot that can be built here."""
    for name in robot_names():
        if environment_id(name) not in gymnasium.registry:
            gymnasium.register(
                environment_id(name),
                entry_point="controller.gym_env:WalkEnv",
                vector_entry_point="controller.gym_vector:WalkVectorEnv",
                kwargs={"robot": name},
            )


# Gymnasium's custom: environments are there once their module is imported.
register()
