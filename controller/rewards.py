"""Rewards: the terms, their weights, and the quantities they are computed from.

A term is a pure function of `RewardInputs` that gives (B,) in [-1, 1]. The terms of `PAPER` are
those of Singh et al. 2022, sec. IV-C. `PRECISE` rewards the *named* foot on its own target, with a
kernel that sharpens near it, and its heading. `QUIET` adds upright posture, low power and landing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from controller.gait import CONTROL_PERIOD_S
from controller.observation import pelvis_yaw_rad
from controller.walker import Walker
from planner.plan import wrap_angle

TARGET_RADIUS_M = 0.20
FOOT_SPEED_SCALE_M_S = 0.4
SWING_FOOT_SHARE = 0.7
SWING_HEIGHT_M = 0.06
HIGH_SWING_M = 0.10
# Apex of the swing on level ground, and its increase per metre of climb: edges and treads that are
# not where they seem need more clearance than level ground and the sills on it.
SWING_APEX_M, APEX_PER_CLIMB = 0.075, 0.3
# Sole speed allowed at the ground, its increase per metre of height, and up to which height.
TOUCHDOWN_M_S, FASTER_PER_S, NEAR_GROUND_M = 0.08, 12.0, 0.06


@dataclass(frozen=True, kw_only=True)
class StepTargets:
    """The targets of B robots when their actions were chosen; see `StepCursor`.

    Poses are x, y, z, yaw in the world.
    """

    foot_targets: np.ndarray  # (B, 2, 4)
    side: np.ndarray  # (B,) foot of the present step
    window: np.ndarray  # (B, 2, 4) present and next step
    support_indicator: np.ndarray  # (B, 2)
    swinging: np.ndarray  # (B,)
    lift_off: np.ndarray  # (B, 4) pose that the foot of the present step leaves
    previous_action: np.ndarray  # (B, J)
    joint_speed_rad_s: np.ndarray  # (B, J) before the action
    swing_end_s: np.ndarray  # (B,) from the end of the action to the nearer end of the swing
    step_s: np.ndarray  # (B,) duration of the present step
    standing: np.ndarray  # (B,)

    @classmethod
    def of(cls, walker: Walker) -> StepTargets:
        """The present targets of a walker, before it acts."""
        cursor = walker.cursor
        ended = cursor.tick + 1
        swing_end_ticks = np.maximum(np.minimum(ended, cursor.ticks.swing - ended), 0)
        return cls(
            foot_targets=cursor.foot_targets,
            side=cursor.side,
            window=cursor.window,
            support_indicator=cursor.support_indicator,
            swinging=cursor.swinging,
            lift_off=cursor.lift_off_poses,
            previous_action=walker.action,
            joint_speed_rad_s=walker.sim.qvel[:, walker.scene.joint_qvel].copy(),
            swing_end_s=swing_end_ticks * CONTROL_PERIOD_S,
            step_s=cursor.step_s[:, 0],
            standing=cursor.standing,
        )


@dataclass(frozen=True, kw_only=True)
class RewardInputs:
    """The quantities that the terms are computed from; forces are means over the control step."""

    support_indicator: np.ndarray  # (B, 2) in [-1, 1], left then right
    ground_force_weights: np.ndarray  # (B, 2) vertical force over the robot's weight
    sole_speed_m_s: np.ndarray  # (B, 2)
    sole_height_m: np.ndarray  # (B, 2) above the ground of the foot's target
    foot_error_m: np.ndarray  # (B, 2) horizontal distance of each foot from its own target
    foot_heading_error_rad: np.ndarray  # (B, 2) absolute
    target_distance_m: np.ndarray  # (B,) of the present step from the nearer foot
    root_distance_m: np.ndarray  # (B,) of the pelvis from midway between the next two steps
    swing_share: np.ndarray  # (B, 2) weights of the foot errors, sum 1
    tilt_rad: np.ndarray  # (B,) of the pelvis's z axis from the vertical
    heading_error_rad: np.ndarray  # (B,) of the pelvis from the mean of the foot targets
    tilt_cos: np.ndarray  # (B,) <q, q*> of the pelvis with the upright pose of that heading
    height_error_m: np.ndarray  # (B,) pelvis above the lower sole, from its standing height
    head_offset_m: np.ndarray  # (B,) horizontal, of the head from the pelvis
    action_change_rad: np.ndarray  # (B,) mean absolute
    torque_change_nm: np.ndarray  # (B,) mean absolute
    joint_acceleration_rad_s2: np.ndarray  # (B,) mean absolute, of the joints over the control step
    swing_height_error_m: np.ndarray  # (B,) of the swing foot from its height profile; else 0
    climb_m: np.ndarray  # (B,) greatest height difference among the footholds of the step
    step_s: np.ndarray  # (B,) duration of the present step
    pelvis_speed_z_m_s: np.ndarray  # (B,) upward
    power_w: np.ndarray  # (B,) sum over the joints of |torque * speed|
    posture_error_rad: np.ndarray  # (B,) mean absolute, of the joints from half-sitting
    standing: np.ndarray  # (B,) commanded to stand
    peak_force_weights: np.ndarray  # (B,) of one foot, over the physics steps
    # (B, 2) most over the physics steps, of the sole's speed above that allowed at its height
    landing_overspeed_m_s: np.ndarray


def swing_ground_m(sole: np.ndarray, start: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Reference ground height (n,) under a swing foot, from poses (n, 4) in the world.

    Upward it rises from the start's height to the target's over the first half of the horizontal
    distance, since the toe passes the edges ahead of the foot's middle; downward it falls over the
    second half, since the heel clears them late.
    """
    way = target[:, :2] - start[:, :2]
    length_2 = np.maximum(np.sum(way**2, axis=1), 1e-6)
    done = np.clip(np.sum((sole[:, :2] - start[:, :2]) * way, axis=1) / length_2, 0.0, 1.0)
    change = target[:, 2] - start[:, 2]
    share = np.where(change > 0, np.minimum(2 * done, 1.0), np.maximum(2 * done - 1.0, 0.0))
    return np.asarray(start[:, 2] + share * change)


