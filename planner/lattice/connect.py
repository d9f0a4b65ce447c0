"""The first step: from feet that stand anywhere to the nodes of the lattice."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planner.checks.collision import box_free, clearance_at
from planner.jit import allocating, lean
from planner.lattice.layout import allowed, step_cost_um
from planner.lattice.rise import first_climbs
from planner.lattice.space import Space, clearance_cost, node_free, radius_of
from planner.model import Side, StepModel
from planner.plan import wrap_angle

FloatArray = NDArray[np.float64]
Int64s = NDArray[np.int64]


def first_steps(
    space: Space,
    model: StepModel,
    support_lattice: FloatArray,
    swing: Side,
    body_margin_m: float,
    support_um: int = 0,
) -> tuple[Int64s, Int64s]:
    """Nodes (n,) and costs (n,) in micrometres of all allowed first steps of one foot.

    support_lattice (3,): x_m, y_m, yaw_rad of the other foot in the lattice frame, at no node in
    general. Every node within the step limits counts, not only those near the step set.
    body_margin_m: margin of the body's box at the pair pose of this step.
    support_um: height of the ground under the other foot in micrometres.
    """
    limits = model.limits
    low, high = (
        np.array([limits.x_m[end], limits.y_m[end], limits.yaw_rad[end]]) for end in range(2)
    )
    far_m = math.hypot(*(max(map(abs, span)) for span in (limits.x_m, limits.y_m)))
    shift_m = swing.outward * model.stance_width_m / 2
    nodes, poses = _nodes_around(
        space, np.array(support_lattice, float), int(swing), shift_m, low, high, far_m
    )
    support = np.array([*support_lattice[:2], 0.0, support_lattice[2]])
    steps = _relative(support, poses, swing)
    keep = allowed(steps, model)
    nodes, poses, steps = nodes[keep], poses[keep], steps[keep]
    costs_um = step_cost_um(steps, model)
    body = (model.body.length_m / 2 + body_margin_m, model.body.width_m / 2 + body_margin_m)
    free = np.zeros(len(nodes), np.bool_)
    _check_first(space, nodes, poses, costs_um, np.array(support_lattice), body, free)
    if len(space.node_um):
        _check_climbs(space, nodes, np.array(support_lattice), support_um, free)
    return nodes[free], costs_um[free]


@allocating
def _nodes_around(
    space: Space,
    support: FloatArray,
    swing: int,
    shift_m: float,
    low: FloatArray,
    high: FloatArray,
    far_m: float,
) -> tuple[Int64s, FloatArray]:
    """Nodes (n,) of a side within the limits or a hair beyond, and their poses (n, 3)."""
    hair = 1e-6
    bin_rad = 2 * math.pi / space.headings
    out = 1 - 2 * swing
    cos, sin = math.cos(support[2]), math.sin(support[2])
    first_col = max(math.floor((support[0] - far_m) / space.cell_m), -space.origin_col)
    last_col = min(
        math.ceil((support[0] + far_m) / space.cell_m), space.cols - space.origin_col - 1
    )
    first_row = max(math.floor((support[1] - shift_m - far_m) / space.cell_m), -space.origin_row)
    last_row = min(
        math.ceil((support[1] - shift_m + far_m) / space.cell_m), space.rows - space.origin_row - 1
    )
    turns = min(math.ceil(max(abs(low[2]), abs(high[2])) / bin_rad) + 1, (space.headings - 1) // 2)
    middle = round(support[2] / bin_rad)
    most = max(last_col - first_col + 1, 0) * max(last_row - first_row + 1, 0) * (2 * turns + 1)
    nodes, poses = np.empty(most, np.int64), np.empty((most, 3))
    number = 0
    for col in range(first_col, last_col + 1):
        for row in range(first_row, last_row + 1):
            x, y = col * space.cell_m, row * space.cell_m + shift_m
            ahead = cos * (x - support[0]) + sin * (y - support[1])
            outward = out * (cos * (y - support[1]) - sin * (x - support[0]))
            if not (low[0] - hair <= ahead <= high[0] + hair):
                continue
            if not (low[1] - hair <= outward <= high[1] + hair):
                continue
            cell = (row + space.origin_row) * space.cols + col + space.origin_col
            for turn in range(middle - turns, middle + turns + 1):
                if low[2] - hair <= out * (turn * bin_rad - support[2]) <= high[2] + hair:
                    nodes[number] = (cell * space.headings + turn % space.headings) * 2 + swing
                    poses[number] = x, y, turn * bin_rad
                    number += 1
    return nodes[:number], poses[:number]


def _relative(support: FloatArray, poses: FloatArray, swing: Side) -> FloatArray:
    """Steps (n, 3) from one support foot (4,) to poses (n, 3); see `plan.relative_step`."""
    cos, sin = math.cos(support[3]), math.sin(support[3])
    away = poses[:, :2] - support[:2]
    out = swing.outward
    return np.column_stack(
        [
            cos * away[:, 0] + sin * away[:, 1],
            out * (cos * away[:, 1] - sin * away[:, 0]),
            out * wrap_angle(poses[:, 2] - support[3]),
        ]
    )


@lean
def _check_first(
    space: Space,
    nodes: Int64s,
    poses: FloatArray,
    costs_um: Int64s,
    support: FloatArray,
    body: tuple[float, float],
    free: NDArray[np.bool_],
) -> None:
    """Marks the nodes (n,) whose foot and body are free, and adds the cost of clearance."""
    terrain = space.terrain
    clearance_m, size_m, radius_m = terrain.clearance_m, terrain.resolution_m, radius_of(body)
    ox, oy, frame_cos, frame_sin = space.frame
    frame_yaw = math.atan2(frame_sin, frame_cos)
    for i in range(len(nodes)):
        if not node_free(space, nodes[i]):
            continue
        x, y = 0.5 * (poses[i, 0] + support[0]), 0.5 * (poses[i, 1] + support[1])
        turn = (poses[i, 2] - support[2] + math.pi) % (2 * math.pi) - math.pi
        yaw = frame_yaw + support[2] + 0.5 * turn
        gx, gy = ox + frame_cos * x - frame_sin * y, oy + frame_sin * x + frame_cos * y
        clear_m = clearance_at(clearance_m, size_m, gx, gy)
        if clear_m > radius_m or box_free(
            terrain, gx, gy, math.cos(yaw), math.sin(yaw), body[0], body[1]
        ):
            free[i] = True
            if clear_m < space.clearance[0]:
                costs_um[i] += clearance_cost(space, clear_m)


@lean
def _check_climbs(
    space: Space,
    nodes: Int64s,
    support: FloatArray,
    support_um: int,
    free: NDArray[np.bool_],
) -> None:
    """Unmarks the nodes (n,) that are too high, too low or behind ground that is too high."""
    ox, oy, frame_cos, frame_sin = space.frame
    yaw = math.atan2(frame_sin, frame_cos) + support[2]
    x = ox + frame_cos * support[0] - frame_sin * support[1]
    y = oy + frame_sin * support[0] + frame_cos * support[1]
    foot = x, y, math.cos(yaw), math.sin(yaw)
    for i in range(len(nodes)):
        if free[i]:
            free[i] = first_climbs(space, foot, support_um, nodes[i])
