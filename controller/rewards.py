"""Reward terms: pure functions of arrays (B, ...) to (B,), each in [-1, 1], and their weights.

The terms of `PAPER` are those of Singh et al. 2022, sec. IV-C. `PRECISE` asks for more: the
*named* foot on its own target, measured more sharply the nearer it gets, with its heading.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from controller.gait import CONTROL_PERIOD_S
from controller.observation import pelvis_yaw_rad, to_heading_frame, wrap_angle_rad
from controller.walker import Walker

TARGET_RADIUS_M = 0.20
FOOT_SPEED_SCALE_M_S = 0.4
SWING_HEIGHT_M = 0.06
HIGH_SWING_M = 0.10
SWING_APEX_M = 0.075
# How fast a sole may be: so fast at the ground, so much faster per metre above it, up to a height.
TOUCHDOWN_M_S, FASTER_PER_S, NEAR_GROUND_M = 0.08, 12.0, 0.06


@dataclass(frozen=True, kw_only=True)
class WalkState:
    """What the terms are computed from; forces are means over the control step."""

    support_indicator: np.ndarray  # (B, 2) in [-1, 1], left then right
    ground_force_weights: np.ndarray  # (B, 2) vertical force over the robot's weight
    sole_speed_m_s: np.ndarray  # (B, 2)
    sole_height_m: np.ndarray  # (B, 2) above where the foot is to stand
    foot_error_m: np.ndarray  # (B, 2) of each foot from its own target
    foot_heading_error_rad: np.ndarray  # (B, 2) absolute
    target_distance_m: np.ndarray  # (B,) of the present step from the nearer foot
    root_distance_m: np.ndarray  # (B,) of the pelvis from midway between the two next steps
    swing_share: np.ndarray  # (B, 2) how the foot errors are weighed, sums to 1
    tilt_rad: np.ndarray  # (B,) of the pelvis's z axis from the vertical
    heading_error_rad: np.ndarray  # (B,) of the pelvis from the mean of the feet's targets
    tilt_cos: np.ndarray  # (B,) <q, q*> of the pelvis with the upright one of that heading
    height_error_m: np.ndarray  # (B,) pelvis above the lower sole, from its standing height
    head_offset_m: np.ndarray  # (B,) horizontal, of the head from the pelvis
    action_change_rad: np.ndarray  # (B,) mean absolute
    torque_change_nm: np.ndarray  # (B,) mean absolute
    swing_height_error_m: np.ndarray  # (B,) of the swing foot from its height profile; else 0
    climb_m: np.ndarray  # (B,) height between the places that the feet are at and go to
    step_s: np.ndarray  # (B,) duration of the present step
    pelvis_speed_z_m_s: np.ndarray  # (B,) upward
    power_w: np.ndarray  # (B,) sum over the joints of |torque * speed|
    posture_error_rad: np.ndarray  # (B,) mean absolute, of the joints from half-sitting
    standing: np.ndarray  # (B,) asked to stand
    peak_force_weights: np.ndarray  # (B,) of one foot, over the physics steps
    hasty_m_s: np.ndarray  # (B, 2) by how much soles are faster than so near the ground


def ground_force(s: WalkState) -> np.ndarray:
    """Weight on the support feet and none on the swing foot; half the weight counts as full."""
    force = 2 * np.clip(2 * s.ground_force_weights, 0.0, 1.0) - 1
    return np.mean(s.support_indicator * force, axis=1)


def foot_speed(s: WalkState) -> np.ndarray:
    """Support feet at rest, swing foot moving."""
    speed = 2 * np.clip(s.sole_speed_m_s / FOOT_SPEED_SCALE_M_S, 0.0, 1.0) - 1
    return np.mean(-s.support_indicator * speed, axis=1)


def any_foot_step(s: WalkState) -> np.ndarray:
    """The paper's: whichever foot is within the target radius, and the pelvis near."""
    hit = np.exp(-s.target_distance_m / 0.25) * (s.target_distance_m <= TARGET_RADIUS_M)
    return 0.8 * hit + 0.2 * np.exp(-s.root_distance_m / 2)


def named_foot_step(s: WalkState) -> np.ndarray:
    """Each foot near its own target, with one wide kernel to draw it and one narrow to place it."""
    near = 0.4 * np.exp(-s.foot_error_m / 0.25) + 0.6 * np.exp(-s.foot_error_m / 0.04)
    return np.sum(s.swing_share * near, axis=1)