def swing_height_profile_m(swing_end_s: np.ndarray, climb_m: np.ndarray) -> np.ndarray:
    """Reference height (n,) of a swing foot, from the time (n,) to the nearer end of its swing.

    It leaves and lands with `TOUCHDOWN_M_S`. Near the ground speed grows with height, dv/dh =
    `FASTER_PER_S`; then it levels off smoothly, as tanh does, since a foot that had to stop at once
    would overshoot. The apex is `SWING_APEX_M` and `APEX_PER_CLIMB` of the height difference (n,)
    of the footholds.
    """
    apex_m = SWING_APEX_M + APEX_PER_CLIMB * climb_m
    rising_m = TOUCHDOWN_M_S / FASTER_PER_S * np.expm1(FASTER_PER_S * swing_end_s)
    return np.asarray(apex_m * np.tanh(rising_m / apex_m))


def reward_inputs(
    walker: Walker, step: StepTargets, previous_torque_nm: np.ndarray
) -> RewardInputs:
    """The inputs after the action; `previous_torque_nm` (B, J) is of the control step before."""
    sim, sensors, qpos = walker.sim, walker.scene.sensors, walker.sim.qpos
    targets, window = step.foot_targets, step.window
    latest, soles = sim.sensors[:, -1], walker.soles_world()
    pelvis = latest[:, sensors.pelvis_pos_world]
    head_offset = latest[:, sensors.head_pos_world[:2]] - pelvis[:, :2]
    torque_nm = walker.joint_torque_nm()
    heading = targets[:, 1, 3] + 0.5 * wrap_angle(targets[:, 0, 3] - targets[:, 1, 3])
    weight_n = walker.robot.weight_n
    force_z_n = sim.sensors[:, :, sensors.ground_force_world[:, 2]]
    joint_speed = sim.qvel[:, walker.scene.joint_qvel]
    joint_speed_change = joint_speed - step.joint_speed_rad_s
    posture = qpos[:, walker.scene.joint_qpos] - walker.robot.half_sitting_rad
    to_present = soles[:, :, :3] - window[:, None, 0, :3]
    return RewardInputs(
        support_indicator=step.support_indicator,
        ground_force_weights=force_z_n.mean(axis=1) / weight_n,
        foot_error_m=np.linalg.norm(soles[..., :2] - targets[..., :2], axis=2),
        foot_heading_error_rad=np.abs(wrap_angle(soles[..., 3] - targets[..., 3])),
        target_distance_m=np.linalg.norm(to_present, axis=2).min(axis=1),
        root_distance_m=np.linalg.norm(pelvis[:, :2] - window[..., :2].mean(axis=1), axis=1),
        tilt_rad=np.arccos(np.clip(1 - 2 * (qpos[:, 4] ** 2 + qpos[:, 5] ** 2), -1, 1)),
        heading_error_rad=wrap_angle(pelvis_yaw_rad(qpos) - heading),
        tilt_cos=qpos[:, 3] * np.cos(heading / 2) + qpos[:, 6] * np.sin(heading / 2),
        height_error_m=pelvis[:, 2] - soles[..., 2].min(axis=1) - walker.robot.pelvis_height_m,
        head_offset_m=np.linalg.norm(head_offset, axis=1),
        action_change_rad=np.abs(walker.action - step.previous_action).mean(axis=1),
        torque_change_nm=np.abs(torque_nm - previous_torque_nm).mean(axis=1),
        joint_acceleration_rad_s2=np.abs(joint_speed_change).mean(axis=1) / CONTROL_PERIOD_S,
        step_s=step.step_s,
        pelvis_speed_z_m_s=latest[:, sensors.pelvis_linvel_world[2]],
        power_w=np.abs(torque_nm * joint_speed).sum(axis=1),
        posture_error_rad=np.abs(posture).mean(axis=1),
        standing=step.standing,
        peak_force_weights=force_z_n.max(axis=(1, 2)) / weight_n,
        **_swing_inputs(walker, step, soles),
    )


