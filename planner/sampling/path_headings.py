"""Headings of the body along a path, chosen so that walking it costs little.

Sampling planners turn the body at random, so many paths lead sideways. The line of the path is
kept, and the heading at each of its points is chosen among evenly spaced ones, by dynamic
programming on the costs of stepping ahead, sideways, back and on the spot.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from planner.collision import Terrain
from planner.compiled import njit_arrays, njit_no_refcount
from planner.lattice.steps import step_cost_um
from planner.plan import wrap_angle
from planner.robot_model import StepModel
from planner.sampling.ompl_paths import Outline, can_stand

FloatArray = NDArray[np.float64]
_HEADINGS = 64
_SPACING_M = 0.05
_SHARE = 0.9  # of the limits, in an ordinary step
_FAR = 1e12


def walking_rate(model: StepModel, angle_rad: FloatArray) -> FloatArray:
    """Cost (...) per metre of walking toward angles (...) from straight ahead, in metres.

    Two steps in turn, of equal length and as long as the limits allow: to the side one foot opens
    the stance and the other closes it.
    """
    (x_low, x_high), (y_low, y_high) = model.limits.x_m, model.limits.y_m
    cos, sin = np.cos(angle_rad), np.abs(np.sin(angle_rad))
    most_x = np.where(cos >= 0, x_high, -x_low) * 2 * _SHARE
    most_y = (y_high - y_low) * _SHARE
    with np.errstate(divide="ignore"):
        reach_m = np.minimum(most_x / np.abs(cos), most_y / sin)
    ahead = reach_m * cos / 2
    middle = np.clip(model.stance_width_m, y_low + reach_m * sin / 2, y_high - reach_m * sin / 2)
    cost_um = sum(
        step_cost_um(
            np.stack([ahead, middle + sign * reach_m * sin / 2, np.zeros_like(ahead)], axis=-1),
            model,
        )
        for sign in (1, -1)
    )
    with np.errstate(divide="ignore"):
        return np.where(reach_m > 1e-6, cost_um / 1e6 / reach_m, _FAR)


def turning_rate(model: StepModel) -> float:
    """Cost per radian of turning on the spot, in metres: an outward and an inward step."""
    low, high = (_SHARE * v for v in model.limits.yaw_rad)
    steps = np.array([[0.0, model.stance_width_m, high], [0.0, model.stance_width_m, low]])
    turn_rad = high - low
    return float(step_cost_um(steps, model).sum()) / 1e6 / turn_rad if turn_rad > 1e-6 else _FAR


def choose_headings(
    terrain: Terrain, outline: Outline, model: StepModel, corners: FloatArray
) -> FloatArray:
    """Poses (n, 3) along a path with these corners (m, 3), first and last as they are.

    All in the grid frame. The corners themselves if no headings are free along the line.
    """
    line = _line(corners)
    headings = corners[-1, 2] + np.arange(_HEADINGS) * (2 * math.pi / _HEADINGS)
    free = np.zeros((len(line), _HEADINGS), np.bool_)
    _check(terrain, outline, line, headings, free)
    turn_m = turning_rate(model)
    walk_m = _walking_costs(line, headings, model)
    start_m = turn_m * np.abs(wrap_angle(headings - corners[0, 2]))
    steps = _cheapest(free, walk_m, start_m, turn_m * 2 * math.pi / _HEADINGS)
    if not len(steps):
        return corners
    poses = np.column_stack([line[steps[:, 0]], headings[steps[:, 1]]])
    return np.concatenate([corners[:1], poses, corners[-1:]])


def _line(corners: FloatArray) -> FloatArray:
    """Points (n, 2) along the path, at most _SPACING_M apart."""
    points = [corners[:1, :2]]
    for start, end in itertools.pairwise(corners[:, :2]):
        number = max(1, math.ceil(float(np.hypot(*(end - start))) / _SPACING_M))
        points.append(start + np.linspace(0, 1, number + 1)[1:, None] * (end - start))
    line = np.concatenate(points)
    moved = np.hypot(*np.diff(line, axis=0).T) > 1e-9
    return line[np.concatenate([[True], moved])]


def _walking_costs(line: FloatArray, headings: FloatArray, model: StepModel) -> FloatArray:
    """Cost (n - 1, H) in metres from each point to the next with each heading."""
    away = np.diff(line, axis=0)
    direction = np.arctan2(away[:, 1], away[:, 0])
    length = np.hypot(away[:, 0], away[:, 1])
    return length[:, None] * walking_rate(model, wrap_angle(direction[:, None] - headings))


@njit_no_refcount
def _check(
    terrain: Terrain,
    outline: Outline,
    line: FloatArray,
    headings: FloatArray,
    free: NDArray[np.bool_],
) -> None:
    for i in range(len(line)):
        for h in range(len(headings)):
            free[i, h] = can_stand(terrain, outline, line[i, 0], line[i, 1], headings[h])


@njit_arrays
def _cheapest(
    free: NDArray[np.bool_], walk_m: FloatArray, start_m: FloatArray, bin_m: float
) -> NDArray[np.int64]:
    """Pairs (k, 2) of point and heading, from the first point to heading 0 at the last.

    Between two points the heading may change by one; at a point it may change further.
    """
    points, number = free.shape
    cost = np.full((points, number), _FAR)
    came = np.zeros((points, number), np.int8)  # 0, -1, 1: by walking; -2, 2: by turning
    for h in range(number):
        if free[0, h]:
            cost[0, h] = start_m[h]
    for i in range(points):
        if i > 0:
            for h in range(number):
                if not free[i, h]:
                    continue
                for turn in (0, -1, 1):
                    before = (h - turn) % number
                    step = max(walk_m[i - 1, h], bin_m) if turn != 0 else walk_m[i - 1, h]
                    # A trifle for each turn, so that of two equal ways the straighter is taken.
                    there = cost[i - 1, before] + step + abs(turn) * 1e-6
                    if there < cost[i, h]:
                        cost[i, h], came[i, h] = there, turn
        for turn in (1, -1):
            for k in range(2 * number):
                h = (k if turn == 1 else -k) % number
                there = cost[i, (h - turn) % number] + bin_m
                if free[i, h] and there < cost[i, h]:
                    cost[i, h], came[i, h] = there, 2 * turn
    back = np.empty((points * (number + 1), 2), np.int64)
    if cost[points - 1, 0] >= _FAR:
        return back[:0]
    i, h, used = points - 1, 0, 0
    while True:
        back[used, 0], back[used, 1] = i, h
        used += 1
        how = came[i, h]
        if abs(how) == 2:
            h = (h - how // 2) % number
        elif i == 0:
            return back[:used][::-1].copy()
        else:
            i, h = i - 1, (h - how) % number
