"""Cost and validity of a plan off the lattice: a path of foot poses.

Poses here are x_m, y_m, yaw_rad in the grid frame. Pose 0 is the foot that stands while the first
step is taken, poses 1 to N are the steps; the last two are the feet at the goal.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.collision import Terrain, box_free, point_clearance
from planner.compiled import njit_inner, njit_no_refcount
from planner.lattice.lattice import (
    Lattice,
    clearance_cost,
    feet_climb,
    foot_at,
    level_height_um,
)
from planner.lattice.steps import MICRO
from planner.robot_model import RoundedBox, StepModel, rounded_box

FloatArray = NDArray[np.float64]
NOT_ALLOWED = -1
_TOLERANCE = 1e-9
_CORNER_M = 1e-3  # over which the corners of the cost are rounded off
_HINGE_M = 0.05  # over which the clearance is smoothed


class Weights(NamedTuple):
    """Cost of a step: see `StepModel`; turn, side and back in metres per radian or metre."""

    stance_m: float
    step_m: float
    turn: float
    side: float
    back: float


class RefinementProblem(NamedTuple):
    """What holds for every path of one plan on a map.

    limits (6,): low and high of a step's x, y and yaw, outward positive. reach (k, 3): half planes
    n . (x, y) <= c in which a step's x and y lie, as (n, c), if there are any. foot: half length
    and half width of the foot, half of the gap between feet included. first_body: the body at the
    first pair pose, where the robot may stand nearer than the margin.
    feet (2, 3), feet_um (2,): where the robot stands.
    """

    lattice: Lattice
    limits: FloatArray
    reach: FloatArray
    foot: tuple[float, float]
    first_body: RoundedBox
    weights: Weights
    feet: FloatArray
    feet_um: NDArray[np.int64]


def refinement_problem(
    lattice: Lattice,
    model: StepModel,
    feet: FloatArray,
    feet_um: NDArray[np.int64],
    first_body_margin_m: float,
) -> RefinementProblem:
    """The problem of a step model on a map, for a robot that stands on feet (2, 3)."""
    limits, half_gap_m = model.limits, model.foot_gap_m / 2
    return RefinementProblem(
        lattice=lattice,
        limits=np.array([*limits.x_m, *limits.y_m, *limits.yaw_rad]),
        reach=np.ascontiguousarray(limits.half_planes),
        foot=(model.foot.length_m / 2 + half_gap_m, model.foot.width_m / 2 + half_gap_m),
        first_body=rounded_box(model.body, first_body_margin_m),
        weights=Weights(
            stance_m=model.stance_width_m,
            step_m=model.step_cost_m,
            turn=model.turn_cost_m,
            side=model.side_cost_m,
            back=model.back_cost_m,
        ),
        feet=feet,
        feet_um=feet_um,
    )


@njit_inner
def turn_between(yaw: float, other: float) -> float:
    """Angle from one heading to another in [-pi, pi)."""
    turn = other - yaw
    return turn - 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)


@njit_inner
def step_between(
    support: FloatArray, swing: FloatArray, outward: float
) -> tuple[float, float, float]:
    """Step x, y, yaw of a pose (3,) in the frame of the support foot (3,), outward positive."""
    dx, dy = swing[0] - support[0], swing[1] - support[1]
    cos, sin = math.cos(support[2]), math.sin(support[2])
    turn = turn_between(support[2], swing[2])
    return cos * dx + sin * dy, outward * (cos * dy - sin * dx), outward * turn


@njit_inner
def gap_axis(
    x: float, y: float, yaw: float, half_l: float, half_w: float
) -> tuple[float, float, float, float]:
    """Distance of two grown feet along the best of four separating axes, and its derivatives.

    The distance is in metres, negative where the boxes overlap; the derivatives are by x, y and yaw
    of the step. The axes are those of `lattice.steps.feet_apart`.
    """
    cos, sin = math.cos(yaw), math.sin(yaw)
    cos_sign, sin_sign = (1.0 if cos >= 0 else -1.0), (1.0 if sin >= 0 else -1.0)
    long = half_l + half_l * abs(cos) + half_w * abs(sin)
    wide = half_w + half_l * abs(sin) + half_w * abs(cos)
    d_long = half_w * cos * sin_sign - half_l * sin * cos_sign
    d_wide = half_l * cos * sin_sign - half_w * sin * cos_sign
    along, across = cos * x + sin * y, cos * y - sin * x
    sign = 1.0 if y >= 0 else -1.0
    best, d_x, d_y, d_yaw = abs(y) - wide, 0.0, sign, -d_wide
    if abs(across) - wide > best:
        sign = 1.0 if across >= 0 else -1.0
        best, d_x, d_y = abs(across) - wide, -sign * sin, sign * cos
        d_yaw = -sign * along - d_wide
    if abs(x) - long > best:
        sign = 1.0 if x >= 0 else -1.0
        best, d_x, d_y, d_yaw = abs(x) - long, sign, 0.0, -d_long
    if abs(along) - long > best:
        sign = 1.0 if along >= 0 else -1.0
        best, d_x, d_y = abs(along) - long, sign * cos, sign * sin
        d_yaw = sign * across - d_long
    return best, d_x, d_y, d_yaw


@njit_inner
def foot_pose_free(lattice: Lattice, pose: FloatArray, outward: float) -> bool:
    """Whether a foot may stand at a pose (3,): its box and the body's box over it are free."""
    x, y, cos, sin = pose[0], pose[1], math.cos(pose[2]), math.sin(pose[2])
    if not box_free(lattice.terrain, x, y, cos, sin, lattice.foot):
        return False
    inward = outward * lattice.half_stance_m
    body_x, body_y = x + sin * inward, y - cos * inward
    return box_free(lattice.terrain, body_x, body_y, cos, sin, lattice.body)


