"""What the rewards are computed from: errors, speeds, heights, forces of B robots after an action.

Swing feet have a reference: a time law for the way to their step, and a profile of their height.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controller.gait import CONTROL_PERIOD_S
from controller.observation import pelvis_yaw_rad
from controller.walker import Walker
from planner.plan import wrap_angle

SWING_FOOT_SHARE = 0.7
# Apex of the swing on level ground, and its increase per metre of climb: edges and treads that are
# not where they seem need more clearance than level ground and the sills on it.
SWING_APEX_M, APEX_PER_CLIMB = 0.07, 0.3
# A foot that steps down goes ahead before it comes down, or its heel catches on the edge behind it:
# it has gone its way after `AHEAD_GONE` of the swing, and its ground falls during `DOWN_GONE`.
AHEAD_GONE, DOWN_GONE, DOWN_M = 0.75, (0.4, 0.85), 0.05
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
    swing_gone: np.ndarray  # (B,) share of the swing's time that is over after the action
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
            swing_gone=np.clip(ended / cursor.ticks.swing, 0.0, 1.0),
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
    # (B, 2) the same from where it should be by now: a swing foot is on its way to its target
    foot_path_error_m: np.ndarray
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
    power_w_kg: np.ndarray  # (B,) sum over the joints of |torque * speed|, by the robot's mass
    posture_error_rad: np.ndarray  # (B,) mean absolute, of the joints from half-sitting
    standing: np.ndarray  # (B,) commanded to stand
    peak_force_weights: np.ndarray  # (B,) of one foot, over the physics steps
    # (B, 2) most over the physics steps, of the sole's speed above that allowed at its height
    landing_overspeed_m_s: np.ndarray


def swing_ground_m(
    sole: np.ndarray,
    start: np.ndarray,
    target: np.ndarray,
    swing_gone: np.ndarray,
    foot_length_m: float,
) -> np.ndarray:
    """Reference ground height (n,) under a swing foot, from poses (n, 4) in the world.

    Upward it rises from the start's height to the target's over the first half of the horizontal
    distance, since the toe passes the edges ahead of the foot's middle. Downward it falls in time,
    `DOWN_GONE` being shares (from, to) of the swing's, but not before the heel is past an edge
    midway; `swing_gone` (n,) is the share that is over.
    """
    way = target[:, :2] - start[:, :2]
    length_2 = np.maximum(np.sum(way**2, axis=1), 1e-6)
    done = np.clip(np.sum((sole[:, :2] - start[:, :2]) * way, axis=1) / length_2, 0.0, 1.0)
    change = target[:, 2] - start[:, 2]
    heel_past = np.minimum(0.5 + foot_length_m / 2 / np.sqrt(length_2), 0.95)
    past = np.clip(1 - (heel_past - done) / 0.15, 0.0, 1.0)
    since, until = DOWN_GONE
    lowered = swing_way_gone(np.clip((swing_gone - since) / (until - since), 0.0, 1.0))
    share = np.where(change > 0, np.minimum(2 * done, 1.0), np.minimum(past, lowered))
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


def swing_way_gone(swing_gone: np.ndarray) -> np.ndarray:
    """Share (n,) of its horizontal way that a swing foot should have gone, in [0, 1].

    The minimum-jerk time law of Flash & Hogan 1985, eq. 8: it begins and ends at rest. `swing_gone`
    (n,) is the share of the swing's time.
    """
    t = swing_gone
    return np.asarray(t**3 * (10 - 15 * t + 6 * t**2))


def swing_path_error_m(
    sole: np.ndarray, start: np.ndarray, target: np.ndarray, swing_gone: np.ndarray
) -> np.ndarray:
    """Horizontal distance (n,) of a swing foot from where it should be, from poses (n, 4).

    In mid-swing as much is forgiven as the step rises or falls: a foot may have to pass an edge
    before or after it moves ahead. On steps that fall by `DOWN_M` or more it is ahead of time.
    """
    fall = np.clip((start[:, 2] - target[:, 2]) / DOWN_M, 0.0, 1.0)
    gone = swing_way_gone(np.minimum(swing_gone / (1 - fall * (1 - AHEAD_GONE)), 1.0))
    place = start[:, :2] + gone[:, None] * (target[:, :2] - start[:, :2])
    forgiven_m = 4 * gone * (1 - gone) * np.abs(target[:, 2] - start[:, 2])
    return np.maximum(np.linalg.norm(sole[:, :2] - place, axis=1) - forgiven_m, 0.0)


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
        power_w_kg=np.abs(torque_nm * joint_speed).sum(axis=1) / walker.robot.mass_kg,
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
    ground_z[foot] = swing_ground_m(
        soles[foot],
        step.lift_off[rows],
        targets[foot],
        step.swing_gone[rows],
        walker.robot.step_model.foot.length_m,
    )
    height_m = soles[..., 2] - ground_z
    climb_m = np.abs(targets[:, 0, 2] - targets[:, 1, 2])
    climb_m[rows] = np.maximum(climb_m[rows], np.abs(targets[foot][:, 2] - step.lift_off[rows, 2]))
    height_error_m = np.zeros(len(soles))
    profile_m = swing_height_profile_m(step.swing_end_s[rows], climb_m[rows])
    height_error_m[rows] = height_m[foot] - profile_m
    error_m = np.linalg.norm(soles[..., :2] - targets[..., :2], axis=2)
    path_error_m = error_m.copy()
    path_error_m[foot] = swing_path_error_m(
        soles[foot], step.lift_off[rows], targets[foot], step.swing_gone[rows]
    )
    # A foot may touch down between two control steps, so each physics step counts.
    heights_m = sim.sensors[:, :, sensors.sole_pos_world[:, 2]] - ground_z[:, None]
    speeds_m_s = np.linalg.norm(sim.sensors[:, :, sensors.sole_linvel_world], axis=3)
    allowed_m_s = TOUCHDOWN_M_S + FASTER_PER_S * np.maximum(heights_m, 0.0)
    overspeed_m_s = np.where(heights_m < NEAR_GROUND_M, speeds_m_s - allowed_m_s, 0.0)
    return {
        "swing_share": share,
        "sole_speed_m_s": speeds_m_s[:, -1],
        "sole_height_m": height_m,
        "foot_error_m": error_m,
        "foot_path_error_m": path_error_m,
        "swing_height_error_m": height_error_m,
        "climb_m": climb_m,
        "landing_overspeed_m_s": np.maximum(overspeed_m_s.max(axis=1), 0.0),
    }
