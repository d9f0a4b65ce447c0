"""Poses and points, as arrays, between the lattice frame and the grid frame."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planner.plan import wrap_angle

FloatArray = NDArray[np.float64]
Frame = tuple[float, float, float, float]  # x, y, cos, sin of the goal's pair pose in the grid


def poses_to_grid(frame: Frame, poses: FloatArray) -> FloatArray:
    """Poses (n, 3) of the lattice frame in the grid frame, headings not wrapped."""
    x, y, cos, sin = frame
    in_grid = np.empty(poses.shape)  # C order: functions are compiled for that order alone
    in_grid[:, 0] = x + cos * poses[:, 0] - sin * poses[:, 1]
    in_grid[:, 1] = y + sin * poses[:, 0] + cos * poses[:, 1]
    in_grid[:, 2] = poses[:, 2] + math.atan2(sin, cos)
    return in_grid


def poses_from_grid(frame: Frame, poses: FloatArray) -> FloatArray:
    """Poses (n, 3) of the grid frame in the lattice frame."""
    yaw_rad = wrap_angle(poses[:, 2] - math.atan2(frame[3], frame[2]))
    return np.column_stack([*points_from_grid(frame, poses[:, 0], poses[:, 1]), yaw_rad])


def points_from_grid(frame: Frame, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points (n,), (n,) of the grid frame in the lattice frame."""
    ox, oy, cos, sin = frame
    dx, dy = x - ox, y - oy
    return cos * dx + sin * dy, cos * dy - sin * dx
