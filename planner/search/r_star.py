"""R*: a first plan by way of sparse random sub-goals, for large open maps.

After Likhachev and Stentz, "R* Search", 2008; its steps are told in docs/notes/planner_design.md. A
state whose local search is hard, or whose cost is high, is put behind all others (AVOID). Nothing
of this needs path costs over the whole map. Where it finds nothing `first_plan` follows, and then
the full search, so no plan is missed.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass, field, replace

import numpy as np

from planner.heuristics.heuristic import heuristic_by_path
from planner.heuristics.potential import straight_cost
from planner.heuristics.wavefront import NO_COST_AHEAD, cell_shut, moves_of, propagate
from planner.lattice.lattice import Int64s
from planner.lattice.steps import final_cost_um
from planner.options import PlannerOptions
from planner.search.ara_star import AraStar, improved
from planner.search.best_first import NO_COST, OUT_OF_ENTRIES, start_iteration
from planner.search.first_plan import CUT_OFF, FirstPlan, find_first_plan
from planner.search.problem import (
    Request,
    Result,
    SearchTask,
    best_nodes,
    expand_up_to,
    no_first_step,
    with_longer_queue,
)
from planner.time_limit import is_late

_APART_M = 2.0  # from a state to its successors
_SUCCESSORS = 8
_SUB_GOAL_CELLS = 2  # radius of a sub-goal
_WEIGHT = 2.0
_EASY, _HARD = 1_000, 10_000  # expansions of a local search, at first and once more
_MOST_STATES = 2_000
_MOST_EXPANSIONS = 5_000  # then `first_plan` takes over, which needs fewer
_BEYOND_MOVES = 8  # by which path costs of a local search reach beyond its roots


@dataclass(kw_only=True)
class _State:
    """A state of the sparse graph.

    at (2,): the body's col and row. parent: number of the state before, -1 for the start. cost_um:
    cost-to-come, or its lower bound until the state is reached. ahead_um: heuristic. nodes: path
    from the parent, without its first node. tries: local searches so far.
    """

    at: Int64s
    parent: int
    cost_um: int
    ahead_um: int
    is_goal: bool
    nodes: Int64s = field(default_factory=lambda: np.zeros(0, np.int64))
    tries: int = 0

    @property
    def is_reached(self) -> bool:
        """Whether a path to the state is known."""
        return self.parent < 0 or len(self.nodes) > 0


def plan_rstar(request: Request, options: PlannerOptions, began: float) -> Result:
    """A first plan by sub-goals, then the search of `plan_ara` until the options are met."""
    if not request.has_first_step:
        return no_first_step(request)
    sparse = SparseSearch(request, options)
    first = sparse.plan()
    if first is None:
        first = find_first_plan(request, options)
        if first is not None and first is not CUT_OFF:
            first = replace(first, expansions=first.expansions + sparse.expansions)
    return improved(AraStar(request, options, began), first)


class SparseSearch:
    """The search of the sparse graph from the first steps."""

    def __init__(self, request: Request, options: PlannerOptions) -> None:
        self.request, self.options = request, options
        self.expansions = 0
        self._rng = np.random.default_rng(options.seed)
        self._states: list[_State] = []
        self._heap: list[tuple[bool, float, int]] = []
        self._goal_at = np.array([request.lattice.origin_col, request.lattice.origin_row])

    def plan(self) -> FirstPlan | None:
        """The first plan to the goal region; None if none was found within the limits."""
        if not len(self.request.context.ends):
            return None
        nodes, costs_um = self.request.first_steps
        cell = int(self.request.context.body_cells(nodes)[np.argmin(costs_um)])
        at = np.array([cell % self.request.lattice.cols, cell // self.request.lattice.cols])
        self._add(at, parent=-1, cost_um=int(costs_um.min()))
        while self._heap and not self._limit_reached():
            number = heapq.heappop(self._heap)[2]
            state = self._states[number]
            if not state.is_reached:
                self._search_path_to(number)
            elif state.is_goal:
                return self._plan_by(number)
            else:
                self._expand(number)
        return None

    def _limit_reached(self) -> bool:
        most = min(_MOST_EXPANSIONS, self.options.max_expansions)
        return is_late() or self.expansions >= most or len(self._states) >= _MOST_STATES

    def _straight_um(self, at: Int64s, to: Int64s) -> int:
        potential = self.request.context.tables.potential
        return int(straight_cost(to[0] - at[0], to[1] - at[1], *potential.straight_um))

    def _add(self, at: Int64s, *, parent: int, cost_um: int, is_goal: bool = False) -> None:
        ahead_um = 0 if is_goal else self._straight_um(at, self._goal_at)
        state = _State(at=at, parent=parent, cost_um=cost_um, ahead_um=ahead_um, is_goal=is_goal)
        self._states.append(state)
        self._push(len(self._states) - 1)

    def _push(self, number: int) -> None:
        """Into the queue; states to avoid come behind all others."""
        state, start = self._states[number], self._states[0]
        fair_um = start.cost_um + _WEIGHT * self._straight_um(start.at, state.at)
        is_hard = not state.is_reached and state.tries > 0
        is_avoided = is_hard or (number > 0 and state.cost_um > fair_um)
        heapq.heappush(self._heap, (is_avoided, state.cost_um + _WEIGHT * state.ahead_um, number))

    def _search_path_to(self, number: int) -> None:
        """Local search from the parent; a state that it misses twice is dropped."""
        state = self._states[number]
        parent = self._states[state.parent]
        roots, root_um = self.request.first_steps
        if len(parent.nodes):
            roots, root_um = parent.nodes[-1:], np.array([parent.cost_um])
        path, cost_um = self._local_search(state, roots, root_um)
        state.tries += 1
        if len(path):
            state.cost_um = cost_um
            state.nodes = path[1:] if len(parent.nodes) else path
            if not len(state.nodes):  # it is where the parent is
                state.nodes = parent.nodes[-1:]
        elif state.tries > 1:
            return
        self._push(number)

    def _local_search(self, state: _State, roots: Int64s, root_um: Int64s) -> tuple[Int64s, int]:
        """Nodes (n,) and cost of the first path to a state from one of the roots (k,) with costs.

        No nodes if none was found.
        """
        task = self._local_task(state, roots, root_um)
        if not task.is_connected:
            return np.zeros(0, np.int64), 0
        budget = _HARD if state.tries else _EASY
        tree = task.tree()
        start_iteration(task.lattice, task.heuristic, tree, _WEIGHT)
        outcome = OUT_OF_ENTRIES
        while outcome == OUT_OF_ENTRIES and tree.expansions < budget:
            outcome = expand_up_to(task, tree, _WEIGHT, budget)
            if outcome == OUT_OF_ENTRIES:
                tree = with_longer_queue(tree)
        self.expansions += tree.expansions
        if tree.best_um == NO_COST:
            return np.zeros(0, np.int64), 0
        path = best_nodes(tree)
        return path, tree.best_um - int(task.goal_um[np.searchsorted(task.goals, path[-1])])

    def _local_task(self, state: _State, roots: Int64s, root_um: Int64s) -> SearchTask:
        """The search from roots (k,) to a state; its path costs reach up to the roots and beyond.

        A sub-goal is all nodes with the body in a disc of cells, whatever the heading.
        """
        context, lattice = self.request.context, self.request.lattice
        potential = context.tables.potential
        potential_um = potential.potential_um
        if state.is_goal:
            nodes = context.ends
            node_um = np.full(len(nodes), final_cost_um(self.request.model))
            cells = np.unique(context.body_cells(nodes))
        else:
            potential_um = potential_um - potential_um.min()
            rows = np.arange(2 * lattice.headings)
            reach = np.arange(-_SUB_GOAL_CELLS, _SUB_GOAL_CELLS + 1)
            col, row = np.meshgrid(reach, reach)
            near = np.hypot(col, row) <= _SUB_GOAL_CELLS
            cells = (state.at[1] + row[near]) * lattice.cols + state.at[0] + col[near]
            feet = cells[:, None] - potential.cell_offsets(lattice.cols)
            nodes = (feet * len(rows) + rows).reshape(-1)
            nodes = np.sort(nodes[(nodes >= 0) & (nodes < lattice.nodes)])
            node_um = potential_um[nodes % len(rows)]
        cost_um = np.zeros(lattice.cols * lattice.rows, np.int32)
        wanted = np.unique(context.body_cells(roots))
        beyond_um = _BEYOND_MOVES * int(potential.move_um.min())
        seeds = cells, np.zeros(len(cells), np.int64)
        moves = moves_of(potential)
        reached_um = propagate(lattice, cost_um, *seeds, moves, wanted, beyond_um, NO_COST_AHEAD)
        heuristic = heuristic_by_path(lattice, potential, cost_um, potential_um, reached_um)
        if state.is_goal and context.region.is_point:
            table = context.tables.goal_table
            heuristic = heuristic._replace(goal_table_um=table.cost_um, cap_um=table.cap_um)
        return SearchTask(
            lattice=lattice,
            heuristic=heuristic,
            is_backward=False,
            roots=roots,
            root_um=root_um,
            goals=nodes,
            goal_um=node_um,
        )

    def _expand(self, number: int) -> None:
        """Adds random successors of a state, and the goal if it is near."""
        lattice, state = self.request.lattice, self._states[number]
        apart = _APART_M / lattice.cell_m
        if np.hypot(*(self._goal_at - state.at)) <= 1.5 * apart:
            cost_um = state.cost_um + state.ahead_um
            self._add(self._goal_at, parent=number, cost_um=cost_um, is_goal=True)
        reach_m = self.request.context.tables.potential.reach_m
        known = np.array([other.at for other in self._states if other.is_reached])
        turn = self._rng.uniform(0, 2 * math.pi)
        for k in range(_SUCCESSORS):
            angle = turn + (k + self._rng.uniform(-0.3, 0.3)) * 2 * math.pi / _SUCCESSORS
            move = apart * np.array([math.cos(angle), math.sin(angle)])
            at = state.at + np.rint(move).astype(np.int64)
            rim = 2 + _SUB_GOAL_CELLS
            if min(at) < rim or at[0] >= lattice.cols - rim or at[1] >= lattice.rows - rim:
                continue
            is_crowded = np.hypot(*(known - at).T).min() < 0.4 * apart
            if is_crowded or cell_shut(lattice, int(at[1] * lattice.cols + at[0]), reach_m):
                continue
            cost_um = state.cost_um + self._straight_um(state.at, at)
            self._add(at, parent=number, cost_um=cost_um)

    def _plan_by(self, number: int) -> FirstPlan:
        """The plan along the states up to one at the goal."""
        cost_um = self._states[number].cost_um + final_cost_um(self.request.model)
        paths = []
        while number > 0:
            paths.append(self._states[number].nodes)
            number = self._states[number].parent
        return FirstPlan(
            nodes=np.concatenate(paths[::-1]),
            cost_um=cost_um,
            lower_bound_um=min(cost_um, self.request.quick_bound()),
            expansions=self.expansions,
        )
