"""A plan as a chain of foot poses off the lattice: what it costs, and whether it may be walked.

Poses here are x_m, y_m, yaw_rad in the grid frame. Pose 0 is the foot that stands while the first
step is taken, poses 1 to N are the steps; the last two are the feet at the goal.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.collision import NO_GROUND_UM, box_free, box_heights, point_clearance
from planner.compiled import njit_no_refcount
from planner.lattice.lattice import Lattice, clearance_cost, swing_clears
from planner.lattice.steps import MICRO
from planner.robot_model import StepModel

FloatArray = NDArray[np.float64]
NOT_ALLOWED = -1
_TOLERANCE = 1e-9


class Rules(NamedTuple):
    """What holds for every chain of one plan.

    limits (6,): low and high of a step's x, y and yaw, outward positive. reach (k, 3): half planes
    n . (x, y) <= c in which a step's x and y lie, as (n, c), if there are any. foot: half length
    and half width of the foot, half of the gap between feet included. first_body: half length and
    half width of the body at the first pair pose, where the robot may stand nearer than the margin.
    weights: stance width, and the costs of a step, of turning, of y off the stance width, of going
    back.
    """

    lattice: Lattice
    limits: FloatArray
    reach: FloatArray
    foot: tuple[float, float]
    first_body: tuple[float, float]
    weights: tuple[float, float, float, float, float]
    feet: FloatArray
    feet_um: NDArray[np.int64]


def build_rules(
    lattice: Lattice,
    model: StepModel,
    feet: FloatArray,
    feet_um: NDArray[np.int64],
    first_body_margin_m: float,
) -> Rules:
    """The rules of a step model in a space, for a robot that stands on feet (2, 3)."""
    limits, half_gap_m = model.limits, model.foot_gap_m / 2
    return Rules(
        lattice=lattice,
        limits=np.array([*limits.x_m, *limits.y_m, *limits.yaw_rad]),
        reach=np.ascontiguousarray(limits.half_planes),
        foot=(model.foot.length_m / 2 + half_gap_m, model.foot.width_m / 2 + half_gap_m),
        first_body=(
            model.body.length_m / 2 + first_body_margin_m,
            model.body.width_m / 2 + first_body_margin_m,
        ),
        weights=(
            model.stance_width_m,
            model.step_cost_m,
            model.turn_cost_m,
            model.side_cost_m,
            model.back_cost_m,
        ),
        feet=feet,
        feet_um=feet_um,
    )


@njit_no_refcount
def turn_between(yaw: float, other: float) -> float:
    """Angle from one heading to another in [-pi, pi)."""
    turn = other - yaw
    return turn - 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)


@njit_no_refcount
def step_between(
    support: FloatArray, swing: FloatArray, outward: float
) -> tuple[float, float, float]:
    """Step x, y, yaw of a pose (3,) in the frame of the support foot (3,), outward positive."""
    dx, dy = swing[0] - support[0], swing[1] - support[1]
    cos, sin = math.cos(support[2]), math.sin(support[2])
    turn = turn_between(support[2], swing[2])
    return cos * dx + sin * dy, outward * (cos * dy - sin * dx), outward * turn


@njit_no_refcount
def gap_axis(
    x: float, y: float, yaw: float, half_l: float, half_w: float
) -> tuple[float, float, float, float]:
    """How far apart two grown feet are along the best of four axes, and how that changes.

    Returns the distance in metres, negative where the boxes overlap, and its derivatives by x, y
    and yaw of the step. The axes are those of `lattice.feet_apart`.
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
        best, d_x, d_y, d_yaw = (
            abs(across) - wide,
            -sign * sin,
            sign * cos,
            -sign * along - d_wide,
        )
    if abs(x) - long > best:
        sign = 1.0 if x >= 0 else -1.0
        best, d_x, d_y, d_yaw = abs(x) - long, sign, 0.0, -d_long
    if abs(along) - long > best:
        sign = 1.0 if along >= 0 else -1.0
        best, d_x, d_y, d_yaw = (
            abs(along) - long,
            sign * cos,
            sign * sin,
            sign * across - d_long,
        )
    return best, d_x, d_y, d_yaw


