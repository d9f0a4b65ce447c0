"""Path costs of the body, exact on the way to where they are asked for and bounds elsewhere.

A* with the straight way s to the cells asked for, stopped once every path with cost D and D + s
below S is known. A cell c that was not settled has D(c) + s(c) >= S, so S - s(c) never exceeds
D(c). A move changes D and s by no more than it costs, so D where it is settled and S - s elsewhere,
taken together, do not change by more either: they are a consistent heuristic, wherever the search
for steps goes. The nearer it comes to what is asked for the fewer cells there are.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.heuristics.distance_field import BodyPath, ring_on_map
from planner.heuristics.heuristic import Heuristic
from planner.heuristics.potential import Potential
from planner.heuristics.wavefront import (
    EVERYWHERE,
    NOWHERE_UM,
    SHUT_CELL,
    Ahead,
    ahead_of,
    ahead_um,
    moves_of,
    spread_costs,
)
from planner.jit import lean
from planner.lattice.lattice import Int64s, Space
from planner.search.toward import Toward, body_cells_of

FURTHER_UM = 500_000


def draw_path(
    space: Space,
    guide: Potential,
    cells: Int64s,
    costs_um: Int64s,
    wanted: Int64s,
    further_um: int = FURTHER_UM,
) -> BodyPath:
    """Path costs of the body's cells from the cells (n,), each with its own cost.

    Exact where paths pass that lead to one of the wanted cells (k,) for further_um more than the
    cheapest; elsewhere they may be too low. Nowhere if no wanted cell can be reached.
    """
    ahead = ahead_of(space, guide, wanted)
    cost_um = np.zeros(space.cols * space.rows, np.int32)
    # The way to the last of what is wanted may be longer than to the first by twice the slack.
    beyond_um = 2 * ahead.slack_um + further_um + int(guide.move_um.max())
    moves = moves_of(guide)
    settled_um = spread_costs(
        space, cost_um, cells, costs_um, moves, wanted, beyond_um, EVERYWHERE, ahead
    )
    if settled_um < NOWHERE_UM:
        _bound_unsettled(cost_um, space.cols, settled_um, ahead)
    return BodyPath(cost_um, NOWHERE_UM)


def heuristic_on_the_way(toward: Toward, nodes: Int64s) -> Heuristic:
    """The heuristic toward the goal's own pose where ways from nodes (n,) pass; lower elsewhere.

    Outside the ring of the endgame D is the least cost by way of the ring, as in
    `search_body_path`, inside it that of the straight way: there the endgame's table says more.
    """
    space, tables = toward.space, toward.tables
    guide, wanted = tables.potential, np.unique(body_cells_of(toward, nodes))
    goal = np.array([space.origin_row * space.cols + space.origin_col])
    path = BodyPath(np.zeros(0, np.int32), NOWHERE_UM)
    cells, costs_um = ring_on_map(space, tables.endgame)
    if len(cells):
        path = draw_path(space, guide, cells, costs_um, wanted)
        _lower_inside(space, path.cost_um, tables.endgame.inside, ahead_of(space, guide, goal))
    if not len(cells) or not np.any(path.cost_um[wanted] > 0):
        path = draw_path(space, guide, goal, np.array([0]), wanted)
    return toward.heuristic_by(path)


@lean
def _bound_unsettled(cost_um: NDArray[np.int32], cols: int, settled_um: int, ahead: Ahead) -> None:
    """Puts the bound in place of costs that are not known to be the least."""
    for cell in range(len(cost_um)):
        if cost_um[cell] == SHUT_CELL:
            continue
        row = cell // cols
        least_um = settled_um - ahead_um(ahead, cell - row * cols, row)
        if cost_um[cell] == 0 or cost_um[cell] - 1 >= least_um:
            cost_um[cell] = max(least_um, 0) + 1


@lean
def _lower_inside(
    space: Space, cost_um: NDArray[np.int32], inside: NDArray[np.bool_], ahead: Ahead
) -> None:
    """Puts the straight way in place of costs inside the ring."""
    reach = len(inside) // 2
    for up in range(-reach, reach + 1):
        row = space.origin_row + up
        if row < 0 or row >= space.rows:
            continue
        for across in range(-reach, reach + 1):
            col = space.origin_col + across
            if 0 <= col < space.cols and inside[up + reach, across + reach]:
                cell = row * space.cols + col
                cost_um[cell] = ahead_um(ahead, col, row) + 1
