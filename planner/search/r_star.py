"""R*: a first plan by way of sparse random sub-goals, for large open maps.

After Likhachev and Stentz, "R* Search", 2008. The search knows a graph of few states only: from
each it goes on to some random ones at a fixed distance, and to the goal once that is near. What a
way between two of them costs is at first only a lower bound; the way itself is searched for when it
is its turn (`local.py`), and seldom far: a state that is hard to come to, or dearly, is put behind
all that are not. Nothing of this sees the whole map. The plan is then improved in a strip along it.

Where this finds nothing the quick search follows (`quick.py`), and then the full one, so no plan is
missed; and that goes on from this plan unless the first is good enough. The bound reported is the
full search's, or before it that of the straight way.
"""

from __future__ import annotations

import heapq
import math
import time
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from planner.heuristics.heuristic import Heuristic, of_path
from planner.heuristics.turning import straight_cost
from planner.heuristics.wavefront import (
    EVERYWHERE,
    NO_CELLS,
    NOT_DRAWN,
    cell_shut,
    moves_of,
    spread_costs,
)
from planner.lattice.lattice import Int64s
from planner.lattice.steps import final_cost_um
from planner.options import PlannerOptions
from planner.search import best_first as search
from planner.search.ara_star import Run, quick_plan
from planner.search.best_first import costs_of, trace
from planner.search.coarse_to_fine import least_straight
from planner.search.first_plan import NO_WAY, QuickPath
from planner.search.problem import (
    GoalContext,
    Request,
    Result,
    body_cells_of,
    first_nodes,
    no_first_step,
    no_way,
)
from planner.search.search_task import Task, forward_task, least_toward_goal

# Searches between nodes of the lattice that are a few metres apart, which see nothing else.
#
# Their heuristic is the path cost of the body's cells around the target, up to the cells asked for
# and a little further, or within a mask of cells.

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


def target_around(context: GoalContext, cells: Int64s) -> Target:
    """All nodes with the body in one of the cells, whatever the heading."""
    rows = 2 * context.lattice.headings
    row = np.arange(rows)
    nodes = ((cells[:, None] - context.body_cell[row]) * rows + row).reshape(-1)
    nodes = np.sort(nodes[(nodes >= 0) & (nodes < context.lattice.nodes)])
    potential_um = context.tables.potential.potential_um.reshape(-1)
    node_um = potential_um[nodes % rows] - potential_um.min()
    return Target(cells=cells, nodes=nodes, node_um=node_um, is_goal=False)


