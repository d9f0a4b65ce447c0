"""How a control step is judged: what was asked, what the reward and the critic see, who fell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controller.observation import pelvis_yaw_rad, to_heading_frame, wrap_angle_rad
from controller.rewards import WalkState
from controller.swing import lift_reference_m
from controller.walker import Walker

SWING_FOOT_SHARE = 0.7


@dataclass(frozen=True, kw_only=True)
class Asked:
    """What each of B robots was to do when its action was chosen; see `StepCursor`.

    `targets` (B, 2, 4), `window` (B, 2, 4) and `lift_off` (B, 4) are poses in the world, `side`
    (B,), `swinging` (B,), `indicator` (B, 2); `previous_action` (B, J) is the one before.
    """

    targets: np.ndarray
    side: np.ndarray
    window: np.ndarray
    indicator: np.ndarray
    swinging: np.ndarray
    lift_off: np.ndarray
    previous_action: np.ndarray

    @classmethod
    def of(cls, walker: Walker) -> Asked:
        """As it stands now, before the action."""
        cursor = walker.cursor
        return cls(
            targets=cursor.foot_targets,
            side=cursor.side,
            window=cursor.window,
            indicator=cursor.support_indicator,
            swinging=cursor.swinging,
            lift_off=cursor.lift_off_poses,
            previous_action=walker.action,
        )


def walk_state(walker: Walker, asked: Asked, previous_torque_nm: np.ndarray) -> WalkState:
    """What the reward is computed from, after the action; joint torques (B, J) are last step's."""
    sim, sensors, qpos = walker.sim, walker.scene.sensors, walker.sim.qpos
    targets, window, side = asked.targets, asked.window, asked.side
    latest = sim.sensors[:, -1]
    soles = walker.soles_world()
    pelvis = latest[:, sensors.pelvis_pos_world]
    head_offset = latest[:, sensors.head_pos_world[:2]] - pelvis[:, :2]
    torque_change = np.abs(latest[:, sensors.joint_torque] - previous_torque_nm).mean(axis=1)
    share = np.full((sim.count, 2), 0.5)
    rows = np.flatnonzero(asked.swinging)
    share[rows, side[rows]] = SWING_FOOT_SHARE
    share[rows, 1 - side[rows]] = 1 - SWING_FOOT_SHARE
    heading = targets[:, 1, 3] + 0.5 * wrap_angle_rad(targets[:, 0, 3] - targets[:, 1, 3])
    weight_n = walker.robot.mass_kg * 9.81
    force_z = sim.sensors[:, :, sensors.ground_force_world[:, 2]].mean(axis=1)
    ground_z = targets[..., 2].copy()
    ground_z[rows, side[rows]] = lift_reference_m(
        soles[rows, side[rows]], asked.lift_off[rows], targets[rows, side[rows]]
    )
    to_present = soles[:, :, :3] - window[:, None, 0, :3]
    return WalkState(
        support_indicator=asked.indicator,
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
        height_error_m=pelvis[:, 2] - soles[..., 2].min(axis=1) - walker.robot.pelvis_height_m,
        head_offset_m=np.linalg.norm(head_offset, axis=1),
        action_change_rad=np.abs(walker.action - asked.previous_action).mean(axis=1),
        torque_change_nm=torque_change,
    )


def joint_torques_nm(walker: Walker) -> np.ndarray:
    """Torques (B, J) at the end of the control step."""
    return walker.sim.sensors[:, -1][:, walker.scene.sensors.joint_torque]


def fallen(walker: Walker) -> np.ndarray:
    """Too low, or the legs touching, at the end of the control step (B,)."""
    sensors = walker.scene.sensors
    latest = walker.sim.sensors[:, -1]
    lower_sole_z = latest[:, sensors.sole_pos_world[:, 2]].min(axis=1)
    low = latest[:, sensors.pelvis_pos_world[2]] - lower_sole_z < walker.robot.fallen_height_m
    touching = walker.sim.sensors[:, :, sensors.legs_touching[0]].max(axis=1) > 0
    return np.asarray(low | touching)


def privileged(walker: Walker, fresh: np.ndarray) -> np.ndarray:
    """What the critic sees besides (B, M), before scaling: see `critic_fields`.

    Of `fresh` (B,) robots, whose episodes have just begun, the sensors still show the one before.
    """
    sim, sensors, qpos = walker.sim, walker.scene.sensors, walker.sim.qpos
    error = walker.soles_world() - walker.cursor.foot_targets
    error[..., 3] = wrap_angle_rad(error[..., 3])
    error = to_heading_frame(qpos, error)[..., [0, 1, 3]]
    velocity = to_heading_frame(qpos, sim.qvel[:, None, :3])[:, 0]
    height = qpos[:, 2:3] - walker.robot.pelvis_height_m
    force = sim.sensors[:, :, sensors.ground_force_world[:, 2]].mean(axis=1)
    force = force / (walker.robot.mass_kg * 9.81)
    error[fresh], force[fresh] = 0.0, 0.5
    return np.concatenate([velocity, height, error.reshape(sim.count, -1), force], axis=1)