def _swing_inputs(walker: Walker, step: StepTargets, soles: np.ndarray) -> dict[str, np.ndarray]:
    """The inputs on swing and sole motion, from the soles (B, 2, 4) after the action."""
    sim, sensors, targets = walker.sim, walker.scene.sensors, step.foot_targets
    rows = np.flatnonzero(step.swinging)
    foot = rows, step.side[rows]
    share = np.full(targets.shape[:2], 0.5)
    share[foot], share[rows, 1 - step.side[rows]] = SWING_FOOT_SHARE, 1 - SWING_FOOT_SHARE
    ground_z = targets[..., 2].copy()
    ground_z[foot] = swing_ground_m(soles[foot], step.lift_off[rows], targets[foot])
    height_m = soles[..., 2] - ground_z
    climb_m = np.abs(targets[:, 0, 2] - targets[:, 1, 2])
    climb_m[rows] = np.maximum(climb_m[rows], np.abs(targets[foot][:, 2] - step.lift_off[rows, 2]))
    height_error_m = np.zeros(len(soles))
    profile_m = swing_height_profile_m(step.swing_end_s[rows], climb_m[rows])
    height_error_m[rows] = height_m[foot] - profile_m
    # A foot may touch down between two control steps, so each physics step counts.
    heights_m = sim.sensors[:, :, sensors.sole_pos_world[:, 2]] - ground_z[:, None]
    speeds_m_s = np.linalg.norm(sim.sensors[:, :, sensors.sole_linvel_world], axis=3)
    allowed_m_s = TOUCHDOWN_M_S + FASTER_PER_S * np.maximum(heights_m, 0.0)
    overspeed_m_s = np.where(heights_m < NEAR_GROUND_M, speeds_m_s - allowed_m_s, 0.0)
    return {
        "swing_share": share,
        "sole_speed_m_s": speeds_m_s[:, -1],
        "sole_height_m": height_m,
        "swing_height_error_m": height_error_m,
        "climb_m": climb_m,
        "landing_overspeed_m_s": np.maximum(overspeed_m_s.max(axis=1), 0.0),
    }


