"""Searches between nodes of the lattice that are a few metres apart, which see nothing else.

Their heuristic is the path cost of the body's cells around the target, up to the cells asked for
and a little further, or within a mask of cells.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.heuristics.heuristic import Heuristic, of_path
from planner.heuristics.wavefront import EVERYWHERE, NO_CELLS, NOT_DRAWN, moves_of, spread_costs
from planner.lattice.lattice import Int64s
from planner.search import best_first as search
from planner.search.reading import costs_of, trace
from planner.search.search_task import Task
from planner.search.toward import Toward

_BEYOND_MOVES = 8  # by which the path costs reach beyond the cells asked for


@dataclass(frozen=True, kw_only=True)
class Found:
    """Nodes (n,) of a way, the root first, what it costs up to its last node, and the effort.

    No nodes where none was found.
    """

    nodes: Int64s
    cost_um: int
    expansions: int


@dataclass(frozen=True, kw_only=True)
class Target:
    """Where a search is to end: nodes (n,) in rising order with what is still to pay at each.

    cells (m,): the body's cells there. is_goal: whether they are the ends of the plan.
    """

    cells: Int64s
    nodes: Int64s
    node_um: Int64s
    is_goal: bool


def target_around(toward: Toward, cells: Int64s) -> Target:
    """All nodes with the body in one of the cells, whatever the heading."""
    rows = 2 * toward.space.headings
    row = np.arange(rows)
    nodes = ((cells[:, None] - toward.body_cell[row]) * rows + row).reshape(-1)
    nodes = np.sort(nodes[(nodes >= 0) & (nodes < toward.space.nodes)])
    potential_um = toward.tables.potential.potential_um.reshape(-1)
    node_um = potential_um[nodes % rows] - potential_um.min()
    return Target(cells=cells, nodes=nodes, node_um=node_um, is_goal=False)


def search_to(
    toward: Toward,
    target: Target,
    roots: Int64s,
    root_um: Int64s,
    *,
    epsilon: float,
    budget: int,
    mask: NDArray[np.uint8] | None = None,
    best_um: int = search.NO_COST,
) -> Found:
    """A way from one of the roots (k,), with their costs, to the target, if one is soon found.

    budget: expansions. mask (rows * cols,): cells that the body may be in, all if none; then the
    search goes on until epsilon or the budget is met, else it is content with its first way.
    best_um: cost of a plan that is known already; a way must cost less.
    """
    task = Task(
        space=toward.space,
        heuristic=_heuristic(toward, target, roots, mask),
        steps=toward.space.steps,
        is_backward=False,
        roots=roots,
        root_um=root_um,
        goals=target.nodes,
        goal_um=target.node_um,
    )
    if not task.may_connect:
        return Found(nodes=np.zeros(0, np.int64), cost_um=0, expansions=0)
    tree = task.tree()
    scalars = tree.scalars
    known_um = min(best_um, int(scalars[search.BEST_UM]))
    scalars[search.BEST_UM] = known_um
    search.begin_round(task.space, task.heuristic, tree, epsilon)
    while True:
        left = budget - int(scalars[search.EXPANSIONS])
        outcome = search.expand(task.space, task.heuristic, tree, epsilon, left)
        if outcome == search.OUT_OF_ENTRIES:
            tree = search.with_more_entries(tree)
        elif outcome != search.IMPROVED or mask is None:
            break
    last, expansions = int(scalars[search.BEST_NODE]), int(scalars[search.EXPANSIONS])
    if scalars[search.BEST_UM] >= best_um or last == 0:
        return Found(nodes=np.zeros(0, np.int64), cost_um=0, expansions=expansions)
    way = trace(tree, last)
    return Found(nodes=way, cost_um=int(costs_of(tree, way[-1:])[0]), expansions=expansions)


def _heuristic(
    toward: Toward, target: Target, roots: Int64s, mask: NDArray[np.uint8] | None
) -> Heuristic:
    """As `Toward.heuristic`, toward the target, on the cells on the way."""
    space, tables = toward.space, toward.tables
    rows = 2 * space.headings
    potential_um = tables.potential.potential_um.reshape(-1)
    cost_um = np.zeros(space.cols * space.rows, np.int32)
    wanted = np.unique(roots // rows + toward.body_cell[roots % rows])
    reached_um = spread_costs(
        space,
        cost_um,
        target.cells,
        np.zeros(len(target.cells), np.int64),
        moves_of(tables.potential),
        wanted if mask is None else NO_CELLS,
        _BEYOND_MOVES * int(tables.potential.move_um.min()),
        EVERYWHERE if mask is None else mask,
        NOT_DRAWN,
    )
    heuristic = of_path(
        space,
        cost_um,
        reached_um,
        toward.body_cell,
        potential_um if target.is_goal else potential_um - potential_um.min(),
    )
    if target.is_goal and toward.region.is_point:
        endgame = tables.endgame
        return heuristic._replace(endgame_um=endgame.cost_um, cap_um=endgame.cap_um)
    return heuristic
