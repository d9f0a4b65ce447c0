"""The first step: from feet that stand anywhere to the nodes of the lattice."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planner.collision import box_free, clearance_at
from planner.compiled import njit_arrays, njit_no_refcount
from planner.lattice.lattice import (
    Lattice,
    clearance_cost,
    first_climbs,
    node_free,
    radius_of,
    to_grid,
)
from planner.lattice.steps import allowed, step_cost_um
from planner.robot_model import Side, StepModel

FloatArray = NDArray[np.float64]
Int64s = NDArray[np.int64]


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
    body_margin_m: margin of the body's box at the pair pose of this step.
    feet_um (2,): height of the ground under the feet in micrometres.
    """
    limits = model.limits
    spans = np.array([limits.x_m, limits.y_m, limits.yaw_rad])
    far_m = math.hypot(*np.abs(spans[:2]).max(axis=1))
    around = [
        _nodes_around(
            *(lattice.cols, lattice.rows, lattice.headings, lattice.origin_col, lattice.origin_row),
            lattice.cell_m,
            feet_lattice[swing.other],
            int(swing),
            swing.outward * model.stance_width_m / 2,
            spans,
            far_m,
        )
        for swing in swings
    ]
    nodes, poses, steps = (np.concatenate(parts) for parts in zip(*around, strict=True))
    keep = allowed(steps, model)
    nodes, poses, steps = nodes[keep], poses[keep], steps[keep]
    costs_um = step_cost_um(steps, model)
    body = (model.body.length_m / 2 + body_margin_m, model.body.width_m / 2 + body_margin_m)
    free = np.zeros(len(nodes), np.bool_)
    _check_first(lattice, nodes, poses, costs_um, feet_lattice, body, free)
    if len(lattice.node_um):
        _check_climbs(lattice, nodes, feet_lattice, feet_um, free)
    return nodes[free], costs_um[free]


@njit_arrays
def _nodes_around(
    cols: int,
    rows: int,
    headings: int,
    origin_col: int,
    origin_row: int,
    cell_m: float,
    support: FloatArray,
    swing: int,
    shift_m: float,
    spans: FloatArray,
    far_m: float,
) -> tuple[Int64s, FloatArray, FloatArray]:
    """Nodes (n,) of a side within the limits (3, 2) or a hair beyond, their poses and steps (n, 3).

    Steps are from the support foot (3,), as `plan.relative_step` has them.
    """
    hair = 1e-6
    bin_rad = 2 * math.pi / headings
    out = 1 - 2 * swing
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
                    poses[number] = x, y, turn * bin_rad
                    steps[number] = ahead, outward, turned
                    number += 1
    return nodes[:number], poses[:number], steps[:number]


@njit_no_refcount
def _check_first(
    lattice: Lattice,
    nodes: Int64s,
    poses: FloatArray,
    costs_um: Int64s,
    feet: FloatArray,
    body: tuple[float, float],
    free: NDArray[np.bool_],
) -> None:
    """Marks the nodes (n,) whose foot and body are free, and adds the cost of clearance."""
    terrain = lattice.terrain
    clearance_m, size_m, radius_m = terrain.clearance_m, terrain.resolution_m, radius_of(body)
    frame_yaw = math.atan2(lattice.frame[3], lattice.frame[2])
    for i in range(len(nodes)):
        if not node_free(lattice, nodes[i]):
            continue
        support = feet[1 - (nodes[i] & 1)]
        x, y = 0.5 * (poses[i, 0] + support[0]), 0.5 * (poses[i, 1] + support[1])
        turn = (poses[i, 2] - support[2] + math.pi) % (2 * math.pi) - math.pi
        yaw = frame_yaw + support[2] + 0.5 * turn
        gx, gy = to_grid(lattice, x, y)
        clear_m = clearance_at(clearance_m, size_m, gx, gy)
        if clear_m > radius_m or box_free(
            terrain, gx, gy, math.cos(yaw), math.sin(yaw), body[0], body[1]
        ):
            free[i] = True
            if clear_m < lattice.clearance[0]:
                costs_um[i] += clearance_cost(lattice, clear_m)


@njit_no_refcount
def _check_climbs(
    lattice: Lattice, nodes: Int64s, feet: FloatArray, feet_um: Int64s, free: NDArray[np.bool_]
) -> None:
    """Unmarks the nodes (n,) that are too high, too low or behind ground that is too high."""
    frame_yaw = math.atan2(lattice.frame[3], lattice.frame[2])
    for i in range(len(nodes)):
        if free[i]:
            side = 1 - (nodes[i] & 1)
            support = feet[side]
            yaw = frame_yaw + support[2]
            x, y = to_grid(lattice, support[0], support[1])
            foot = x, y, math.cos(yaw), math.sin(yaw)
            free[i] = first_climbs(lattice, foot, feet_um[side], nodes[i])
