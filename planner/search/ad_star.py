"""Anytime search that is asked again while the robot walks: what earlier searches found is kept.

The first plan to a goal is improved as far as the options say. After that a plan is good enough as
soon as it is proven to cost at most `epsilon` times the least: mostly that is so before any search,
by the tree that is kept (`kept.py`) or by the heuristic toward the goal. Else the search goes on
where the last one stopped.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planner.compiled import njit_no_refcount
from planner.heuristics.distance_field import FURTHER_UM, BodyPath, draw_path, ring_on_map
from planner.heuristics.heuristic import Heuristic, estimates
from planner.heuristics.wavefront import NOWHERE_UM, Ahead, ahead_of, ahead_um
from planner.lattice.lattice import Int64s, Lattice, turned_round
from planner.lattice.map_change import Change
from planner.lattice.steps import final_cost_um
from planner.options import PlannerOptions
from planner.search import best_first as search
from planner.search.ad_star_tree import border, cut, find_best, graft, renew, reopen, shift_um
from planner.search.ara_star import Run, quick_plan
from planner.search.best_first import NO_COST, costs_of, trace
from planner.search.first_plan import NO_WAY
from planner.search.problem import (
    GoalContext,
    Request,
    Result,
    body_cells_of,
    first_nodes,
    found,
    no_first_step,
    no_way,
)
from planner.search.search_task import Task, heuristic_toward_start, new_tree


def heuristic_on_the_way(context: GoalContext, nodes: Int64s) -> Heuristic:
    """The heuristic toward the goal's own pose where ways from nodes (n,) pass; lower elsewhere.

    Outside the ring of the endgame D is the least cost by way of the ring, as in
    `search_body_path`, inside it that of the straight way: there the endgame's table says more.
    """
    lattice, tables = context.lattice, context.tables
    potential, wanted = tables.potential, np.unique(body_cells_of(context, nodes))
    goal = np.array([lattice.origin_row * lattice.cols + lattice.origin_col])
    path = BodyPath(np.zeros(0, np.int32), NOWHERE_UM)
    cells, costs_um = ring_on_map(lattice, tables.goal_table)
    if len(cells):
        path = draw_path(lattice, potential, cells, costs_um, wanted)
        _lower_inside(
            lattice, path.cost_um, tables.goal_table.inside, ahead_of(lattice, potential, goal)
        )
    if not len(cells) or not np.any(path.cost_um[wanted] > 0):
        path = draw_path(lattice, potential, goal, np.array([0]), wanted)
    return context.heuristic_by(path)


@njit_no_refcount
def _lower_inside(
    lattice: Lattice, cost_um: NDArray[np.int32], inside: NDArray[np.bool_], ahead: Ahead
) -> None:
    """Puts the straight way in place of costs inside the ring."""
    reach = len(inside) // 2
    for up in range(-reach, reach + 1):
        row = lattice.origin_row + up
        if row < 0 or row >= lattice.rows:
            continue
        for across in range(-reach, reach + 1):
            col = lattice.origin_col + across
            if 0 <= col < lattice.cols and inside[up + reach, across + reach]:
                cell = row * lattice.cols + col
                cost_um[cell] = ahead_um(ahead, col, row) + 1


# A search tree from the goal that is kept while the robot walks: new starts, the same tree.
#
# After Koenig and Likhachev, "D* Lite", 2002, and Likhachev et al., "Anytime Dynamic A*", 2005.
# Costs in the tree are those of ways to the goal, so they hold wherever the robot is. Its new first
# steps are looked up in the tree, and the cheapest of them leads to the goal by the tree's
# pointers.
#
# What is proven is kept as well. The heuristic h of the last search was made for its start. It is
# consistent, so from any first step s, which costs c(s), to a state t the way costs at least h(t) -
# h(s). With the shift k = max over the new first steps of h(s) - c(s), h(t) - k is a heuristic for
# the new start, and the least cost + h of all open states, less k, is a bound on any plan that
# would still have to be found.

_MOST_ROUNDS = 100  # numbers of rounds are 7 bit


@dataclass(frozen=True, kw_only=True)
class View:
    """What a tree says of a start: cost of its best plan, NO_COST for none, and a bound on any."""

    best_um: int
    least_um: int


class KeptTree:
    """The tree toward one goal on one map, from which plans of many starts come.

    tree: see `search.Tree`; its goals are the first steps of the start that was looked at last.
    heuristic: toward the start of the last search; None before the first. open_um: no open state's
    cost and heuristic is less.
    """

    def __init__(self, request: Request) -> None:
        self._final_um = final_cost_um(request.model)
        self.tree = new_tree(request.lattice, turned_round(request.lattice.steps), True)
        self.tree.scalars[search.SLACK_UM] = NO_COST
        self.heuristic: Heuristic | None = None
        self.open_um = 0
        self._ahead: Heuristic | None = None

    def graft(self, lattice: Lattice, nodes: Int64s) -> None:
        """Takes the end of a plan (n,), its steps in their order, into the tree."""
        self._make_room(len(nodes))
        graft(lattice, self.tree, nodes)

    def look(self, request: Request, nodes: Int64s, costs_um: Int64s) -> View:
        """Turns to a start with these first steps (n,) and their costs."""
        ends = request.context.ends
        self._make_room(len(ends))
        search.seed(self.tree, ends, np.full(len(ends), self._final_um))
        order = np.argsort(nodes)
        tree = self.tree._replace(goals=nodes[order], goal_um=costs_um[order])
        self.tree = tree
        tree.scalars[search.EXPANSIONS] = 0
        find_best(tree)
        best = int(tree.scalars[search.BEST_UM])
        if best < NO_COST:
            # Costs may have fallen since along the way: then the plan costs less than it says.
            self.graft(request.lattice, self.plan())
            tree = self.tree
            find_best(tree)
            best = int(tree.scalars[search.BEST_UM])
        least = 0
        if self.heuristic is not None:
            least = self.open_um - shift_um(request.lattice, self.heuristic, tree)
        return View(best_um=best, least_um=max(0, min(best, least)))

    def bounds(self, request: Request, nodes: Int64s, costs_um: Int64s) -> Iterator[int]:
        """What any plan from first steps (n,) costs at least: as was known, then found for these.

        A heuristic toward the goal holds for every start; it says less of those that lie apart from
        the way that it was made for.
        """
        context = request.context
        if self._ahead is not None:
            yield _least(request, self._ahead, nodes, costs_um)
        is_point = context.region.is_point
        self._ahead = heuristic_on_the_way(context, nodes) if is_point else context.heuristic
        yield _least(request, self._ahead, nodes, costs_um)

    def plan(self) -> Int64s:
        """Nodes (n,) of the best plan from the start that was looked at, but for its last."""
        return trace(self.tree, int(self.tree.scalars[search.BEST_NODE]))[::-1].copy()

    def task(self, request: Request, wanted: float) -> Task:
        """The search that goes on from the tree to the start that was looked at.

        If there is a plan it ends once that costs at most wanted times the least.
        """
        tree = self.tree
        further_um: int | None = None
        best_um = int(tree.scalars[search.BEST_UM])
        if self._ahead is not None and best_um < NO_COST:
            least_um = _least_by_path(request, self._ahead, tree.goals, tree.goal_um)
            further_um = FURTHER_UM + max(0, int(best_um / wanted) - least_um)
        if tree.scalars[search.ROUND] > _MOST_ROUNDS:
            renew(tree)
        self.heuristic = heuristic_toward_start(request, tree.goals, tree.goal_um, further_um)
        self.open_um = 0
        return Task(
            lattice=request.lattice,
            heuristic=self.heuristic,
            steps=tree.steps,
            is_backward=True,
            roots=request.context.ends,
            root_um=np.full(len(request.context.ends), self._final_um),
            goals=tree.goals,
            goal_um=tree.goal_um,
        )

    def mend(self, lattice: Lattice, change: Change) -> None:
        """Goes over to the lattice after a change of the map."""
        removed = cut(lattice, self.tree, change.shut)
        renew(self.tree)
        # Where nothing became cheaper only what was cut off has to be reached another way.
        again = border(lattice, self.tree, removed, change.freed)
        self._make_room(len(again))
        reopen(self.tree, again)
        if len(change.freed):
            # Ways that the heuristic knows nothing of may be shorter than what it says.
            self.heuristic, self._ahead, self.open_um = None, None, 0
        elif self.heuristic is not None and len(again):
            nodes = again.astype(np.int64)
            values_um = estimates(lattice, self.heuristic, nodes)
            least_um = int((costs_of(self.tree, nodes) + values_um).min())
            self.open_um = min(self.open_um, least_um)

    def _make_room(self, entries: int) -> None:
        while self.tree.scalars[search.USED] + entries > len(self.tree.entry_node):
            self.tree = search.with_more_entries(self.tree)


def _least(request: Request, heuristic: Heuristic, nodes: Int64s, costs_um: Int64s) -> int:
    return int((costs_um + estimates(request.lattice, heuristic, nodes)).min())


def _least_by_path(request: Request, heuristic: Heuristic, nodes: Int64s, costs_um: Int64s) -> int:
    """The same by the path of the body alone."""
    rows = nodes % (2 * request.lattice.headings)
    path_um = heuristic.cost_um[body_cells_of(request.context, nodes)].astype(np.int64) - 1
    return int((costs_um + np.maximum(path_um, 0) + heuristic.potential_um[rows]).min())


_NAME = "adstar"


def plan_adstar(request: Request, options: PlannerOptions, began: float) -> Result:
    """Plans from the tree that is kept in the request's memory, searching only where it must."""
    nodes, costs_um = first_nodes(request)
    if not len(nodes):
        return no_first_step(request)
    memory, expansions, least_um = request.context.memory, 0, 0
    wanted = options.epsilon
    kept = memory.get(_NAME)
    is_first = kept is None
    if kept is None:
        kept = memory[_NAME] = KeptTree(request)
    if is_first or options.improve_expansions is None:
        wanted = options.final_epsilon
    view = kept.look(request, nodes, costs_um)
    if view.best_um == NO_COST:
        quick = quick_plan(request, nodes, costs_um, options)
        if quick is NO_WAY:
            return no_way()
        if quick is not None:
            kept.graft(request.lattice, quick.nodes)
            expansions, least_um = quick.expansions, quick.least_um
            view = kept.look(request, nodes, costs_um)
    least_um = max(least_um, view.least_um)
    if view.best_um < NO_COST:
        is_enough = is_first and options.stop_at_first
        bounds = kept.bounds(request, nodes, costs_um)
        while not (is_enough or view.best_um <= wanted * least_um):
            bound_um = next(bounds, None)
            if bound_um is None:
                break
            least_um = max(least_um, bound_um)
        else:
            return _at_once(request, kept, least_um, expansions, began)
    run = Run(request, replace(options, final_epsilon=wanted), began)
    run.begin_with(view.best_um, least_um, expansions)
    result = run.result(kept.task(request, wanted), kept.tree)
    kept.tree, kept.open_um = run.tree, run.open_um
    return result


def _at_once(
    request: Request, kept: KeptTree, least_um: int, expansions: int, began: float
) -> Result:
    """The best plan in the tree as it is."""
    best_um = int(kept.tree.scalars[search.BEST_UM])
    return found(
        request,
        kept.plan(),
        cost_um=best_um,
        epsilon=best_um / min(best_um, max(least_um, 1)),
        expansions=expansions,
        time_to_first_s=time.perf_counter() - began,
    )
