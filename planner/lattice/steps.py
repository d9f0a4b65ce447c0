"""The search lattice: foot poses on a grid that is laid out from the goal, and the steps between.

Lattice frame: x, y in metres with the goal's pair pose at zero, so the goal feet are nodes and
need no rounding. A node (col i, row j, heading h, side) is the foot at

    (i * cell_m, j * cell_m + outward * stance_width_m / 2), heading h * 2 pi / headings.

The constant shift of the two sides puts the goal feet at i = j = h = 0 for any stance width, and
makes (i, j) the body's own cell when h = 0.

Every step of the step set is rounded to the nodes once per heading and side; the limits and the gap
between the feet are then tested on the rounded step, so no rounding can break them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.plan import wrap_angle
from planner.robot_model import FootShape, Side, StepModel

MICRO = 1e6  # costs are whole micrometres, so sums are exact and plans repeat to the bit
_NEIGHBOURS = np.array([(dx, dy) for dx in range(-2, 3) for dy in range(-2, 3)])

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class StepTable:
    """Rounded steps per heading, side of the support foot and step number: shape (H, 2, K).

    d_col, d_row, d_heading: where the swing foot's node lies from the support foot's.
    cost_um: cost of the step; 0 marks a step that this heading and side do not have.
    """

    d_col: IntArray
    d_row: IntArray
    d_heading: IntArray
    cost_um: IntArray


def moved_cells(table: StepTable, body_col: IntArray, body_row: IntArray) -> IntArray:
    """Columns and rows (H, 2, K, 2) by which steps move the body's cell.

    body_col, body_row (H, 2): that cell from the foot's node.
    """
    heading, side, _ = np.indices(table.cost_um.shape)
    to_heading, to_side = (heading + table.d_heading) % len(body_col), 1 - side
    return np.stack(
        [
            move + body[to_heading, to_side] - body[heading, side]
            for move, body in ((table.d_col, body_col), (table.d_row, body_row))
        ],
        axis=-1,
    )


def foot_position(col: FloatArray, row: FloatArray, side: int, model: StepModel) -> FloatArray:
    """Positions (..., 2) in the lattice frame of feet of one side at (col, row)."""
    shift_m = Side(side).outward * model.stance_width_m / 2
    return np.stack([col * model.cell_m, row * model.cell_m + shift_m], axis=-1)


def step_cost_um(steps: FloatArray, model: StepModel) -> IntArray:
    """Cost (...) of steps (..., 3) without regard to obstacles, in micrometres."""
    x_m, y_m, yaw_rad = np.moveaxis(np.asarray(steps, dtype=float), -1, 0)
    cost_m = (
        np.hypot(x_m, y_m)
        + model.step_cost_m
        + model.turn_cost_m * np.abs(yaw_rad)
        + model.side_cost_m * np.abs(y_m - model.stance_width_m)
        + model.back_cost_m * np.maximum(-x_m, 0.0)
    )
    return np.rint(cost_m * MICRO).astype(np.int64)


def final_cost_um(model: StepModel) -> int:
    """Cost of the last step of every plan: beside the other foot at the goal."""
    return int(step_cost_um(np.array([0.0, model.stance_width_m, 0.0]), model))


def feet_apart(steps: FloatArray, foot: FootShape, gap_m: float) -> NDArray[np.bool_]:
    """Whether support and swing foot stay at least gap_m apart, for steps (..., 3).

    Each box in turn grows by gap_m / 2 on all sides and the grown boxes must not overlap
    (separating axes of two rectangles), which is at least as strict as a distance of gap_m.
    """
    x_m, y_m, yaw_rad = np.moveaxis(np.asarray(steps, dtype=float), -1, 0)
    half_l, half_w = foot.length_m / 2 + gap_m / 2, foot.width_m / 2 + gap_m / 2
    cos, sin = np.abs(np.cos(yaw_rad)), np.abs(np.sin(yaw_rad))
    apart = np.abs(x_m) >= half_l + half_l * cos + half_w * sin
    apart |= np.abs(y_m) >= half_w + half_l * sin + half_w * cos
    along = np.cos(yaw_rad) * x_m + np.sin(yaw_rad) * y_m
    across = -np.sin(yaw_rad) * x_m + np.cos(yaw_rad) * y_m
    apart |= np.abs(along) >= half_l + half_l * cos + half_w * sin
    apart |= np.abs(across) >= half_w + half_l * sin + half_w * cos
    return np.asarray(apart)


def allowed(steps: FloatArray, model: StepModel) -> NDArray[np.bool_]:
    """Whether steps (..., 3) are within the limits and keep the feet apart."""
    inside = model.limits.contain(steps)
    return np.asarray(inside & feet_apart(steps, model.foot, model.foot_gap_m))


def build_step_table(model: StepModel) -> StepTable:
    """The step set rounded to the lattice for every heading and side.

    A step takes the nearest node that is allowed, at most two cells away along either axis; where
    two steps round to the same node one is dropped. Raises ValueError where a side has no step.
    """
    shape = (model.headings, 2, len(model.steps))
    table = StepTable(
        d_col=np.zeros(shape, np.int64),
        d_row=np.zeros(shape, np.int64),
        d_heading=np.zeros(shape, np.int64),
        cost_um=np.zeros(shape, np.int64),
    )
    for heading in range(model.headings):
        taken: set[tuple[int, int, int]] = set()
        for k, step in enumerate(model.steps):
            rounded = _round_step(np.array(step), heading, model)
            if rounded is None or rounded[:3] in taken:
                continue
            taken.add(rounded[:3])
            # The right foot's steps are the left one's in a mirror, so no side is preferred.
            for side, at, sign in ((Side.LEFT, heading, 1), (Side.RIGHT, -heading, -1)):
                index = at % model.headings, int(side), k
                table.d_col[index], table.cost_um[index] = rounded[0], rounded[3]
                table.d_row[index], table.d_heading[index] = sign * rounded[1], sign * rounded[2]
        if not taken:
            raise ValueError(
                f"no step of the set fits cells of {model.cell_m} m within the step limits "
                f"at heading {heading} of {model.headings}: take a smaller cell_m"
            )
    return table


def _round_step(
    step: FloatArray, heading: int, model: StepModel
) -> tuple[int, int, int, int] | None:
    """(d_col, d_row, d_heading, cost_um) of the allowed node nearest to a step of the right foot.

    None if no node near it is allowed.
    """
    bin_rad = 2 * np.pi / model.headings
    turn = _round_turn(step[2], bin_rad, model)
    yaw_rad = heading * bin_rad
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    # From the left to the right foot's node, less the constant shift between the sides' nodes.
    shift_m = np.array([0.0, -model.stance_width_m])
    target_m = np.array([[cos, -sin], [sin, cos]]) @ (step[0], -step[1]) - shift_m
    nodes = np.rint(np.round(target_m / model.cell_m, 6)).astype(np.int64) + _NEIGHBOURS
    moved_m = (nodes * model.cell_m + shift_m) @ np.array([[cos, -sin], [sin, cos]])
    rounded = np.column_stack([moved_m[:, 0], -moved_m[:, 1], np.full(len(nodes), turn * bin_rad)])
    off_m = np.linalg.norm(nodes * model.cell_m - target_m, axis=1)
    off_m[~allowed(rounded, model)] = np.inf
    # Ties are decided by a fixed order, not by the last bit of a cosine.
    best = int(np.argmin(np.round(off_m, 9)))
    if not np.isfinite(off_m[best]):
        return None
    return (
        int(nodes[best, 0]),
        int(nodes[best, 1]),
        -turn,
        int(step_cost_um(rounded[best], model)),
    )


def _round_turn(yaw_rad: float, bin_rad: float, model: StepModel) -> int:
    """Heading bins of a turn: the nearest whole number within the limits."""
    low, high = model.limits.yaw_rad
    lowest = int(np.ceil((low - 1e-9) / bin_rad))
    highest = int(np.floor((high + 1e-9) / bin_rad))
    return int(np.clip(np.rint(yaw_rad / bin_rad), lowest, highest))


def table_steps(table: StepTable, model: StepModel) -> FloatArray:
    """Steps (H, 2, K, 3) in the support foot's frame, outward positive, as the table has them."""
    bin_rad = 2 * np.pi / model.headings
    yaw_rad = (np.arange(model.headings) * bin_rad)[:, None, None]
    out = np.array([side.other.outward for side in Side])[None, :, None]
    dx_m = table.d_col * model.cell_m
    dy_m = table.d_row * model.cell_m + out * model.stance_width_m
    x_m = np.cos(yaw_rad) * dx_m + np.sin(yaw_rad) * dy_m
    y_m = out * (-np.sin(yaw_rad) * dx_m + np.cos(yaw_rad) * dy_m)
    return np.stack([x_m, y_m, wrap_angle(out * table.d_heading * bin_rad)], axis=-1)
