"""Constraints on the steps of a plan, their values and gradients, compiled.

Every constraint is a distance that must not be negative: from a limit of the step, between the two
feet, from a box to the blocked cells around it. A step shares constraints with its neighbours only,
so the matrix of the Newton step is banded.

A box, widened by its margin, has twelve distances to the cells around it. Each cell is nearest to
the box either at a corner of both, or along one of four axes, those of the map and those of the
box, the one on which it lies farthest off. The least distance on either side of each axis and at
each corner of the box bounds where the box may move, and turning changes it smoothly.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.collision import NO_GROUND_UM, Terrain, corner_gap, point_clearance, radius_of
from planner.compiled import njit_inner
from planner.lattice.lattice import Lattice
from planner.refinement.cost import RefinementProblem, gap_axis, pair_pose_of, turn_between
from planner.robot_model import RoundedBox

FloatArray = NDArray[np.float64]
# Ahead, back, left, right of the box; +x, -x, +y, -y of the map; corners as in `corner_gap`.
DIRECTIONS, _FIRST_CORNER = 12, 8
MARGIN_M = 1e-5  # kept from all limits, more than the numeric error of an iteration


class _Box(NamedTuple):
    """A box with half extents: half_l, half_w along its own axes, reach_x, reach_y along the map's.

    cell_reach: half extent of a cell along the box's axes. by_yaw_*: derivatives of the last three
    by the yaw. radius: of the disc that widens the box, which the other numbers leave out.
    """

    x: float
    y: float
    cos: float
    sin: float
    half_l: float
    half_w: float
    radius: float
    reach_x: float
    reach_y: float
    cell_reach: float
    by_yaw_x: float
    by_yaw_y: float
    by_yaw_cell: float


@njit_inner
def _box(x: float, y: float, yaw: float, rounded: RoundedBox, size: float) -> _Box:
    half_l, half_w, radius = rounded
    cos, sin = math.cos(yaw), math.sin(yaw)
    cos_sign, sin_sign = (1.0 if cos >= 0 else -1.0), (1.0 if sin >= 0 else -1.0)
    return _Box(
        x,
        y,
        cos,
        sin,
        half_l,
        half_w,
        radius + MARGIN_M,
        abs(cos) * half_l + abs(sin) * half_w,
        abs(sin) * half_l + abs(cos) * half_w,
        0.5 * size * (abs(cos) + abs(sin)),
        half_w * cos * sin_sign - half_l * sin * cos_sign,
        half_l * cos * sin_sign - half_w * sin * cos_sign,
        0.5 * size * (cos * sin_sign - sin * cos_sign),
    )


@njit_inner
def distances_to_blocked(
    terrain: Terrain,
    x: float,
    y: float,
    yaw: float,
    rounded: RoundedBox,
    range_m: float,
    distances: FloatArray,
) -> bool:
    """Fills distances (DIRECTIONS, 4): metres, and their derivatives by x, y and yaw of the box.

    A distance is range_m where nothing is nearer, and negative where box and cells overlap.
    Returns False, with nothing filled, if no cell is in range.
    """
    if point_clearance(terrain, x, y) > radius_of(rounded) + range_m:
        return False
    size = terrain.resolution_m
    box = _box(x, y, yaw, rounded, size)
    distances[:, 0] = range_m
    _measure_edges(terrain, box, distances)
    row0, row1, col0, col1 = _cells_around(terrain, box, range_m)
    for row in range(row0, row1 + 1):
        dy = (row + 0.5) * size - box.y
        col = col0
        while col <= col1:
            if terrain.blocked[row, col]:
                _measure_cell(box, (col + 0.5) * size - box.x, dy, 0.5 * size, distances)
                col += 1
            else:
                # No blocked ground within this distance, so the next cells are free as well.
                col += max(1, int(terrain.clearance_m[row, col] / size + 0.499))
    return True


@njit_inner
def distances_to_level_edge(
    terrain: Terrain,
    x: float,
    y: float,
    yaw: float,
    rounded: RoundedBox,
    level_um: int,
    range_m: float,
    distances: FloatArray,
) -> bool:
    """As `distances_to_blocked`, to floor more than level_um above or below that at the centre.

    Returns False where the centre is on no floor.
    """
    size = terrain.resolution_m
    rows, cols = terrain.blocked.shape
    row, col = math.floor(y / size), math.floor(x / size)
    if row < 0 or col < 0 or row >= rows or col >= cols:
        return False
    own_um = terrain.height_um[row, col]
    if own_um == NO_GROUND_UM:
        return False
    box = _box(x, y, yaw, rounded, size)
    distances[:, 0] = range_m
    row0, row1, col0, col1 = _cells_around(terrain, box, range_m)
    for row in range(row0, row1 + 1):
        dy = (row + 0.5) * size - box.y
        for col in range(col0, col1 + 1):
            height_um = terrain.height_um[row, col]
            if height_um != NO_GROUND_UM and abs(height_um - own_um) > level_um:
                _measure_cell(box, (col + 0.5) * size - box.x, dy, 0.5 * size, distances)
    return True


@njit_inner
def _cells_around(terrain: Terrain, box: _Box, range_m: float) -> tuple[int, int, int, int]:
    """First and last row and column of the cells that may lie in range of a box."""
    rows, cols = terrain.blocked.shape
    size = terrain.resolution_m
    reach_x, reach_y = box.reach_x + box.radius + range_m, box.reach_y + box.radius + range_m
    return (
        max(0, math.floor((box.y - reach_y) / size)),
        min(rows - 1, math.floor((box.y + reach_y) / size)),
        max(0, math.floor((box.x - reach_x) / size)),
        min(cols - 1, math.floor((box.x + reach_x) / size)),
    )


@njit_inner
def _measure_edges(terrain: Terrain, box: _Box, distances: FloatArray) -> None:
    """Measures to the edges of the map, which no box may cross."""
    rows, cols = terrain.blocked.shape
    size = terrain.resolution_m
    for direction, gap in (
        (4, cols * size - box.x - box.reach_x - box.radius),
        (5, box.x - box.reach_x - box.radius),
        (6, rows * size - box.y - box.reach_y - box.radius),
        (7, box.y - box.reach_y - box.radius),
    ):
        if gap < distances[direction, 0]:
            _measure_on_map_axis(box, direction, gap, distances)


@njit_inner
def _measure_cell(box: _Box, dx: float, dy: float, half: float, distances: FloatArray) -> None:
    """Measures to a cell with its centre at (dx, dy) from that of the box; keeps the nearest."""
    along, across = box.cos * dx + box.sin * dy, box.cos * dy - box.sin * dx
    direction, gap = (0 if along >= 0 else 1), abs(along) - box.half_l - box.cell_reach
    if abs(across) - box.half_w - box.cell_reach > gap:
        direction, gap = (2 if across >= 0 else 3), abs(across) - box.half_w - box.cell_reach
    if abs(dx) - box.reach_x - half > gap:
        direction, gap = (4 if dx >= 0 else 5), abs(dx) - box.reach_x - half
    if abs(dy) - box.reach_y - half > gap:
        direction, gap = (6 if dy >= 0 else 7), abs(dy) - box.reach_y - half
    if gap > 0.0:
        corner, gap_x, gap_y = corner_gap(dx, dy, half, box.cos, box.sin, box.half_l, box.half_w)
        if corner >= 0:
            _measure_corner(box, corner, gap_x, gap_y, distances)
            return
    gap -= box.radius
    if gap >= distances[direction, 0]:
        return
    if direction >= 4:
        _measure_on_map_axis(box, direction, gap, distances)
        return
    distances[direction, 0] = gap
    sign = 1.0 if direction % 2 == 0 else -1.0
    if direction < 2:
        distances[direction, 1], distances[direction, 2] = -sign * box.cos, -sign * box.sin
        distances[direction, 3] = sign * across - box.by_yaw_cell
    else:
        distances[direction, 1], distances[direction, 2] = sign * box.sin, -sign * box.cos
        distances[direction, 3] = -sign * along - box.by_yaw_cell


@njit_inner
def _measure_corner(
    box: _Box, corner: int, gap_x: float, gap_y: float, distances: FloatArray
) -> None:
    """Measures from a corner of the box over a gap to the corner of a cell."""
    direction, length = _FIRST_CORNER + corner, math.sqrt(gap_x * gap_x + gap_y * gap_y)
    if length - box.radius >= distances[direction, 0]:
        return
    ahead, left = 1.0 - 2.0 * (corner & 1), 1.0 - (corner & 2)
    x = box.cos * ahead * box.half_l - box.sin * left * box.half_w
    y = box.sin * ahead * box.half_l + box.cos * left * box.half_w
    distances[direction, 0] = length - box.radius
    distances[direction, 1], distances[direction, 2] = -gap_x / length, -gap_y / length
    distances[direction, 3] = (gap_x * y - gap_y * x) / length


@njit_inner
def _measure_on_map_axis(box: _Box, direction: int, gap: float, distances: FloatArray) -> None:
    sign = -1.0 if direction % 2 == 0 else 1.0
    distances[direction, 0] = gap
    distances[direction, 1], distances[direction, 2] = (sign, 0.0) if direction < 6 else (0.0, sign)
    distances[direction, 3] = -box.by_yaw_x if direction < 6 else -box.by_yaw_y


# Constraints of a step: low and high limits of x, y and yaw; the gap between the feet; then twelve
# distances each of the body on both feet, of the foot, of the body on this foot, and on uneven
# floors of the foot on its tread; then one for each edge of the landing polygon.
GAP, PAIR, FOOT, BODY, TREAD = 6, 7, 7 + DIRECTIONS, 7 + 2 * DIRECTIONS, 7 + 3 * DIRECTIONS
BAND = 6  # a row of the matrix reaches over two poses

_RANGE_M = 0.07  # of cells that constrain: more than a pose moves in one iteration


class Workspace(NamedTuple):
    """Arrays of one run for N steps, of which all but the last have R constraints each.

    value, slack, multiplier (N - 1, R): of the constraints. gradient (N - 1, R, 6): by the pose
    before and the pose itself. active, was_active (N - 1, R): now, and one iteration ago. newton
    (N - 1, R, 2): Newton step of slack and multiplier. step (N - 1, 3, 7): derivatives of each
    step's x, y and yaw by both poses, and their values. matrix (3 (N - 2), BAND), right
    (3 (N - 2),): the banded system. Scratch: distances (DIRECTIONS, 4); block (6, 7): Hessian and
    negative gradient by the two poses of one step; along (6,).
    """

    value: FloatArray
    gradient: FloatArray
    slack: FloatArray
    multiplier: FloatArray
    newton: FloatArray
    active: NDArray[np.bool_]
    was_active: NDArray[np.bool_]
    step: FloatArray
    matrix: FloatArray
    right: FloatArray
    distances: FloatArray
    block: FloatArray
    along: FloatArray


def new_workspace(lattice: Lattice, steps: int, edges: int) -> Workspace:
    """Empty arrays for so many steps, in a polygon of so many edges."""
    free, bound = 3 * (steps - 2), steps - 1
    number = edges + (TREAD if len(lattice.node_um) == 0 else TREAD + DIRECTIONS)
    return Workspace(
        np.zeros((bound, number)),
        np.zeros((bound, number, 6)),
        np.zeros((bound, number)),
        np.zeros((bound, number)),
        np.zeros((bound, number, 2)),
        np.zeros((bound, number), np.bool_),
        np.zeros((bound, number), np.bool_),
        np.zeros((bound, 3, 7)),
        np.zeros((free, BAND)),
        np.zeros(free),
        np.zeros((DIRECTIONS, 4)),
        np.zeros((6, 7)),
        np.zeros(6),
    )


# The functions below take arrays, not the tuples that hold them: reading an array from a tuple in
# the loop over the steps costs more than the work on it.


@njit_inner
def evaluate_constraints(
    problem: RefinementProblem, workspace: Workspace, poses: FloatArray, first_outward: float
) -> None:
    """Fills step, value, gradient and active; step i leads from pose i to pose i + 1."""
    terrain, foot, body = problem.lattice.terrain, problem.lattice.foot, problem.lattice.body
    tread, level_um = problem.lattice.tread, problem.lattice.climb_um[2]
    half_stance_m, is_flat = problem.lattice.half_stance_m, len(problem.lattice.node_um) == 0
    first_body, sole, limits, reach = (
        problem.first_body,
        problem.foot,
        problem.limits,
        problem.reach,
    )
    value, gradient, active = workspace.value, workspace.gradient, workspace.active
    distances, step = workspace.distances, workspace.step
    outward = first_outward
    for i in range(len(value)):
        _evaluate_step(poses, i, outward, step)
        _constrain_step(limits, sole, i, step, value, gradient, active)
        _constrain_to_polygon(reach, i, step, value, gradient, active)
        x, y, yaw = pair_pose_of(poses[i], poses[i + 1])
        at_pair = first_body if i == 0 else body
        near = distances_to_blocked(terrain, x, y, yaw, at_pair, _RANGE_M, distances)
        _set_distances(i, int(PAIR), near, distances, (0.5, 0.5, 0.0, 0.0), value, gradient, active)
        if i == len(value) - 1:
            break  # this foot stands where the goal wants it
        x, y, yaw = poses[i + 1, 0], poses[i + 1, 1], poses[i + 1, 2]
        near = distances_to_blocked(terrain, x, y, yaw, foot, _RANGE_M, distances)
        _set_distances(i, int(FOOT), near, distances, (0.0, 1.0, 0.0, 0.0), value, gradient, active)
        inward_x = half_stance_m * outward * math.sin(yaw)
        inward_y = -half_stance_m * outward * math.cos(yaw)
        near = distances_to_blocked(
            terrain, x + inward_x, y + inward_y, yaw, body, _RANGE_M, distances
        )
        _set_distances(
            i, int(BODY), near, distances, (0.0, 1.0, -inward_y, inward_x), value, gradient, active
        )
        if not is_flat:
            near = distances_to_level_edge(terrain, x, y, yaw, tread, level_um, _RANGE_M, distances)
            _set_distances(
                i, int(TREAD), near, distances, (0.0, 1.0, 0.0, 0.0), value, gradient, active
            )
        outward = -outward


@njit_inner
def _evaluate_step(poses: FloatArray, i: int, outward: float, step: FloatArray) -> None:
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


@njit_inner
def _constrain_step(
    limits: FloatArray,
    sole: tuple[float, float],
    i: int,
    step: FloatArray,
    value: FloatArray,
    gradient: FloatArray,
    active: NDArray[np.bool_],
) -> None:
    """Fills the constraints of step i: its limits and the gap between the feet."""
    for axis in range(3):
        low, high = 2 * axis, 2 * axis + 1
        value[i, low] = step[i, axis, 6] - limits[low] - MARGIN_M
        value[i, high] = limits[high] - step[i, axis, 6] - MARGIN_M
        active[i, low] = active[i, high] = True
        for k in range(6):
            gradient[i, low, k] = step[i, axis, k]
            gradient[i, high, k] = -step[i, axis, k]
    gap, by_x, by_y, by_yaw = gap_axis(
        step[i, 0, 6], step[i, 1, 6], step[i, 2, 6], sole[0], sole[1]
    )
    value[i, GAP] = gap - MARGIN_M
    active[i, GAP] = gap < _RANGE_M
    for k in range(6):
        gradient[i, GAP, k] = by_x * step[i, 0, k] + by_y * step[i, 1, k] + by_yaw * step[i, 2, k]


@njit_inner
def _constrain_to_polygon(
    reach: FloatArray,
    i: int,
    step: FloatArray,
    value: FloatArray,
    gradient: FloatArray,
    active: NDArray[np.bool_],
) -> None:
    """Fills the constraints of step i by the half planes (k, 3) of the landing polygon."""
    first = value.shape[1] - len(reach)
    for edge in range(len(reach)):
        row, n_x, n_y = first + edge, reach[edge, 0], reach[edge, 1]
        value[i, row] = reach[edge, 2] - n_x * step[i, 0, 6] - n_y * step[i, 1, 6] - MARGIN_M
        active[i, row] = True
        for k in range(6):
            gradient[i, row, k] = -n_x * step[i, 0, k] - n_y * step[i, 1, k]


@njit_inner
def _set_distances(
    i: int,
    first: int,
    near: bool,
    distances: FloatArray,
    moves: tuple[float, float, float, float],
    value: FloatArray,
    gradient: FloatArray,
    active: NDArray[np.bool_],
) -> None:
    """Takes the distances of a box as constraints of step i from row `first` on.

    moves: derivatives of the box's pose by the support's and by the swing foot's pose, and of x
    and y of its centre by the swing foot's yaw. Give a constant `first` as `int(PAIR)`: numba
    compiles a function anew for each literal.
    """
    support, swing, x_by_yaw, y_by_yaw = moves
    for direction in range(DIRECTIONS):
        row = first + direction
        active[i, row] = near and distances[direction, 0] < _RANGE_M
        if not active[i, row]:
            continue
        value[i, row] = distances[direction, 0]
        for k in range(3):
            gradient[i, row, k] = support * distances[direction, k + 1]
            gradient[i, row, k + 3] = swing * distances[direction, k + 1]
        gradient[i, row, 5] += (
            distances[direction, 1] * x_by_yaw + distances[direction, 2] * y_by_yaw
        )


@njit_inner
def add_block(block: FloatArray, i: int, matrix: FloatArray, right: FloatArray) -> None:
    """Adds the block of step i to the system, without the rows and columns of fixed poses."""
    base, size = 3 * (i - 1), len(right)
    for a in range(max(0, -base), min(6, size - base)):
        right[base + a] += block[a, 6]
        for b in range(max(0, -base), a + 1):
            matrix[base + a, a - b] += block[a, b]
