"""The swing foot: where its sole is at each moment, and when it counts as landed.

It rises on the spot, goes over by quintic polynomials, and comes down on the spot, so that it
neither drags nor scuffs. Contact may come early, when the ground is higher than planned, and late,
when it is lower.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.plan import wrap_angle

SWING_HEIGHT_M = 0.05
TAKE_OFF_S, LANDING_S = 0.02, 0.05
# Share of the swing at which the foot is highest.
APEX_SHARE = 0.45
# Contact counts from this share of the swing on, this close to its end, with this force.
EARLY_SHARE, EARLY_HEIGHT_M = 0.67, 0.03
CONTACT_N = 50.0
# A foot that has not touched the ground at the end goes on down, so far at most.
LATE_SPEED_M_S, LATE_DEPTH_M = 0.10, 0.03


@dataclass(frozen=True, kw_only=True)
class SwingFoot:
    """A swing from the pose `lift_off` (4,) x, y, z, yaw, over the height `apex_z_m`."""

    lift_off: np.ndarray
    apex_z_m: float

    def pose(self, target: np.ndarray, time_s: float, swing_s: float) -> np.ndarray:
        """Pose x, y, z, yaw (4,) at a time since lift-off, on the way to a target (4,).

        The target may change on the way. After `swing_s` the foot is there.
        """
        along = _quintic((time_s - TAKE_OFF_S) / (swing_s - TAKE_OFF_S - LANDING_S))
        pose = self.lift_off.copy()
        pose[:2] += along * (target[:2] - self.lift_off[:2])
        pose[3] += along * float(wrap_angle(target[3] - self.lift_off[3]))
        highest_m = max(self.apex_z_m, target[2])
        share = time_s / swing_s
        if share < APEX_SHARE:
            up = _quintic(share / APEX_SHARE)
            pose[2] += up * (highest_m - self.lift_off[2])
        else:
            down = _quintic((share - APEX_SHARE) / (1 - APEX_SHARE))
            pose[2] = highest_m + down * (target[2] - highest_m)
        if time_s > swing_s:
            pose[2] -= min(LATE_SPEED_M_S * (time_s - swing_s), LATE_DEPTH_M)
        return pose


def swing_over(lift_off: np.ndarray, target: np.ndarray, obstacle_z_m: float) -> SwingFoot:
    """A swing that clears both its ends (4,), and what is between them, by the swing height."""
    highest_m = max(lift_off[2], target[2], obstacle_z_m)
    return SwingFoot(lift_off=lift_off, apex_z_m=highest_m + SWING_HEIGHT_M)


def has_landed(
    sole_z_m: float, target_z_m: float, time_s: float, swing_s: float, force_n: float
) -> bool:
    """Whether a force under the swing foot is the ground at its target."""
    if force_n < CONTACT_N:
        return False
    near = sole_z_m - target_z_m < EARLY_HEIGHT_M
    return time_s >= swing_s or (time_s >= EARLY_SHARE * swing_s and near)


def _quintic(share: float) -> float:
    """From 0 to 1 with no speed and no acceleration at both ends."""
    s = min(max(share, 0.0), 1.0)
    return s**3 * (10 + s * (6 * s - 15))