def search_to(
    context: GoalContext,
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
        lattice=context.lattice,
        heuristic=_heuristic(context, target, roots, mask),
        steps=context.lattice.steps,
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
    search.begin_round(task.lattice, task.heuristic, tree, epsilon)
    while True:
        left = budget - int(scalars[search.EXPANSIONS])
        outcome = search.expand(task.lattice, task.heuristic, tree, epsilon, left)
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
    context: GoalContext, target: Target, roots: Int64s, mask: NDArray[np.uint8] | None
) -> Heuristic:
    """As `GoalContext.heuristic`, toward the target, on the cells on the way."""
    lattice, tables = context.lattice, context.tables
    rows = 2 * lattice.headings
    potential_um = tables.potential.potential_um.reshape(-1)
    cost_um = np.zeros(lattice.cols * lattice.rows, np.int32)
    wanted = np.unique(roots // rows + context.body_cell[roots % rows])
    reached_um = spread_costs(
        lattice,
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
        lattice,
        cost_um,
        reached_um,
        context.body_cell,
        potential_um if target.is_goal else potential_um - potential_um.min(),
    )
    if target.is_goal and context.region.is_point:
        goal_table = tables.goal_table
        return heuristic._replace(endgame_um=goal_table.cost_um, cap_um=goal_table.cap_um)
    return heuristic


_APART_M = 2.0  # from a state to the next
_SUCCESSORS = 8
_TARGET_CELLS = 2  # radius of what counts as having come to a sub-goal
_WEIGHT = 2.0
_EASY, _HARD = 1_000, 10_000  # expansions of a search between two states, at first and once more
_MOST_STATES = 2_000
_MOST_EXPANSIONS = 5_000  # then the quick search takes over, which needs fewer
_STRIP_M, _STRIP_EXPANSIONS = 0.6, 20_000


def plan_rstar(request: Request, options: PlannerOptions, began: float) -> Result:
    """A first plan by sub-goals, then the search of `plan_ara` until the options are content."""
    nodes, costs_um = first_nodes(request)
    if not len(nodes):
        return no_first_step(request)
    run = Run(request, options, began)
    sparse = _Sparse(request, nodes, costs_um, options, began)
    first = sparse.plan()
    if first is None:
        first = quick_plan(request, nodes, costs_um, options)
        if first is NO_WAY:
            return no_way()
        if first is not None:
            first = replace(first, expansions=first.expansions + sparse.expansions)
    if first is not None:
        run.take(first)
        if options.stop_at_first or run.proven <= options.final_epsilon:
            return run.quick_result()
    return run.result(forward_task(request, nodes, costs_um))


@dataclass(kw_only=True)
class _State:
    """A state of the sparse graph: the body's cell, and the way to it once that is known.

    at (2,): col and row. parent: number of the state before. nodes: the way from the parent, its
    last node included, its first not. cost_um: to here, or what it is at least. tries: searches.
    """

    at: Int64s
    parent: int
    cost_um: int
    ahead_um: int
    is_goal: bool
    nodes: Int64s = field(default_factory=lambda: np.zeros(0, np.int64))
    is_reached: bool = False
    tries: int = 0


class _Sparse:
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
        lattice = request.lattice
        self._goal_at = np.array([lattice.origin_col, lattice.origin_row])
        ends = request.context.ends
        self._goal = Target(
            cells=np.unique(body_cells_of(request.context, ends)),
            nodes=ends,
            node_um=np.full(len(ends), final_cost_um(request.model)),
            is_goal=True,
        )

    def plan(self) -> QuickPath | None:
        """The plan, improved in a strip around it; None if none was found soon."""
        if not len(self._goal.nodes):
            return None
        cells = body_cells_of(self.request.context, self.nodes)
        first = int(cells[np.argmin(self.costs_um)])
        self._add(self._at(first), parent=-1, cost_um=int(self.costs_um.min()), is_goal=False)
        self._states[0].is_reached = True
        while self._heap and not self._is_over():
            number = heapq.heappop(self._heap)[2]
            state = self._states[number]
            if not state.is_reached:
                self._reach(number)
            elif state.is_goal:
                return self._improved(number)
            else:
                self._go_on(number)
        return None

    def _is_over(self) -> bool:
        limit_s = self.options.time_limit_s
        late = limit_s is not None and time.perf_counter() - self.began >= limit_s
        most = min(_MOST_EXPANSIONS, self.options.max_expansions)
        return late or self.expansions >= most or len(self._states) >= _MOST_STATES

    def _at(self, cell: int) -> Int64s:
        return np.array([cell % self.request.lattice.cols, cell // self.request.lattice.cols])

    def _straight_um(self, at: Int64s, to: Int64s) -> int:
        potential = self.request.context.tables.potential
        return int(straight_cost(to[0] - at[0], to[1] - at[1], potential))

    def _add(self, at: Int64s, *, parent: int, cost_um: int, is_goal: bool) -> None:
        ahead_um = 0 if is_goal else self._straight_um(at, self._goal_at)
        state = _State(at=at, parent=parent, cost_um=cost_um, ahead_um=ahead_um, is_goal=is_goal)
        self._states.append(state)
        self._push(len(self._states) - 1)

    def _push(self, number: int) -> None:
        """Into the queue: those that are hard or dear to come to behind the others."""
        state = self._states[number]
        dear_um = _WEIGHT * self._straight_um(self._states[0].at, state.at)
        is_hard = not state.is_reached and state.tries > 0
        is_dear = number > 0 and state.cost_um > self._states[0].cost_um + dear_um
        avoid = is_hard or is_dear
        heapq.heappush(self._heap, (avoid, state.cost_um + _WEIGHT * state.ahead_um, number))

    def _reach(self, number: int) -> None:
        """Searches for the way from the parent; a state that has none is dropped in the end."""
        state, context = self._states[number], self.request.context
        parent = self._states[state.parent]
        roots, root_um = self.nodes, self.costs_um
        if len(parent.nodes):
            roots, root_um = parent.nodes[-1:], np.array([parent.cost_um])
        budget = (_EASY, _HARD)[min(state.tries, 1)]
        target = self._goal if state.is_goal else target_around(context, self._disc(state.at))
        found = search_to(context, target, roots, root_um, epsilon=_WEIGHT, budget=budget)
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

    def _disc(self, at: Int64s) -> Int64s:
        """Cells around a sub-goal at which it counts as reached."""
        reach = np.arange(-_TARGET_CELLS, _TARGET_CELLS + 1)
        col, row = np.meshgrid(reach, reach)
        near = np.hypot(col, row) <= _TARGET_CELLS
        return (at[1] + row[near]) * self.request.lattice.cols + at[0] + col[near]

    def _go_on(self, number: int) -> None:
        """Adds random states around one, and the goal if it is near."""
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
            way = apart * np.array([math.cos(angle), math.sin(angle)])
            at = state.at + np.rint(way).astype(np.int64)
            rim = 2 + _TARGET_CELLS
            if min(at) < rim or at[0] >= lattice.cols - rim or at[1] >= lattice.rows - rim:
                continue
            crowded = np.hypot(*(known - at).T).min() < 0.4 * apart
            if crowded or cell_shut(lattice, int(at[1] * lattice.cols + at[0]), reach_m):
                continue
            cost_um = state.cost_um + self._straight_um(state.at, at)
            self._add(at, parent=number, cost_um=cost_um, is_goal=False)

    def _improved(self, number: int) -> QuickPath:
        """The plan to the goal's state, or a better one in the strip along it."""
        ways, cost_um = [], self._states[number].cost_um + final_cost_um(self.request.model)
        while number > 0:
            ways.append(self._states[number].nodes)
            number = self._states[number].parent
        nodes = np.concatenate(ways[::-1])
        best = self._in_strip(nodes, cost_um)
        self.expansions += best.expansions
        if len(best.nodes):
            nodes, cost_um = best.nodes, best.cost_um + final_cost_um(self.request.model)
        return QuickPath(
            nodes=nodes,
            cost_um=cost_um,
            least_um=min(cost_um, self._least_um()),
            expansions=self.expansions,
        )

    def _in_strip(self, nodes: Int64s, cost_um: int) -> Found:
        context, lattice = self.request.context, self.request.lattice
        mask = np.zeros((lattice.rows, lattice.cols), np.uint8)
        mask.reshape(-1)[body_cells_of(context, nodes)] = 1
        side = 2 * math.ceil(_STRIP_M / lattice.cell_m) + 1
        strip = cv2.dilate(mask, np.ones((side, side), np.uint8)).astype(np.uint8)
        # First steps elsewhere have no path in the strip, and are left alone.
        return search_to(
            context,
            self._goal,
            self.nodes,
            self.costs_um,
            epsilon=max(self.options.epsilon, 1.0),
            budget=min(_STRIP_EXPANSIONS, self.options.max_expansions),
            mask=strip.reshape(-1),
            best_um=cost_um,
        )

    def _least_um(self) -> int:
        """What any plan costs at least, as far as it is known without seeing the map."""
        context = self.request.context
        if not context.region.is_point:
            return least_toward_goal(self.request, self.nodes, self.costs_um)
        return least_straight(self.request, self.nodes, self.costs_um)
