"""AD*: a search that is asked again while the robot walks and the map changes.

After Koenig and Likhachev, "D* Lite", 2002, and Likhachev et al., "Anytime Dynamic A*", 2005. The
tree grows from the goal, so its costs-to-go hold wherever the robot is. When a plan is good enough
without a search is told in docs/notes/planner_design.md.

Bounds are reused: the heuristic h of the last search was made for its start and is consistent, so
from a first step s of cost c(s) to a state t the cost is at least h(t) - h(s). With the shift
k = max over the new first steps of h(s) - c(s), h(t) - k is a heuristic for the new start, and the
least cost + h of all open states, less k, is a lower bound on all plans that are not in the tree.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planner.compiled import njit_no_refcount
from planner.heuristics.distance_field import FURTHER_UM, lazy_path_costs, ring_on_map
from planner.heuristics.heuristic import Heuristic, estimates, full_heuristic
from planner.heuristics.wavefront import StraightCost, straight_to, straight_um
from planner.lattice.lattice import Int64s, Lattice
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
from planner.search.ara_star import AraStar, proven_ratio
from planner.search.best_first import (
    EXPANSIONS,
    ITERATION,
    NO_COST,
    SLACK_UM,
    USED,
    insert_roots,
)
from planner.search.first_plan import CUT_OFF, find_first_plan
from planner.search.problem import (
    Request,
    Result,
    SearchTask,
    backward_task,
    best_nodes,
    new_tree,
    no_body_path,
    no_first_step,
    result_of,
    with_longer_queue,
)
from planner.time_limit import OutOfTime

_NAME = "adstar"
_MOST_ITERATIONS = 100  # their numbers are 7 bit


def plan_adstar(request: Request, options: PlannerOptions, began: float) -> Result:
    """Plans from the tree in the context's memory, and searches only where it must."""
    if not request.has_first_step:
        return no_first_step(request)
    memory = request.context.memory
    kept = memory.get(_NAME)
    is_first = kept is None
    if kept is None:
        kept = memory[_NAME] = ReusableTree(request)
    kept.move_start(request)
    try:
        return _improved(request, options, began, kept, is_first)
    except OutOfTime:
        if kept.tree.best_um == NO_COST:
            raise
        return _known(request, began, kept, kept.bound_um(request.lattice), 0)


def _improved(
    request: Request, options: PlannerOptions, began: float, kept: ReusableTree, is_first: bool
) -> Result:
    """The plan in the tree, or a better one if that is wanted and there is one."""
    expansions, bound_um = 0, 0
    prove_all = is_first or options.improve_expansions is None
    wanted = options.final_epsilon if prove_all else options.epsilon
    if kept.tree.best_um == NO_COST or kept.may_be_shorter:
        # Over freed ground there may be quite another way, of which the tree knows nothing.
        first = find_first_plan(request, options)
        kept.may_be_shorter = False
        if first is CUT_OFF:
            return no_body_path()
        if first is not None:
            expansions, bound_um = first.expansions, first.lower_bound_um
            if first.cost_um < kept.tree.best_um:
                kept.add_path(request.lattice, first.nodes)
                kept.move_start(request)
    bound_um = max(bound_um, kept.bound_um(request.lattice))
    if kept.tree.best_um < NO_COST:
        is_enough = is_first and options.stop_at_first
        for least_um in itertools.chain([bound_um], kept.bounds(request)):
            bound_um = max(bound_um, least_um)
            if is_enough or kept.tree.best_um <= wanted * bound_um:
                return _known(request, began, kept, bound_um, expansions)
    search = AraStar(request, replace(options, final_epsilon=wanted), began)
    search.note_known_plan(kept.tree.best_um, bound_um, expansions)
    result = search.run(kept.task(request, wanted), kept.tree)
    kept.tree, kept.open_bound_um = search.tree, search.open_bound_um
    return result


def _known(
    request: Request, began: float, kept: ReusableTree, bound_um: int, expansions: int
) -> Result:
    """The plan in the tree, which there must be."""
    return result_of(
        request,
        best_nodes(kept.tree),
        cost_um=kept.tree.best_um,
        epsilon=proven_ratio(kept.tree.best_um, bound_um),
        expansions=expansions,
        time_to_first_s=time.perf_counter() - began,
    )


