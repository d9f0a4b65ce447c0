"""What steps along a path hit, climb and cost, and the cheapest of them, compiled."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planner.collision import box_free, point_clearance
from planner.ground_heights import box_heights
from planner.jit import lean
from planner.lattice.lattice import Space, clearance_cost
from planner.lattice.rise import swing_clears

FloatArray = NDArray[np.float64]
Int64s = NDArray[np.int64]

NO_COST = 1 << 60
START, NOWHERE = -1, -2  # instead of the point stepped from


@lean
def check_feet(
    space: Space, path: FloatArray, feet: FloatArray, ok: NDArray[np.bool_], height_um: Int64s
) -> None:
    """Marks (n, 2) where a foot and the body over it are free, and notes the ground's height."""
    for i in range(len(path)):
        cos, sin = math.cos(path[i, 2]), math.sin(path[i, 2])
        x, y = path[i, 0], path[i, 1]
        if not box_free(space.terrain, x, y, cos, sin, space.body[0], space.body[1]):
            continue
        for side in range(2):
            x, y = feet[side, i, 0], feet[side, i, 1]
            ok[i, side] = box_free(space.terrain, x, y, cos, sin, space.foot[0], space.foot[1])
            if ok[i, side] and len(space.node_um) > 0:
                half_l, half_w = space.tread
                low, high = box_heights(space.terrain, x, y, cos, sin, half_l, half_w)
                ok[i, side] = high - low <= space.climb_um[2]
                height_um[i, side] = high


@lean
def _extra_cost(
    space: Space,
    support: FloatArray,
    swing: FloatArray,
    side: int,
    heights_um: tuple[int, int],
    body: tuple[float, float],
) -> int:
    """Cost of clearance of a step between two feet (3,); -1 where it hits or climbs too much.

    side: of the swing foot. heights_um: of the ground under support and swing foot.
    """
    x, y = 0.5 * (support[0] + swing[0]), 0.5 * (support[1] + swing[1])
    turn = (swing[2] - support[2] + math.pi) % (2 * math.pi) - math.pi
    yaw = support[2] + 0.5 * turn
    if not box_free(space.terrain, x, y, math.cos(yaw), math.sin(yaw), body[0], body[1]):
        return -1
    if len(space.node_um) > 0:
        rise = heights_um[1] - heights_um[0]
        if rise < space.climb_um[0] or rise > space.climb_um[1]:
            return -1
        stands = support[0], support[1], math.cos(support[2]), math.sin(support[2])
        lands = swing[0], swing[1], math.cos(swing[2]), math.sin(swing[2])
        highest = max(heights_um[0], heights_um[1]) + space.climb_um[3]
        if not swing_clears(space, stands, lands, side, highest):
            return -1
    return clearance_cost(space, point_clearance(space.terrain, x, y))


@lean
def check_seeds(
    space: Space,
    standing: FloatArray,
    standing_um: Int64s,
    feet: FloatArray,
    height_um: Int64s,
    ok: NDArray[np.bool_],
    body: tuple[float, float],
    seeds_um: Int64s,
) -> None:
    """Completes the costs (m, 2) of first steps, and takes out those that hit something."""
    for i in range(len(seeds_um)):
        for side in range(2):
            if seeds_um[i, side] == 0:
                continue
            extra = -1
            if ok[i, side]:
                heights = standing_um[1 - side], height_um[i, side]
                support = standing[1 - side]
                extra = _extra_cost(space, support, feet[side, i], side, heights, body)
            seeds_um[i, side] = seeds_um[i, side] + extra if extra >= 0 else 0


@lean
def walk(
    space: Space,
    feet: FloatArray,
    height_um: Int64s,
    ok: NDArray[np.bool_],
    cost_um: Int64s,
    seeds_um: Int64s,
    best_um: Int64s,
    before: Int64s,
) -> None:
    """Fills in the least costs (n, 2) and the point stepped from, point by point."""
    for i in range(len(seeds_um)):
        for side in range(2):
            if seeds_um[i, side] > 0:
                best_um[i, side], before[i, side] = seeds_um[i, side], START
    for i in range(len(best_um)):
        # The cheaper foot first: the other may come beside it.
        first = 0 if best_um[i, 0] <= best_um[i, 1] else 1
        for support in (first, 1 - first):
            if best_um[i, support] == NO_COST:
                continue
            swing = 1 - support
            for ahead in range(cost_um.shape[1]):
                step = cost_um[i, ahead, swing]
                if step == 0 or not ok[i + ahead, swing]:
                    continue
                to, there = i + ahead, best_um[i, support] + step
                if there >= best_um[to, swing]:
                    continue
                heights = height_um[i, support], height_um[to, swing]
                stands, lands = feet[support, i], feet[swing, to]
                extra = _extra_cost(space, stands, lands, swing, heights, space.body)
                if extra >= 0 and there + extra < best_um[to, swing]:
                    best_um[to, swing], before[to, swing] = there + extra, i
