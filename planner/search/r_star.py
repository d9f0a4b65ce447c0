"""R*: a first plan by way of sparse random sub-goals, for large open maps.

After Likhachev and Stentz, "R* Search", 2008. The search expands a sparse graph: a state has random
successors at a fixed distance, and the goal once that is near. An edge has at first a lower bound
for its cost; a local search finds the path when the state is taken from the queue. A state whose
local search is hard, or whose cost is high, is put behind all others (AVOID). Nothing of this needs
path costs over the whole map.

Where this finds nothing `first_plan` follows, and then the full search, so no plan is missed.
"""

from __future__ import annotations

import heapq
import math
import time
from dataclasses import dataclass, field, replace

import numpy as np

from planner.heuristics.heuristic import Heuristic, of_path
from planner.heuristics.turning import straight_cost
from planner.heuristics.wavefront import (
    EVERYWHERE,
    NOT_DRAWN,
    cell_shut,
    moves_of,
    spread_costs,
)
from planner.lattice.lattice import Int64s
from planner.lattice.steps import final_cost_um
from planner.options import PlannerOptions
from planner.search.ara_star import AraStar, improved
from planner.search.best_first import (
    BEST_NODE,
    BEST_UM,
    EXPANSIONS,
    NO_COST,
    OUT_OF_ENTRIES,
    expand,
    start_iteration,
)
from planner.search.first_plan import CUT_OFF, FirstPlan, find_first_plan
from planner.search.problem import (
    GoalContext,
    Request,
    Result,
    SearchTask,
    no_first_step,
    trace,
    with_longer_queue,
)

_APART_M = 2.0  # from a state to its successors
_SUCCESSORS = 8
_SUB_GOAL_CELLS = 2  # radius of a sub-goal
_WEIGHT = 2.0
_EASY, _HARD = 1_000, 10_000  # expansions of a local search, at first and once more
_MOST_STATES = 2_000
_MOST_EXPANSIONS = 5_000  # then `first_plan` takes over, which needs fewer
_BEYOND_MOVES = 8  # by which path costs of a local search reach beyond its roots

_NO_NODES = np.zeros(0, np.int64)


@dataclass(frozen=True, kw_only=True)
class Target:
    """Goal of a local search: nodes (n,) in rising order with their costs-to-go.

    cells (m,): the body's cells there. is_goal: whether they are the ends of the plan.
    """

    cells: Int64s
    nodes: Int64s
    node_um: Int64s
    is_goal: bool


@dataclass(frozen=True, kw_only=True)
class LocalPath:
    """Nodes (n,) of a path, the root first, and its cost; no nodes if none was found."""

    nodes: Int64s
    cost_um: int
    expansions: int


@dataclass(kw_only=True)
class _State:
    """A state of the sparse graph.

    at (2,): the body's col and row. parent: number of the state before, -1 for the start. nodes:
    path from the parent, without its first node. cost_um: cost-to-come, or its lower bound until
    the state is reached. ahead_um: heuristic. tries: local searches so far.
    """

    at: Int64s
    parent: int
    cost_um: int
    ahead_um: int
    is_goal: bool
    nodes: Int64s = field(default_factory=lambda: _NO_NODES)
    is_reached: bool = False
    tries: int = 0


def plan_rstar(request: Request, options: PlannerOptions, began: float) -> Result:
    """A first plan by sub-goals, then the search of `plan_ara` until the options are met."""
    nodes, costs_um = request.first_nodes()
    if not len(nodes):
        return no_first_step(request)
    sparse = SparseSearch(request, nodes, costs_um, options, began)
    first = sparse.plan()
    if first is None:
        first = find_first_plan(request, nodes, costs_um, options)
        if first is not None and first is not CUT_OFF:
            first = replace(first, expansions=first.expansions + sparse.expansions)
    return improved(AraStar(request, options, began), first, nodes, costs_um)