def named_foot_heading(s: WalkState) -> np.ndarray:
    """Each foot along its own target's heading."""
    return np.sum(s.swing_share * np.exp(-s.foot_heading_error_rad / 0.1), axis=1)


def swing_clearance(s: WalkState) -> np.ndarray:
    """The swing foot lifted clear of the ground in the middle of its swing, and not much more.

    `foot_speed` asks a swing foot to move; where the step is short, up is as good as forward to it.
    """
    lift = np.clip(s.sole_height_m / SWING_HEIGHT_M, 0.0, 1.0)
    excess = np.clip(s.sole_height_m / HIGH_SWING_M - 1, 0.0, 1.0)
    return np.min(np.where(s.support_indicator <= -1.0, lift - excess, 1.0), axis=1)


def orientation(s: WalkState) -> np.ndarray:
    """Pelvis upright and heading where the feet do."""
    return np.exp(-10 * (1 - s.tilt_cos**2))


def upright(s: WalkState) -> np.ndarray:
    """Pelvis upright; sharper than the paper's, since a body that leans needs wider passages."""
    return np.exp(-s.tilt_rad / 0.1)


def facing(s: WalkState) -> np.ndarray:
    """Pelvis heading where the feet do."""
    return np.exp(-np.abs(s.heading_error_rad) / 0.2)


def height(s: WalkState) -> np.ndarray:
    """Pelvis at its standing height."""
    return np.exp(-40 * s.height_error_m**2)


def standing_height(s: WalkState) -> np.ndarray:
    """Pelvis at its standing height; sharper than the paper's, which lets a robot walk crouched."""
    return np.exp(-np.abs(s.height_error_m) / 0.1)


def upper_body(s: WalkState) -> np.ndarray:
    """Head above the pelvis."""
    return np.exp(-10 * s.head_offset_m**2)


def action_smoothness(s: WalkState) -> np.ndarray:
    """Little change of the action."""
    return np.exp(-5 * s.action_change_rad)


def torque_smoothness(s: WalkState) -> np.ndarray:
    """Little change of the joint torques."""
    return np.exp(-0.25 * s.torque_change_nm)


def stance_at_rest(s: WalkState) -> np.ndarray:
    """Support feet at rest."""
    weight = (1 + s.support_indicator) / 2
    rest = np.exp(-s.sole_speed_m_s / 0.1)
    return np.sum(weight * rest, axis=1) / np.sum(weight, axis=1)


def swing_profile(s: WalkState) -> np.ndarray:
    """The swing foot on its height profile, with a wide kernel to draw it and a narrow one."""
    error_m = np.abs(s.swing_height_error_m)
    return 0.5 * np.exp(-error_m / 0.05) + 0.5 * np.exp(-error_m / 0.015)


def pelvis_height(s: WalkState) -> np.ndarray:
    """Pelvis at its standing height, but for what a climb between two places needs."""
    return np.exp(-np.maximum(np.abs(s.height_error_m) - s.climb_m, 0.0) / 0.04)


def pelvis_speed(s: WalkState) -> np.ndarray:
    """Pelvis neither rising nor falling, but for what a climb needs."""
    allowed_m_s = 1.5 * s.climb_m / s.step_s
    return np.exp(-np.maximum(np.abs(s.pelvis_speed_z_m_s) - allowed_m_s, 0.0) / 0.1)


def power(s: WalkState) -> np.ndarray:
    """Little mechanical power of the joints."""
    return np.exp(-s.power_w / 150)


def standing_posture(s: WalkState) -> np.ndarray:
    """Half-sitting where the robot is to stand."""
    return np.where(s.standing, np.exp(-s.posture_error_rad / 0.05), 1.0)


def peak_force(s: WalkState) -> np.ndarray:
    """No foot that bears much more than the weight, at any physics step."""
    return np.exp(-np.maximum(s.peak_force_weights - 1.0, 0.0) / 0.3)


def soft_landing(s: WalkState) -> np.ndarray:
    """A sole near the ground hardly moves: it comes down, and leaves, slowly and straight."""
    return np.exp(-s.hasty_m_s.max(axis=1) / 0.15)