def ground_force(s: RewardInputs) -> np.ndarray:
    """Weight on the support feet and none on the swing foot; half the weight counts as full."""
    force = 2 * np.clip(2 * s.ground_force_weights, 0.0, 1.0) - 1
    return np.mean(s.support_indicator * force, axis=1)


def foot_speed(s: RewardInputs) -> np.ndarray:
    """Support feet at rest, swing foot moving."""
    speed = 2 * np.clip(s.sole_speed_m_s / FOOT_SPEED_SCALE_M_S, 0.0, 1.0) - 1
    return np.mean(-s.support_indicator * speed, axis=1)


def any_foot_step(s: RewardInputs) -> np.ndarray:
    """As in the paper: either foot within the target radius, and the pelvis near."""
    hit = np.exp(-s.target_distance_m / 0.25) * (s.target_distance_m <= TARGET_RADIUS_M)
    return 0.8 * hit + 0.2 * np.exp(-s.root_distance_m / 2)


def named_foot_step(s: RewardInputs) -> np.ndarray:
    """Each foot near its own target: a wide kernel to attract it and a narrow one to place it."""
    near = 0.4 * np.exp(-s.foot_error_m / 0.25) + 0.6 * np.exp(-s.foot_error_m / 0.04)
    return np.sum(s.swing_share * near, axis=1)


def named_foot_heading(s: RewardInputs) -> np.ndarray:
    """Each foot along its own target's heading."""
    return np.sum(s.swing_share * np.exp(-s.foot_heading_error_rad / 0.1), axis=1)


def swing_clearance(s: RewardInputs) -> np.ndarray:
    """The swing foot lifted clear of the ground in mid-swing, but not higher.

    `foot_speed` rewards upward motion like forward motion, which matters in short steps.
    """
    lift = np.clip(s.sole_height_m / SWING_HEIGHT_M, 0.0, 1.0)
    excess = np.clip(s.sole_height_m / HIGH_SWING_M - 1, 0.0, 1.0)
    return np.min(np.where(s.support_indicator <= -1.0, lift - excess, 1.0), axis=1)


def orientation(s: RewardInputs) -> np.ndarray:
    """Pelvis upright, heading along the mean heading of the foot targets."""
    return np.exp(-10 * (1 - s.tilt_cos**2))


def upright(s: RewardInputs) -> np.ndarray:
    """Pelvis upright; sharper than the paper's, since a body that leans needs wider passages."""
    return np.exp(-s.tilt_rad / 0.1)


def facing(s: RewardInputs) -> np.ndarray:
    """Pelvis heading along the mean heading of the foot targets."""
    return np.exp(-np.abs(s.heading_error_rad) / 0.2)


def height(s: RewardInputs) -> np.ndarray:
    """Pelvis at its standing height."""
    return np.exp(-40 * s.height_error_m**2)


def standing_height(s: RewardInputs) -> np.ndarray:
    """Pelvis at its standing height; sharper than the paper's, which lets a robot walk crouched."""
    return np.exp(-np.abs(s.height_error_m) / 0.1)


def upper_body(s: RewardInputs) -> np.ndarray:
    """Head above the pelvis."""
    return np.exp(-10 * s.head_offset_m**2)


def action_smoothness(s: RewardInputs) -> np.ndarray:
    """Little change of the action."""
    return np.exp(-5 * s.action_change_rad)


def torque_smoothness(s: RewardInputs) -> np.ndarray:
    """Little change of the joint torques."""
    return np.exp(-0.25 * s.torque_change_nm)


def joint_acceleration(s: RewardInputs) -> np.ndarray:
    """Joints that neither jerk nor shake."""
    return np.exp(-s.joint_acceleration_rad_s2 / 25)


def stance_at_rest(s: RewardInputs) -> np.ndarray:
    """Support feet at rest."""
    weight = (1 + s.support_indicator) / 2
    rest = np.exp(-s.sole_speed_m_s / 0.1)
    return np.sum(weight * rest, axis=1) / np.sum(weight, axis=1)


