"""Simulated localization on the map, and the filter that joins it with the odometry of the legs.

The filter holds where the odometry's frame lies in the map, as ROS has it (REP 105, "Coordinate
Frames for Mobile Platforms"): the odometry drifts but never jumps, and corrections move the frame.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from controller.gait import CONTROL_PERIOD_S
from planner.plan import from_frame, to_frame, wrap_angle

# A fix farther from what is believed, in the sense of Mahalanobis, is an outlier: the square that
# one fix in a thousand exceeds (chi-squared with three degrees of freedom).
GATE = 16.27
# Outliers that agree with each other for so long, and are so many, tell that the frame has moved.
JUMP_AFTER_S, JUMP_FIXES = 0.5, 3
# What the filter expects of the odometry, as variances: 2 cm after a metre, and of the heading half
# a degree after a radian turned and one after ten seconds.
DRIFT_M2_PER_M = 0.02**2
DRIFT_RAD2_PER_RAD, DRIFT_RAD2_PER_S = math.radians(0.5) ** 2, math.radians(1.0) ** 2 / 10
_OUTLIER_M = 1.0


@dataclass(frozen=True, kw_only=True)
class LocalizationConfig:
    """A pose of the pelvis in the map, `rate_hz` times a second, with errors.

    `noise_m` and `noise_rad` are standard deviations of x and y, and of the heading. Fixes come
    `delay_s` late. A share `outliers` of them is off by a metre anywhere. All from `jump_at_s` on
    are off by `jump_m` in a direction that is drawn.
    """

    rate_hz: float = 10.0
    noise_m: float = 0.03
    noise_rad: float = math.radians(2.0)
    delay_s: float = 0.1
    outliers: float = 0.0
    jump_at_s: float = 0.0
    jump_m: float = 0.0

    def __post_init__(self) -> None:
        """Raises ValueError for a rate that is not above 0, or a negative error or delay."""
        if not 0 < self.rate_hz <= 1 / CONTROL_PERIOD_S:
            raise ValueError(f"rate {self.rate_hz} Hz is not within 0 to {1 / CONTROL_PERIOD_S:g}")
        if min(self.noise_m, self.noise_rad) <= 0 or min(self.delay_s, self.jump_m) < 0:
            raise ValueError("noise must be above 0, delay and jump not below 0")
        if not 0 <= self.outliers < 1:
            raise ValueError(f"share of outliers {self.outliers} is not within 0 to 1")


@dataclass(frozen=True, kw_only=True)
class Fix:
    """A pose x, y, yaw (3,) of the pelvis in the map as it was at `time_s`."""

    time_s: float
    pose_map: np.ndarray


class SimulatedLocalization:
    """Makes fixes from the true poses, which it is told at every control step."""

    def __init__(self, config: LocalizationConfig, *, seed: int):
        self._config = config
        self._rng = np.random.default_rng(seed)
        angle_rad = self._rng.uniform(-math.pi, math.pi)
        self._jump = config.jump_m * np.array([math.cos(angle_rad), math.sin(angle_rad), 0.0])
        self._next_s = 1 / config.rate_hz
        self._sent: deque[Fix] = deque()

    def fixes(self, true_pose: np.ndarray, time_s: float) -> list[Fix]:
        """The fixes that arrive now, the true pose x, y, yaw (3,) of the pelvis being this."""
        config, rng = self._config, self._rng
        if time_s + 1e-9 >= self._next_s:
            self._next_s += 1 / config.rate_hz
            noise = rng.normal(0.0, (config.noise_m, config.noise_m, config.noise_rad))
            angle_rad, is_outlier = rng.uniform(-math.pi, math.pi), rng.random() < config.outliers
            off = _OUTLIER_M * np.array([math.cos(angle_rad), math.sin(angle_rad), 0.0])
            pose = np.asarray(true_pose) + noise + off * is_outlier
            pose += self._jump * (time_s >= config.jump_at_s)
            pose[2] = wrap_angle(pose[2])
            self._sent.append(Fix(time_s=time_s, pose_map=pose))
        arrived = []
        while self._sent and self._sent[0].time_s + config.delay_s <= time_s + 1e-9:
            arrived.append(self._sent.popleft())
        return arrived


@dataclass(kw_only=True)
class PoseFilter:
    """Extended Kalman filter of the pelvis's pose in the map.

    `odom_in_map` (3,) is the pose x, y, yaw of the odometry's frame in the map. `fixes` and
    `rejected` count what came and what lay outside the gate, `jumps` how often the frame was found
    to have moved; then the belief begins anew from the fixes that told so.
    """

    config: LocalizationConfig
    odom_in_map: np.ndarray = field(default_factory=lambda: np.zeros(3))
    fixes: int = 0
    rejected: int = 0
    jumps: int = 0
    _covariance: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    _path: deque[tuple[float, np.ndarray]] = field(default_factory=deque)
    _outliers: list[tuple[float, np.ndarray]] = field(default_factory=list)

    def predict(self, odom_pose: np.ndarray, time_s: float) -> None:
        """The odometry has the pelvis at odom_pose (3,) now."""
        if self._path:
            before = self._path[-1][1]
            move = odom_pose[:2] - before[:2]
            moved_m = float(np.hypot(*move))
            turned_rad = abs(float(wrap_angle(odom_pose[2] - before[2])))
            world = from_frame(np.array([[*move, 0.0]]), [0.0, 0.0, self.odom_in_map[2]])[0]
            carry = np.array([[1.0, 0.0, -world[1]], [0.0, 1.0, world[0]], [0.0, 0.0, 1.0]])
            grown_m2 = DRIFT_M2_PER_M * moved_m
            grown_rad2 = DRIFT_RAD2_PER_RAD * turned_rad + DRIFT_RAD2_PER_S * CONTROL_PERIOD_S
            self._covariance = carry @ self._covariance @ carry.T
            self._covariance += np.diag([grown_m2, grown_m2, grown_rad2])
        self._path.append((time_s, np.array(odom_pose)))
        while self._path[0][0] < time_s - self.config.delay_s - 1.0:
            self._path.popleft()

    def correct(self, fix: Fix) -> None:
        """Take a fix, which may be late."""
        self.fixes += 1
        config = self.config
        odom_then = min(self._path, key=lambda at: abs(at[0] - fix.time_s))[1]
        error = fix.pose_map - from_frame(odom_then[None], self.odom_in_map)[0]
        error[2] = wrap_angle(error[2])
        noise = np.diag([config.noise_m, config.noise_m, config.noise_rad]) ** 2
        spread = self._covariance + noise
        if error @ np.linalg.solve(spread, error) > GATE:
            self.rejected += 1
            self._doubt(fix.time_s, error, noise)
            return
        self._outliers.clear()
        gain = np.linalg.solve(spread, self._covariance).T
        self._move(gain @ error)
        self._covariance = (np.eye(3) - gain) @ self._covariance

    def _doubt(self, time_s: float, error: np.ndarray, noise: np.ndarray) -> None:
        """Note an outlier; where they have agreed for long, believe them."""
        apart = [error - other for _, other in self._outliers]
        if any(a @ np.linalg.solve(2 * noise, a) > GATE for a in apart):
            self._outliers.clear()
        self._outliers.append((time_s, error))
        lasted_s = time_s - self._outliers[0][0]
        if len(self._outliers) < JUMP_FIXES or lasted_s < JUMP_AFTER_S:
            return
        self._move(np.mean([error for _, error in self._outliers], axis=0))
        self._covariance = noise / len(self._outliers)
        self._outliers.clear()
        self.jumps += 1

    def _move(self, correction: np.ndarray) -> None:
        """Move the believed pose of the pelvis by x, y, yaw (3,) in the map, and the frame so."""
        odom_pose = self._path[-1][1]
        pose = from_frame(odom_pose[None], self.odom_in_map)[0] + correction
        yaw_rad = float(wrap_angle(pose[2] - odom_pose[2]))
        turned = from_frame(np.array([[*odom_pose[:2], 0.0]]), [0.0, 0.0, yaw_rad])[0]
        self.odom_in_map = np.array([*(pose[:2] - turned[:2]), yaw_rad])


def frame_difference(
    frame: Sequence[float] | np.ndarray, other: Sequence[float] | np.ndarray, at_map: np.ndarray
) -> tuple[float, float]:
    """How far a point of the map (2,) moves, and how far headings turn, from one frame to another.

    Both frames are poses x, y, yaw (3,) in the map.
    """
    seen = to_frame(np.array([[*at_map, 0.0]]), np.asarray(frame))
    moved = from_frame(seen, np.asarray(other))[0]
    return float(np.hypot(*(moved[:2] - at_map))), abs(float(wrap_angle(moved[2])))
