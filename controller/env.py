"""The training task: B robots that follow tracks drawn anew every episode, flat or on stairs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controller.curriculum import Stage
from controller.episodes import Episodes
from controller.judging import Asked, fallen, joint_torques_nm, privileged, walk_state
from controller.observation import critic_fields, normaliser, policy_fields
from controller.planned import PlannedSteps
from controller.randomization import Disturbances
from controller.rewards import reward
from controller.stairs import STAIR_MODES
from controller.step_sequences import MAX_STEPS
from controller.task_config import TaskConfig
from controller.walker import Walker
from sim.robot import Robot
from sim.scene import build_scene


@dataclass(frozen=True, kw_only=True)
class Transition:
    """What one control step gave; all arrays are (B, ...).

    After a done episode `observation` is already the next episode's first.
    """

    observation: np.ndarray
    critic_observation: np.ndarray
    reward: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    failed: np.ndarray
    landed: np.ndarray
    landing_error_m: np.ndarray
    landing_heading_error_rad: np.ndarray
    landing_height_error_m: np.ndarray
    stairs: np.ndarray
    terms: dict[str, float]


class WalkTask:
    """B robots that walk episodes of at most `episode_ticks` control steps.

    An episode is terminated when the robot has fallen (pelvis too low over the lower foot), its
    legs touch, or the simulation left the finite numbers; it is truncated at its full length.
    `stage` says how hard new episodes are; `mode` is one of `MODES`, `STAIR_MODES` or `standing`,
    and None draws from all flat modes, the planner's own steps if there are any `planned`, and, at
    the stage's rise, stairs.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        count: int,
        seed: int,
        threads: int = 1,
        mode: str | None = None,
        config: TaskConfig | None = None,
        stage: Stage | None = None,
        planned: PlannedSteps | None = None,
    ):
        self.config = config or TaskConfig()
        self.robot = robot
        self.mode = mode
        self.stage = stage or Stage()
        stairs = mode in STAIR_MODES or (mode is None and self.config.stairs_share > 0)
        self.walker = Walker(
            build_scene(robot, timestep_s=self.config.timestep_s, treads=stairs),
            count=count,
            threads=threads,
            capacity=MAX_STEPS,
        )
        self.ticks = np.zeros(count, dtype=np.int64)
        self._rng = np.random.default_rng(seed)
        self._torque = np.zeros((count, len(robot.joints)))
        self._disturbances = Disturbances(self.config.robustness, count, len(robot.joints))
        self._varied = False
        self._episodes = Episodes(
            self.walker, self._disturbances, config=self.config, mode=mode, planned=planned
        )
        self._policy_normaliser = normaliser(policy_fields(robot))
        self._critic_normaliser = normaliser(critic_fields())
        self.restart(seed)

    @property
    def count(self) -> int:
        """How many robots there are."""
        return self.walker.sim.count

    def restart(self, seed: int | np.random.SeedSequence, *, stage: Stage | None = None) -> None:
        """Forget everything and start new episodes from a seed, at a stage (default: as before)."""
        self._rng = np.random.default_rng(seed)
        self.stage = stage or self.stage
        if (self.stage.hardness > 0 and self.config.robustness.varies_models) or self._varied:
            self._disturbances.vary_models(self._rng, self.walker.sim, self.stage.hardness)
            self._varied = True
        self.reset(np.arange(self.count))

    def reset(self, rows: np.ndarray) -> None:
        """Start new episodes for the robots `rows`."""
        for row in rows:
            self._episodes.begin(self._rng, int(row), self.stage)
        self._torque[rows] = 0.0
        self.ticks[rows] = 0

    def observe(self) -> np.ndarray:
        """The policy's scaled observation (B, N), with the noise of its sensors."""
        offset, scale = self._policy_normaliser
        observation = self.walker.observe()
        self._true_observation = (observation - offset) / scale
        if self.stage.hardness == 0:
            return self._true_observation
        return (self._disturbances.sense(self._rng, observation) - offset) / scale

    def step(self, action: np.ndarray) -> Transition:
        """Act on every robot, reward it, and start new episodes where one has ended."""
        asked = Asked.of(self.walker)
        side, rows = asked.side, np.arange(self.count)
        self._disturbances.push(self.walker.sim, self.ticks)
        landed = self.walker.act(action)
        failed = self.walker.sim.failed.copy()
        state = walk_state(self.walker, asked, self._torque)
        self._torque = joint_torques_nm(self.walker)
        value, terms = reward(state, self.config.reward)
        self.ticks += 1
        terminated = failed | fallen(self.walker)
        truncated = ~terminated & (self.ticks >= self.config.episode_ticks)
        errors = state.foot_error_m[rows, side], state.foot_heading_error_rad[rows, side]
        soles_z = self.walker.soles_world()[rows, side, 2]
        height_error_m = soles_z - asked.targets[rows, side, 2]
        on_stairs = self._episodes.on_stairs.copy()
        self.reset(np.flatnonzero(terminated | truncated))
        observation = self.observe()
        return Transition(
            observation=observation,
            critic_observation=self.critic_observe(observation),
            reward=np.where(failed, 0.0, value),
            terminated=terminated,
            truncated=truncated,
            failed=failed,
            landed=landed & ~terminated,
            landing_error_m=errors[0],
            landing_heading_error_rad=errors[1],
            landing_height_error_m=height_error_m,
            stairs=on_stairs,
            terms=terms,
        )

    def critic_observe(self, observation: np.ndarray) -> np.ndarray:
        """What the critic sees (B, M): the true scaled observation and privileged fields.

        `observation` is what `observe` gave last.
        """
        del observation
        offset, scale = self._critic_normaliser
        scaled = (privileged(self.walker, self.ticks == 0) - offset) / scale
        return np.concatenate([self._true_observation, scaled], axis=1)
