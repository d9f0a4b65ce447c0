"""Rewards: the terms and their weights.

A term is a pure function of `RewardInputs` that gives (B,) in [-1, 1]. The terms of `PAPER` are
those of Singh et al. 2022, sec. IV-C. `PRECISE` rewards the *named* foot on its own target, with a
kernel that sharpens near it, and its heading. `QUIET` wants it there when its swing ends, not
sooner, and adds upright posture, low power and landing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from controller.reward_inputs import RewardInputs

TARGET_RADIUS_M = 0.20
FOOT_SPEED_SCALE_M_S = 0.4
SWING_HEIGHT_M = 0.06
HIGH_SWING_M = 0.10


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
    return _near(s, s.foot_error_m)


def foot_path(s: RewardInputs) -> np.ndarray:
    """As `named_foot_step`, the swing foot where it should be by now.

    A swing foot that is paid for its distance from the target darts there, and then waits.
    """
    return _near(s, s.foot_path_error_m)


def _near(s: RewardInputs, error_m: np.ndarray) -> np.ndarray:
    """1 where both feet have no error (B, 2), flat far away and steep near by."""
    near = 0.4 * np.exp(-error_m / 0.25) + 0.6 * np.exp(-error_m / 0.04)
    return np.asarray(np.sum(s.swing_share * near, axis=1))


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
    return np.exp(-s.power_w_kg / 2.4)


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
        foot_path,
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
    "ground_force": 0.08,
    "foot_path": 0.26,
    "named_foot_heading": 0.05,
    "stance_at_rest": 0.05,
    "swing_profile": 0.08,
    "soft_landing": 0.12,
    "upright": 0.05,
    "facing": 0.04,
    "pelvis_height": 0.06,
    "pelvis_speed": 0.02,
    "power": 0.06,
    "standing_posture": 0.03,
    "peak_force": 0.03,
    "joint_acceleration": 0.05,
    "action_smoothness": 0.02,
}
PRESETS = {"paper": PAPER, "precise": PRECISE, "quiet": QUIET}
# Terms that ask each foot to bear and rest, or to hang and move, as the clock says: those that
# Singh et al. 2022 call periodic, and the one that is for `foot_speed` in `QUIET`.
PERIODIC = ("ground_force", "foot_speed", "stance_at_rest")


@dataclass(frozen=True, kw_only=True)
class RewardSchedule:
    """Weights that change over a training run, from `first` to `last`, while the robot walks.

    Under `QUIET` standing still pays more than a first step, so walking is learned under `PRECISE`.
    While `success` of the held-out flat episodes succeed, with feet `error_m` from their steps or
    nearer (median), the weights move toward `last`, all the way in `blend_share` of the run, and
    else back at the same pace: a robot that `last` would cost its precision stays between.
    """

    first: Mapping[str, float]
    last: Mapping[str, float]
    success: float = 0.95
    error_m: float = 0.02
    blend_share: float = 0.23

    def walks(self, *, success: float, error_m: float) -> bool:
        """Whether a robot of this success and median error, NaN for no step at all, is there."""
        return success >= self.success and error_m <= self.error_m

    def after(self, blended: float, *, share: float, walks: bool) -> float:
        """Position of the weights between `first` (0) and `last` (1) in the next segment.

        `blended` is that of the segment before, which was `share` of the run; `walks` says
        whether the robot did at its end.
        """
        if self.first == self.last:
            return 1.0
        change = share / self.blend_share
        return min(max(blended + (change if walks else -change), 0.0), 1.0)

    def at(self, blended: float) -> dict[str, float]:
        """The weights at a position in [0, 1] between `first` and `last`."""
        names = dict.fromkeys((*self.first, *self.last))
        weights = {
            n: (1 - blended) * self.first.get(n, 0.0) + blended * self.last.get(n, 0.0)
            for n in names
        }
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
