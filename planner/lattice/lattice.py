"""The lattice laid over one map for one goal, as plain arrays that the compiled search reads.

Nodes are numbered ((row * cols + col) * headings + heading) * 2 + side, with row and col counted
from a corner so that the whole map and a rim of one step around it have numbers 0 and up. The rim
is never free, so no step of the search leaves the arrays.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from maps.grid import OccupancyGrid
from planner.collision import (
    NEAR_M,
    NO_GROUND_UM,
    Terrain,
    box_free,
    box_heights,
    clearance_at,
    highest_between,
    point_clearance,
    radius_of,
)
from planner.compiled import (
    Slots,
    njit_inner,
    njit_no_refcount,
    slot_of,
    slots_for,
    take_slot,
    zeros,
)
from planner.lattice.frame import Frame
from planner.lattice.steps import MICRO, StepTable, numbered_steps
from planner.robot_model import RoundedBox, StepModel, level_box, rounded_box

UNKNOWN, FREE, BLOCKED = 0, 1, 2
_PAIR_SLOTS = 1 << 15

Int64s = NDArray[np.int64]
Floats = NDArray[np.float64]
Foot = tuple[float, float, float, float]  # x, y, cos, sin in the grid frame

# Columns of Lattice.steps
COST_UM, D_COL, D_ROW, D_NODE, D_CELL, TO_ROW, D_HALF, HALF_HEADING = range(8)


class Lattice(NamedTuple):
    """Geometry of the lattice over a map, and the caches of its checks.

    steps (2 H, K, 8): the step table; row heading * 2 + side is the support foot's. COST_UM: 0 for
    no step. D_COL, D_ROW, D_NODE, D_CELL: differences of columns, rows and numbers. TO_ROW: row of
    the swing foot. D_HALF: the cells' difference for the midpoint of the feet on the grid of half
    cells. HALF_HEADING: mean heading in half bins.
    cos, sin (2 H,): of half heading bins in the grid frame. frame: x, y, cos, sin of the goal's
    pair pose in the grid frame. origin: col, row of the goal's cell. foot, body: widened by their
    margins. clearance: see `_clearance`.
    tread: box of a foot on which the ground must be level. sole: half length and half
    width of a foot. swing_reach_m: how far from a foot a step may pass over ground. climb_um: see
    `_climb`.
    slots: where arrays over the nodes have what is known of each. node_state (slots,): UNKNOWN,
    FREE or BLOCKED. node_um (slots,): height of the ground under each node that was found free, in
    micrometres; (0,) where the floor is flat. pair_key: see `pair_free`.
    """

    terrain: Terrain
    steps: Int64s
    cols: int
    rows: int
    headings: int
    origin_col: int
    origin_row: int
    cell_m: float
    frame: Frame
    half_stance_m: float
    foot: RoundedBox
    body: RoundedBox
    clearance: tuple[float, float, float]
    cos: Floats
    sin: Floats
    slots: Slots
    node_state: NDArray[np.uint8]
    pair_key: Int64s
    tread: RoundedBox
    sole: tuple[float, float]
    swing_reach_m: float
    climb_um: tuple[int, int, int, int]
    node_um: NDArray[np.int32]

    @property
    def nodes(self) -> int:
        """How many nodes there are."""
        return self.cols * self.rows * self.headings * 2

    @property
    def goal_cell(self) -> Int64s:
        """Number of the goal's cell (1,)."""
        return np.array([self.origin_row * self.cols + self.origin_col])

    @property
    def goal_nodes(self) -> Int64s:
        """Nodes of the goal feet (2,), left then right."""
        return self.goal_cell * self.headings * 2 + np.arange(2)


def reversed_steps(steps: Int64s) -> Int64s:
    """Steps (2 H, K', 8) by the row in which they end, as `Lattice.steps` by the first."""
    from_row, number = np.nonzero(steps[..., COST_UM])
    back = steps[from_row, number]
    to_row = back[:, TO_ROW].copy()
    # A pair pose lies halfway: as far back from the one foot as on from the other.
    back[:, [D_COL, D_ROW, D_NODE, D_CELL, D_HALF]] *= -1
    back[:, TO_ROW] = from_row
    order = np.argsort(to_row, kind="stable")
    to_row, back = to_row[order], back[order]
    place = np.arange(len(back)) - np.searchsorted(to_row, to_row)
    turned = np.zeros((len(steps), int(place.max()) + 1, steps.shape[2]), np.int64)
    turned[to_row, place] = back
    return turned


