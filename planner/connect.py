"""The first step: from feet that stand anywhere to the nodes of the lattice."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planner.collision import box_free, point_clearance
from planner.lattice import allowed, foot_position, step_cost_um
from planner.model import Side, StepModel
from planner.plan import wrap_angle
from planner.rise import first_climbs
from planner.space import Space, clearance_cost, node_free

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
    nodes, poses = _nodes_around(space, model, support_lattice, swing)
    if not len(nodes):
        return nodes, np.zeros(0, np.int64)
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


def _nodes_around(
    space: Space, model: StepModel, support: FloatArray, swing: Side
) -> tuple[Int64s, FloatArray]:
    """All nodes (n,) of a side near enough to be a step away, and their poses (n, 3)."""
    limits = model.limits
    far_m = math.hypot(max(np.abs(limits.x_m)), max(np.abs(limits.y_m)))
    bin_rad = 2 * np.pi / model.headings
    centre = foot_position(np.zeros(()), np.zeros(()), swing, model)
    low = np.floor((support[:2] - centre - far_m) / model.cell_m).astype(int)
    high = np.ceil((support[:2] - centre + far_m) / model.cell_m).astype(int)
    turn = math.ceil(max(np.abs(limits.yaw_rad)) / bin_rad) + 1
    middle = round(float(support[2]) / bin_rad)
    turns = np.arange(middle - turn, middle + turn + 1)[: model.headings]
    cols = np.arange(max(low[0], -space.origin_col), high[0] + 1)
    rows = np.arange(max(low[1], -space.origin_row), high[1] + 1)
    cols = cols[cols < space.cols - space.origin_col]
    rows = rows[rows < space.rows - space.origin_row]
    col, row, heading = (v.reshape(-1) for v in np.meshgrid(cols, rows, turns, indexing="ij"))
    cell = (row + space.origin_row) * space.cols + col + space.origin_col
    nodes = (cell * space.headings + heading % space.headings) * 2 + int(swing)
    poses = np.column_stack(
        [foot_position(col.astype(float), row.astype(float), swing, model), heading * bin_rad]
    )
    return nodes.astype(np.int64), poses


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


@njit(cache=True)
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
    ox, oy, frame_cos, frame_sin = space.frame
    frame_yaw = math.atan2(frame_sin, frame_cos)
    for i in range(len(nodes)):
        if not node_free(space, nodes[i]):
            continue
        x, y = 0.5 * (poses[i, 0] + support[0]), 0.5 * (poses[i, 1] + support[1])
        turn = (poses[i, 2] - support[2] + math.pi) % (2 * math.pi) - math.pi
        yaw = frame_yaw + support[2] + 0.5 * turn
        gx, gy = ox + frame_cos * x - frame_sin * y, oy + frame_sin * x + frame_cos * y
        if box_free(space.terrain, gx, gy, math.cos(yaw), math.sin(yaw), body[0], body[1]):
            free[i] = True
            costs_um[i] += clearance_cost(space, point_clearance(space.terrain, gx, gy))


@njit(cache=True)
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
