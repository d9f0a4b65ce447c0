"""The heuristics that footstep planners have long had, which know less: to compare with.

All are consistent. With v the way that a step moves the body's cell and the cost of the last step
added to each:

- euclidean: e times the straight distance to the goal, where e is the least cost of a metre, over
  all steps of (cost - step_cost_m) / |v|;
- steps: the same, and step_cost_m for each of the steps that this takes at least, which is the
  distance over the longest |v|;
- path: the cost of the body's path around obstacles, as in `guide.py`.
"""

from __future__ import annotations

import numpy as np

from planner.heuristics.heuristic import Heuristic, of_path
from planner.heuristics.tables import Tables
from planner.heuristics.toward_region import path_to_ends
from planner.heuristics.wavefront import NOWHERE_UM
from planner.lattice.lattice import Int64s, Space
from planner.lattice.steps import MICRO, final_cost_um, moved_cells
from planner.robot_model import StepModel


def simpler_heuristic(
    name: str, space: Space, model: StepModel, tables: Tables, body_cell: Int64s, ends: Int64s
) -> Heuristic:
    """The heuristic of that name toward the ends of a plan, nodes (n,)."""
    if name == "path":
        base_um, path = path_to_ends(space, tables, body_cell, ends, final_cost_um(model))
        potential_um = base_um + tables.potential.potential_um.reshape(-1)
        return of_path(space, path.cost_um, path.frontier_um, body_cell, potential_um)
    rate = _cost_of_metre(model, tables, counts_steps=name == "steps")
    rows = 2 * space.headings
    row, col = np.divmod(np.arange(space.cols * space.rows), space.cols)
    away_m = np.hypot(col - space.origin_col, row - space.origin_row) * space.cell_m
    # Ends lie around the goal, none farther off than this.
    away_m -= away_m[ends // rows + body_cell[ends % rows]].max()
    cost_um = np.clip(np.floor(away_m * rate * MICRO), 0, NOWHERE_UM - 1).astype(np.int32)
    potential_um = np.full(rows, final_cost_um(model), np.int64)
    return of_path(space, cost_um + 1, NOWHERE_UM, body_cell, potential_um)


def _cost_of_metre(model: StepModel, tables: Tables, counts_steps: bool) -> float:
    """What it costs at least to move the body's cell by a metre."""
    table = tables.steps
    move = moved_cells(table, tables.potential.body_col, tables.potential.body_row)
    length_m = np.linalg.norm(move, axis=-1) * model.cell_m
    moving = (table.cost_um > 0) & (length_m > 0)
    step_m = model.step_cost_m
    rate = float(((table.cost_um[moving] / MICRO - step_m) / length_m[moving]).min())
    return rate + step_m / float(length_m[moving].max()) if counts_steps else rate
