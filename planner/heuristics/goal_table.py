"""Exact cost-to-go on an empty map near the goal, and what it says about the way from farther off.

The lattice is laid out from the goal, so one table per step model serves every goal on every map.
On any map a plan costs at least what it costs on the empty one; that is consistent, because it is
the true cost of a problem with fewer obstacles.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from planner.compiled import njit_inner, njit_no_refcount
from planner.heuristics.potential import Potential
from planner.lattice.steps import IntArray, StepTable, final_cost_um, moved_cells
from planner.robot_model import StepModel

_RADIUS_CELLS = 100
FAR_UM = 1 << 40


@dataclass(frozen=True, kw_only=True)
class GoalTable:
    """Costs near the goal.

    cost_um (2 n + 1, 2 n + 1, 2 H) int32: cost to the end of the plan of a foot node at row, col
    (goal in the middle) and heading * 2 + side; no more than cap_um, which holds everywhere else.
    ring (m, 3): col, row from the goal and cost in micrometres of the body cells through one of
    which every plan from outside must come, potentials taken off. inside (2 n + 1, 2 n + 1): body
    cells on or within the ring.
    """

    cost_um: NDArray[np.int32]
    cap_um: int
    ring: IntArray
    inside: NDArray[np.bool_]


def build_goal_table(model: StepModel, table: StepTable, potential: Potential) -> GoalTable:
    """The table of a step model."""
    cap_um = int(potential.rate * _RADIUS_CELLS * model.cell_m * 1e6)
    # By inequality (1) of `potential.py` no state whose cost is below the cap has its body farther.
    body_cells = max(cap_um - int(potential.potential_um.min()), 0) // int(potential.move_um.min())
    reach = body_cells + int(np.abs(potential.body_cell).max()) + 1
    size = 2 * reach + 1
    cost_um = np.full((size, size, 2 * model.headings), cap_um, np.int32)
    _fill(cost_um.reshape(-1), size, backward_steps(table), final_cost_um(model), cap_um)
    body_um = _body_costs(cost_um, potential)
    level_um = cap_um - int(potential.potential_um.max()) - 1
    inside = body_um <= level_um
    # A step moves the body's cell by at most so many cells along either axis.
    longest = longest_move(table, potential)
    square = np.ones((2 * longest + 1, 2 * longest + 1), np.uint8)
    near_outside = cv2.dilate((~inside).astype(np.uint8), square) > 0
    row, col = np.nonzero(inside & near_outside)
    return GoalTable(
        cost_um=cost_um,
        cap_um=cap_um,
        ring=np.column_stack([col - reach, row - reach, body_um[row, col]]).astype(np.int64),
        inside=inside,
    )


def longest_move(table: StepTable, potential: Potential) -> int:
    """By how many cells along an axis a step moves the body's cell at most."""
    moved = moved_cells(table, potential.body_cell)
    return int(np.abs(moved[table.cost_um > 0]).max())


def backward_steps(table: StepTable) -> IntArray:
    """Steps (2 H, K, 4) that end in a row (heading * 2 + side): from row, d_col, d_row, cost."""
    headings, _, most = table.cost_um.shape
    steps = np.zeros((2 * headings, most, 4), np.int64)
    heading, side, k = np.nonzero(table.cost_um)
    at = heading, side, k
    to = (heading + table.d_heading[at]) % headings * 2 + 1 - side
    columns = heading * 2 + side, table.d_col[at], table.d_row[at], table.cost_um[at]
    steps[to, k] = np.stack(columns, axis=-1)
    return steps


def _body_costs(cost_um: NDArray[np.int32], potential: Potential) -> IntArray:
    """Least cost (size, size) over headings and sides with the body in a cell, less potentials."""
    size = len(cost_um)
    least = np.full((size, size), np.iinfo(np.int32).max, np.int64)
    for row, (d_col, d_row) in enumerate(potential.body_cell.tolist()):
        p_um = potential.potential_um[row]
        moved = np.roll(cost_um[:, :, row], (d_row, d_col), axis=(0, 1))
        least = np.minimum(least, moved.astype(np.int64) - p_um)
    return least


@njit_no_refcount
def _fill(
    cost_um: NDArray[np.int32], size: int, steps: IntArray, final_um: int, cap_um: int
) -> None:
    """Dijkstra's search backward from the goal feet, in buckets one least step wide.

    No step leads from a bucket into the same, so a look through the table finds all that is in one:
    a queue would take more memory than the table, and no less time.
    """
    rows, most, _ = steps.shape
    width = least_step(steps)
    middle = (size // 2 * size + size // 2) * rows
    cost_um[middle] = cost_um[middle + 1] = final_um
    for bucket in range(final_um // width, cap_um // width + 1):
        low, high = bucket * width, min((bucket + 1) * width, cap_um)
        for node in range(len(cost_um)):
            here: int = np.int64(cost_um[node])  # type: ignore[assignment]
            if here < low or here >= high:
                continue
            row, cell = node % rows, node // rows
            grid_row, grid_col = cell // size, cell % size
            for k in range(most):
                cost = here + steps[row, k, 3]
                if cost == here or cost >= cap_um:
                    continue
                col_before = grid_col - steps[row, k, 1]
                row_before = grid_row - steps[row, k, 2]
                if col_before < 0 or row_before < 0 or col_before >= size or row_before >= size:
                    continue
                before = (row_before * size + col_before) * rows + steps[row, k, 0]
                if cost < cost_um[before]:
                    cost_um[before] = cost


@njit_inner
def least_step(steps: IntArray) -> int:
    """Cost of the cheapest step of `backward_steps`."""
    rows, most, _ = steps.shape
    least = FAR_UM
    for row in range(rows):
        for k in range(most):
            if steps[row, k, 3] > 0:
                least = min(least, steps[row, k, 3])
    return least