@njit_no_refcount
def foot_pose_free(lattice: Lattice, pose: FloatArray, outward: float) -> bool:
    """Whether a foot may stand at a pose (3,): its box and the body's box over it are free."""
    x, y, cos, sin = pose[0], pose[1], math.cos(pose[2]), math.sin(pose[2])
    if not box_free(lattice.terrain, x, y, cos, sin, lattice.foot[0], lattice.foot[1]):
        return False
    inward = outward * lattice.half_stance_m
    body_x, body_y = x + sin * inward, y - cos * inward
    return box_free(lattice.terrain, body_x, body_y, cos, sin, lattice.body[0], lattice.body[1])


@njit_no_refcount
def foot_height_um(lattice: Lattice, pose: FloatArray) -> int:
    """Height of the ground under a foot in micrometres; NO_GROUND_UM where it is not level."""
    if len(lattice.node_um) == 0:
        return 0
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    half_l, half_w = lattice.tread
    low, high = box_heights(lattice.terrain, pose[0], pose[1], cos, sin, half_l, half_w)
    return high if high - low <= lattice.climb_um[2] else NO_GROUND_UM


@njit_no_refcount
def _climbs(
    lattice: Lattice,
    support: FloatArray,
    swing: FloatArray,
    support_um: int,
    swing_um: int,
    outward: float,
) -> bool:
    """Whether a step is within the limits of rise and of what it swings over, as in `rise.py`."""
    if len(lattice.node_um) == 0:
        return True
    rise = swing_um - support_um
    if swing_um == NO_GROUND_UM or rise < lattice.climb_um[0] or rise > lattice.climb_um[1]:
        return False
    return swing_clears(
        lattice,
        (support[0], support[1], math.cos(support[2]), math.sin(support[2])),
        (swing[0], swing[1], math.cos(swing[2]), math.sin(swing[2])),
        0 if outward > 0 else 1,
        max(support_um, swing_um) + lattice.climb_um[3],
    )


@njit_no_refcount
def pair_pose_of(support: FloatArray, swing: FloatArray) -> tuple[float, float, float]:
    """Point midway between two feet (3,) and their mean heading."""
    yaw = support[2] + 0.5 * turn_between(support[2], swing[2])
    return 0.5 * (support[0] + swing[0]), 0.5 * (support[1] + swing[1]), yaw


@njit_no_refcount
def _within(rules: Rules, x: float, y: float, yaw: float) -> bool:
    """Whether a step is within the limits and keeps the feet apart."""
    limits, reach, foot = rules.limits, rules.reach, rules.foot
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
def chain_cost_um(rules: Rules, poses: FloatArray, first_outward: float) -> int:
    """Cost of a chain (N + 1, 3) as the search counts it, or NOT_ALLOWED if it breaks a rule.

    first_outward: sign of the first step's side.
    """
    lattice = rules.lattice
    stance, per_step, per_turn, per_side, per_back = rules.weights
    total, outward = 0, first_outward
    support_um = rules.feet_um[1 if first_outward > 0 else 0]
    for i in range(1, len(poses)):
        x, y, yaw = step_between(poses[i - 1], poses[i], outward)
        if not _within(rules, x, y, yaw):
            return NOT_ALLOWED
        swing_um = foot_height_um(lattice, poses[i])
        if not _climbs(lattice, poses[i - 1], poses[i], support_um, swing_um, outward):
            return NOT_ALLOWED
        cost_m = math.hypot(x, y) + per_step + per_turn * abs(yaw)
        cost_m += per_side * abs(y - stance) + per_back * max(-x, 0.0)
        total += int(np.rint(cost_m * MICRO))
        # Both feet of the last step stand where the goal wants them, clear of everything.
        if i < len(poses) - 1:
            pair_x, pair_y, pair_yaw = pair_pose_of(poses[i - 1], poses[i])
            body = rules.first_body if i == 1 else lattice.body
            cos, sin = math.cos(pair_yaw), math.sin(pair_yaw)
            if not box_free(lattice.terrain, pair_x, pair_y, cos, sin, body[0], body[1]):
                return NOT_ALLOWED
            total += clearance_cost(lattice, point_clearance(lattice.terrain, pair_x, pair_y))
            if not foot_pose_free(lattice, poses[i], outward):
                return NOT_ALLOWED
        outward, support_um = -outward, swing_um
    return total