def build_lattice(
    grid: OccupancyGrid,
    terrain: Terrain,
    model: StepModel,
    table: StepTable,
    goal: tuple[float, float, float],
) -> Lattice:
    """The lattice over a map for a goal pair pose in the world; fails for no goal."""
    x_m, y_m = (float(v) for v in grid.world_to_grid(goal[:2]))
    yaw_rad = goal[2] - grid.origin[2]
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    width_m, height_m = grid.size_m
    corners = np.array([[0.0, 0.0], [width_m, 0.0], [0.0, height_m], [width_m, height_m]])
    corners = (corners - (x_m, y_m)) @ np.array([[cos, -sin], [sin, cos]]) / model.cell_m
    rim = int(max(np.abs(table.d_col).max(), np.abs(table.d_row).max())) + 4
    low = np.floor(corners.min(axis=0)).astype(int) - rim
    high = np.ceil(corners.max(axis=0)).astype(int) + rim
    cols, rows = (int(v) for v in high - low + 1)
    slots = slots_for(cols * rows * model.headings * 2)
    half_bins = yaw_rad + np.arange(2 * model.headings) * (np.pi / model.headings)
    return Lattice(
        terrain=terrain,
        steps=numbered_steps(table, cols),
        cols=cols,
        rows=rows,
        headings=model.headings,
        origin_col=int(-low[0]),
        origin_row=int(-low[1]),
        cell_m=model.cell_m,
        frame=(x_m, y_m, cos, sin),
        half_stance_m=model.stance_width_m / 2,
        foot=rounded_box(model.foot, model.foot_margin_m),
        body=rounded_box(model.body, model.body_margin_m),
        clearance=_clearance(model),
        cos=np.cos(half_bins),
        sin=np.sin(half_bins),
        slots=slots,
        node_state=zeros(slots.length, np.uint8),
        pair_key=zeros(_PAIR_SLOTS, np.int64),
        tread=level_box(model),
        sole=(model.foot.length_m / 2, model.foot.width_m / 2),
        swing_reach_m=_swing_reach(model),
        climb_um=_climb(model),
        node_um=zeros(0 if terrain.is_flat else slots.length, np.int32),
    )


def _clearance(model: StepModel) -> tuple[float, float, float]:
    """Clearance of the pair pose that costs nothing, that costs most, and the most in micrometres.

    As far as the body's half width nothing is gained.
    """
    if model.clearance_m == 0 or model.clearance_cost_m == 0:
        return 0.0, -1.0, 0.0
    half_width_m = model.body.width_m / 2
    return half_width_m + model.clearance_m, half_width_m, model.clearance_cost_m * MICRO


def _climb(model: StepModel) -> tuple[int, int, int, int]:
    """Lowest and highest rise of a step, what counts as level, and what a swing clears, in um."""
    values_m = *model.limits.z_m, model.level_m, model.swing_clear_m
    low, high, level, clear = (round(value_m * MICRO) for value_m in values_m)
    return low, high, level, clear


def _swing_reach(model: StepModel) -> float:
    """How far from the support foot's centre the feet of a step may pass (see `step_climbs`)."""
    limits = model.limits
    step_m = math.hypot(max(map(abs, limits.x_m)), max(map(abs, limits.y_m)))
    sole_m = math.hypot(model.foot.length_m, model.foot.width_m) / 2
    return step_m + model.stance_width_m + sole_m


@njit_inner
def out_of_frame(frame: Frame, x: float, y: float) -> tuple[float, float]:
    """Point of a frame, given by x, y, cos and sin, in the frame that it is given in."""
    ox, oy, cos, sin = frame
    return ox + cos * x - sin * y, oy + sin * x + cos * y


@njit_inner
def to_grid(lattice: Lattice, x: float, y: float) -> tuple[float, float]:
    """Point of the lattice frame in the grid frame."""
    return out_of_frame(lattice.frame, x, y)


@njit_inner
def decoded(lattice: Lattice, node: int) -> tuple[int, int, int, int]:
    """Column and row of a node, both from the goal's cell, its heading and its side."""
    cell = (node >> 1) // lattice.headings
    col, row = cell % lattice.cols - lattice.origin_col, cell // lattice.cols - lattice.origin_row
    return col, row, (node >> 1) % lattice.headings, node & 1


@njit_inner
def node_pose(lattice: Lattice, node: int) -> tuple[float, float, float]:
    """x, y and yaw of the foot of a node in the lattice frame."""
    col, row, heading, side = decoded(lattice, node)
    y = row * lattice.cell_m + (1 - 2 * side) * lattice.half_stance_m
    return col * lattice.cell_m, y, heading * (2.0 * math.pi / lattice.headings)


