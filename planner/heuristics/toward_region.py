"""The heuristic toward a goal that is a region."""

from __future__ import annotations

import math

import numpy as np

from planner.heuristics.distance_field import BodyPath, least_in_cells, spread_from
from planner.heuristics.heuristic import Heuristic
from planner.heuristics.tables import Tables
from planner.heuristics.turning import no_detours
from planner.lattice.lattice import Int64s, Space
from planner.lattice.region import Region
from planner.lattice.steps import final_cost_um
from planner.robot_model import StepModel


def heuristic_toward_region(
    space: Space,
    model: StepModel,
    tables: Tables,
    body_cell: Int64s,
    ends: Int64s,
    region: Region,
) -> Heuristic:
    """Least cost to the end of a plan at any of the nodes (n,), of which there must be one.

    By the inequality (1) of `guide.py`, summed up to an end e,

        h(s) = p(s) + min over e of [ D(cell(s), cell(e)) - p(e) ] + cost of the last step.

    The table of the empty map is exact for the goal's own pose. It is consistent, so from a state
    to an end it falls by no more than the way costs, and what is left of it at e is too much by at
    most its largest value at any e.
    """
    final_um = final_cost_um(model)
    base_um, path = path_to_ends(space, tables, body_cell, ends, final_um)
    potential_um = tables.potential.potential_um.reshape(-1)
    slack_um = _most_exact(space, tables, ends) - final_um
    endgame, exits = tables.endgame, tables.exits
    return Heuristic(
        path.cost_um,
        path.frontier_um,
        body_cell,
        base_um + potential_um,
        np.maximum(endgame.cost_um - np.int32(slack_um), 0),
        max(endgame.cap_um - slack_um, 0),
        base_um + exits.turn_um,
        no_detours(space.cols, space.rows),
        exits.rim,
        # No end may lie within the circle wherever its bound is used.
        exits.radius_cells + math.ceil(region.reach_m / model.cell_m) + 2,
    )


def path_to_ends(
    space: Space, tables: Tables, body_cell: Int64s, ends: Int64s, final_um: int
) -> tuple[int, BodyPath]:
    """What every end of a plan (n,) adds at least, and the path costs to the nearest end."""
    potential_um, rows = tables.potential.potential_um.reshape(-1), 2 * space.headings
    value_um = final_um - potential_um[ends % rows]
    cells, least_um = least_in_cells(ends // rows + body_cell[ends % rows], value_um)
    base_um = int(least_um.min())
    return base_um, spread_from(space, tables.potential, cells, least_um - base_um)


def _most_exact(space: Space, tables: Tables, ends: Int64s) -> int:
    """What a plan costs at most on the empty map from an end (n,) to the goal's own pose."""
    endgame, rows = tables.endgame, 2 * space.headings
    reach = len(endgame.cost_um) // 2
    cell = ends // rows
    col = np.clip(cell % space.cols - space.origin_col + reach, 0, 2 * reach)
    row = np.clip(cell // space.cols - space.origin_row + reach, 0, 2 * reach)
    return int(endgame.cost_um[row, col, ends % rows].max())