class ReusableTree:
    """The search tree of one goal, from which plans of many starts come.

    tree: its goals are the first steps of the current start. heuristic: toward the start of the
    last search; None before the first. open_bound_um: least cost + heuristic of all open states.
    may_be_shorter: ground has become free since the last plan.
    """

    def __init__(self, request: Request) -> None:
        self.tree = new_tree(request.lattice, is_backward=True)
        self.tree.scalars[SLACK_UM] = NO_COST
        self.heuristic: Heuristic | None = None
        self.open_bound_um = 0
        self.may_be_shorter = False
        self._toward_goal: Heuristic | None = None

    def add_path(self, lattice: Lattice, nodes: Int64s) -> None:
        """Adds the end of a plan (n,), its nodes in the order of its steps, to the tree."""
        self._make_room(len(nodes))
        add_path(lattice, self.tree, nodes)

    def move_start(self, request: Request) -> None:
        """Makes the first steps of a request the goals of the tree."""
        ends, (nodes, costs_um) = request.context.ends, request.first_steps
        self._make_room(len(ends))
        insert_roots(self.tree, ends, np.full(len(ends), final_cost_um(request.model)))
        order = np.argsort(nodes)
        self.tree = self.tree._replace(goals=nodes[order], goal_um=costs_um[order])
        self.tree.scalars[EXPANSIONS] = 0
        find_best_goal(self.tree)
        if self.tree.best_um < NO_COST:
            # Costs may have fallen along the path since: then the plan costs less than it says.
            self.add_path(request.lattice, best_nodes(self.tree))
            find_best_goal(self.tree)

    def bound_um(self, lattice: Lattice) -> int:
        """Lower bound on plans from the current start by the last search."""
        if self.heuristic is None:
            return 0
        least_um = self.open_bound_um - heuristic_shift_um(lattice, self.heuristic, self.tree)
        return max(0, min(self.tree.best_um, least_um))

    def bounds(self, request: Request) -> Iterator[int]:
        """Lower bounds on plans by the heuristic toward the goal.

        The first is by the heuristic made for an earlier start, which is lower away from the paths
        that it was made for; the second by one made for this start.
        """
        if self._toward_goal is not None:
            yield request.heuristic_bound(self._toward_goal)
        is_point = request.context.region.is_point
        self._toward_goal = heuristic_near_paths(request) if is_point else request.context.heuristic
        yield request.heuristic_bound(self._toward_goal)

    def task(self, request: Request, wanted: float) -> SearchTask:
        """The search that continues from the tree to the current start.

        If there is a plan it is to end once that costs at most wanted times the optimum.
        """
        further_um: int | None = None
        if self._toward_goal is not None and self.tree.best_um < NO_COST:
            least_um = _path_bound_um(request, self._toward_goal)
            further_um = FURTHER_UM + max(0, int(self.tree.best_um / wanted) - least_um)
        if self.tree.scalars[ITERATION] > _MOST_ITERATIONS:
            reset_iterations(self.tree)
        task = backward_task(request, further_um)
        self.heuristic, self.open_bound_um = task.heuristic, 0
        return task

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
            self.may_be_shorter = True
        elif self.heuristic is not None and len(again):
            nodes = again.astype(np.int64)
            values_um = estimates(lattice, self.heuristic, nodes)
            least_um = int((costs_of(self.tree, nodes) + values_um).min())
            self.open_bound_um = min(self.open_bound_um, least_um)

    def _make_room(self, entries: int) -> None:
        while self.tree.scalars[USED] + entries > len(self.tree.entry_node):
            self.tree = with_longer_queue(self.tree)


def _path_bound_um(request: Request, heuristic: Heuristic) -> int:
    """As `Request.heuristic_bound`, by the path of the body alone."""
    nodes, costs_um = request.first_steps
    path_um = heuristic.cost_um[request.context.body_cells(nodes)].astype(np.int64) - 1
    potentials_um = heuristic.potential_um[nodes % (2 * request.lattice.headings)]
    return int((costs_um + np.maximum(path_um, 0) + potentials_um).min())


def heuristic_near_paths(request: Request) -> Heuristic:
    """The heuristic toward the goal's own pose near paths from the first steps; lower elsewhere.

    Outside the ring of the goal table D is the least cost by way of the ring, as in
    `path_costs_to_goal`, inside it that of the straight line: there the goal table says more.
    """
    context, lattice, tables = request.context, request.lattice, request.context.tables
    potential, goal_table = tables.potential, tables.goal_table
    wanted = np.unique(context.body_cells(request.first_steps[0]))
    cells, costs_um = ring_on_map(lattice, goal_table)
    cost_um = None
    if len(cells):
        cost_um = lazy_path_costs(lattice, potential, cells, costs_um, wanted)
        ahead = straight_to(lattice, potential, lattice.goal_cell)
        _lower_inside(lattice, cost_um, goal_table.inside, ahead)
    if cost_um is None or not np.any(cost_um[wanted] > 0):
        cost_um = lazy_path_costs(lattice, potential, lattice.goal_cell, np.array([0]), wanted)
    return full_heuristic(lattice, tables, cost_um)


@njit_no_refcount
def _lower_inside(
    lattice: Lattice, cost_um: NDArray[np.int32], inside: NDArray[np.bool_], ahead: StraightCost
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
                cost_um[cell] = straight_um(ahead, col, row) + 1
