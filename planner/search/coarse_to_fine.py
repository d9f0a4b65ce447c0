"""Plans for a lattice of fine cells from one of coarse cells, every so many of the fine ones.

Both are laid out from the same goal with the same headings, so a node of the coarse one is a node
of the fine one, with the same checks. The coarse one's steps are rounded to its own cells, within
the limits and with their own cost; a plan of them is a plan, and where it costs less than any of
the fine one's steps the search of the fine one has only to prove that.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planner.heuristics.heuristic import tables_of
from planner.heuristics.turning import straight_cost
from planner.lattice.lattice import Int64s, Lattice, node_free
from planner.robot_model import StepModel
from planner.search.problem import Request, body_cells_of

_CELL_M = 0.05
_FINE_M = 0.03  # from cells that are larger nothing is to be gained


def coarse_model(model: StepModel) -> StepModel | None:
    """The robot on a coarse lattice; None where its cells are not fine, or too fine for others."""
    if model.cell_m > _FINE_M:
        return None
    coarse = replace(model, cell_m=round(_CELL_M / model.cell_m) * model.cell_m)
    try:
        tables_of(coarse)
    except ValueError:  # no step of some heading and side is within the limits there
        return None
    return coarse


def on_coarse(request: Request) -> Request | None:
    """The request on the coarse lattice, if there is one."""
    coarse = request.context.coarse
    return None if coarse is None else replace(request, context=coarse)


def on_fine(coarse: Lattice, fine: Lattice, nodes: Int64s) -> Int64s:
    """Nodes (n,) of the fine lattice that are those (n,) of the coarse one."""
    times = round(coarse.cell_m / fine.cell_m)
    rows = 2 * fine.headings
    cell, row = nodes // rows, nodes % rows
    col = (cell % coarse.cols - coarse.origin_col) * times + fine.origin_col
    up = (cell // coarse.cols - coarse.origin_row) * times + fine.origin_row
    found = np.asarray((up * fine.cols + col) * rows + row, np.int64)
    for node in found:
        node_free(fine, int(node))  # notes its height
    return found


def least_straight(request: Request, nodes: Int64s, costs_um: Int64s) -> int:
    """What any plan to the goal's own pose costs at least, without a look at the map.

    nodes (n,), costs_um (n,): first steps.
    """
    lattice, tables = request.lattice, request.context.tables
    cells = body_cells_of(request.context, nodes)
    across = cells % lattice.cols - lattice.origin_col
    up = cells // lattice.cols - lattice.origin_row
    potential_um = tables.potential.potential_um.reshape(-1)
    straight_um = straight_cost(across, up, tables.potential)
    return int((costs_um + straight_um + potential_um[nodes % len(potential_um)]).min())
