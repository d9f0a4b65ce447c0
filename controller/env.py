"""The walking task of training: B robots, each with its own episode, on flat ground or on stairs.

`TaskConfig` is its settings, `EpisodeSampler` draws how an episode begins, `WalkTask` steps.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from controller.curriculum import Stage
from controller.observation import critic_fields, normaliser, policy_fields, to_heading_frame
from controller.randomization import Disturbances, DomainRandomization
from controller.recovery import change_steps, step_change
from controller.reward_inputs import StepTargets, reward_inputs
from controller.rewards import PRECISE, reward
from controller.stairs import STAIR_MODES, draw_stairs
from controller.step_cursor import STANCE, StepSequence
from controller.step_sequences import MAX_STEPS, PlannedSteps, draw_sequence
from controller.walker import Walker
from planner.plan import wrap_angle
from planner.robot_model import Interval
from sim.engines import MUJOCO, Engine
from sim.robot import Robot
from sim.scene import build_scene

EPISODE_TICKS = 400


@dataclass(frozen=True, kw_only=True)
class TaskConfig:
    """Settings of the walking task.

    A share `stairs_share` of the episodes are on stairs once the curriculum has reached them, with
    the rise of the stage if `exact_rise`, else with rises up to it. A share `planned_share` of the
    flat episodes take steps from the planner's corpus, if there is one. In `paced_share` of the
    episodes step durations are drawn from `step_s`, on stairs none shorter than the robot's gait;
    in the others they are those of the robot's gait. Physics steps last `timestep_s`, or less where
    the robot's model needs shorter ones.

    Raises:
        ValueError: an invalid share, length or noise.
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


class EpisodeSampler:
    """Draws the episodes of a walker's robots: posture, steps, ground and disturbances.

    `mode` is one of `MODES`, `STAIR_MODES` or `standing`. None is a mix of all flat modes, the
    `planned` steps if given, and stairs if the stage has a rise. `on_stairs` (B,) marks the robots
    on stairs.
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
        """Reset robot `row` and draw its steps, ground and disturbances."""
        scene, config, walker = self._walker.scene, self.config, self._walker
        joints = len(walker.robot.joints)
        qpos, qvel = scene.standing_qpos.copy(), np.zeros(scene.model.nv)
        qpos[scene.joint_qpos] += config.joint_noise_rad * rng.uniform(-1, 1, joints)
        qvel[scene.joint_qvel] = config.joint_speed_noise_rad_s * rng.uniform(-1, 1, joints)
        walker.place(row, qpos, qvel)
        steps = int(rng.integers(4, MAX_STEPS + 1))
        if stage.disturbance_level > 0:
            self._disturbances.draw_episode(
                rng, row, stage.disturbance_level, ticks=config.episode_ticks
            )
        else:
            self._disturbances.clear(row)
        walker.latency_ticks[row] = self._disturbances.latency_ticks[row]
        mode = self.mode
        if mode is None and stage.rise_m > 0 and rng.uniform() < config.stairs_share:
            mode = "stairs"
        if mode in STAIR_MODES:
            sequence = self._draw_on_stairs(rng, row, stage, str(mode), steps)
        else:
            sequence = self._draw_on_flat(rng, mode, steps)
        if rng.uniform() < config.paced_share:
            sequence = replace(
                sequence, step_s=self._draw_step_s(rng, sequence, mode in STAIR_MODES)
            )
        walker.follow(row, sequence, wait_ticks=int(rng.integers(config.wait_ticks + 1)))
        self.on_stairs[row] = mode in STAIR_MODES

    def _draw_on_stairs(
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

    def _draw_on_flat(self, rng: np.random.Generator, mode: str | None, steps: int) -> StepSequence:
        if mode is None and self.planned and rng.uniform() < self.config.planned_share:
            return self.planned.draw(rng, self._start_feet, steps=steps)
        model = self._walker.robot.training_model
        return draw_sequence(rng, model, self._start_feet, mode=mode, steps=steps)

    def _draw_step_s(
        self, rng: np.random.Generator, sequence: StepSequence, on_stairs: bool
    ) -> np.ndarray:
        """Durations (N,) of the steps: constant, or changing in half of the episodes."""
        low, high = self.config.step_s
        if on_stairs:
            low = min(max(low, self._walker.robot.gait.step_s), high)
        steps = len(sequence.side) - STANCE
        drawn = rng.uniform(low, high, steps)
        changes = rng.uniform(size=steps) < (0.3 if rng.uniform() < 0.5 else 0.0)
        return np.asarray(drawn[np.maximum.accumulate(np.where(changes, np.arange(steps), 0))])

    def _draw_rise_m(self, rng: np.random.Generator, stage: Stage) -> float:
        """Half of the rises are near the stage's, the others uniform below it."""
        if self.config.exact_rise:
            return stage.rise_m
        low = 0.8 if rng.uniform() < 0.5 else 0.1
        return stage.rise_m * rng.uniform(low, 1.0)


