"""The first step: from feet that stand anywhere to the nodes of the lattice."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planner.collision import box_free, clearance_at, radius_of
from planner.compiled import njit_arrays, njit_no_refcount
from planner.lattice.lattice import (
    Int64s,
    Lattice,
    clearance_cost,
    feet_climb,
    node_foot,
    node_free,
    node_height_um,
    to_grid,
)
from planner.lattice.steps import allowed, step_cost_um
from planner.robot_model import RoundedBox, Side, StepModel, rounded_box

FloatArray = NDArray[np.float64]


def first_steps(
    lattice: Lattice,
    model: StepModel,
    feet_lattice: FloatArray,
    swings: Sequence[Side],
    body_margin_m: float,
    feet_um: Int64s,
) -> tuple[Int64s, Int64s]:
    """Nodes (n,) and costs (n,) in micrometres of all allowed first steps of one foot or the other.

    feet_lattice (2, 3): x_m, y_m, yaw_rad of the feet in the lattice frame, at no nodes in
    general. Every node within the step limits counts, not only those near the step set.
    body_margin_m: margin of the body at the pair pose of this step.
    feet_um (2,): height of the ground under the feet in micrometres.
    """
    limits = model.limits
    spans = np.array([limits.x_m, limits.y_m, limits.yaw_rad])
    around = [_nodes_around(lattice, feet_lattice[side.other], int(side), spans) for side in swings]
    nodes, poses, steps = (np.concatenate(parts) for parts in zip(*around, strict=True))
    keep = allowed(steps, model)
    nodes, poses, steps = nodes[keep], poses[keep], steps[keep]
    costs_um = step_cost_um(steps, model)
    free = np.zeros(len(nodes), np.bool_)
    body = rounded_box(model.body, body_margin_m)
    _check_first(lattice, nodes, poses, costs_um, feet_lattice, feet_um, body, free)
    return nodes[free], costs_um[free]


@njit_arrays
def _nodes_around(
    lattice: Lattice, support: FloatArray, swing: int, spans: FloatArray
) -> tuple[Int64s, FloatArray, FloatArray]:
    """Nodes (n,) of a side within the limits (3, 2) or a hair beyond, their poses and steps (n, 3).

    Steps are from the support foot (3,), as `plan.relative_step` has them.
    """
    cols, rows, headings, cell_m = lattice.cols, lattice.rows, lattice.headings, lattice.cell_m
    origin_col, origin_row = lattice.origin_col, lattice.origin_row
    hair = 1e-6
    far_m = math.hypot(
        max(abs(spans[0, 0]), abs(spans[0, 1])), max(abs(spans[1, 0]), abs(spans[1, 1]))
    )
    bin_rad = 2 * math.pi / headings
    out = 1 - 2 * swing
    shift_m = out * lattice.half_stance_m
    cos, sin = math.cos(support[2]), math.sin(support[2])
    first_col = max(math.floor((support[0] - far_m) / cell_m), -origin_col)
    last_col = min(math.ceil((support[0] + far_m) / cell_m), cols - origin_col - 1)
    first_row = max(math.floor((support[1] - shift_m - far_m) / cell_m), -origin_row)
    last_row = min(math.ceil((support[1] - shift_m + far_m) / cell_m), rows - origin_row - 1)
    widest_rad = max(abs(spans[2, 0]), abs(spans[2, 1]))
    turns = min(math.ceil(widest_rad / bin_rad) + 1, (headings - 1) // 2)
    middle = round(support[2] / bin_rad)
    most = max(last_col - first_col + 1, 0) * max(last_row - first_row + 1, 0) * (2 * turns + 1)
    nodes, poses, steps = np.empty(most, np.int64), np.empty((most, 3)), np.empty((most, 3))
    number = 0
    for col in range(first_col, last_col + 1):
        for row in range(first_row, last_row + 1):
            x, y = col * cell_m, row * cell_m + shift_m
            ahead = cos * (x - support[0]) + sin * (y - support[1])
            outward = out * (cos * (y - support[1]) - sin * (x - support[0]))
            if not (spans[0, 0] - hair <= ahead <= spans[0, 1] + hair):
                continue
            if not (spans[1, 0] - hair <= outward <= spans[1, 1] + hair):
                continue
            cell = (row + origin_row) * cols + col + origin_col
            for turn in range(middle - turns, middle + turns + 1):
                turned = out * (turn * bin_rad - support[2])
                if spans[2, 0] - hair <= turned <= spans[2, 1] + hair:
                    nodes[number] = (cell * headings + turn % headings) * 2 + swing
                    # Rows assigned as a whole would bring along, compiled, the texts of errors.
                    poses[number, 0], poses[number, 1] = x, y
                    poses[number, 2] = turn * bin_rad
                    steps[number, 0], steps[number, 1] = ahead, outward
                    steps[number, 2] = turned
                    number += 1
    return nodes[:number], poses[:number], steps[:number]


@njit_no_refcount
def _check_first(
    lattice: Lattice,
    nodes: Int64s,
    poses: FloatArray,
    costs_um: Int64s,
    feet: FloatArray,
    feet_um: Int64s,
    body: RoundedBox,
    free: NDArray[np.bool_],
) -> None:
    """Marks the nodes (n,) that a first step may lead to, and adds the cost of clearance.

    Foot and body are free there, and neither ground nor rise is too high.
    """
    terrain = lattice.terrain
    clearance_m, size_m, radius_m = terrain.clearance_m, terrain.resolution_m, radius_of(body)
    frame_yaw = math.atan2(lattice.frame[3], lattice.frame[2])
    for i in range(len(nodes)):
        if not node_free(lattice, nodes[i]):
            continue
        side = nodes[i] & 1
        support = feet[1 - side]
        x, y = 0.5 * (poses[i, 0] + support[0]), 0.5 * (poses[i, 1] + support[1])
        turn = (poses[i, 2] - support[2] + math.pi) % (2 * math.pi) - math.pi
        yaw = frame_yaw + support[2] + 0.5 * turn
        gx, gy = to_grid(lattice, x, y)
        clear_m = clearance_at(clearance_m, size_m, gx, gy)
        if clear_m <= radius_m and not box_free(
            terrain, gx, gy, math.cos(yaw), math.sin(yaw), body
        ):
            continue
        if len(lattice.node_um) > 0:
            x, y = to_grid(lattice, support[0], support[1])
            yaw = frame_yaw + support[2]
            foot = x, y, math.cos(yaw), math.sin(yaw)
            swing, swing_um = node_foot(lattice, nodes[i]), node_height_um(lattice, nodes[i])
            if not feet_climb(lattice, foot, swing, feet_um[1 - side], swing_um, side):
                continue
        free[i] = True
        if clear_m < lattice.clearance[0]:
            costs_um[i] += clearance_cost(lattice, clear_m)
