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


def moved_cells(table: StepTable, body_cell: IntArray) -> IntArray:
    """Columns and rows (H, 2, K, 2) by which steps move the body's cell.

    body_cell (2 H, 2): col and row of that cell from the foot's node, per heading * 2 + side.
    """
    headings = len(table.cost_um)
    heading, side, _ = np.indices(table.cost_um.shape)
    to_row = (heading + table.d_heading) % headings * 2 + 1 - side
    move = np.stack([table.d_col, table.d_row], axis=-1)
    return move + body_cell[to_row] - body_cell[heading * 2 + side]


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


def numbered_steps(table: StepTable, cols: int) -> IntArray:
    """The step table as `Lattice.steps` (2 H, K, 8), for a lattice of so many columns."""
    headings, _, most = table.cost_um.shape
    index = np.indices(table.cost_um.shape)
    heading, side = index[0], index[1]
    to_row = (heading + table.d_heading) % headings * 2 + 1 - side
    d_cell = table.d_row * cols + table.d_col
    columns = [
        table.cost_um,
        table.d_col,
        table.d_row,
        d_cell * headings * 2 + to_row - (heading * 2 + side),
        d_cell,
        to_row,
        table.d_row * 2 * cols + table.d_col,
        (2 * heading + table.d_heading) % (2 * headings),
    ]
    return np.ascontiguousarray(np.stack(columns, axis=-1).reshape(2 * headings, most, 8))
