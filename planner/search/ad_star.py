"""AD*: a search that is asked again while the robot walks and the map changes.

After Koenig and Likhachev, "D* Lite", 2002, and Likhachev et al., "Anytime Dynamic A*", 2005. The
tree grows from the goal, so its costs-to-go hold wherever the robot is: the new first steps are
looked up in it, and the cheapest leads to the goal by the tree's parents.

The first plan to a goal is improved as far as the options say. After that a plan is good enough
once it is proven to cost at most `epsilon` times the optimum: mostly by the tree, or by the
heuristic toward the goal, without any search. Else the search continues where it stopped.

Bounds are reused as well. The heuristic h of the last search was made for its start and is
consistent, so from a first step s of cost c(s) to a state t the cost is at least h(t) - h(s). With
the shift k = max over the new first steps of h(s) - c(s), h(t) - k is a heuristic for the new
start, and the least cost + h of all open states, less k, is a lower bound on all plans that are not
in the tree.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

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
from planner.search.ad_star_tree import (
    add_path,
    costs_of,
    find_best_goal,
    heuristic_shift_um,
    nodes_to_reopen,
    remove_invalid,
    reopen,
    reset_iterations,
)
from planner.search.ara_star import AraStar
from planner.search.best_first import (
    BEST_NODE,
    BEST_UM,
    EXPANSIONS,
    ITERATION,
    NO_COST,
    SLACK_UM,
    USED,
    insert_roots,
)
from planner.search.first_plan import CUT_OFF, find_first_plan
from planner.search.problem import (
    GoalContext,
    Request,
    Result,
    SearchTask,
    heuristic_to_start,
    new_tree,
    no_body_path,
    no_first_step,
    result_of,
    trace,
    with_longer_queue,
)

_NAME = "adstar"
_MOST_ITERATIONS = 100  # their numbers are 7 bit


def plan_adstar(request: Request, options: PlannerOptions, began: float) -> Result:
    """Plans from the tree in the context's memory, and searches only where it must."""
    nodes, costs_um = request.first_nodes()
    if not len(nodes):
        return no_first_step(request)
    memory, expansions, bound_um = request.context.memory, 0, 0
    wanted = options.epsilon
    kept = memory.get(_NAME)
    is_first = kept is None
    if kept is None:
        kept = memory[_NAME] = ReusableTree(request)
    if is_first or options.improve_expansions is None:
        wanted = options.final_epsilon
    kept.move_start(request, nodes, costs_um)
    if kept.best_um == NO_COST:
        first = find_first_plan(request, nodes, costs_um, options)
        if first is CUT_OFF:
            return no_body_path()
        if first is not None:
            kept.add_path(request.lattice, first.nodes)
            expansions, bound_um = first.expansions, first.lower_bound_um
            kept.move_start(request, nodes, costs_um)
    bound_um = max(bound_um, kept.bound_um(request.lattice))
    if kept.best_um < NO_COST:
        is_enough = is_first and options.stop_at_first
        bounds = kept.bounds(request, nodes, costs_um)
        while not (is_enough or kept.best_um <= wanted * bound_um):
            next_um = next(bounds, None)
            if next_um is None:
                break
            bound_um = max(bound_um, next_um)
        else:
            return result_of(
                request,
                kept.plan(),
                cost_um=kept.best_um,
                epsilon=kept.best_um / min(kept.best_um, max(bound_um, 1)),
                expansions=expansions,
                time_to_first_s=time.perf_counter() - began,
            )
    search = AraStar(request, replace(options, final_epsilon=wanted), began)
    search.note_known_plan(kept.best_um, bound_um, expansions)
    result = search.run(kept.task(request, wanted), kept.tree)
    kept.tree, kept.open_bound_um = search.tree, search.open_bound_um
    return result