@njit_no_refcount
def foot_height_um(lattice: Lattice, pose: FloatArray) -> int:
    """Height of the ground under a foot in micrometres; NO_GROUND_UM where it is not level."""
    return 0 if len(lattice.node_um) == 0 else level_height_um(lattice, foot_at(pose))


@njit_inner
def pair_pose_of(support: FloatArray, swing: FloatArray) -> tuple[float, float, float]:
    """Point midway between two feet (3,) and their mean heading."""
    yaw = support[2] + 0.5 * turn_between(support[2], swing[2])
    return 0.5 * (support[0] + swing[0]), 0.5 * (support[1] + swing[1]), yaw


@njit_inner
def _within_limits(problem: RefinementProblem, x: float, y: float, yaw: float) -> bool:
    """Whether a step is within the limits and keeps the feet apart."""
    limits, reach, foot = problem.limits, problem.reach, problem.foot
    for k in range(len(reach)):
        if reach[k, 0] * x + reach[k, 1] * y > reach[k, 2] + _TOLERANCE:
            return False
    return (
        limits[0] - _TOLERANCE <= x <= limits[1] + _TOLERANCE
        and limits[2] - _TOLERANCE <= y <= limits[3] + _TOLERANCE
        and limits[4] - _TOLERANCE <= yaw <= limits[5] + _TOLERANCE
        and gap_axis(x, y, yaw, foot[0], foot[1])[0] >= -_TOLERANCE
    )


@njit_no_refcount
def plan_cost_um(problem: RefinementProblem, poses: FloatArray, first_outward: float) -> int:
    """Cost of a path (N + 1, 3) as the search counts it, or NOT_ALLOWED if a step is not valid.

    first_outward: sign of the first step's side.
    """
    lattice = problem.lattice
    stance, per_step, per_turn, per_side, per_back = problem.weights
    total, outward = 0, first_outward
    support_um = problem.feet_um[1 if first_outward > 0 else 0]
    for i in range(1, len(poses)):
        x, y, yaw = step_between(poses[i - 1], poses[i], outward)
        if not _within_limits(problem, x, y, yaw):
            return NOT_ALLOWED
        swing_um = foot_height_um(lattice, poses[i])
        if len(lattice.node_um) > 0:
            support, swing, side = foot_at(poses[i - 1]), foot_at(poses[i]), 0 if outward > 0 else 1
            if not feet_climb(lattice, support, swing, support_um, swing_um, side):
                return NOT_ALLOWED
        cost_m = math.hypot(x, y) + per_step + per_turn * abs(yaw)
        cost_m += per_side * abs(y - stance) + per_back * max(-x, 0.0)
        total += int(np.rint(cost_m * MICRO))
        # The last step ends at the goal feet, which are free.
        if i < len(poses) - 1:
            pair_x, pair_y, pair_yaw = pair_pose_of(poses[i - 1], poses[i])
            body = problem.first_body if i == 1 else lattice.body
            cos, sin = math.cos(pair_yaw), math.sin(pair_yaw)
            if not box_free(lattice.terrain, pair_x, pair_y, cos, sin, body):
                return NOT_ALLOWED
            total += clearance_cost(lattice, point_clearance(lattice.terrain, pair_x, pair_y))
            if not foot_pose_free(lattice, poses[i], outward):
                return NOT_ALLOWED
        outward, support_um = -outward, swing_um
    return total


