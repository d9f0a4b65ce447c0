"""Goals that are regions: any pose near the one asked for may be the end of a plan.

A plan ends with a foot at a node and the other one put down beside it, a stance width away. Every
node thus stands for one final pose of both feet, and a region of poses for many nodes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.collision import NO_GROUND_UM, box_free
from planner.ground_heights import box_heights
from planner.jit import allocating, lean
from planner.lattice.lattice import Int64s, Space, node_free, to_grid
from planner.lattice.slots import slot_of

_ROUNDING = 1e-9


class Region(NamedTuple):
    """How far from the goal, and how far turned, the pair pose of both feet may be in the end."""

    reach_m: float = 0.0
    reach_rad: float = 0.0

    @property
    def is_point(self) -> bool:
        """Whether the goal itself is the only end."""
        return self.reach_m == 0.0 and self.reach_rad == 0.0


def ends_in(space: Space, region: Region) -> Int64s:
    """Nodes (n,), in rising order, beside which the other foot may be put down as the last."""
    reach = math.ceil((region.reach_m + 2 * space.half_stance_m) / space.cell_m) + 1
    bins = min(math.ceil(region.reach_rad * space.headings / (2 * np.pi)), space.headings // 2)
    col, row, heading, side = (
        v.reshape(-1)
        for v in np.meshgrid(
            np.arange(-reach, reach + 1),
            np.arange(-reach, reach + 1),
            np.unique(np.arange(-bins, bins + 1) % space.headings),
            np.arange(2),
            indexing="ij",
        )
    )
    across, up = col + space.origin_col, row + space.origin_row
    nodes = ((up * space.cols + across) * space.headings + heading) * 2 + side
    on_map = (across >= 0) & (up >= 0) & (across < space.cols) & (up < space.rows)
    nodes = np.sort(nodes[on_map])
    return nodes[_may_end(space, nodes, region.reach_m, region.reach_rad)]


POINT = Region()


@lean
def beside(space: Space, node: int) -> tuple[float, float, float, float]:
    """Where the other foot stands beside that of a node, and where the body is: x, y, x, y.

    In the frame of the lattice.
    """
    heading = (node >> 1) % space.headings
    cell = (node >> 1) // space.headings
    out = (1 - 2 * (node & 1)) * space.half_stance_m
    yaw = heading * (2.0 * math.pi / space.headings)
    x = (cell % space.cols - space.origin_col) * space.cell_m
    y = (cell // space.cols - space.origin_row) * space.cell_m + out
    over_x, over_y = out * math.sin(yaw), -out * math.cos(yaw)
    return x + 2.0 * over_x, y + 2.0 * over_y, x + over_x, y + over_y


@lean
def may_end_at(space: Space, node: int) -> bool:
    """Whether both feet may stand side by side, one of them at a node."""
    if not node_free(space, node):
        return False
    foot_x, foot_y, _, _ = beside(space, node)
    x, y = to_grid(space, foot_x, foot_y)
    heading = (node >> 1) % space.headings
    cos, sin = space.cos[2 * heading], space.sin[2 * heading]
    if not box_free(space.terrain, x, y, cos, sin, space.foot[0], space.foot[1]):
        return False
    if len(space.node_um) == 0:
        return True
    low, high = box_heights(space.terrain, x, y, cos, sin, space.tread[0], space.tread[1])
    rise = abs(high - space.node_um[slot_of(space.slots, node)])
    lowest, highest, level, _ = space.climb_um
    return low != NO_GROUND_UM and high - low <= level and rise <= min(-lowest, highest, level)


@lean
def height_beside(space: Space, node: int) -> int:
    """Height in micrometres of the ground under the other foot beside that of a node."""
    if len(space.node_um) == 0:
        return 0
    foot_x, foot_y, _, _ = beside(space, node)
    x, y = to_grid(space, foot_x, foot_y)
    heading = (node >> 1) % space.headings
    cos, sin = space.cos[2 * heading], space.sin[2 * heading]
    return box_heights(space.terrain, x, y, cos, sin, space.tread[0], space.tread[1])[1]


@allocating
def _may_end(space: Space, nodes: Int64s, reach_m: float, reach_rad: float) -> NDArray[np.bool_]:
    """Which of the nodes (n,) stand for free poses of the region."""
    free = np.zeros(len(nodes), np.bool_)
    for i in range(len(nodes)):
        heading = (nodes[i] >> 1) % space.headings
        turn = min(heading, space.headings - heading) * (2.0 * math.pi / space.headings)
        _, _, x, y = beside(space, nodes[i])
        near = turn <= reach_rad + _ROUNDING and math.hypot(x, y) <= reach_m + _ROUNDING
        free[i] = near and may_end_at(space, nodes[i])
    return free
