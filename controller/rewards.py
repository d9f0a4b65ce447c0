"""Reward terms: pure functions of arrays (B, ...) to (B,), each in [-1, 1], and their weights.

The terms of `PAPER` are those of Singh et al. 2022, sec. IV-C. `PRECISE` asks for more: the
*named* foot on its own target, measured more sharply the nearer it gets, with its heading.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

TARGET_RADIUS_M = 0.20
FOOT_SPEED_SCALE_M_S = 0.4
SWING_HEIGHT_M = 0.06
HIGH_SWING_M = 0.10


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
PRESETS = {"paper": PAPER, "precise": PRECISE}


def reward(state: WalkState, weights: Mapping[str, float]) -> tuple[np.ndarray, dict[str, float]]:
    """The weighted sum (B,) and each term's batch mean.

    Raises:
        KeyError: a weight names no term.
    """
    values = {name: TERMS[name](state) for name in weights}
    total = sum(weight * values[name] for name, weight in weights.items())
    return np.asarray(total), {name: float(value.mean()) for name, value in values.items()}
