"""Goal regions: any pose near the one asked for may be the end of a plan.

A plan ends with a foot at a node and the other one put down beside it, a stance width away. Every
node thus stands for one final pose of both feet, and a region of poses for many nodes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.collision import NO_GROUND_UM, box_free
from planner.compiled import njit_arrays, njit_inner, njit_no_refcount, slot_of
from planner.lattice.lattice import (
    Int64s,
    Lattice,
    decoded,
    level_height_um,
    node_foot,
    node_free,
    node_pose,
    to_grid,
)

_ROUNDING = 1e-9


class GoalRegion(NamedTuple):
    """How far from the goal, and how far turned, the pair pose of both feet may be in the end."""

    reach_m: float = 0.0
    reach_rad: float = 0.0

    @property
    def is_point(self) -> bool:
        """Whether the goal itself is the only end."""
        return self.reach_m == 0.0 and self.reach_rad == 0.0


def ends_in(lattice: Lattice, region: GoalRegion) -> Int64s:
    """Nodes (n,), in rising order, beside which the other foot may be put down as the last."""
    reach = math.ceil((region.reach_m + 2 * lattice.half_stance_m) / lattice.cell_m) + 1
    bins = min(math.ceil(region.reach_rad * lattice.headings / (2 * np.pi)), lattice.headings // 2)
    col, row, heading, side = (
        v.reshape(-1)
        for v in np.meshgrid(
            np.arange(-reach, reach + 1),
            np.arange(-reach, reach + 1),
            np.unique(np.arange(-bins, bins + 1) % lattice.headings),
            np.arange(2),
            indexing="ij",
        )
    )
    across, up = col + lattice.origin_col, row + lattice.origin_row
    nodes = ((up * lattice.cols + across) * lattice.headings + heading) * 2 + side
    on_map = (across >= 0) & (up >= 0) & (across < lattice.cols) & (up < lattice.rows)
    nodes = np.sort(nodes[on_map])
    return nodes[_may_end(lattice, nodes, region.reach_m, region.reach_rad)]


POINT = GoalRegion()


@njit_inner
def beside(lattice: Lattice, node: int) -> tuple[float, float, float, float]:
    """Where the other foot stands beside that of a node, and where the body is: x, y, x, y.

    In the frame of the lattice.
    """
    x, y, yaw = node_pose(lattice, node)
    out = (1 - 2 * (node & 1)) * lattice.half_stance_m
    over_x, over_y = out * math.sin(yaw), -out * math.cos(yaw)
    return x + 2.0 * over_x, y + 2.0 * over_y, x + over_x, y + over_y


@njit_inner
def _foot_beside(lattice: Lattice, node: int) -> tuple[float, float, float, float]:
    """As `node_foot`, of the other foot beside that of a node."""
    foot_x, foot_y, _, _ = beside(lattice, node)
    x, y = to_grid(lattice, foot_x, foot_y)
    _, _, cos, sin = node_foot(lattice, node)
    return x, y, cos, sin


@njit_inner
def may_end_at(lattice: Lattice, node: int) -> bool:
    """Whether both feet may stand side by side, one of them at a node."""
    if not node_free(lattice, node):
        return False
    x, y, cos, sin = _foot_beside(lattice, node)
    if not box_free(lattice.terrain, x, y, cos, sin, lattice.foot):
        return False
    if len(lattice.node_um) == 0:
        return True
    height_um = level_height_um(lattice, (x, y, cos, sin))
    rise = abs(height_um - lattice.node_um[slot_of(lattice.slots, node)])
    lowest, highest, level, _ = lattice.climb_um
    return height_um != NO_GROUND_UM and rise <= min(-lowest, highest, level)


@njit_no_refcount
def last_foot(lattice: Lattice, node: int) -> tuple[float, float, int]:
    """Where the other foot stands beside that of a node: x, y, and the ground in micrometres.

    In the frame of the lattice.
    """
    x, y, _, _ = beside(lattice, node)
    height_um = 0
    if len(lattice.node_um) > 0:
        height_um = level_height_um(lattice, _foot_beside(lattice, node))
    return x, y, height_um


@njit_arrays
def _may_end(
    lattice: Lattice, nodes: Int64s, reach_m: float, reach_rad: float
) -> NDArray[np.bool_]:
    """Which of the nodes (n,) stand for free poses of the region."""
    free = np.zeros(len(nodes), np.bool_)
    for i in range(len(nodes)):
        _, _, heading, _ = decoded(lattice, nodes[i])
        turn = min(heading, lattice.headings - heading) * (2.0 * math.pi / lattice.headings)
        _, _, x, y = beside(lattice, nodes[i])
        near = turn <= reach_rad + _ROUNDING and math.hypot(x, y) <= reach_m + _ROUNDING
        free[i] = near and may_end_at(lattice, nodes[i])
    return free
