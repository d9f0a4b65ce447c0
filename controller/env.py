"""The training task: B robots that follow tracks drawn anew every episode, flat or on stairs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from controller.curriculum import Stage
from controller.gait import CONTROL_PERIOD_S
from controller.observation import (
    critic_fields,
    normaliser,
    pelvis_yaw_rad,
    policy_fields,
    to_heading_frame,
    wrap_angle_rad,
)
from controller.planned import PlannedSteps
from controller.reward import PRECISE, WalkState, reward
from controller.robustness import Disturbances, Robustness
from controller.sequences import MAX_STEPS, draw_track
from controller.stairs import STAIR_MODES, draw_stairs
from controller.swing import lift_reference_m
from controller.walker import Walker
from sim.robot import Robot
from sim.scene import build_scene

EPISODE_TICKS = 400
SWING_FOOT_SHARE = 0.7


@dataclass(frozen=True, kw_only=True)
class TaskConfig:
    """What is trained on.

    `stairs_share` of the episodes are on stairs once the curriculum has come to them. Where
    `exact_rise` is set, all their rises are the stage's own, else they are drawn up to it.
    `planned_share` of the flat episodes walk steps of the planner's corpus, if there is one.
    """

    timestep_s: float = 0.005
    episode_ticks: int = EPISODE_TICKS
    joint_noise_rad: float = 0.02
    joint_speed_noise_rad_s: float = 0.2
    wait_ticks: int = 20
    stairs_share: float = 0.38
    planned_share: float = 0.25
    exact_rise: bool = False
    robustness: Robustness = field(default_factory=Robustness)
    reward: Mapping[str, float] = field(default_factory=lambda: dict(PRECISE))


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
        self.planned = planned
        self.stage = stage or Stage()
        stairs = mode in STAIR_MODES or (mode is None and self.config.stairs_share > 0)
        self.walker = Walker(
            build_scene(robot, timestep_s=self.config.timestep_s, treads=stairs),
            count=count,
            threads=threads,
            capacity=MAX_STEPS,
        )
        self.ticks = np.zeros(count, dtype=np.int64)
        self.on_stairs = np.zeros(count, dtype=bool)
        self._rng = np.random.default_rng(seed)
        self._torque = np.zeros((count, len(robot.joints)))
        self._disturbances = Disturbances(self.config.robustness, count, len(robot.joints))
        self._varied = False
        self._start_feet = self.walker.scene.soles_at(self.walker.scene.standing_qpos)
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
        scene, config, rng = self.walker.scene, self.config, self._rng
        joints = len(self.robot.joints)
        for row in rows:
            qpos, qvel = scene.standing_qpos.copy(), np.zeros(scene.model.nv)
            qpos[scene.joint_qpos] += config.joint_noise_rad * rng.uniform(-1, 1, joints)
            qvel[scene.joint_qvel] = config.joint_speed_noise_rad_s * rng.uniform(-1, 1, joints)
            self.walker.place(int(row), qpos, qvel)
            self._draw_episode(int(row))
        self._torque[rows] = 0.0
        self.ticks[rows] = 0

    def _draw_episode(self, row: int) -> None:
        """Give robot `row`, just placed, its steps, its ground and its disturbances."""
        config, stage, rng, disturbances = self.config, self.stage, self._rng, self._disturbances
        steps = int(rng.integers(4, MAX_STEPS + 1))
        if stage.hardness > 0:
            disturbances.draw_episode(
                rng, row, stage.hardness, period_s=CONTROL_PERIOD_S, ticks=config.episode_ticks
            )
            self.walker.late_ticks[row] = disturbances.late_ticks[row]
        mode, model = self.mode, self.robot.training_model
        if mode is None and stage.rise_m > 0 and rng.uniform() < config.stairs_share:
            mode = "stairs"
        if mode in STAIR_MODES:
            track, ground = draw_stairs(
                rng,
                model,
                self._start_feet,
                mode=str(mode),
                rise_m=self._draw_rise_m(),
                steps=steps,
                tread_error_m=disturbances.draw_tread_error_m(rng, stage.hardness),
            )
            self.walker.sim.place_ground(row, ground)
        elif mode is None and self.planned and rng.uniform() < config.planned_share:
            track = self.planned.draw(rng, self._start_feet, steps=steps)
        else:
            track = draw_track(rng, model, self._start_feet, mode=mode, steps=steps)
        wait_ticks = int(rng.integers(config.wait_ticks + 1))
        self.walker.follow(row, track, wait_ticks=wait_ticks)
        self.on_stairs[row] = mode in STAIR_MODES

    def _draw_rise_m(self) -> float:
        """Half of the rises are near the stage's, the others anywhere below."""
        if self.config.exact_rise:
            return self.stage.rise_m
        low = 0.8 if self._rng.uniform() < 0.5 else 0.1
        return self.stage.rise_m * self._rng.uniform(low, 1.0)

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
        cursor = self.walker.cursor
        targets, side = cursor.foot_targets, cursor.side
        window, indicator = cursor.window, cursor.support_indicator
        swinging, previous_action = cursor.swinging, self.walker.action
        lift_off = cursor.lift_off_poses
        self._disturbances.push(self.walker.sim, self.ticks)
        landed = self.walker.act(action)
        failed = self.walker.sim.failed.copy()
        state = self._walk_state(
            targets, window, indicator, swinging, side, previous_action, lift_off
        )
        value, terms = reward(state, self.config.reward)
        self.ticks += 1
        terminated = failed | self._fallen()
        truncated = ~terminated & (self.ticks >= self.config.episode_ticks)
        rows = np.arange(self.count)
        errors = state.foot_error_m[rows, side], state.foot_heading_error_rad[rows, side]
        soles_z = self.walker.soles_world()[rows, side, 2]
        height_error_m = soles_z - targets[rows, side, 2]
        on_stairs = self.on_stairs.copy()
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

    def _fallen(self) -> np.ndarray:
        """Too low, or the legs touching, at the end of the control step (B,)."""
        sensors = self.walker.scene.sensors
        latest = self.walker.sim.sensors[:, -1]
        lower_sole_z = latest[:, sensors.sole_pos_world[:, 2]].min(axis=1)
        low = latest[:, sensors.pelvis_pos_world[2]] - lower_sole_z < self.robot.fallen_height_m
        touching = self.walker.sim.sensors[:, :, sensors.legs_touching[0]].max(axis=1) > 0
        return np.asarray(low | touching)

    def _walk_state(
        self,
        targets: np.ndarray,
        window: np.ndarray,
        indicator: np.ndarray,
        swinging: np.ndarray,
        side: np.ndarray,
        previous_action: np.ndarray,
        lift_off: np.ndarray,
    ) -> WalkState:
        """What the reward is computed from; arrays as they were when the action was chosen."""
        sim, sensors, qpos = self.walker.sim, self.walker.scene.sensors, self.walker.sim.qpos
        latest = sim.sensors[:, -1]
        soles = self.walker.soles_world()
        pelvis = latest[:, sensors.pelvis_pos_world]
        head_offset = latest[:, sensors.head_pos_world[:2]] - pelvis[:, :2]
        torque = latest[:, sensors.joint_torque]
        torque_change, self._torque = np.abs(torque - self._torque).mean(axis=1), torque
        share = np.full((self.count, 2), 0.5)
        rows = np.flatnonzero(swinging)
        share[rows, side[rows]] = SWING_FOOT_SHARE
        share[rows, 1 - side[rows]] = 1 - SWING_FOOT_SHARE
        heading = targets[:, 1, 3] + 0.5 * wrap_angle_rad(targets[:, 0, 3] - targets[:, 1, 3])
        weight_n = self.robot.mass_kg * 9.81
        force_z = sim.sensors[:, :, sensors.ground_force_world[:, 2]].mean(axis=1)
        ground_z = targets[..., 2].copy()
        ground_z[rows, side[rows]] = lift_reference_m(
            soles[rows, side[rows]], lift_off[rows], targets[rows, side[rows]]
        )
        to_present = soles[:, :, :3] - window[:, None, 0, :3]
        return WalkState(
            support_indicator=indicator,
            ground_force_weights=force_z / weight_n,
            sole_speed_m_s=np.linalg.norm(latest[:, sensors.sole_linvel_world], axis=2),
            sole_height_m=soles[..., 2] - ground_z,
            foot_error_m=np.linalg.norm(soles[..., :2] - targets[..., :2], axis=2),
            foot_heading_error_rad=np.abs(wrap_angle_rad(soles[..., 3] - targets[..., 3])),
            target_distance_m=np.linalg.norm(to_present, axis=2).min(axis=1),
            root_distance_m=np.linalg.norm(pelvis[:, :2] - window[..., :2].mean(axis=1), axis=1),
            swing_share=share,
            tilt_rad=np.arccos(np.clip(1 - 2 * (qpos[:, 4] ** 2 + qpos[:, 5] ** 2), -1, 1)),
            heading_error_rad=wrap_angle_rad(pelvis_yaw_rad(qpos) - heading),
            tilt_cos=qpos[:, 3] * np.cos(heading / 2) + qpos[:, 6] * np.sin(heading / 2),
            height_error_m=pelvis[:, 2] - soles[..., 2].min(axis=1) - self.robot.pelvis_height_m,
            head_offset_m=np.linalg.norm(head_offset, axis=1),
            action_change_rad=np.abs(self.walker.action - previous_action).mean(axis=1),
            torque_change_nm=torque_change,
        )

    def critic_observe(self, observation: np.ndarray) -> np.ndarray:
        """What the critic sees (B, M): the true scaled observation and privileged fields.

        `observation` is what `observe` gave last.
        """
        del observation
        sim, sensors, qpos = self.walker.sim, self.walker.scene.sensors, self.walker.sim.qpos
        error = self.walker.soles_world() - self.walker.cursor.foot_targets
        error[..., 3] = wrap_angle_rad(error[..., 3])
        error = to_heading_frame(qpos, error)[..., [0, 1, 3]]
        velocity = to_heading_frame(qpos, sim.qvel[:, None, :3])[:, 0]
        height = qpos[:, 2:3] - self.robot.pelvis_height_m
        force = sim.sensors[:, :, sensors.ground_force_world[:, 2]].mean(axis=1)
        force = force / (self.robot.mass_kg * 9.81)
        fresh = self.ticks == 0  # sensors still show the episode before
        error[fresh], force[fresh] = 0.0, 0.5
        privileged = np.concatenate(
            [velocity, height, error.reshape(self.count, -1), force], axis=1
        )
        offset, scale = self._critic_normaliser
        return np.concatenate([self._true_observation, (privileged - offset) / scale], axis=1)
