"""A first plan soon: a search in the strip of ground that the path of the body lies in.

The path comes from A* over the body's cells, from the goal toward the start. It looks at a few of
the cells that the heuristic of the full search wants to know; the search for steps then keeps to
those cells and weighs their path cost more than it is due. Where it finds nothing nothing is lost:
the full search follows in any case, or proves what is asked.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planner import search
from planner.body_path import Strip, descend, path_toward
from planner.lattice import final_cost_um
from planner.options import PlannerOptions
from planner.request import Request
from planner.search import Heuristic
from planner.space import Int64s
from planner.task import Task
from planner.toward import body_cells_of

_LEAST_EPSILON = 2.0
_MOST_EXPANSIONS = 3000
_LEVEL = 0.8  # of the cost up to which the table near the goal is exact


@dataclass(frozen=True, kw_only=True)
class QuickPath:
    """Nodes of a plan but for its last, its cost, and what any plan costs at least."""

    nodes: Int64s
    cost_um: int
    least_um: int
    expansions: int


def quick_path(
    request: Request, nodes: Int64s, costs_um: Int64s, options: PlannerOptions
) -> QuickPath | None:
    """A plan from the first steps (n,) with their costs; None where the strip holds none."""
    toward = request.toward
    potential_um = toward.tables.potential.potential_um.reshape(-1)
    cells = body_cells_of(toward, nodes)
    path = path_toward(request.space, toward.tables.potential, np.unique(cells))
    rows = nodes % (2 * request.space.headings)
    bounds_um = costs_um + path.least_um(cells) + potential_um[rows]
    _lift(request, path, int(cells[np.argmin(costs_um)]))
    task = Task(
        space=request.space,
        heuristic=Heuristic(
            path.cost_um,
            path.settled_um,  # off the strip it is as far as from the start
            toward.body_cell,
            potential_um,
            toward.tables.endgame.cost_um,
            toward.tables.endgame.cap_um,
            toward.tables.exits.turn_um,
            np.zeros((1, 1), np.int32),
            np.zeros((0, 4), np.int64),
            request.space.cols + request.space.rows,  # no exit bound: all is within the circle
        ),
        steps=request.space.steps,
        is_backward=False,
        roots=nodes,
        root_um=costs_um,
        goals=toward.goal_nodes,
        goal_um=np.full(2, final_cost_um(request.model)),
    )
    tree = task.tree()
    epsilon = max(options.epsilon, _LEAST_EPSILON)
    budget = min(_MOST_EXPANSIONS, options.max_expansions)
    search.begin_round(task.space, task.heuristic, tree, epsilon)
    outcome = search.expand(task.space, task.heuristic, tree, epsilon, budget)
    if outcome != search.IMPROVED and tree.scalars[search.BEST_UM] == search.NO_COST:
        return None
    return QuickPath(
        nodes=task.in_order(search.trace(tree, int(tree.scalars[search.BEST_NODE]))),
        cost_um=int(tree.scalars[search.BEST_UM]),
        least_um=int(bounds_um.min()),
        expansions=int(tree.scalars[search.EXPANSIONS]),
    )


def _lift(request: Request, path: Strip, start: int) -> None:
    """Raises the path costs far from the goal by what turning near it will cost.

    Near the goal the exact table counts every turn, farther off nothing does. A search that weighs
    the heuristic would go along the border between the two and look everywhere outside first.
    """
    endgame, space = request.toward.tables.endgame, request.space
    potential_um = request.toward.tables.potential.potential_um.reshape(-1)
    level_um = int(_LEVEL * endgame.cap_um)
    cell, before = descend(space, path.cost_um, start, level_um)
    if cell == start:
        return
    came = cell % space.cols - before % space.cols, cell // space.cols - before // space.cols
    heading = round(math.atan2(came[1], came[0]) / (2 * math.pi) * space.headings) % space.headings
    rows = np.array([2 * heading, 2 * heading + 1])
    reach = len(endgame.cost_um) // 2
    feet = cell - request.toward.body_cell[rows]
    col = feet % space.cols - space.origin_col + reach
    row = feet // space.cols - space.origin_row + reach
    if min(col.min(), row.min()) >= 0 and max(col.max(), row.max()) <= 2 * reach:
        exact_um = endgame.cost_um[row, col, rows] - potential_um[rows]
        gap_um = int(exact_um.min()) - int(path.cost_um[cell])
        path.cost_um[path.cost_um > level_um] += max(0, gap_um)