class ReusableTree:
    """The search tree of one goal, from which plans of many starts come.

    tree: its goals are the first steps of the current start. heuristic: toward the start of the
    last search; None before the first. open_bound_um: least cost + heuristic of all open states.
    """

    def __init__(self, request: Request) -> None:
        self._final_um = final_cost_um(request.model)
        self.tree = new_tree(request.lattice, turned_round(request.lattice.steps), True)
        self.tree.scalars[SLACK_UM] = NO_COST
        self.heuristic: Heuristic | None = None
        self.open_bound_um = 0
        self._toward_goal: Heuristic | None = None

    @property
    def best_um(self) -> int:
        """Cost of the best plan from the current start, NO_COST without one."""
        return int(self.tree.scalars[BEST_UM])

    def add_path(self, lattice: Lattice, nodes: Int64s) -> None:
        """Adds the end of a plan (n,), its nodes in the order of its steps, to the tree."""
        self._make_room(len(nodes))
        add_path(lattice, self.tree, nodes)

    def move_start(self, request: Request, nodes: Int64s, costs_um: Int64s) -> None:
        """Makes first steps (n,) with their costs the goals of the tree."""
        ends = request.context.ends
        self._make_room(len(ends))
        insert_roots(self.tree, ends, np.full(len(ends), self._final_um))
        order = np.argsort(nodes)
        self.tree = self.tree._replace(goals=nodes[order], goal_um=costs_um[order])
        self.tree.scalars[EXPANSIONS] = 0
        find_best_goal(self.tree)
        if self.best_um < NO_COST:
            # Costs may have fallen along the path since: then the plan costs less than it says.
            self.add_path(request.lattice, self.plan())
            find_best_goal(self.tree)

    def bound_um(self, lattice: Lattice) -> int:
        """Lower bound on plans from the current start by the last search."""
        if self.heuristic is None:
            return 0
        least_um = self.open_bound_um - heuristic_shift_um(lattice, self.heuristic, self.tree)
        return max(0, min(self.best_um, least_um))

    def bounds(self, request: Request, nodes: Int64s, costs_um: Int64s) -> Iterator[int]:
        """Lower bounds on plans from first steps (n,) by the heuristic toward the goal.

        The first is by the heuristic made for an earlier start, which is lower away from the paths
        that it was made for; the second by one made for this start.
        """
        context = request.context
        if self._toward_goal is not None:
            yield _least_um(request, self._toward_goal, nodes, costs_um)
        is_point = context.region.is_point
        self._toward_goal = heuristic_near_paths(context, nodes) if is_point else context.heuristic
        yield _least_um(request, self._toward_goal, nodes, costs_um)

    def plan(self) -> Int64s:
        """Nodes (n,) of the best plan from the current start, but for its last."""
        return trace(self.tree, int(self.tree.scalars[BEST_NODE]))[::-1].copy()

    def task(self, request: Request, wanted: float) -> SearchTask:
        """The search that continues from the tree to the current start.

        If there is a plan it is to end once that costs at most wanted times the optimum.
        """
        tree = self.tree
        further_um: int | None = None
        if self._toward_goal is not None and self.best_um < NO_COST:
            least_um = _least_by_path_um(request, self._toward_goal, tree.goals, tree.goal_um)
            further_um = FURTHER_UM + max(0, int(self.best_um / wanted) - least_um)
        if tree.scalars[ITERATION] > _MOST_ITERATIONS:
            reset_iterations(tree)
        self.heuristic = heuristic_to_start(request, tree.goals, tree.goal_um, further_um)
        self.open_bound_um = 0
        return SearchTask(
            lattice=request.lattice,
            heuristic=self.heuristic,
            steps=tree.steps,
            is_backward=True,
            roots=request.context.ends,
            root_um=np.full(len(request.context.ends), self._final_um),
            goals=tree.goals,
            goal_um=tree.goal_um,
        )

    def repair(self, lattice: Lattice, change: Change) -> None:
        """Repairs the tree after a change of the map: the lattice is the new one."""
        removed = remove_invalid(lattice, self.tree, change.shut)
        reset_iterations(self.tree)
        # Where nothing became cheaper only the removed nodes have to be reached another way.
        again = nodes_to_reopen(lattice, self.tree, removed, change.freed)
        self._make_room(len(again))
        reopen(self.tree, again)
        if len(change.freed):
            # New paths may be shorter than the heuristics allow for.
            self.heuristic, self._toward_goal, self.open_bound_um = None, None, 0
        elif self.heuristic is not None and len(again):
            nodes = again.astype(np.int64)
            values_um = estimates(lattice, self.heuristic, nodes)
            least_um = int((costs_of(self.tree, nodes) + values_um).min())
            self.open_bound_um = min(self.open_bound_um, least_um)

    def _make_room(self, entries: int) -> None:
        while self.tree.scalars[USED] + entries > len(self.tree.entry_node):
            self.tree = with_longer_queue(self.tree)


def _least_um(request: Request, heuristic: Heuristic, nodes: Int64s, costs_um: Int64s) -> int:
    return int((costs_um + estimates(request.lattice, heuristic, nodes)).min())


def _least_by_path_um(
    request: Request, heuristic: Heuristic, nodes: Int64s, costs_um: Int64s
) -> int:
    """The same by the path of the body alone."""
    rows = nodes % (2 * request.lattice.headings)
    path_um = heuristic.cost_um[request.context.body_cells(nodes)].astype(np.int64) - 1
    return int((costs_um + np.maximum(path_um, 0) + heuristic.potential_um[rows]).min())


def heuristic_near_paths(context: GoalContext, nodes: Int64s) -> Heuristic:
    """The heuristic toward the goal's own pose near paths from nodes (n,); lower elsewhere.

    Outside the ring of the goal table D is the least cost by way of the ring, as in
    `search_body_path`, inside it that of the straight line: there the goal table says more.
    """
    lattice, tables = context.lattice, context.tables
    potential, wanted = tables.potential, np.unique(context.body_cells(nodes))
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
    """Replaces costs inside the ring by those of the straight line."""
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