@njit_inner
def add(block: FloatArray, curvature: float, v: FloatArray, multiplier: float) -> None:
    """Adds curvature * v * v^T and multiplier * v to a block (6, 7), with the first six of v."""
    for a in range(6):
        block[a, 6] += multiplier * v[a]
        for b in range(6):
            block[a, b] += curvature * v[a] * v[b]


@njit_inner
def add_step_cost(
    weights: Weights,
    i: int,
    step: FloatArray,
    along: FloatArray,
    block: FloatArray,
) -> float:
    """Adds negative gradient and Hessian of the cost of step i to the block; returns it in metres.

    |t| is taken as sqrt(t^2 + _CORNER_M^2), with the curvature of the parabola that touches it from
    above there: the true one is too small away from 0, so a Newton step would go too far. along
    (6,) is scratch.
    """
    stance, per_step, per_turn, per_side, per_back = weights
    x, y, yaw = step[i, 0, 6], step[i, 1, 6], step[i, 2, 6]
    length = math.sqrt(x * x + y * y)
    # Along and across the step: turning the support foot changes no distance.
    u, v = x / max(length, _CORNER_M), y / max(length, _CORNER_M)
    for k in range(6):
        along[k] = u * step[i, 0, k] + v * step[i, 1, k]
    add(block, 0.0, along, -1.0)
    for k in range(6):
        along[k] = v * step[i, 0, k] - u * step[i, 1, k]
    along[2] = along[5] = 0.0
    add(block, 1.0 / max(length, _CORNER_M), along, 0.0)
    if per_turn > 0.0:
        size = math.sqrt(yaw * yaw + _CORNER_M * _CORNER_M)
        add(block, per_turn / size, step[i, 2], -per_turn * yaw / size)
    if per_side > 0.0:
        off = y - stance
        size = math.sqrt(off * off + _CORNER_M * _CORNER_M)
        add(block, per_side / size, step[i, 1], -per_side * off / size)
    if per_back > 0.0:
        # max(-x, 0) is (|x| - x) / 2.
        size = math.sqrt(x * x + _CORNER_M * _CORNER_M)
        add(block, 0.5 * per_back / size, step[i, 0], -0.5 * per_back * (x / size - 1.0))
    cost_m = length + per_step + per_turn * abs(yaw) + per_side * abs(y - stance)
    return cost_m + per_back * max(-x, 0.0)


@njit_inner
def add_clearance_cost(
    terrain: Terrain,
    clearance: tuple[float, float, float],
    poses: FloatArray,
    i: int,
    along: FloatArray,
    block: FloatArray,
) -> float:
    """Adds the clearance cost of the pair pose, with derivatives by differences over _HINGE_M.

    Returns that cost in metres, as the search counts it.
    """
    wanted_m, worst_m, most_um = clearance
    x, y, _ = pair_pose_of(poses[i], poses[i + 1])
    size, field = terrain.resolution_m, terrain.clearance_m
    here = _smooth(field, size, x, y)
    if here > wanted_m + _HINGE_M:
        return 0.0
    rate = most_um / MICRO / (wanted_m - worst_m)
    here = rate * max(wanted_m - here, 0.0)
    for axis in range(2):
        step_x, step_y = (_HINGE_M, 0.0) if axis == 0 else (0.0, _HINGE_M)
        more = rate * max(wanted_m - _smooth(field, size, x + step_x, y + step_y), 0.0)
        less = rate * max(wanted_m - _smooth(field, size, x - step_x, y - step_y), 0.0)
        along[:] = 0.0
        along[axis] = along[axis + 3] = 0.5
        curvature = max((more - 2.0 * here + less) / (_HINGE_M * _HINGE_M), 0.0)
        add(block, curvature, along, -(more - less) / (2.0 * _HINGE_M))
    short_m = wanted_m - point_clearance(terrain, x, y)
    return most_um / MICRO * min(max(short_m / (wanted_m - worst_m), 0.0), 1.0)


@njit_inner
def _smooth(field: NDArray[np.float32], size: float, x: float, y: float) -> float:
    """Clearance at a point, linear between the centres of cells."""
    rows, cols = field.shape
    col = min(max(x / size - 0.5, 0.0), cols - 1.0)
    row = min(max(y / size - 0.5, 0.0), rows - 1.0)
    col0, row0 = int(col), int(row)
    col1, row1 = min(col0 + 1, cols - 1), min(row0 + 1, rows - 1)
    u, v = col - col0, row - row0
    low = (1.0 - u) * field[row0, col0] + u * field[row0, col1]
    return (1.0 - v) * low + v * ((1.0 - u) * field[row1, col0] + u * field[row1, col1])
