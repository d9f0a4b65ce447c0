"""Many robots as one Gymnasium vector environment, backed by one batch of simulations."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from controller.curriculum import Stage
from controller.env import Transition
from controller.gym_env import WalkEnv
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


class WalkVectorEnv(gymnasium.vector.VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """B robots, each walking along steps of its own.

    Where an episode ends, the next one begins within the same step: the observation is the new
    episode's first, and `final_obs` and `final_info` hold what ended, as Gymnasium's SAME_STEP
    has it. Spaces, rewards and infos are otherwise those of `WalkEnv`, the infos as arrays (B,)
    each with a mask of its name after an underscore; the terms of the reward are left out.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (as Gymnasium declares it)
        **WalkEnv.metadata,
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(
        self,
        robot: str = "jvrc1",
        *,
        num_envs: int = 1,
        threads: int = 1,
        mode: str | None = None,
        config: TaskConfig | None = None,
        stage: Stage | None = None,
        render_mode: str | None = None,
    ):
        """Set `num_envs` robots up, whose physics runs in `threads` threads.

        Raises:
            ValueError: there is no such robot, way of walking or render mode, or no robot at all.
            NoGlError: pictures are asked for, and no GL library works here.
        """
        self._task = make_task(
            robot,
            count=num_envs,
            threads=threads,
            mode=mode,
            config=config,
            stage=stage,
            render_mode=render_mode,
        )
        self.num_envs = num_envs
        self.render_mode = render_mode
        self.single_observation_space = observation_space(self._task.robot)
        self.single_action_space = action_space(self._task.robot)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._painter = Painter(self._task.walker.scene) if render_mode else None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start new episodes everywhere; one seed is for all robots, whatever the threads."""
        super().reset(seed=seed)
        refuse_options(options)
        self._task.restart(int(self.np_random.integers(2**63)))
        return within_space(self._task.observe()), {}

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Act (B, J) for one control step."""
        step = self._task.step(checked_action(actions, self.action_space.shape or ()))
        ended = step.terminated | step.truncated
        infos: dict[str, Any] = dict(_infos(step, ~ended))
        if ended.any():
            final = np.full(self.num_envs, None, dtype=object)
            seen = within_space(self._task.last_observation)
            for row in np.flatnonzero(ended):
                final[row] = seen[row].copy()
            infos |= {"final_obs": final, "_final_obs": ended.copy()}
            infos |= {"final_info": _infos(step, ended), "_final_info": ended.copy()}
        observation = within_space(step.observation)
        return observation, step.reward, step.terminated, step.truncated, infos

    def render(self) -> tuple[np.ndarray, ...] | None:
        """A picture (480, 640, 3) of every robot; None without render_mode."""
        if self._painter is None:
            return None
        now = self._task.moment()
        return tuple(self._painter.draw(now, row) for row in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """Free what drawing holds."""
        if self._painter is not None:
            self._painter.close()


def _infos(step: Transition, rows: np.ndarray) -> dict[str, np.ndarray]:
    """What the step tells of the robots where `rows` (B,) is true, with masks."""
    told = dict.fromkeys(("landed", "stairs", "failed"), rows)
    told |= dict.fromkeys(LANDING_ERRORS, rows & step.landed)
    infos = {}
    for name, mask in told.items():
        values = getattr(step, name)
        infos[name] = np.where(mask, values, np.zeros(1, values.dtype))
        infos[f"_{name}"] = mask.copy()
    return infos