def node_poses(lattice: Lattice, nodes: Int64s) -> Floats:
    """`node_pose` (n, 3) of nodes (n,).

    Not compiled: it is asked for once a plan, and would take longer to load.
    """
    up, across = np.divmod(nodes // (2 * lattice.headings), lattice.cols)
    y = (up - lattice.origin_row) * lattice.cell_m + (1 - 2 * (nodes & 1)) * lattice.half_stance_m
    yaw = (nodes >> 1) % lattice.headings * (2.0 * math.pi / lattice.headings)
    return np.column_stack([(across - lattice.origin_col) * lattice.cell_m, y, yaw])


@njit_inner
def node_foot(lattice: Lattice, node: int) -> tuple[float, float, float, float]:
    """Where the foot of a node is, x and y in the grid frame, and cosine and sine of its yaw."""
    x, y, _ = node_pose(lattice, node)
    x, y = to_grid(lattice, x, y)
    heading = (node >> 1) % lattice.headings
    return x, y, lattice.cos[2 * heading], lattice.sin[2 * heading]


@njit_inner
def foot_at(pose: Floats) -> tuple[float, float, float, float]:
    """The foot of a pose (3,) in the grid frame."""
    return pose[0], pose[1], math.cos(pose[2]), math.sin(pose[2])


@njit_no_refcount
def node_free(lattice: Lattice, node: int) -> bool:
    """Whether the foot's box and the body's box over this one foot are free; cached.

    Where the floor is not flat it must also be level under the foot.
    """
    slot = take_slot(lattice.slots, node)
    state = lattice.node_state[slot]
    if state == UNKNOWN:
        state = check_node(lattice, node, slot)
    return state == FREE


@njit_inner
def check_node(lattice: Lattice, node: int, slot: int) -> int:
    """FREE or BLOCKED, which it also notes in the node's slot."""
    state = FREE if _node_is_free(lattice, node, slot) else BLOCKED
    lattice.node_state[slot] = state
    return state


@njit_inner
def far_from_all(
    clearance_m: NDArray[np.float32],
    size_m: float,
    foot: tuple[float, float],
    turn: tuple[float, float],
    inward_m: float,
    radii_m: tuple[float, float],
) -> bool:
    """Whether distances alone say that a foot and the body over it keep off all that is blocked.

    foot: x, y in the grid frame; turn: cos, sin; inward_m: how far to its left the body is;
    radii_m: of the circles around both boxes. With a field (H, W) and its cells' size at hand this
    costs a tenth of `check_node`, which takes over the whole lattice.
    """
    if clearance_at(clearance_m, size_m, foot[0], foot[1]) <= radii_m[0]:
        return False
    body_x, body_y = foot[0] - turn[1] * inward_m, foot[1] + turn[0] * inward_m
    return clearance_at(clearance_m, size_m, body_x, body_y) > radii_m[1]


@njit_inner
def _node_is_free(lattice: Lattice, node: int, slot: int) -> bool:
    x, y, cos, sin = node_foot(lattice, node)
    if not box_free(lattice.terrain, x, y, cos, sin, lattice.foot):
        return False
    if len(lattice.node_um) > 0:
        height_um = level_height_um(lattice, (x, y, cos, sin))
        if height_um == NO_GROUND_UM:
            return False
        lattice.node_um[slot] = height_um
    inward = (1 - 2 * (node & 1)) * lattice.half_stance_m
    body_x, body_y = x + sin * inward, y - cos * inward
    return box_free(lattice.terrain, body_x, body_y, cos, sin, lattice.body)


@njit_inner
def node_height_um(lattice: Lattice, node: int) -> int:
    """Height of the ground under a node that was found free; the floor must not be flat."""
    height_um: int = np.int64(lattice.node_um[slot_of(lattice.slots, node)])  # type: ignore[assignment]
    return height_um


@njit_inner
def level_height_um(lattice: Lattice, foot: Foot) -> int:
    """Height of the ground under a foot in micrometres; NO_GROUND_UM where it is not level.

    The floor must not be flat.
    """
    x, y, cos, sin = foot
    low, high = box_heights(lattice.terrain, x, y, cos, sin, lattice.tread)
    return high if high - low <= lattice.climb_um[2] else NO_GROUND_UM


@njit_inner
def _half_point(lattice: Lattice, half: int) -> tuple[float, float]:
    """Point half = row * 2 * cols + col of the grid of half cells, in the grid frame."""
    width = 2 * lattice.cols
    row, col = half // width - 2 * lattice.origin_row, half % width - 2 * lattice.origin_col
    return to_grid(lattice, 0.5 * col * lattice.cell_m, 0.5 * row * lattice.cell_m)


@njit_inner
def half_clearance(lattice: Lattice, half: int) -> float:
    """Clearance in metres of a point of the grid of half cells, see `_half_point`."""
    x, y = _half_point(lattice, half)
    return point_clearance(lattice.terrain, x, y)


@njit_inner
def pair_free(lattice: Lattice, half: int, half_heading: int) -> bool:
    """Whether the body's box at the pair pose of a step is free; cached."""
    key = (half * 2 * lattice.headings + half_heading) * 2
    slot = (key * 0x9E3779B1 >> 7) & (_PAIR_SLOTS - 1)
    stored = lattice.pair_key[slot]  # 0 where nothing is: the first half cell lies on the rim
    if stored >> 1 == key >> 1:
        return (stored & 1) == 1
    x, y = _half_point(lattice, half)
    free = box_free(
        lattice.terrain, x, y, lattice.cos[half_heading], lattice.sin[half_heading], lattice.body
    )
    lattice.pair_key[slot] = key + (1 if free else 0)
    return free


@njit_inner
def pair_known_free(lattice: Lattice, half: int, half_heading: int) -> bool:
    """As `pair_free`, without asking for the box where the clearance alone says that it is free."""
    if half_clearance(lattice, half) > radius_of(lattice.body):
        return True
    return pair_free(lattice, half, half_heading)


@njit_no_refcount
def clearance_cost(lattice: Lattice, clearance_m: float) -> int:
    """Extra cost in micrometres of a step whose pair pose has this clearance."""
    wanted_m, worst_m, cost_um = lattice.clearance
    if clearance_m >= wanted_m:
        return 0
    return int(cost_um * min(1.0, (wanted_m - clearance_m) / (wanted_m - worst_m)))


@njit_inner
def step_climbs(lattice: Lattice, support: int, swing: int) -> bool:
    """As `feet_climb`, between two free nodes. The floor must not be flat."""
    support_um, swing_um = node_height_um(lattice, support), node_height_um(lattice, swing)
    rise = swing_um - support_um
    if rise < lattice.climb_um[0] or rise > lattice.climb_um[1]:
        return False
    foot = node_foot(lattice, support)
    highest = max(support_um, swing_um) + lattice.climb_um[3]
    if _lower_around(lattice, foot, highest):
        return True
    return _swing_clears(lattice, foot, node_foot(lattice, swing), swing & 1, highest)


@njit_inner
def feet_climb(
    lattice: Lattice, support: Foot, swing: Foot, support_um: int, swing_um: int, side: int
) -> bool:
    """Whether a step is within the limits of rise and clears the ground that it swings over.

    support_um, swing_um: heights of the ground under the feet. side: that of the swing foot.
    """
    rise = swing_um - support_um
    if rise < lattice.climb_um[0] or rise > lattice.climb_um[1]:
        return False
    highest = max(support_um, swing_um) + lattice.climb_um[3]
    return _swing_clears(lattice, support, swing, side, highest)


@njit_inner
def _lower_around(lattice: Lattice, foot: Foot, highest: int) -> bool:
    """Whether all ground that a step from this foot can have to do with is no higher."""
    terrain: Terrain = lattice.terrain
    if lattice.swing_reach_m > NEAR_M:
        return False
    rows, cols = terrain.blocked.shape
    row = min(max(math.floor(foot[1] / terrain.resolution_m), 0), rows - 1)
    col = min(max(math.floor(foot[0] / terrain.resolution_m), 0), cols - 1)
    return terrain.highest_um[row, col] <= highest


@njit_inner
def _swing_clears(lattice: Lattice, support: Foot, swing: Foot, side: int, highest: int) -> bool:
    """Whether the ground below a step's swing is no higher than that (um).

    The search does not know where the swing foot stood before. So every swing is taken to pass
    beside the support foot, a stance width away and parallel to it, and each step is checked for
    two ways: that of its own foot from beside the support foot to its place, and that of the
    support foot, which swings next, from its place to beside the foot just put down.
    """
    stance_m = 2.0 * lattice.half_stance_m * (1 - 2 * side)
    beside_support = support[0] - support[3] * stance_m, support[1] + support[2] * stance_m
    beside_swing = swing[0] + swing[3] * stance_m, swing[1] - swing[2] * stance_m
    to_swing = highest_between(
        lattice.terrain, beside_support, (swing[0], swing[1]), swing[2], swing[3], lattice.sole
    )
    if to_swing > highest:
        return False
    from_support = highest_between(
        lattice.terrain,
        (support[0], support[1]),
        beside_swing,
        support[2],
        support[3],
        lattice.sole,
    )
    return from_support <= highest
