"""What a chain of steps costs and what binds it, as slopes and curvatures where it is, compiled.

Every rule is a distance that must not be negative: from a limit of the step, between the two feet,
from a box to the blocked cells around it. A step shares rules with its neighbours only, so the
matrix of curvatures is banded.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.collision import NO_GROUND_UM, Terrain, point_clearance
from planner.compiled import njit_arrays, njit_no_refcount
from planner.lattice.lattice import Lattice
from planner.lattice.steps import MICRO
from planner.refinement.cost import Rules, gap_axis, turn_between

# The room that a box has among the cells around it, as eight distances that may not shrink.
#
# Each cell that a box must keep off is separated from it along one of four axes, those of the map
# and those of the box (two rectangles overlap unless one of the four does); it counts toward the
# axis on which it lies farthest off. The least distance on either side of each axis bounds where
# the box may move, and turning changes it smoothly.

FloatArray = NDArray[np.float64]
WAYS = 8  # ahead, back, left, right of the box, then +x, -x, +y, -y of the map
SPARE_M = 1e-5  # kept from all limits, so that what is left of an iteration's error breaks none


class _Box(NamedTuple):
    """A box as the compiled checks see it; reach_x, reach_y: how far it goes along the map's axes.

    cell_reach: how far a cell goes from its centre along the box's axes. by_yaw_*: how the three
    change with the yaw.
    """

    x: float
    y: float
    cos: float
    sin: float
    half_l: float
    half_w: float
    reach_x: float
    reach_y: float
    cell_reach: float
    by_yaw_x: float
    by_yaw_y: float
    by_yaw_cell: float


@njit_no_refcount
def _box(x: float, y: float, yaw: float, half_l: float, half_w: float, size: float) -> _Box:
    cos, sin = math.cos(yaw), math.sin(yaw)
    cos_sign, sin_sign = (1.0 if cos >= 0 else -1.0), (1.0 if sin >= 0 else -1.0)
    return _Box(
        x,
        y,
        cos,
        sin,
        half_l,
        half_w,
        abs(cos) * half_l + abs(sin) * half_w + SPARE_M,
        abs(sin) * half_l + abs(cos) * half_w + SPARE_M,
        0.5 * size * (abs(cos) + abs(sin)) + SPARE_M,
        half_w * cos * sin_sign - half_l * sin * cos_sign,
        half_l * cos * sin_sign - half_w * sin * cos_sign,
        0.5 * size * (cos * sin_sign - sin * cos_sign),
    )


@njit_no_refcount
def room_off_blocked(
    terrain: Terrain,
    x: float,
    y: float,
    yaw: float,
    half_l: float,
    half_w: float,
    reach_m: float,
    room: FloatArray,
) -> bool:
    """Fills room (WAYS, 4): distance in metres, and its derivatives by x, y and yaw of the box.

    The distance is reach_m where nothing is nearer, and negative where box and cells overlap.
    Returns False, with nothing filled, if nothing at all is near.
    """
    radius = math.sqrt(half_l * half_l + half_w * half_w) + reach_m
    if point_clearance(terrain, x, y) > radius:
        return False
    size = terrain.resolution_m
    box = _box(x, y, yaw, half_l, half_w, size)
    room[:, 0] = reach_m
    _note_edges(terrain, box, room)
    row0, row1, col0, col1 = _window(terrain, box, reach_m)
    for row in range(row0, row1 + 1):
        dy = (row + 0.5) * size - box.y
        col = col0
        while col <= col1:
            if terrain.blocked[row, col]:
                _note_cell(box, (col + 0.5) * size - box.x, dy, 0.5 * size, room)
                col += 1
            else:
                # No blocked ground within this distance, so the next cells are free as well.
                col += max(1, int(terrain.clearance_m[row, col] / size + 0.499))
    return True


@njit_no_refcount
def room_on_level(
    terrain: Terrain,
    x: float,
    y: float,
    yaw: float,
    half_l: float,
    half_w: float,
    level_um: int,
    reach_m: float,
    room: FloatArray,
) -> bool:
    """As `room_off_blocked`, from floor at another height than that below the box's centre.

    Floor that is at most level_um higher or lower counts as the same. Returns False where the
    centre is on no floor at all.
    """
    size = terrain.resolution_m
    rows, cols = terrain.blocked.shape
    row, col = math.floor(y / size), math.floor(x / size)
    if row < 0 or col < 0 or row >= rows or col >= cols:
        return False
    own_um = terrain.height_um[row, col]
    if own_um == NO_GROUND_UM:
        return False
    box = _box(x, y, yaw, half_l, half_w, size)
    room[:, 0] = reach_m
    row0, row1, col0, col1 = _window(terrain, box, reach_m)
    for row in range(row0, row1 + 1):
        dy = (row + 0.5) * size - box.y
        for col in range(col0, col1 + 1):
            height_um = terrain.height_um[row, col]
            if height_um != NO_GROUND_UM and abs(height_um - own_um) > level_um:
                _note_cell(box, (col + 0.5) * size - box.x, dy, 0.5 * size, room)
    return True


@njit_no_refcount
def _window(terrain: Terrain, box: _Box, reach_m: float) -> tuple[int, int, int, int]:
    """First and last row and column of the cells that may lie within reach of a box."""
    rows, cols = terrain.blocked.shape
    size = terrain.resolution_m
    return (
        max(0, math.floor((box.y - box.reach_y - reach_m) / size)),
        min(rows - 1, math.floor((box.y + box.reach_y + reach_m) / size)),
        max(0, math.floor((box.x - box.reach_x - reach_m) / size)),
        min(cols - 1, math.floor((box.x + box.reach_x + reach_m) / size)),
    )


@njit_no_refcount
def _note_edges(terrain: Terrain, box: _Box, room: FloatArray) -> None:
    """Notes the edges of the map, which no box may cross."""
    rows, cols = terrain.blocked.shape
    size = terrain.resolution_m
    for way, gap in (
        (4, cols * size - box.x - box.reach_x),
        (5, box.x - box.reach_x),
        (6, rows * size - box.y - box.reach_y),
        (7, box.y - box.reach_y),
    ):
        if gap < room[way, 0]:
            _note_on_map_axis(box, way, gap, room)


@njit_no_refcount
def _note_cell(box: _Box, dx: float, dy: float, half: float, room: FloatArray) -> None:
    """Notes a cell whose centre is at (dx, dy) from that of the box, if it is the nearest yet."""
    along, across = box.cos * dx + box.sin * dy, box.cos * dy - box.sin * dx
    way, gap = (0 if along >= 0 else 1), abs(along) - box.half_l - box.cell_reach
    if abs(across) - box.half_w - box.cell_reach > gap:
        way, gap = (2 if across >= 0 else 3), abs(across) - box.half_w - box.cell_reach
    if abs(dx) - box.reach_x - half > gap:
        way, gap = (4 if dx >= 0 else 5), abs(dx) - box.reach_x - half
    if abs(dy) - box.reach_y - half > gap:
        way, gap = (6 if dy >= 0 else 7), abs(dy) - box.reach_y - half
    if gap >= room[way, 0]:
        return
    if way >= 4:
        _note_on_map_axis(box, way, gap, room)
        return
    room[way, 0] = gap
    sign = 1.0 if way % 2 == 0 else -1.0
    if way < 2:
        room[way, 1], room[way, 2] = -sign * box.cos, -sign * box.sin
        room[way, 3] = sign * across - box.by_yaw_cell
    else:
        room[way, 1], room[way, 2] = sign * box.sin, -sign * box.cos
        room[way, 3] = -sign * along - box.by_yaw_cell


@njit_no_refcount
def _note_on_map_axis(box: _Box, way: int, gap: float, room: FloatArray) -> None:
    sign = -1.0 if way % 2 == 0 else 1.0
    room[way, 0] = gap
    room[way, 1], room[way, 2] = (sign, 0.0) if way < 6 else (0.0, sign)
    room[way, 3] = -box.by_yaw_x if way < 6 else -box.by_yaw_y


# Rows of a step's rules: low and high of x, y and yaw; the gap between the feet; then the room of
# the body on both feet, of the foot, of the body on this foot, and of the foot on its tread. The
# last rows, as many as it has edges, are about the polygon in which a step must lie.
GAP, PAIR, FOOT, BODY, TREAD = 6, 7, 7 + WAYS, 7 + 2 * WAYS, 7 + 3 * WAYS
BAND = 6  # a row of the matrix reaches over two poses

_REACH_M = 0.07  # cells farther off bind nothing yet: more than a pose moves at once
_CORNER_M = 1e-3  # over which the corners of the cost are rounded off
_HINGE_M = 0.05  # over which the clearance is taken to be smooth


class Work(NamedTuple):
    """Arrays of one run for N steps, of which all but the last have rules (N - 1, ...).

    value, slack, force (N - 1, R): the distances of the R rules, their slacks and multipliers.
    slope (N - 1, R, 6): derivatives by the pose before and the pose itself. active (N - 1, R).
    toward (N - 1, R, 2): how slack and force move along the solution. step (N - 1, 3, 7): of each
    step's x, y and yaw the derivatives by both poses, and the value. matrix (3 (N - 2), BAND),
    right (3 (N - 2),): the banded system. Scratch: room (WAYS, 4); block (6, 7), curvature and
    minus the gradient by the two poses of one step; along (1, 1, 6).
    """

    value: FloatArray
    slope: FloatArray
    slack: FloatArray
    force: FloatArray
    toward: FloatArray
    active: NDArray[np.bool_]
    step: FloatArray
    matrix: FloatArray
    right: FloatArray
    room: FloatArray
    block: FloatArray
    along: FloatArray


@njit_arrays
def new_work(lattice: Lattice, steps: int, edges: int) -> Work:
    """Empty arrays for so many steps, in a polygon of so many edges."""
    free, bound = 3 * (steps - 2), steps - 1
    rules = edges + (TREAD if len(lattice.node_um) == 0 else TREAD + WAYS)
    return Work(
        np.zeros((bound, rules)),
        np.zeros((bound, rules, 6)),
        np.zeros((bound, rules)),
        np.zeros((bound, rules)),
        np.zeros((bound, rules, 2)),
        np.zeros((bound, rules), np.bool_),
        np.zeros((bound, 3, 7)),
        np.zeros((free, BAND)),
        np.zeros(free),
        np.zeros((WAYS, 4)),
        np.zeros((6, 7)),
        np.zeros((1, 1, 6)),
    )


# The functions below get arrays, not the tuples that hold them: taking an array from a tuple in the
# loop over the steps costs more than what is done with it.


@njit_no_refcount
def note_rules(rules: Rules, work: Work, poses: FloatArray, first_outward: float) -> None:
    """Fills step, value, slope and active of all steps; step i leads from pose i to pose i + 1."""
    terrain, foot, body = rules.lattice.terrain, rules.lattice.foot, rules.lattice.body
    tread, level_um = rules.lattice.tread, rules.lattice.climb_um[2]
    half_stance_m, is_flat = rules.lattice.half_stance_m, len(rules.lattice.node_um) == 0
    first_body, sole, limits, reach = rules.first_body, rules.foot, rules.limits, rules.reach
    value, slope, active, room, step = work.value, work.slope, work.active, work.room, work.step
    outward = first_outward
    for i in range(len(value)):
        _note_step(poses, i, outward, step)
        _note_limits(limits, sole, i, step, value, slope, active)
        _note_reach(reach, i, step, value, slope, active)
        x, y, yaw = _midway(poses, i)
        half_l, half_w = first_body if i == 0 else body
        near = room_off_blocked(terrain, x, y, yaw, half_l, half_w, _REACH_M, room)
        _take_room(i, PAIR, near, room, (0.5, 0.5, 0.0, 0.0), value, slope, active)
        if i == len(value) - 1:
            break  # this foot stands where the goal wants it
        x, y, yaw = poses[i + 1, 0], poses[i + 1, 1], poses[i + 1, 2]
        near = room_off_blocked(terrain, x, y, yaw, foot[0], foot[1], _REACH_M, room)
        _take_room(i, FOOT, near, room, (0.0, 1.0, 0.0, 0.0), value, slope, active)
        inward_x = half_stance_m * outward * math.sin(yaw)
        inward_y = -half_stance_m * outward * math.cos(yaw)
        near = room_off_blocked(
            terrain, x + inward_x, y + inward_y, yaw, body[0], body[1], _REACH_M, room
        )
        _take_room(i, BODY, near, room, (0.0, 1.0, -inward_y, inward_x), value, slope, active)
        if not is_flat:
            near = room_on_level(terrain, x, y, yaw, tread[0], tread[1], level_um, _REACH_M, room)
            _take_room(i, TREAD, near, room, (0.0, 1.0, 0.0, 0.0), value, slope, active)
        outward = -outward


@njit_no_refcount
def _note_step(poses: FloatArray, i: int, outward: float, step: FloatArray) -> None:
    """Fills step i of (N - 1, 3, 7): derivatives of x, y, yaw by both poses, and their values."""
    dx, dy = poses[i + 1, 0] - poses[i, 0], poses[i + 1, 1] - poses[i, 1]
    cos, sin = math.cos(poses[i, 2]), math.sin(poses[i, 2])
    x, y = cos * dx + sin * dy, cos * dy - sin * dx
    turn = turn_between(poses[i, 2], poses[i + 1, 2])
    for k, number in enumerate((-cos, -sin, y, cos, sin, 0.0, x)):
        step[i, 0, k] = number
    for k, number in enumerate((sin, -cos, -x, -sin, cos, 0.0, y)):
        step[i, 1, k] = outward * number
    for k, number in enumerate((0.0, 0.0, -1.0, 0.0, 0.0, 1.0, turn)):
        step[i, 2, k] = outward * number


@njit_no_refcount
def _midway(poses: FloatArray, i: int) -> tuple[float, float, float]:
    """Pair pose of poses i and i + 1."""
    x, y = 0.5 * (poses[i, 0] + poses[i + 1, 0]), 0.5 * (poses[i, 1] + poses[i + 1, 1])
    return x, y, poses[i, 2] + 0.5 * turn_between(poses[i, 2], poses[i + 1, 2])


@njit_no_refcount
def _note_limits(
    limits: FloatArray,
    sole: tuple[float, float],
    i: int,
    step: FloatArray,
    value: FloatArray,
    slope: FloatArray,
    active: NDArray[np.bool_],
) -> None:
    """Fills the rules of step i about its own size and about the gap between the feet."""
    for axis in range(3):
        low, high = 2 * axis, 2 * axis + 1
        value[i, low] = step[i, axis, 6] - limits[low] - SPARE_M
        value[i, high] = limits[high] - step[i, axis, 6] - SPARE_M
        active[i, low] = active[i, high] = True
        for k in range(6):
            slope[i, low, k] = step[i, axis, k]
            slope[i, high, k] = -step[i, axis, k]
    gap, by_x, by_y, by_yaw = gap_axis(
        step[i, 0, 6], step[i, 1, 6], step[i, 2, 6], sole[0], sole[1]
    )
    value[i, GAP] = gap - SPARE_M
    active[i, GAP] = gap < _REACH_M
    for k in range(6):
        slope[i, GAP, k] = by_x * step[i, 0, k] + by_y * step[i, 1, k] + by_yaw * step[i, 2, k]


@njit_no_refcount
def _note_reach(
    reach: FloatArray,
    i: int,
    step: FloatArray,
    value: FloatArray,
    slope: FloatArray,
    active: NDArray[np.bool_],
) -> None:
    """Fills the rules of step i about the half planes (k, 3) in which it must lie."""
    first = value.shape[1] - len(reach)
    for edge in range(len(reach)):
        row, n_x, n_y = first + edge, reach[edge, 0], reach[edge, 1]
        value[i, row] = reach[edge, 2] - n_x * step[i, 0, 6] - n_y * step[i, 1, 6] - SPARE_M
        active[i, row] = True
        for k in range(6):
            slope[i, row, k] = -n_x * step[i, 0, k] - n_y * step[i, 1, k]


@njit_no_refcount
def _take_room(
    i: int,
    first: int,
    near: bool,
    room: FloatArray,
    moves: tuple[float, float, float, float],
    value: FloatArray,
    slope: FloatArray,
    active: NDArray[np.bool_],
) -> None:
    """Takes the room of a box over as rules of step i from row `first` on.

    moves: how much of the support's and of the swing foot's pose makes the box's, and how x and y
    of its centre change with the swing foot's yaw.
    """
    support, swing, x_by_yaw, y_by_yaw = moves
    for way in range(WAYS):
        row = first + way
        active[i, row] = near and room[way, 0] < _REACH_M
        if not active[i, row]:
            continue
        value[i, row] = room[way, 0]
        for k in range(3):
            slope[i, row, k] = support * room[way, k + 1]
            slope[i, row, k + 3] = swing * room[way, k + 1]
        slope[i, row, 5] += room[way, 1] * x_by_yaw + room[way, 2] * y_by_yaw


@njit_no_refcount
def add(block: FloatArray, curve: float, slope: FloatArray, i: int, row: int, force: float) -> None:
    """Adds curve * along * along^T and force * along to a block (6, 7); along: slope[i, row]."""
    for a in range(6):
        along = slope[i, row, a]
        block[a, 6] += force * along
        for b in range(6):
            block[a, b] += curve * along * slope[i, row, b]


@njit_no_refcount
def take_block(block: FloatArray, i: int, matrix: FloatArray, right: FloatArray) -> None:
    """Adds the block of step i to the system; what belongs to fixed poses is left out."""
    base, size = 3 * (i - 1), len(right)
    for a in range(max(0, -base), min(6, size - base)):
        right[base + a] += block[a, 6]
        for b in range(max(0, -base), a + 1):
            matrix[base + a, a - b] += block[a, b]


@njit_no_refcount
def note_costs(
    weights: tuple[float, float, float, float, float],
    i: int,
    step: FloatArray,
    along: FloatArray,
    block: FloatArray,
) -> float:
    """Adds gradient and curvature of what step i costs to the block; returns that cost in metres.

    |t| is taken as sqrt(t^2 + _CORNER_M^2), with the curvature of the parabola that touches it from
    above there: the true one is too small away from 0 and the next step would go too far. along
    (1, 1, 6) is scratch.
    """
    stance, per_step, per_turn, per_side, per_back = weights
    x, y, yaw = step[i, 0, 6], step[i, 1, 6], step[i, 2, 6]
    length = math.sqrt(x * x + y * y)
    # x and y of the step in its own frame: turning the support foot changes no distance.
    u, v = x / max(length, _CORNER_M), y / max(length, _CORNER_M)
    for k in range(6):
        along[0, 0, k] = u * step[i, 0, k] + v * step[i, 1, k]
    add(block, 0.0, along, 0, 0, -1.0)
    for k in range(6):
        along[0, 0, k] = v * step[i, 0, k] - u * step[i, 1, k]
    along[0, 0, 2] = along[0, 0, 5] = 0.0
    add(block, 1.0 / max(length, _CORNER_M), along, 0, 0, 0.0)
    if per_turn > 0.0:
        size = math.sqrt(yaw * yaw + _CORNER_M * _CORNER_M)
        add(block, per_turn / size, step, i, 2, -per_turn * yaw / size)
    if per_side > 0.0:
        off = y - stance
        size = math.sqrt(off * off + _CORNER_M * _CORNER_M)
        add(block, per_side / size, step, i, 1, -per_side * off / size)
    if per_back > 0.0:
        # max(-x, 0) is (|x| - x) / 2.
        size = math.sqrt(x * x + _CORNER_M * _CORNER_M)
        add(block, 0.5 * per_back / size, step, i, 0, -0.5 * per_back * (x / size - 1.0))
    cost_m = length + per_step + per_turn * abs(yaw) + per_side * abs(y - stance)
    return cost_m + per_back * max(-x, 0.0)


@njit_no_refcount
def note_clearance(
    terrain: Terrain,
    clearance: tuple[float, float, float],
    poses: FloatArray,
    i: int,
    along: FloatArray,
    block: FloatArray,
) -> float:
    """Adds what the clearance of the pair pose costs, by differences over _HINGE_M.

    Returns that cost in metres as the search counts it, which knows no slope.
    """
    wanted_m, worst_m, most_um = clearance
    x, y, _ = _midway(poses, i)
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
        along[0, 0, axis] = along[0, 0, axis + 3] = 0.5
        curve = max((more - 2.0 * here + less) / (_HINGE_M * _HINGE_M), 0.0)
        add(block, curve, along, 0, 0, -(more - less) / (2.0 * _HINGE_M))
    short_m = wanted_m - point_clearance(terrain, x, y)
    return most_um / MICRO * min(max(short_m / (wanted_m - worst_m), 0.0), 1.0)


@njit_no_refcount
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
