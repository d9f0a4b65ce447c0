"""What a chain of steps costs and what binds it, as slopes and curvatures where it is, compiled.

Every rule is a distance that must not be negative: from a limit of the step, between the two feet,
from a box to the blocked cells around it. A step shares rules with its neighbours only, so the
matrix of curvatures is banded.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planner.chain import (
    Rules,
    gap_axis,
    pair_pose_of,
    turn_between,
)
from planner.collision import Terrain
from planner.keep_off import SPARE_M, WAYS, room_off_blocked, room_on_level
from planner.lattice import MICRO
from planner.space import Space

FloatArray = NDArray[np.float64]

# Rows of a step's rules: low and high of x, y and yaw; the gap between the feet; then the room of
# the body on both feet, of the foot, of the body on this foot, and of the foot on its tread.
GAP, PAIR, FOOT, BODY, TREAD = 6, 7, 7 + WAYS, 7 + 2 * WAYS, 7 + 3 * WAYS
BAND = 6  # a row of the matrix reaches over two poses

_REACH_M = 0.10  # cells farther off bind nothing yet
_CORNER_M = 1e-3  # over which the corners of the cost are rounded off
_HINGE_M = 0.05  # over which the clearance is taken to be smooth


class Work(NamedTuple):
    """Arrays of one run for N steps, of which all but the last have rules (N - 1, ...).

    value, slack, force (N - 1, R): the distances of the R rules, their slacks and multipliers.
    slope (N - 1, R, 6): derivatives by the pose before and the pose itself. active (N - 1, R).
    toward (N - 1, R, 2): how slack and force move along the solution. matrix (3 (N - 2), BAND),
    right (3 (N - 2),): the banded system. Scratch: room (WAYS, 4); step (3, 7), derivatives of a
    step's x, y and yaw, and these; block (6, 7), curvature and minus the gradient by the two poses
    of one step; along (6,).
    """

    value: FloatArray
    slope: FloatArray
    slack: FloatArray
    force: FloatArray
    toward: FloatArray
    active: NDArray[np.bool_]
    matrix: FloatArray
    right: FloatArray
    room: FloatArray
    step: FloatArray
    block: FloatArray
    along: FloatArray


@njit(cache=True)
def new_work(space: Space, steps: int) -> Work:
    """Empty arrays for so many steps."""
    free, bound = 3 * (steps - 2), steps - 1
    rules = TREAD if len(space.node_um) == 0 else TREAD + WAYS
    return Work(
        np.zeros((bound, rules)),
        np.zeros((bound, rules, 6)),
        np.zeros((bound, rules)),
        np.zeros((bound, rules)),
        np.zeros((bound, rules, 2)),
        np.zeros((bound, rules), np.bool_),
        np.zeros((free, BAND)),
        np.zeros(free),
        np.zeros((WAYS, 4)),
        np.zeros((3, 7)),
        np.zeros((6, 7)),
        np.zeros(6),
    )


@njit(cache=True)
def _note_step(support: FloatArray, swing: FloatArray, outward: float, step: FloatArray) -> None:
    """Fills step (3, 7): derivatives of x, y, yaw by support and swing pose, and their values."""
    dx, dy = swing[0] - support[0], swing[1] - support[1]
    cos, sin = math.cos(support[2]), math.sin(support[2])
    x, y, turn = cos * dx + sin * dy, cos * dy - sin * dx, turn_between(support[2], swing[2])
    step[0] = (-cos, -sin, y, cos, sin, 0.0, x)
    step[1] = (sin, -cos, -x, -sin, cos, 0.0, y)
    step[2] = (0.0, 0.0, -1.0, 0.0, 0.0, 1.0, turn)
    if outward < 0:
        step[1:] *= -1.0


@njit(cache=True)
def note_rules(rules: Rules, work: Work, poses: FloatArray, i: int, outward: float) -> None:
    """Fills value, slope and active of step i, which leads from pose i to pose i + 1."""
    value, slope, active, room = work.value[i], work.slope[i], work.active[i], work.room
    space, limits = rules.space, rules.limits
    support, swing, step = poses[i], poses[i + 1], work.step
    _note_step(support, swing, outward, step)
    for axis in range(3):
        value[2 * axis] = step[axis, 6] - limits[2 * axis] - SPARE_M
        value[2 * axis + 1] = limits[2 * axis + 1] - step[axis, 6] - SPARE_M
        for k in range(6):
            slope[2 * axis, k] = step[axis, k]
            slope[2 * axis + 1, k] = -step[axis, k]
        active[2 * axis] = active[2 * axis + 1] = True
    gap, by_x, by_y, by_yaw = gap_axis(
        step[0, 6], step[1, 6], step[2, 6], rules.foot[0], rules.foot[1]
    )
    value[GAP] = gap - SPARE_M
    active[GAP] = gap < _REACH_M
    for k in range(6):
        slope[GAP, k] = by_x * step[0, k] + by_y * step[1, k] + by_yaw * step[2, k]
    body = rules.first_body if i == 0 else space.body
    pair = pair_pose_of(support, swing)
    near = room_off_blocked(space.terrain, pair, body[0], body[1], _REACH_M, room)
    _take_room(work, i, PAIR, near, (0.5, 0.5), (0.0, 0.0))
    if i < len(poses) - 3:  # else this foot stands where the goal wants it
        _note_foot_rules(space, work, swing, i, outward)


@njit(cache=True)
def _note_foot_rules(space: Space, work: Work, swing: FloatArray, i: int, outward: float) -> None:
    """Fills what binds the foot that step i puts down, and the body over it."""
    terrain, room = space.terrain, work.room
    pose = (swing[0], swing[1], swing[2])
    near = room_off_blocked(terrain, pose, space.foot[0], space.foot[1], _REACH_M, room)
    _take_room(work, i, FOOT, near, (0.0, 1.0), (0.0, 0.0))
    cos, sin = math.cos(swing[2]), math.sin(swing[2])
    inward = outward * space.half_stance_m
    over = (swing[0] + sin * inward, swing[1] - cos * inward, swing[2])
    near = room_off_blocked(terrain, over, space.body[0], space.body[1], _REACH_M, room)
    _take_room(work, i, BODY, near, (0.0, 1.0), (cos * inward, sin * inward))
    if len(space.node_um) > 0:
        half_l, half_w = space.tread
        near = room_on_level(terrain, pose, half_l, half_w, space.climb_um[2], _REACH_M, room)
        _take_room(work, i, TREAD, near, (0.0, 1.0), (0.0, 0.0))


@njit(cache=True)
def _take_room(
    work: Work,
    i: int,
    first: int,
    near: bool,
    shares: tuple[float, float],
    by_yaw: tuple[float, float],
) -> None:
    """Takes the room of a box over as rules from row `first` on.

    shares: how much of the support's and of the swing foot's pose makes the box's. by_yaw: how x
    and y of its centre change with the swing foot's yaw.
    """
    value, slope, active = work.value[i], work.slope[i], work.active[i]
    for way in range(WAYS):
        row = first + way
        gap, by_x, by_y, by_turn = work.room[way]
        active[row] = near and gap < _REACH_M
        if active[row]:
            value[row] = gap
            slope[row, 0] = shares[0] * by_x
            slope[row, 1] = shares[0] * by_y
            slope[row, 2] = shares[0] * by_turn
            slope[row, 3] = shares[1] * by_x
            slope[row, 4] = shares[1] * by_y
            slope[row, 5] = shares[1] * by_turn + by_x * by_yaw[0] + by_y * by_yaw[1]


@njit(cache=True)
def add(block: FloatArray, curve: float, along: FloatArray, force: float) -> None:
    """Adds curve * along * along^T and force * along to a block (6, 7); along: (6,) or longer."""
    for a in range(6):
        block[a, 6] += force * along[a]
        for b in range(6):
            block[a, b] += curve * along[a] * along[b]


@njit(cache=True)
def take_block(work: Work, i: int) -> None:
    """Adds the block of step i to the system; what belongs to fixed poses is left out."""
    base, size = 3 * (i - 1), len(work.right)
    for a in range(max(0, -base), min(6, size - base)):
        work.right[base + a] += work.block[a, 6]
        for b in range(max(0, -base), a + 1):
            work.matrix[base + a, a - b] += work.block[a, b]


@njit(cache=True)
def note_costs(rules: Rules, work: Work, poses: FloatArray, i: int) -> None:
    """Adds gradient and curvature of what step i costs, for which `note_rules` came before.

    |t| is taken as sqrt(t^2 + _CORNER_M^2), with the curvature of the parabola that touches it from
    above there: the true one is too small away from 0 and the next step would go too far.
    """
    stance, _, per_turn, per_side, per_back = rules.weights
    block, step, along = work.block, work.step, work.along
    x, y, yaw = step[0, 6], step[1, 6], step[2, 6]
    dx, dy = poses[i + 1, 0] - poses[i, 0], poses[i + 1, 1] - poses[i, 1]
    length = max(math.sqrt(dx * dx + dy * dy), _CORNER_M)
    along[:] = (-dx / length, -dy / length, 0.0, dx / length, dy / length, 0.0)
    add(block, 0.0, along, -1.0)
    along[:] = (dy / length, -dx / length, 0.0, -dy / length, dx / length, 0.0)
    add(block, 1.0 / length, along, 0.0)
    if per_turn > 0.0:
        size = math.sqrt(yaw * yaw + _CORNER_M * _CORNER_M)
        add(block, per_turn / size, step[2], -per_turn * yaw / size)
    if per_side > 0.0:
        off = y - stance
        size = math.sqrt(off * off + _CORNER_M * _CORNER_M)
        add(block, per_side / size, step[1], -per_side * off / size)
    if per_back > 0.0:
        # max(-x, 0) is (|x| - x) / 2.
        size = math.sqrt(x * x + _CORNER_M * _CORNER_M)
        add(block, 0.5 * per_back / size, step[0], -0.5 * per_back * (x / size - 1.0))
    if rules.space.clearance[2] > 0.0:
        _note_clearance(rules, work, poses, i)


@njit(cache=True)
def _smooth_clearance(terrain: Terrain, x: float, y: float) -> float:
    """Clearance of a point, linear between the centres of cells."""
    rows, cols = terrain.clearance_m.shape
    col = min(max(x / terrain.resolution_m - 0.5, 0.0), cols - 1.0)
    row = min(max(y / terrain.resolution_m - 0.5, 0.0), rows - 1.0)
    col0, row0 = int(col), int(row)
    col1, row1 = min(col0 + 1, cols - 1), min(row0 + 1, rows - 1)
    u, v = col - col0, row - row0
    field = terrain.clearance_m
    low = (1.0 - u) * field[row0, col0] + u * field[row0, col1]
    return (1.0 - v) * low + v * ((1.0 - u) * field[row1, col0] + u * field[row1, col1])


@njit(cache=True)
def _note_clearance(rules: Rules, work: Work, poses: FloatArray, i: int) -> None:
    """Adds what the clearance of the pair pose costs, by differences over _HINGE_M."""
    terrain = rules.space.terrain
    wanted_m, worst_m, most_um = rules.space.clearance
    x, y, _ = pair_pose_of(poses[i], poses[i + 1])
    here = _smooth_clearance(terrain, x, y)
    if here > wanted_m + _HINGE_M:
        return
    rate = most_um / MICRO / (wanted_m - worst_m)
    here = rate * max(wanted_m - here, 0.0)
    along = work.along
    for axis in range(2):
        step_x, step_y = (_HINGE_M, 0.0) if axis == 0 else (0.0, _HINGE_M)
        more = rate * max(wanted_m - _smooth_clearance(terrain, x + step_x, y + step_y), 0.0)
        less = rate * max(wanted_m - _smooth_clearance(terrain, x - step_x, y - step_y), 0.0)
        along[:] = 0.0
        along[axis] = along[axis + 3] = 0.5
        curve = max((more - 2.0 * here + less) / (_HINGE_M * _HINGE_M), 0.0)
        add(work.block, curve, along, -(more - less) / (2.0 * _HINGE_M))