TERMS = {
    term.__name__: term
    for term in (
        ground_force,
        foot_speed,
        any_foot_step,
        named_foot_step,
        named_foot_heading,
        swing_clearance,
        orientation,
        upright,
        facing,
        height,
        standing_height,
        upper_body,
        action_smoothness,
        torque_smoothness,
        stance_at_rest,
        swing_profile,
        pelvis_height,
        pelvis_speed,
        power,
        standing_posture,
        peak_force,
        soft_landing,
    )
}

PAPER: Mapping[str, float] = {
    "ground_force": 0.15,
    "foot_speed": 0.15,
    "any_foot_step": 0.45,
    "orientation": 0.05,
    "height": 0.05,
    "upper_body": 0.05,
    "action_smoothness": 0.05,
    "torque_smoothness": 0.05,
}
PRECISE: Mapping[str, float] = {
    "ground_force": 0.14,
    "foot_speed": 0.10,
    "named_foot_step": 0.35,
    "named_foot_heading": 0.07,
    "swing_clearance": 0.05,
    "upright": 0.07,
    "facing": 0.05,
    "standing_height": 0.08,
    "upper_body": 0.02,
    "action_smoothness": 0.04,
    "torque_smoothness": 0.03,
}
# Upright, quiet and frugal. From nothing it teaches to stand still: see `RewardSchedule`.
QUIET: Mapping[str, float] = {
    "ground_force": 0.11,
    "named_foot_step": 0.30,
    "named_foot_heading": 0.06,
    "stance_at_rest": 0.05,
    "swing_profile": 0.09,
    "soft_landing": 0.05,
    "upright": 0.05,
    "facing": 0.04,
    "pelvis_height": 0.06,
    "pelvis_speed": 0.04,
    "power": 0.04,
    "standing_posture": 0.03,
    "peak_force": 0.03,
    "action_smoothness": 0.03,
    "torque_smoothness": 0.02,
}
PRESETS = {"paper": PAPER, "precise": PRECISE, "quiet": QUIET}


@dataclass(frozen=True, kw_only=True)
class RewardSchedule:
    """Weights that change over a run: `first` until a share of it, then toward `last`.

    Between the shares `blend` (from, to) of the run the weights are interpolated. What is calm
    pays more under `QUIET` than a first step does, so walking is learned under `PRECISE`.
    """

    first: Mapping[str, float]
    last: Mapping[str, float]
    blend: tuple[float, float] = (0.17, 0.4)

    def progress(self, share: float) -> float:
        """How far the weights are on their way, in [0, 1], when `share` of the run is done."""
        low, high = self.blend
        return min(max((share - low) / (high - low), 0.0), 1.0)

    def at(self, share: float) -> dict[str, float]:
        """The weights when `share` in [0, 1] of the run is done."""
        t = self.progress(share)
        names = dict.fromkeys((*self.first, *self.last))
        weights = {n: (1 - t) * self.first.get(n, 0.0) + t * self.last.get(n, 0.0) for n in names}
        return {name: weight for name, weight in weights.items() if weight > 0}


def reward(state: WalkState, weights: Mapping[str, float]) -> tuple[np.ndarray, dict[str, float]]:
    """The weighted sum (B,) and each term's batch mean.

    Raises:
        KeyError: a weight names no term.
    """
    values = {name: TERMS[name](state) for name in weights}
    total = sum(weight * values[name] for name, weight in weights.items())
    return np.asarray(total), {name: float(value.mean()) for name, value in values.items()}


# How high the ground under a swinging foot is taken to be, between two heights.