def swing_profile(s: RewardInputs) -> np.ndarray:
    """The swing foot on its height profile; as steep far from it as near."""
    return 1 - np.minimum(np.abs(s.swing_height_error_m) / 0.06, 2.0)


def pelvis_height(s: RewardInputs) -> np.ndarray:
    """Pelvis at its standing height, within the tolerance that a climb needs."""
    return np.exp(-np.maximum(np.abs(s.height_error_m) - s.climb_m, 0.0) / 0.04)


def pelvis_speed(s: RewardInputs) -> np.ndarray:
    """Pelvis neither rising nor falling, beyond what a climb needs."""
    allowed_m_s = 1.5 * s.climb_m / s.step_s
    return np.exp(-np.maximum(np.abs(s.pelvis_speed_z_m_s) - allowed_m_s, 0.0) / 0.1)


def power(s: RewardInputs) -> np.ndarray:
    """Little mechanical power of the joints."""
    return np.exp(-s.power_w / 150)


def standing_posture(s: RewardInputs) -> np.ndarray:
    """Half-sitting posture while commanded to stand."""
    return np.where(s.standing, np.exp(-s.posture_error_rad / 0.05), 1.0)


def peak_force(s: RewardInputs) -> np.ndarray:
    """No ground force on one foot much above the robot's weight, at any physics step."""
    return np.exp(-np.maximum(s.peak_force_weights - 1.0, 0.0) / 0.3)


def soft_landing(s: RewardInputs) -> np.ndarray:
    """Soles slow near the ground, at lift-off and touchdown."""
    return np.exp(-s.landing_overspeed_m_s.max(axis=1) / 0.15)


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
        joint_acceleration,
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
# Upright, quiet, low power. Alone it trains a policy that stands still: see `RewardSchedule`.
QUIET: Mapping[str, float] = {
    "ground_force": 0.09,
    "named_foot_step": 0.29,
    "named_foot_heading": 0.06,
    "stance_at_rest": 0.05,
    "swing_profile": 0.09,
    "soft_landing": 0.08,
    "upright": 0.05,
    "facing": 0.04,
    "pelvis_height": 0.05,
    "pelvis_speed": 0.03,
    "power": 0.05,
    "standing_posture": 0.03,
    "peak_force": 0.04,
    "joint_acceleration": 0.03,
    "action_smoothness": 0.02,
}
PRESETS = {"paper": PAPER, "precise": PRECISE, "quiet": QUIET}


@dataclass(frozen=True, kw_only=True)
class RewardSchedule:
    """Weights that change over a training run, from `first` to `last`.

    Between the shares `blend` (from, to) of the run the weights are interpolated. Under `QUIET`
    standing still pays more than a first step, so walking is learned under `PRECISE`.
    """

    first: Mapping[str, float]
    last: Mapping[str, float]
    blend: tuple[float, float] = (0.17, 0.4)

    def progress(self, share: float) -> float:
        """Position of the weights between `first` (0) and `last` (1) after `share` of the run."""
        low, high = self.blend
        return min(max((share - low) / (high - low), 0.0), 1.0)

    def at(self, share: float) -> dict[str, float]:
        """The weights after `share` in [0, 1] of the run."""
        t = self.progress(share)
        names = dict.fromkeys((*self.first, *self.last))
        weights = {n: (1 - t) * self.first.get(n, 0.0) + t * self.last.get(n, 0.0) for n in names}
        return {name: weight for name, weight in weights.items() if weight > 0}


def reward(
    inputs: RewardInputs, weights: Mapping[str, float]
) -> tuple[np.ndarray, dict[str, float]]:
    """The weighted sum (B,) and each term's batch mean.

    Raises:
        KeyError: unknown term.
    """
    values = {name: TERMS[name](inputs) for name in weights}
    total = sum(weight * values[name] for name, weight in weights.items())
    return np.asarray(total), {name: float(value.mean()) for name, value in values.items()}
