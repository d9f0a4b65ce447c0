"""Whether a step between two places on uneven ground can be made: its rise and what it swings over.

Before a step the swinging foot stands somewhere that the search no longer knows. Every swing is
therefore taken to pass beside the support foot, a stance width away and parallel to it, and each
step answers for two ways: that of its own foot from beside the support foot to its place, and that
of the support foot, which swings next, from its place to beside the foot just put down. Over both
the ground must be no higher than what the swing clears.
"""

from __future__ import annotations

import math

from planner.collision import NEAR_M, Terrain
from planner.ground_heights import highest_between
from planner.jit import lean
from planner.lattice.lattice import Space, to_grid
from planner.lattice.slots import slot_of

Foot = tuple[float, float, float, float]  # x, y, cos, sin in the grid frame


@lean
def node_foot(space: Space, node: int) -> tuple[float, float, float, float]:
    """Where the foot of a node is, x and y in the grid frame, and cosine and sine of its yaw."""
    heading = (node >> 1) % space.headings
    cell = (node >> 1) // space.headings
    row, col = cell // space.cols - space.origin_row, cell % space.cols - space.origin_col
    foot_y = row * space.cell_m + (1 - 2 * (node & 1)) * space.half_stance_m
    x, y = to_grid(space, col * space.cell_m, foot_y)
    return x, y, space.cos[2 * heading], space.sin[2 * heading]


@lean
def step_climbs(space: Space, support: int, swing: int) -> bool:
    """Whether the step between two free nodes is within the limits of rise and of its swing.

    The space must not be flat.
    """
    support_um = space.node_um[slot_of(space.slots, support)]
    swing_um = space.node_um[slot_of(space.slots, swing)]
    rise = swing_um - support_um
    if rise < space.climb_um[0] or rise > space.climb_um[1]:
        return False
    foot = node_foot(space, support)
    highest = max(support_um, swing_um) + space.climb_um[3]
    if _lower_around(space, foot, highest):
        return True
    return swing_clears(space, foot, node_foot(space, swing), swing & 1, highest)


@lean
def first_climbs(space: Space, support: Foot, support_um: int, swing: int) -> bool:
    """As `step_climbs`, from a foot that stands anywhere."""
    swing_um = space.node_um[slot_of(space.slots, swing)]
    rise = swing_um - support_um
    if rise < space.climb_um[0] or rise > space.climb_um[1]:
        return False
    highest = max(support_um, swing_um) + space.climb_um[3]
    return swing_clears(space, support, node_foot(space, swing), swing & 1, highest)


@lean
def _lower_around(space: Space, foot: Foot, highest: int) -> bool:
    """Whether all ground that a step from this foot can have to do with is no higher."""
    terrain: Terrain = space.terrain
    if space.swing_reach_m > NEAR_M:
        return False
    rows, cols = terrain.blocked.shape
    row = min(max(math.floor(foot[1] / terrain.resolution_m), 0), rows - 1)
    col = min(max(math.floor(foot[0] / terrain.resolution_m), 0), cols - 1)
    return terrain.highest_um[row, col] <= highest


@lean
def swing_clears(space: Space, support: Foot, swing: Foot, side: int, highest: int) -> bool:
    """Whether the ground on both ways that a step answers for is no higher than that (um).

    side: that of the swing foot, 0 left, 1 right.
    """
    stance_m = 2.0 * space.half_stance_m * (1 - 2 * side)
    beside_support = support[0] - support[3] * stance_m, support[1] + support[2] * stance_m
    beside_swing = swing[0] + swing[3] * stance_m, swing[1] - swing[2] * stance_m
    to_swing = highest_between(
        space.terrain, beside_support, (swing[0], swing[1]), swing[2], swing[3], space.sole
    )
    if to_swing > highest:
        return False
    from_support = highest_between(
        space.terrain, (support[0], support[1]), beside_swing, support[2], support[3], space.sole
    )
    return from_support <= highest
