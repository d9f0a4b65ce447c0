"""The training task: B robots that follow sequences drawn anew every episode, flat or on stairs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from controller.curriculum import Stage
from controller.gait import CONTROL_PERIOD_S
from controller.observation import critic_fields, normaliser, policy_fields
from controller.randomization import Disturbances, DomainRandomization
from controller.rewards import (
    PRECISE,
    StepTargets,
    fallen,
    joint_torques_nm,
    privileged,
    reward,
    walk_state,
)
from controller.stairs import STAIR_MODES, draw_stairs
from controller.step_cursor import STANCE, StepSequence
from controller.step_sequences import MAX_STEPS, PlannedSteps, draw_sequence
from controller.walker import Walker
from planner.robot_model import Interval
from sim.robot import Robot
from sim.scene import build_scene

# What the walking task trains on, as one value.

EPISODE_TICKS = 400


@dataclass(frozen=True, kw_only=True)
class TaskConfig:
    """What is trained on.

    `stairs_share` of the episodes are on stairs once the curriculum has come to them. Where
    `exact_rise` is set, all their rises are the stage's own, else they are drawn up to it.
    `planned_share` of the flat episodes walk steps of the planner's corpus, if there is one. In
    `paced_share` of the episodes steps take times drawn from `step_s`, on stairs none shorter than
    the robot's own gait; in the others they take that.

    Raises:
        ValueError: a share, length or noise that no episode can have.
    """

    timestep_s: float = 0.005
    episode_ticks: int = EPISODE_TICKS
    joint_noise_rad: float = 0.02
    joint_speed_noise_rad_s: float = 0.2
    wait_ticks: int = 20
    stairs_share: float = 0.38
    planned_share: float = 0.35
    paced_share: float = 0.55
    step_s: Interval = (0.7, 1.4)
    exact_rise: bool = False
    randomization: DomainRandomization = field(default_factory=DomainRandomization)
    reward: Mapping[str, float] = field(default_factory=lambda: dict(PRECISE))

    def __post_init__(self) -> None:
        for name in ("stairs_share", "planned_share", "paced_share"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} {getattr(self, name)} must be from 0 to 1")
        for name in ("joint_noise_rad", "joint_speed_noise_rad_s", "wait_ticks"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{name} {value} must be a finite number of 0 or more")
        if self.episode_ticks < 1:
            raise ValueError(f"episode_ticks {self.episode_ticks} must be at least 1")


# How an episode begins: the posture, the steps, the ground under them and what disturbs.


class Episodes:
    """Draws the episodes of the robots of a walker.

    `mode` is one of `MODES`, `STAIR_MODES` or `standing`, and None draws from all flat modes, the
    planner's own steps if there are any `planned`, and, at the stage's rise, stairs. `on_stairs`
    (B,) tells which robots are on stairs.
    """

    def __init__(
        self,
        walker: Walker,
        disturbances: Disturbances,
        *,
        config: TaskConfig,
        mode: str | None,
        planned: PlannedSteps | None,
    ):
        self.config, self.mode, self.planned = config, mode, planned
        self.on_stairs = np.zeros(walker.sim.count, dtype=bool)
        self._walker, self._disturbances = walker, disturbances
        self._start_feet = walker.scene.soles_at(walker.scene.standing_qpos)

    def begin(self, rng: np.random.Generator, row: int, stage: Stage) -> None:
        """Put robot `row` where it starts, and give it its steps, ground and disturbances."""
        scene, config, walker = self._walker.scene, self.config, self._walker
        joints = len(walker.robot.joints)
        qpos, qvel = scene.standing_qpos.copy(), np.zeros(scene.model.nv)
        qpos[scene.joint_qpos] += config.joint_noise_rad * rng.uniform(-1, 1, joints)
        qvel[scene.joint_qvel] = config.joint_speed_noise_rad_s * rng.uniform(-1, 1, joints)
        walker.place(row, qpos, qvel)
        steps = int(rng.integers(4, MAX_STEPS + 1))
        if stage.disturbance_level > 0:
            self._disturbances.draw_episode(
                rng,
                row,
                stage.disturbance_level,
                period_s=CONTROL_PERIOD_S,
                ticks=config.episode_ticks,
            )
        else:
            self._disturbances.clear(row)
        walker.latency_ticks[row] = self._disturbances.latency_ticks[row]
        mode = self.mode
        if mode is None and stage.rise_m > 0 and rng.uniform() < config.stairs_share:
            mode = "stairs"
        if mode in STAIR_MODES:
            sequence = self._on_stairs(rng, row, stage, str(mode), steps)
        else:
            sequence = self._on_the_level(rng, mode, steps)
        if rng.uniform() < config.paced_share:
            sequence = replace(
                sequence, step_s=self._draw_step_s(rng, sequence, mode in STAIR_MODES)
            )
        walker.follow(row, sequence, wait_ticks=int(rng.integers(config.wait_ticks + 1)))
        self.on_stairs[row] = mode in STAIR_MODES

    def _on_stairs(
        self, rng: np.random.Generator, row: int, stage: Stage, mode: str, steps: int
    ) -> StepSequence:
        sequence, ground = draw_stairs(
            rng,
            self._walker.robot.training_model,
            self._start_feet,
            mode=mode,
            rise_m=self._draw_rise_m(rng, stage),
            steps=steps,
            tread_error_m=self._disturbances.draw_tread_error_m(rng, stage.disturbance_level),
        )
        self._walker.sim.place_ground(row, ground)
        return sequence

    def _on_the_level(self, rng: np.random.Generator, mode: str | None, steps: int) -> StepSequence:
        if mode is None and self.planned and rng.uniform() < self.config.planned_share:
            return self.planned.draw(rng, self._start_feet, steps=steps)
        model = self._walker.robot.training_model
        return draw_sequence(rng, model, self._start_feet, mode=mode, steps=steps)

    def _draw_step_s(
        self, rng: np.random.Generator, sequence: StepSequence, on_stairs: bool
    ) -> np.ndarray:
        """Durations (N,) of the steps: one for all, or in half of the episodes one that changes."""
        low, high = self.config.step_s
        if on_stairs:
            low = min(max(low, self._walker.robot.gait.step_s), high)
        steps = len(sequence.side) - STANCE
        drawn = rng.uniform(low, high, steps)
        changes = rng.uniform(size=steps) < (0.3 if rng.uniform() < 0.5 else 0.0)
        return np.asarray(drawn[np.maximum.accumulate(np.where(changes, np.arange(steps), 0))])

    def _draw_rise_m(self, rng: np.random.Generator, stage: Stage) -> float:
        """Half of the rises are near the stage's, the others anywhere below."""
        if self.config.exact_rise:
            return stage.rise_m
        low = 0.8 if rng.uniform() < 0.5 else 0.1
        return stage.rise_m * rng.uniform(low, 1.0)


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
    the stage's rise, stairs. `weights` of the reward may be changed between two steps.
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
        self.weights = dict(self.config.reward)
        self._disturbances = Disturbances(self.config.randomization, count, len(robot.joints))
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
        if (
            self.stage.disturbance_level > 0 and self.config.randomization.varies_models
        ) or self._varied:
            self._disturbances.vary_models(self._rng, self.walker.sim, self.stage.disturbance_level)
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
        if self.stage.disturbance_level == 0:
            return self._true_observation
        return (self._disturbances.sense(self._rng, observation) - offset) / scale

    def step(self, action: np.ndarray) -> Transition:
        """Act on every robot, reward it, and start new episodes where one has ended."""
        asked = StepTargets.of(self.walker)
        side, rows = asked.side, np.arange(self.count)
        self._disturbances.push(self.walker.sim, self.ticks)
        landed = self.walker.act(action)
        failed = self.walker.sim.failed.copy()
        state = walk_state(self.walker, asked, self._torque)
        self._torque = joint_torques_nm(self.walker)
        value, terms = reward(state, self.weights)
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
