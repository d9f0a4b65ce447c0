"""The body's path around obstacles to a goal, by which the heuristic estimates the cost-to-go."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner.heuristics.distance_field import path_costs
from planner.heuristics.potential import MOVES
from planner.plan import from_frame, to_frame
from planner.planner import Planner


def body_path(planner: Planner, start: ArrayLike, goal: ArrayLike) -> NDArray[np.float64]:
    """Points (n, 2) x_m, y_m in the world of a least path from a start pose to a goal pose.

    The first is the middle of the lattice cell of the start, the last the goal. (0, 2) where no
    path leads for a disk that fits into the body.
    """
    context = planner.goal_context(goal)
    context = context.coarse or context
    lattice, potential = context.lattice, context.tables.potential
    cost_um = path_costs(lattice, potential, lattice.goal_cell, np.array([0]))
    cost_um = cost_um.reshape(lattice.rows, lattice.cols)
    goal_cell = np.array([lattice.origin_col, lattice.origin_row])
    at_m = to_frame(np.array([start], float), goal)[0, :2]
    cell = np.rint(at_m / lattice.cell_m).astype(int) + goal_cell
    if not (0 <= cell[0] < lattice.cols and 0 <= cell[1] < lattice.rows):
        return np.zeros((0, 2))
    cells = []
    while cost_um[cell[1], cell[0]] > 0:
        cells.append(cell)
        if np.array_equal(cell, goal_cell):
            break
        # No body can be at the rim of the lattice, so that every move ends within it.
        around = cell + MOVES
        found_um = cost_um[around[:, 1], around[:, 0]].astype(np.int64)
        found_um[found_um <= 0] = np.iinfo(np.int32).max
        cell = around[np.argmin(found_um + potential.move_um)]
    points = (np.array(cells).reshape(-1, 2) - goal_cell) * lattice.cell_m
    return from_frame(np.column_stack([points, np.zeros(len(points))]), goal)[:, :2]