class SparseSearch:
    """The search of the sparse graph from first steps (n,) with their costs."""

    def __init__(
        self,
        request: Request,
        nodes: Int64s,
        costs_um: Int64s,
        options: PlannerOptions,
        began: float,
    ) -> None:
        self.request, self.options, self.began = request, options, began
        self.nodes, self.costs_um = nodes, costs_um
        self.expansions = 0
        self._rng = np.random.default_rng(options.seed)
        self._states: list[_State] = []
        self._heap: list[tuple[bool, float, int]] = []
        self._goal_at = np.array([request.lattice.origin_col, request.lattice.origin_row])
        ends = request.context.ends
        self._final_um = final_cost_um(request.model)
        self._goal = Target(
            cells=np.unique(request.context.body_cells(ends)),
            nodes=ends,
            node_um=np.full(len(ends), self._final_um),
            is_goal=True,
        )

    def plan(self) -> FirstPlan | None:
        """The first plan to the goal region; None if none was found within the limits."""
        if not len(self._goal.nodes):
            return None
        cell = int(self.request.context.body_cells(self.nodes)[np.argmin(self.costs_um)])
        at = np.array([cell % self.request.lattice.cols, cell // self.request.lattice.cols])
        self._add(at, parent=-1, cost_um=int(self.costs_um.min()), is_goal=False)
        self._states[0].is_reached = True
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
        limit_s = self.options.time_limit_s
        is_late = limit_s is not None and time.perf_counter() - self.began >= limit_s
        most = min(_MOST_EXPANSIONS, self.options.max_expansions)
        return is_late or self.expansions >= most or len(self._states) >= _MOST_STATES

    def _straight_um(self, at: Int64s, to: Int64s) -> int:
        potential = self.request.context.tables.potential
        return int(straight_cost(to[0] - at[0], to[1] - at[1], potential))

    def _add(self, at: Int64s, *, parent: int, cost_um: int, is_goal: bool) -> None:
        ahead_um = 0 if is_goal else self._straight_um(at, self._goal_at)
        state = _State(at=at, parent=parent, cost_um=cost_um, ahead_um=ahead_um, is_goal=is_goal)
        self._states.append(state)
        self._push(len(self._states) - 1)

    def _push(self, number: int) -> None:
        """Into the queue; states to avoid come behind all others."""
        state = self._states[number]
        fair_um = self._states[0].cost_um + _WEIGHT * self._straight_um(
            self._states[0].at, state.at
        )
        is_hard = not state.is_reached and state.tries > 0
        is_avoided = is_hard or (number > 0 and state.cost_um > fair_um)
        heapq.heappush(self._heap, (is_avoided, state.cost_um + _WEIGHT * state.ahead_um, number))

    def _search_path_to(self, number: int) -> None:
        """Local search from the parent; a state that it misses twice is dropped."""
        state = self._states[number]
        parent = self._states[state.parent]
        roots, root_um = self.nodes, self.costs_um
        if len(parent.nodes):
            roots, root_um = parent.nodes[-1:], np.array([parent.cost_um])
        target = self._goal if state.is_goal else self._around(state.at)
        budget = (_EASY, _HARD)[min(state.tries, 1)]
        found = local_search(self.request.context, target, roots, root_um, budget)
        self.expansions += found.expansions
        state.tries += 1
        if len(found.nodes):
            state.is_reached, state.cost_um = True, found.cost_um
            state.nodes = found.nodes[1:] if len(parent.nodes) else found.nodes
            if not len(state.nodes):  # it is where the parent is
                state.nodes = parent.nodes[-1:]
        elif state.tries > 1:
            return
        self._push(number)

    def _around(self, at: Int64s) -> Target:
        """All nodes with the body in a disc of cells, whatever the heading."""
        context, lattice = self.request.context, self.request.lattice
        reach = np.arange(-_SUB_GOAL_CELLS, _SUB_GOAL_CELLS + 1)
        col, row = np.meshgrid(reach, reach)
        near = np.hypot(col, row) <= _SUB_GOAL_CELLS
        cells = (at[1] + row[near]) * lattice.cols + at[0] + col[near]
        rows = 2 * lattice.headings
        foot = np.arange(rows)
        nodes = ((cells[:, None] - context.body_cell[foot]) * rows + foot).reshape(-1)
        nodes = np.sort(nodes[(nodes >= 0) & (nodes < lattice.nodes)])
        potential_um = context.potential_um
        node_um = potential_um[nodes % rows] - potential_um.min()
        return Target(cells=cells, nodes=nodes, node_um=node_um, is_goal=False)

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
            self._add(at, parent=number, cost_um=cost_um, is_goal=False)

    def _plan_by(self, number: int) -> FirstPlan:
        """The plan along the states up to one at the goal."""
        paths, cost_um = [], self._states[number].cost_um + self._final_um
        while number > 0:
            paths.append(self._states[number].nodes)
            number = self._states[number].parent
        return FirstPlan(
            nodes=np.concatenate(paths[::-1]),
            cost_um=cost_um,
            lower_bound_um=min(cost_um, self.request.lower_bound(self.nodes, self.costs_um)),
            expansions=self.expansions,
        )


def local_search(
    context: GoalContext, target: Target, roots: Int64s, root_um: Int64s, budget: int
) -> LocalPath:
    """The first path from one of the roots (k,), with their costs, to a target.

    budget: expansions. The heuristic knows path costs up to the roots and a little further.
    """
    task = SearchTask(
        lattice=context.lattice,
        heuristic=_local_heuristic(context, target, roots),
        steps=context.lattice.steps,
        is_backward=False,
        roots=roots,
        root_um=root_um,
        goals=target.nodes,
        goal_um=target.node_um,
    )
    if not task.is_connected:
        return LocalPath(nodes=_NO_NODES, cost_um=0, expansions=0)
    tree = task.tree()
    scalars = tree.scalars
    start_iteration(task.lattice, task.heuristic, tree, _WEIGHT)
    outcome = OUT_OF_ENTRIES
    while outcome == OUT_OF_ENTRIES:
        left = budget - int(scalars[EXPANSIONS])
        outcome = expand(task.lattice, task.heuristic, tree, _WEIGHT, left)
        if outcome == OUT_OF_ENTRIES:
            tree = with_longer_queue(tree)
    last, expansions = int(scalars[BEST_NODE]), int(scalars[EXPANSIONS])
    if scalars[BEST_UM] >= NO_COST:
        return LocalPath(nodes=_NO_NODES, cost_um=0, expansions=expansions)
    to_go_um = target.node_um[np.searchsorted(target.nodes, last)]
    return LocalPath(
        nodes=trace(tree, last), cost_um=int(scalars[BEST_UM] - to_go_um), expansions=expansions
    )


def _local_heuristic(context: GoalContext, target: Target, roots: Int64s) -> Heuristic:
    """As `GoalContext.heuristic`, toward the target, on cells up to the roots."""
    lattice, tables = context.lattice, context.tables
    potential_um = context.potential_um
    cost_um = np.zeros(lattice.cols * lattice.rows, np.int32)
    reached_um = spread_costs(
        lattice,
        cost_um,
        target.cells,
        np.zeros(len(target.cells), np.int64),
        moves_of(tables.potential),
        np.unique(context.body_cells(roots)),
        _BEYOND_MOVES * int(tables.potential.move_um.min()),
        EVERYWHERE,
        NOT_DRAWN,
    )
    heuristic = of_path(
        lattice,
        cost_um,
        reached_um,
        context.body_cell,
        potential_um if target.is_goal else potential_um - potential_um.min(),
    )
    if target.is_goal and context.region.is_point:
        table = tables.goal_table
        return heuristic._replace(endgame_um=table.cost_um, cap_um=table.cap_um)
    return heuristic