def lift_reference_m(sole: np.ndarray, start: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Height (n,) above which a swinging foot is to be lifted, from poses (n, 4) in the world.

    Going up it grows from the start's height to the target's over the first half of the
    horizontal way, since the toe passes the edges ahead of the foot's middle; going down it falls
    over the second half, since the heel clears them late.
    """
    way = target[:, :2] - start[:, :2]
    length_2 = np.maximum(np.sum(way**2, axis=1), 1e-6)
    done = np.clip(np.sum((sole[:, :2] - start[:, :2]) * way, axis=1) / length_2, 0.0, 1.0)
    change = target[:, 2] - start[:, 2]
    share = np.where(change > 0, np.minimum(2 * done, 1.0), np.maximum(2 * done - 1.0, 0.0))
    return np.asarray(start[:, 2] + share * change)


def swing_profile_m(from_ends_s: np.ndarray) -> np.ndarray:
    """Height of a swing foot over its ground, so long (n,) from the nearer end of its swing.

    It leaves and comes down with `TOUCHDOWN_M_S`, is faster the higher it is, dv/dh =
    `FASTER_PER_S`, and stays at `SWING_APEX_M` between.
    """
    rising_m = TOUCHDOWN_M_S / FASTER_PER_S * np.expm1(FASTER_PER_S * from_ends_s)
    return np.asarray(np.minimum(rising_m, SWING_APEX_M))


# How a control step is judged: what was asked, what the reward and the critic see, who fell.

SWING_FOOT_SHARE = 0.7


@dataclass(frozen=True, kw_only=True)
class StepTargets:
    """What each of B robots was to do when its action was chosen; see `StepCursor`.

    `targets` (B, 2, 4), `window` (B, 2, 4) and `lift_off` (B, 4) are poses in the world, `side`
    (B,), `swinging` (B,), `indicator` (B, 2); `previous_action` (B, J) is the one before.
    `from_ends_s` (B,) is from the nearer end of the swing to the end of the
    action; `step_s` (B,) the step takes; `standing` (B,).
    """

    targets: np.ndarray
    side: np.ndarray
    window: np.ndarray
    indicator: np.ndarray
    swinging: np.ndarray
    lift_off: np.ndarray
    previous_action: np.ndarray
    from_ends_s: np.ndarray
    step_s: np.ndarray
    standing: np.ndarray

    @classmethod
    def of(cls, walker: Walker) -> StepTargets:
        """As it stands now, before the action."""
        cursor = walker.cursor
        ended = cursor.tick + 1
        return cls(
            targets=cursor.foot_targets,
            side=cursor.side,
            window=cursor.window,
            indicator=cursor.support_indicator,
            swinging=cursor.swinging,
            lift_off=cursor.lift_off_poses,
            previous_action=walker.action,
            from_ends_s=np.maximum(np.minimum(ended, cursor.ticks.swing - ended), 0)
            * CONTROL_PERIOD_S,
            step_s=cursor.step_s[:, 0],
            standing=cursor.standing,
        )


def walk_state(walker: Walker, asked: StepTargets, previous_torque_nm: np.ndarray) -> WalkState:
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
    sole_height_m = soles[..., 2] - ground_z
    swing_error_m = np.zeros(sim.count)
    swing_error_m[rows] = sole_height_m[rows, side[rows]] - swing_profile_m(asked.from_ends_s[rows])
    climb_m = np.abs(asked.targets[:, 0, 2] - asked.targets[:, 1, 2])
    climb_m[rows] = np.maximum(
        climb_m[rows], np.abs(targets[rows, side[rows], 2] - asked.lift_off[rows, 2])
    )
    sole_speed = np.linalg.norm(latest[:, sensors.sole_linvel_world], axis=2)
    allowed_m_s = TOUCHDOWN_M_S + FASTER_PER_S * np.maximum(sole_height_m, 0.0)
    hasty_m_s = np.where(
        sole_height_m < NEAR_GROUND_M, np.maximum(sole_speed - allowed_m_s, 0.0), 0.0
    )
    joint_speed = sim.qvel[:, walker.scene.joint_qvel]
    posture = qpos[:, walker.scene.joint_qpos] - walker.robot.half_sitting_rad
    peak_n = sim.sensors[:, :, sensors.ground_force_world[:, 2]].max(axis=(1, 2))
    to_present = soles[:, :, :3] - window[:, None, 0, :3]
    return WalkState(
        support_indicator=asked.indicator,
        ground_force_weights=force_z / weight_n,
        sole_speed_m_s=sole_speed,
        sole_height_m=sole_height_m,
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
        swing_height_error_m=swing_error_m,
        climb_m=climb_m,
        step_s=asked.step_s,
        pelvis_speed_z_m_s=latest[:, sensors.pelvis_linvel_world[2]],
        power_w=np.abs(latest[:, sensors.joint_torque] * joint_speed).sum(axis=1),
        posture_error_rad=np.abs(posture).mean(axis=1),
        standing=asked.standing,
        peak_force_weights=peak_n / weight_n,
        hasty_m_s=hasty_m_s,
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
