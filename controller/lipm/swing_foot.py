"""The swing foot: where its sole is at each moment, and when it counts as landed.

It rises on the spot, goes over by quintic polynomials, and comes down on the spot, so that it
neither drags nor scuffs: the farther it has to climb the later it sets out, and the farther it has
to step down the sooner it is there. A step that is moved or hastened on the way is taken up from
the motion that the foot has. Contact may come early, when the ground is higher than planned, and
late, when it is lower.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from planner.plan import wrap_angle

SWING_HEIGHT_M = 0.05
TAKE_OFF_S, LANDING_S = 0.02, 0.05
# Share of the swing at which the foot is highest.
APEX_SHARE = 0.45
# Shares of the swing by which a foot that climbs a stair sets out later, and one that steps down is
# there sooner and stays high for longer; in proportion to its height over a stair of this height.
RISE_SHARE, LOWER_SHARE, STAY_SHARE, STAIR_M = 0.2, 0.3, 0.1, 0.10
# A step that is moved or hastened late is reached no sooner than this.
CHANGE_S = 0.1
# Contact counts from this share of the swing on, this close to its end, with this force.
EARLY_SHARE, EARLY_HEIGHT_M = 0.67, 0.03
CONTACT_N = 50.0
# A foot that has not touched the ground at the end goes on down, so far at most.
LATE_SPEED_M_S, LATE_DEPTH_M = 0.10, 0.03


@dataclass(kw_only=True)
class SwingFoot:
    """A swing from the pose `lift_off` (4,) x, y, z, yaw, over the height `apex_z_m`."""

    lift_off: np.ndarray
    apex_z_m: float
    _time_s: float = 0.0
    _state: np.ndarray = field(init=False)  # (3, 4) pose, its rate, and the rate of that
    _planned: tuple[np.ndarray, float] | None = None
    _changed_s: float = -np.inf

    def __post_init__(self) -> None:
        self._state = np.zeros((3, 4))
        self._state[0] = self.lift_off

    def move(self, target: np.ndarray, time_s: float, swing_s: float) -> np.ndarray:
        """Goes on to a time since lift-off, on the way to a target (4,); the pose (4,) then.

        Target and duration may change on the way. After `swing_s` the foot is there.
        """
        self._note_change(target, swing_s)
        begin_s, end_s, stay_s = self._windows(target, swing_s)
        earliest_s = self._changed_s + CHANGE_S
        goal = target.copy()
        goal[3] = self.lift_off[3] + float(wrap_angle(target[3] - self.lift_off[3]))
        over = [0, 1, 3]
        self._advance(over, goal[over], begin_s, time_s, max(end_s, earliest_s))
        highest_m, apex_s = max(self.apex_z_m, target[2]), APEX_SHARE * swing_s
        self._advance([2], np.array([highest_m]), 0.0, min(time_s, apex_s), apex_s)
        self._advance([2], goal[[2]], max(stay_s, apex_s), time_s, max(swing_s, earliest_s))
        self._time_s = time_s
        pose = self._state[0].copy()
        if time_s > swing_s:
            pose[2] -= min(LATE_SPEED_M_S * (time_s - swing_s), LATE_DEPTH_M)
        return pose

    def _note_change(self, target: np.ndarray, swing_s: float) -> None:
        if self._planned is not None:
            before, before_s = self._planned
            if abs(swing_s - before_s) > 1e-6 or np.abs(target - before).max() > 1e-6:
                self._changed_s = self._time_s
        self._planned = target.copy(), swing_s

    def _windows(self, target: np.ndarray, swing_s: float) -> tuple[float, float, float]:
        """Begin and end of the way over, and when the foot begins to come down."""
        rise_m = self.apex_z_m - SWING_HEIGHT_M - self.lift_off[2]
        lower_m = self.apex_z_m - SWING_HEIGHT_M - target[2]
        rise, lower = np.clip(np.array([rise_m, lower_m]) / STAIR_M, 0.0, 1.0) * swing_s
        begin_s = TAKE_OFF_S + RISE_SHARE * rise
        end_s = swing_s - LANDING_S - LOWER_SHARE * lower
        return begin_s, end_s, APEX_SHARE * swing_s + STAY_SHARE * lower

    def _advance(
        self, axes: list[int], goal: np.ndarray, begin_s: float, time_s: float, end_s: float
    ) -> None:
        """Take axes of the state on to a time, by the quintic that brings them to rest at a goal.

        They rest until it begins. Where it has not changed it is the same as before.
        """
        from_s = max(self._time_s, begin_s)
        if time_s <= from_s:
            return
        left_s, t = end_s - from_s, time_s - from_s
        if t >= left_s - 1e-9:
            self._state[:, axes] = 0.0
            self._state[0, axes] = goal
            return
        p, v, a = self._state[:, axes]
        d, s = goal - p, left_s
        c3 = (20 * d - 12 * v * s - 3 * a * s**2) / (2 * s**3)
        c4 = (-30 * d + 16 * v * s + 3 * a * s**2) / (2 * s**4)
        c5 = (12 * d - 6 * v * s - a * s**2) / (2 * s**5)
        self._state[0, axes] = p + t * (v + t * (a / 2 + t * (c3 + t * (c4 + t * c5))))
        self._state[1, axes] = v + t * (a + t * (3 * c3 + t * (4 * c4 + t * 5 * c5)))
        self._state[2, axes] = a + t * (6 * c3 + t * (12 * c4 + t * 20 * c5))


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