@dataclass(frozen=True, kw_only=True)
class Transition:
    """Result of one control step; all arrays are (B, ...).

    Where an episode ended, `observation` is the first of the next episode.
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
    legs touch, or its simulation is not finite; it is truncated at its full length. `stage` is the
    difficulty of new episodes; for `mode` and `planned` see `EpisodeSampler`. The reward's
    `weights` may be changed between two steps.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        count: int,
        seed: int,
        threads: int = 1,
        engine: Engine = MUJOCO,
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
            build_scene(
                robot,
                timestep_s=min(self.config.timestep_s, robot.longest_timestep_s),
                treads=stairs,
            ),
            count=count,
            threads=threads,
            engine=engine,
            capacity=MAX_STEPS,
        )
        self.ticks = np.zeros(count, dtype=np.int64)
        self._rng = np.random.default_rng(seed)
        self._torque_nm = np.zeros((count, len(robot.joints)))
        self.weights = dict(self.config.reward)
        self._disturbances = Disturbances(
            self.config.randomization, count, len(robot.joints), robot.mass_kg
        )
        self._randomized = False
        self._episodes = EpisodeSampler(
            self.walker, self._disturbances, config=self.config, mode=mode, planned=planned
        )
        self._policy_normaliser = normaliser(policy_fields(robot))
        self._critic_normaliser = normaliser(critic_fields())
        self.restart(seed)

    @property
    def count(self) -> int:
        """Number of robots."""
        return self.walker.sim.count

    def restart(self, seed: int | np.random.SeedSequence, *, stage: Stage | None = None) -> None:
        """Start new episodes for all robots from a seed, at a stage (default: the present one)."""
        self._rng = np.random.default_rng(seed)
        self.stage = stage or self.stage
        if (
            self.stage.disturbance_level > 0 and self.config.randomization.varies_models
        ) or self._randomized:
            self._disturbances.randomize_models(
                self._rng, self.walker.sim, self.stage.disturbance_level
            )
            self._randomized = True
        self.reset(np.arange(self.count))

    def reset(self, rows: np.ndarray) -> None:
        """Start new episodes for the robots `rows`."""
        for row in rows:
            self._episodes.begin(self._episode_rng(int(row)), int(row), self.stage)
        self._torque_nm[rows] = 0.0
        self.ticks[rows] = 0

    def _episode_rng(self, row: int) -> np.random.Generator:
        """What the episodes of robot `row` are drawn with."""
        return self._rng

    def observe(self) -> np.ndarray:
        """The policy's scaled observation (B, N), with the noise of its sensors."""
        offset, scale = self._policy_normaliser
        observation = self.walker.observe()
        self._true_observation = (observation - offset) / scale
        if self.stage.disturbance_level == 0:
            return self._true_observation
        return (self.sense(observation) - offset) / scale

    def sense(self, observation: np.ndarray) -> np.ndarray:
        """An unscaled observation (B, N) with the noise of the present episodes' sensors."""
        return self._disturbances.sense(self._rng, observation)

    def unscaled(self, observation: np.ndarray) -> np.ndarray:
        """The observation before scaling: a policy brings its own scale."""
        offset, scale = self._policy_normaliser
        return observation * scale + offset

    def step(self, action: np.ndarray) -> Transition:
        """Act on every robot, reward it, and start new episodes where one has ended."""
        return self.advance(lambda: self.walker.act(action))

    def advance(self, act: Callable[[], np.ndarray]) -> Transition:
        """The same as `step`, by a function that advances the walker as `Walker.act` does."""
        targets = StepTargets.of(self.walker)
        foot = np.arange(self.count), targets.side
        self._disturbances.push(self.walker.sim, self.ticks)
        landed = act()
        failed = self.walker.sim.failed.copy()
        inputs = reward_inputs(self.walker, targets, self._torque_nm)
        self._torque_nm = self.walker.joint_torque_nm()
        value, terms = reward(inputs, self.weights)
        self.ticks += 1
        terminated = self.walker.fallen()
        truncated = ~terminated & (self.ticks >= self.config.episode_ticks)
        height_error_m = (self.walker.soles_world() - targets.foot_targets)[foot][:, 2]
        on_stairs = self._episodes.on_stairs.copy()
        if self.stage.disturbance_level > 0:
            self._change_steps(~on_stairs & ~terminated)
        self.reset(np.flatnonzero(terminated | truncated))
        observation = self.observe()
        return Transition(
            observation=observation,
            critic_observation=self.critic_observe(),
            reward=np.where(failed, 0.0, value),
            terminated=terminated,
            truncated=truncated,
            failed=failed,
            landed=landed & ~terminated,
            landing_error_m=inputs.foot_error_m[foot],
            landing_heading_error_rad=inputs.foot_heading_error_rad[foot],
            landing_height_error_m=height_error_m,
            stairs=on_stairs,
            terms=terms,
        )

    def _change_steps(self, where: np.ndarray) -> None:
        """Move steps of the robots `where` (B,): some at random, some to recover from a push."""
        if self.config.randomization.moved_share > 0:
            level, rows = self.stage.disturbance_level, np.flatnonzero(where)
            self._disturbances.move_steps(self._rng, self.walker, level, rows)
        pushed = np.flatnonzero(where & self._disturbances.pushed(self.ticks))
        if len(pushed):
            change_steps(self.walker, step_change(self.walker, pushed))

    def critic_observe(self) -> np.ndarray:
        """The critic's scaled observation (B, M), of the states that `observe` saw last.

        It is the policy's without noise, followed by `critic_fields`. The sensors of robots whose
        episodes have just begun still hold the episode before: errors read 0, forces half.
        """
        walker, sim, sensors = self.walker, self.walker.sim, self.walker.scene.sensors
        error = walker.soles_world() - walker.cursor.foot_targets
        error[..., 3] = wrap_angle(error[..., 3])
        error = to_heading_frame(sim.qpos, error)[..., [0, 1, 3]]
        velocity = to_heading_frame(sim.qpos, sim.qvel[:, None, :3])[:, 0]
        height = sim.qpos[:, 2:3] - walker.robot.pelvis_height_m
        force = sim.sensors[:, :, sensors.ground_force_world[:, 2]].mean(axis=1)
        force = force / walker.robot.weight_n
        fresh = self.ticks == 0
        error[fresh], force[fresh] = 0.0, 0.5
        fields = [velocity, height, error.reshape(sim.count, -1), force]
        offset, scale = self._critic_normaliser
        scaled = (np.concatenate(fields, axis=1) - offset) / scale
        return np.concatenate([self._true_observation, scaled], axis=1)
