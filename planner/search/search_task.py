"""The two directions of a search: from the start to the goal, and from the goal to the start."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.compiled import zeros
from planner.heuristics.distance_field import draw_path, least_in_cells, spread_from
from planner.heuristics.heuristic import Heuristic, estimates, of_path
from planner.lattice.lattice import Int64s, Lattice, turned_round
from planner.lattice.steps import final_cost_um
from planner.search import best_first as search
from planner.search.best_first import EVERY_STATE, Tree
from planner.search.problem import Request, body_cells_of

_ENTRIES = 1 << 16  # at first; a search that needs more doubles them


@dataclass(frozen=True, kw_only=True)
class Task:
    """A search between nodes: roots (n,) with what they cost, goals (m,) with what is still to pay.

    The goals are in rising order. The heuristic looks toward the goals.
    """

    lattice: Lattice
    heuristic: Heuristic
    steps: Int64s
    is_backward: bool
    roots: Int64s
    root_um: Int64s
    goals: Int64s
    goal_um: Int64s

    def tree(self) -> Tree:
        """A fresh tree with the roots in it."""
        tree = new_tree(self.lattice, self.steps, self.is_backward)
        tree = tree._replace(goals=self.goals, goal_um=self.goal_um)
        search.seed(tree, self.roots, self.root_um)
        return tree

    @property
    def may_connect(self) -> bool:
        """Whether a path of the body leads from a root to the goals, if there are any."""
        rows = self.roots % (2 * self.lattice.headings)
        cells = self.roots // (2 * self.lattice.headings) + self.heuristic.body_cell[rows]
        return len(self.goals) > 0 and bool(np.any(self.heuristic.cost_um[cells] > 0))

    def in_order(self, path: Int64s) -> Int64s:
        """Nodes of a path from a root to a goal in the order of the steps."""
        return path[::-1].copy() if self.is_backward else path


def new_tree(lattice: Lattice, steps: Int64s, is_backward: bool) -> Tree:
    """A tree with neither roots nor goals."""
    length = lattice.slots.length
    scalars = np.zeros(search.SCALARS, np.int64)
    scalars[search.BEST_UM] = search.NO_COST
    return Tree(
        steps=steps,
        is_backward=is_backward,
        slots=lattice.slots,
        cost_um=zeros(length, np.int32),
        before=zeros(length, np.int32),
        round=zeros(length, np.uint8),
        entry_node=np.empty(_ENTRIES, np.int32),
        entry_next=np.empty(_ENTRIES, np.int32),
        head=np.full(search.BUCKETS + 1, -1, np.int32),
        goals=np.zeros(1, np.int64),  # a node of the rim, where no step leads
        goal_um=np.zeros(1, np.int64),
        scalars=scalars,
        places=EVERY_STATE,
    )


def forward_task(request: Request, nodes: Int64s, costs_um: Int64s) -> Task:
    """From the first steps (n,) with their costs to the goal feet."""
    ends = request.context.ends
    return Task(
        lattice=request.lattice,
        heuristic=request.heuristic,
        steps=request.lattice.steps,
        is_backward=False,
        roots=nodes,
        root_um=costs_um,
        goals=ends,
        goal_um=np.full(len(ends), final_cost_um(request.model)),
    )


def backward_task(request: Request, nodes: Int64s, costs_um: Int64s) -> Task:
    """From the goal feet to the first steps (n,) with their costs."""
    roots = request.context.ends
    order = np.argsort(nodes)
    return Task(
        lattice=request.lattice,
        heuristic=heuristic_toward_start(request, nodes, costs_um),
        steps=turned_round(request.lattice.steps),
        is_backward=True,
        roots=roots,
        root_um=np.full(len(roots), final_cost_um(request.model)),
        goals=nodes[order],
        goal_um=costs_um[order],
    )


def heuristic_toward_start(
    request: Request, nodes: Int64s, costs_um: Int64s, further_um: int | None = None
) -> Heuristic:
    """Least cost from the start, by the inequality (1) of `guide.py` summed from a first step s.

    h(t) = min over s of [ cost(s) + p(s) + D(cell(s), cell(t)) ] - p(t).

    further_um: D may be too low, and is found sooner, where only paths to the goal pass that cost
    so much more than the cheapest.
    """
    context = request.context
    potential_um = context.tables.potential.potential_um.reshape(-1)
    value_um = costs_um + potential_um[nodes % (2 * request.lattice.headings)]
    cells, least_um = least_in_cells(body_cells_of(context, nodes), value_um)
    base_um = int(least_um.min())
    seeds = cells, least_um - base_um
    if further_um is None:
        path = spread_from(request.lattice, context.tables.potential, *seeds)
    else:
        ends = np.unique(body_cells_of(context, context.ends))
        path = draw_path(request.lattice, context.tables.potential, *seeds, ends, further_um)
    return of_path(
        request.lattice, path.cost_um, path.frontier_um, context.body_cell, base_um - potential_um
    )


def least_toward_goal(request: Request, nodes: Int64s, costs_um: Int64s) -> int:
    """What any plan costs at least by the heuristic toward the goal, from first steps (n,)."""
    return int(np.min(costs_um + estimates(request.lattice, request.heuristic, nodes)))
