"""Log of a robot that moved: joints, their targets, the inertial unit in the pelvis; its checks."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from sim.scene import Scene

# Between two rows; a slower log cannot tell a delay, and more rows than this are not needed.
SLOWEST_S, FASTEST_S = 0.05, 0.005
LONGEST_GAP_S = 0.1
LEAST_S = 2.0
# How far beyond the range of its joint an angle, or from that a target, may be.
_BEYOND_RAD, _TARGET_BEYOND_RAD = 0.5, math.pi
# Root mean square of the pelvis's angular velocity from which two ways to it are compared.
_TURNS_RAD_S = 0.05


class LogError(ValueError):
    """A log that cannot be used: the message names the column or the time."""


@dataclass(frozen=True, kw_only=True)
class RobotLog:
    """N rows of sensors and M of targets, on one clock; J joints in the order of the robot's.

    Attributes:
        time_s: when the sensors of a row were measured (N,), increasing.
        joint_pos_rad: by the encoders (N, J).
        quat_world_pelvis: orientation w, x, y, z by the inertial unit (N, 4); its heading is free.
        angvel_rad_s: by its gyroscope, in the pelvis's axes (N, 3).
        accel_m_s2: by its accelerometer, in the pelvis's axes (N, 3): 9.81 up at rest. Or None.
        sent_s: when a row of targets was sent (M,), increasing; it holds until the next one.
        target_rad: joint targets (M, J).
    """

    time_s: np.ndarray
    joint_pos_rad: np.ndarray
    quat_world_pelvis: np.ndarray
    angvel_rad_s: np.ndarray
    accel_m_s2: np.ndarray | None
    sent_s: np.ndarray
    target_rad: np.ndarray


def checked(log: RobotLog, scene: Scene, *, named: dict[str, str]) -> RobotLog:
    """The log, if it can be a log of this robot; thinned to at most 200 rows a second.

    `named` gives what the source calls a field of `RobotLog`; `{joint}` in it stands for a joint.

    Raises:
        LogError: Time does not increase, has a gap or another unit, or what was measured cannot be
            that of the robot.
    """
    _check_time(log.time_s, named["time_s"])
    _check_increasing(log.sent_s, named["sent_s"])
    for name in ("joint_pos_rad", "target_rad"):
        time_s = log.sent_s if name == "target_rad" else log.time_s
        _check_joints(getattr(log, name), time_s, name, scene, named[name])
    _check_pelvis(log, named)
    step = max(1, round(FASTEST_S / float(np.median(np.diff(log.time_s)))))
    kept = slice(None, None, step)
    return replace(
        log,
        time_s=log.time_s[kept],
        joint_pos_rad=log.joint_pos_rad[kept],
        quat_world_pelvis=log.quat_world_pelvis[kept],
        angvel_rad_s=log.angvel_rad_s[kept],
        accel_m_s2=None if log.accel_m_s2 is None else log.accel_m_s2[kept],
    )


def _check_increasing(time_s: np.ndarray, name: str) -> None:
    back = np.flatnonzero(np.diff(time_s) <= 0)
    if len(back):
        before, after = time_s[back[0]], time_s[back[0] + 1]
        raise LogError(f"{name}: {after:.6g} comes after {before:.6g}; it must increase")


def _check_time(time_s: np.ndarray, name: str) -> None:
    if len(time_s) < 2:
        raise LogError(f"{name}: there are {len(time_s)} rows, must be {LEAST_S:g} s of them")
    _check_increasing(time_s, name)
    apart_s = np.diff(time_s)
    usual_s = float(np.median(apart_s))
    if usual_s > SLOWEST_S:
        raise LogError(
            f"{name}: rows are {usual_s:g} apart, must be at most {SLOWEST_S:g} s; "
            "is it in milliseconds or nanoseconds?"
        )
    widest = int(apart_s.argmax())
    if apart_s[widest] > max(LONGEST_GAP_S, 3 * usual_s):
        raise LogError(
            f"{name}: a gap of {apart_s[widest]:.3g} s after {time_s[widest]:.6g} s, at most "
            f"{LONGEST_GAP_S:g} s; cut the log there"
        )
    if time_s[-1] - time_s[0] < LEAST_S:
        raise LogError(
            f"{name}: the log lasts {time_s[-1] - time_s[0]:.3g} s, must be at least {LEAST_S:g} s"
        )


def _check_joints(
    values: np.ndarray, time_s: np.ndarray, field: str, scene: Scene, name: str
) -> None:
    beyond_rad = _TARGET_BEYOND_RAD if field == "target_rad" else _BEYOND_RAD
    for j, joint in enumerate(scene.robot.joints):
        low, high = scene.model.joint(joint.name).range
        if not scene.model.joint(joint.name).limited[0]:
            low, high = -math.pi, math.pi
        off = np.maximum(values[:, j] - high, low - values[:, j])
        worst = int(off.argmax())
        if off[worst] > beyond_rad:
            raise LogError(
                f"{name.format(joint=joint.name)}: {values[worst, j]:.4g} at "
                f"{time_s[worst]:.6g} s is far outside the joint's range {low:.3g} to {high:.3g} "
                "rad; is it in degrees, or of another joint?"
            )


def _check_pelvis(log: RobotLog, named: dict[str, str]) -> None:
    name = named["quat_world_pelvis"]
    length = np.linalg.norm(log.quat_world_pelvis, axis=1)
    wrong = np.flatnonzero(np.abs(length - 1) > 0.02)
    if len(wrong):
        first = wrong[0]
        raise LogError(
            f"{name}: length {length[first]:.3g} at {log.time_s[first]:.6g} s, must be 1"
        )
    up = 1 - 2 * (log.quat_world_pelvis[:, 1:3] ** 2).sum(axis=1)
    lying = np.flatnonzero(up < 0)
    if len(lying):
        raise LogError(
            f"{name}: the pelvis is upside down at {log.time_s[lying[0]]:.6g} s; the order is "
            "w, x, y, z, and z of the pelvis is up"
        )
    by_quat = turning(log.time_s, log.quat_world_pelvis)
    middle = (log.angvel_rad_s[1:] + log.angvel_rad_s[:-1]) / 2
    turns = float(np.sqrt((by_quat**2).mean()))
    if turns < _TURNS_RAD_S:
        return
    ratio = float((middle * by_quat).sum() / (by_quat**2).sum())
    rest = float(np.sqrt(((middle - by_quat) ** 2).mean())) / turns
    if rest > 0.7:
        raise LogError(
            f"{named['angvel_rad_s']}: {ratio:.3g} times as fast as {name} turns, must be 1; "
            "in rad/s about the pelvis's axes x, y, z"
        )


def continuous(quat: np.ndarray) -> np.ndarray:
    """Quaternions (N, 4) of the same orientations whose signs do not jump."""
    flips = (quat[1:] * quat[:-1]).sum(axis=1) < 0
    return quat * np.where(np.cumsum([False, *flips]) % 2, -1.0, 1.0)[:, None]


def turning(time_s: np.ndarray, quat: np.ndarray) -> np.ndarray:
    """Angular velocity (N - 1, 3) in the body's axes between orientations (N, 4), rad/s."""
    w, xyz = quat[:, :1], quat[:, 1:]
    # The turn from one to the next, conj(q) * q'.
    scalar = (quat[:-1] * quat[1:]).sum(axis=1, keepdims=True)
    vector = w[:-1] * xyz[1:] - w[1:] * xyz[:-1] - np.cross(xyz[:-1], xyz[1:])
    vector = np.where(scalar < 0, -vector, vector)
    sine = np.linalg.norm(vector, axis=1, keepdims=True)
    angle = 2 * np.arctan2(sine, np.abs(scalar))
    # 2 is the limit of angle / sine for small turns.
    factor = np.where(sine > 1e-9, angle / np.maximum(sine, 1e-9), 2.0)
    return vector * factor / np.diff(time_s)[:, None]
