"""One ARA* run: rounds of falling epsilon, limits, floods, and the plan or why there is none."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from planner.heuristics.rounded_plans import rounded_costs, rounded_steps
from planner.heuristics.wavefront import NOWHERE_UM
from planner.lattice.lattice import Int64s
from planner.lattice.steps import MICRO
from planner.options import FULL, PlannerOptions
from planner.plan import PlanStatus
from planner.search import best_first as search
from planner.search.best_first import Tree, expanded_in_cells, trace
from planner.search.coarse_to_fine import least_straight, on_coarse, on_fine
from planner.search.first_plan import NO_WAY, QuickPath, is_cut_off, quick_path
from planner.search.problem import (
    Request,
    Result,
    SearchRecord,
    failure,
    first_nodes,
    found,
    no_first_step,
    no_way,
)
from planner.search.reachability import Flood, Verdict, new_flood, spread
from planner.search.search_task import (
    Task,
    backward_task,
    forward_task,
    heuristic_toward_start,
    least_toward_goal,
)

# A search goes on with the bound of `rounded.py`, once it is worth what that takes to make.

_SPACING_M = 0.03  # at least


def sharpened(
    request: Request, task: Task, limit_um: int, go_on: Callable[[], bool]
) -> Task | None:
    """A search from the start with a sharper bound, good for plans that cost less than limit_um.

    None where the grid would be too large, or as soon as go_on says so.
    """
    lattice, tables = task.lattice, request.context.tables
    # Most steps are whole cells, and what is a whole number of the grid's as well is not rounded.
    spacing_m = math.ceil(_SPACING_M / lattice.cell_m - 1e-9) * lattice.cell_m
    behind = heuristic_toward_start(request, task.roots, task.root_um)
    start_um = np.where(
        behind.cost_um > 0, behind.cost_um - 1 + int(behind.potential_um.min()), NOWHERE_UM
    )
    steps = rounded_steps(request.model, tables.steps, tables.potential, spacing_m)
    rounded = rounded_costs(
        lattice, request.model, steps, spacing_m, request.context.ends, start_um, limit_um, go_on
    )
    if rounded is None:
        return None
    # The bound by the rim of a circle adds nothing to this one: all is within the circle.
    everywhere = lattice.cols + lattice.rows
    heuristic = task.heuristic._replace(rounded=rounded, radius_cells=everywhere)
    return replace(task, heuristic=heuristic)


_QUICK = -1  # in place of a node: the plan that was found before the search proper
# Expansions after which a search for a proof is given a sharper bound, which takes long to make.
_BLUNT = 2_000_000
_BUDGET = 4096  # expansions between two looks at the clock
# A search that has no plan after so many expansions takes turns with the floods from start and
# goal, which may find that there is none: so many expansions against so many nodes of each flood,
# which double from turn to turn, because the longer there is no plan the likelier there is none.
_PATIENCE, _TURN, _FLOOD_TURN, _FLOOD_TURN_MOST = 1 << 15, 1 << 13, 1 << 12, 1 << 14


_ENCLOSED = {
    Verdict.GOAL_ENCLOSED: "obstacles leave no steps from outside to the goal",
    Verdict.START_ENCLOSED: "obstacles leave no steps out from the start",
}


class Run:
    """The rounds of one search and the limits on them."""

    def __init__(self, request: Request, options: PlannerOptions, began: float) -> None:
        self.request = request
        self.options = options
        self.began = began
        self.time_to_first_s = 0.0
        self.least_um = 0
        self.open_um = 0  # no open state's cost and heuristic is less
        self.proven = math.inf
        self.first_expansions = 0
        self.verdict = Verdict.OPEN
        self.task: Task
        self.tree: Tree
        self._quick: QuickPath | None = None
        self._is_sharp = False
        self._spent = 0  # expansions before the search proper
        self._flood: Flood | None = None
        self._flood_turn = _FLOOD_TURN
        self._moments: list[tuple[float, float, float]] = []

    def take(self, quick: QuickPath) -> None:
        """Takes over a plan that was found before the search proper."""
        self._quick = quick
        self.begin_with(quick.cost_um, quick.least_um, quick.expansions)

    def begin_with(self, cost_um: int, least_um: int, expansions: int) -> None:
        """Takes into account that there is a plan of this cost; NO_COST if there is none.

        least_um: what any plan costs at least. expansions: how many it took to know that.
        """
        self._spent, self.least_um = expansions, least_um
        if cost_um < search.NO_COST:
            self.time_to_first_s = time.perf_counter() - self.began
            self.proven = cost_um / min(cost_um, max(least_um, 1))
            self._note_moment(cost_um)

    def quick_result(self) -> Result:
        """The plan that was taken over."""
        assert self._quick is not None
        return self._found(self._quick.nodes, self._quick.cost_um, self._quick.expansions)

    def result(self, task: Task, tree: Tree | None = None) -> Result:
        """Runs all rounds, from a fresh tree unless one is given, and reads the plan from it."""
        self.task, self.tree = task, tree or task.tree()
        scalars = self.tree.scalars
        if self._quick is not None and self._quick.cost_um < scalars[search.BEST_UM]:
            scalars[search.BEST_UM], scalars[search.BEST_NODE] = self._quick.cost_um, _QUICK
        if not task.may_connect:
            return no_way()
        epsilon = self.options.epsilon
        while self._round(epsilon):
            epsilon = _next_epsilon(epsilon)
        if self._best_um < search.NO_COST:
            return self._best_plan()
        return replace(self._no_plan(), record=self._record())

    def _no_plan(self) -> Result:
        expansions = self._expansions
        if self.verdict in _ENCLOSED:
            assert self._flood is not None
            poses = int(self._flood.ends[1] + self._flood.ends[3])
            reason = f"the goal cannot be reached: {_ENCLOSED[self.verdict]} ({poses} poses tried)"
            return failure(PlanStatus.NO_PATH, reason, expansions)
        if self._limit_reached():
            self._tighten_bound()
            reason = (
                f"no plan found within {self._limit_reached()}; "
                f"any plan costs at least {self.least_um / MICRO:.2f} m"
            )
            return failure(PlanStatus.TIMED_OUT, reason, expansions)
        reason = (
            "the goal cannot be reached: all poses that steps lead to were searched "
            f"({expansions} expansions)"
        )
        return failure(PlanStatus.NO_PATH, reason, expansions)

    def _best_plan(self) -> Result:
        self._tighten_bound()
        self.least_um = int(self._best_um / self.proven)
        self._note_moment(self._best_um)
        plan = self._found(self._best_nodes(), self._best_um, self._expansions)
        return replace(plan, record=self._record())

    def _best_nodes(self) -> Int64s:
        last = int(self.tree.scalars[search.BEST_NODE])
        if last == _QUICK:
            assert self._quick is not None
            return self._quick.nodes
        return self.task.in_order(trace(self.tree, last))

    def best(self) -> QuickPath | None:
        """The best plan after `result`, if there is one."""
        if self._best_um == search.NO_COST:
            return None
        return QuickPath(
            nodes=self._best_nodes(),
            cost_um=self._best_um,
            least_um=self.least_um,
            expansions=self._expansions,
        )

    def _note_moment(self, best_um: int) -> None:
        if self.options.record:
            cost_m = best_um / MICRO if best_um < search.NO_COST else math.inf
            elapsed_s = time.perf_counter() - self.began
            self._moments.append((elapsed_s, cost_m, self.least_um / MICRO))

    def _record(self) -> SearchRecord | None:
        """How the search went, if that is asked."""
        if not self.options.record:
            return None
        lattice = self.task.lattice
        done = expanded_in_cells(lattice, self.tree)
        cell = np.flatnonzero(done)
        x_m = (cell % lattice.cols - lattice.origin_col) * lattice.cell_m
        y_m = (cell // lattice.cols - lattice.origin_row) * lattice.cell_m
        moments = np.array(self._moments).reshape(-1, 3)
        return SearchRecord(
            time_s=moments[:, 0],
            cost_m=moments[:, 1],
            least_m=moments[:, 2],
            expanded=np.column_stack([x_m, y_m, done[cell]]),
        )

    def _found(self, nodes: Int64s, cost_um: int, expansions: int) -> Result:
        return found(
            self.request,
            nodes,
            cost_um=cost_um,
            epsilon=self.proven,
            expansions=expansions,
            time_to_first_s=self.time_to_first_s,
        )

    @property
    def _best_um(self) -> int:
        return int(self.tree.scalars[search.BEST_UM])

    @property
    def _expansions(self) -> int:
        return self._spent + int(self.tree.scalars[search.EXPANSIONS])

    def _round(self, epsilon: float) -> bool:
        """One search with a weight; whether another one may follow."""
        lattice, heuristic = self.task.lattice, self.task.heuristic
        self._begin_round(epsilon)
        self._note_moment(self._best_um)
        if self.proven <= self.options.final_epsilon:
            return False
        while True:
            if self._may_sharpen(epsilon) and self._sharpen():
                return True
            outcome = search.expand(lattice, heuristic, self.tree, epsilon, self._budget())
            if outcome == search.OUT_OF_ENTRIES:
                self.tree = search.with_more_entries(self.tree)
            elif outcome == search.IMPROVED:
                self._note_moment(self._best_um)
                if self.time_to_first_s == 0.0:
                    self.time_to_first_s = time.perf_counter() - self.began
                    self.first_expansions = self._expansions
                if self.options.stop_at_first:
                    return False
            elif outcome in (search.FINISHED, search.EXHAUSTED):
                if self._best_um < search.NO_COST and epsilon == 1.0:
                    self.proven = 1.0
                    self.open_um = max(self.open_um, self._best_um)
                return self._best_um < search.NO_COST and self.proven > self.options.final_epsilon
            if self._limit_reached() or self._improved_enough() or self._is_enclosed():
                return False

    def _may_sharpen(self, epsilon: float) -> bool:
        blunt = 0 if self.request.context.coarse is not None else _BLUNT
        return (
            epsilon == 1.0
            and self.options.heuristic == FULL
            and not (self._is_sharp or self.task.is_backward)
            and self._best_um < search.NO_COST
            and self._expansions >= blunt
        )

    def _sharpen(self) -> bool:
        """Looks for a sharper bound, once; whether there is one."""
        self._is_sharp = True
        task = sharpened(self.request, self.task, self._best_um, lambda: not self._limit_reached())
        if task is None:
            return False
        self.task = task
        return True

    def _is_enclosed(self) -> bool:
        """Whether the floods, if it is their turn, find that no steps lead to the goal."""
        if self._may_be_enclosed() and self._expansions >= _PATIENCE:
            if self._flood is None:
                self._flood = self._new_flood()
            self._flood, self.verdict = spread(self.task.lattice, self._flood, self._flood_turn)
            self._flood_turn = min(2 * self._flood_turn, _FLOOD_TURN_MOST)
        return self.verdict in _ENCLOSED

    def _new_flood(self) -> Flood:
        task = self.task
        ends = (task.goals, task.roots) if task.is_backward else (task.roots, task.goals)
        return new_flood(task.lattice, *ends)

    def _may_be_enclosed(self) -> bool:
        return self.verdict is Verdict.OPEN and self._best_um == search.NO_COST

    def _tighten_bound(self) -> None:
        """Takes over what the open states prove now that the search stopped in mid-round."""
        if self.proven > 1.0:
            self._begin_round(1.0)

    def _begin_round(self, epsilon: float) -> None:
        """Orders the open states anew, and takes over what the least g + h of all proves."""
        lattice, heuristic = self.task.lattice, self.task.heuristic
        self.least_um = int(search.begin_round(lattice, heuristic, self.tree, epsilon))
        self.open_um = max(self.open_um, self.least_um)
        best = self._best_um
        if best < search.NO_COST:
            self.proven = min(self.proven, best / min(best, max(self.least_um, 1)))

    def _budget(self) -> int:
        """Expansions until one of the limits is to be looked at again."""
        budget = self.options.max_expansions - self._expansions
        if self.options.time_limit_s:
            budget = min(budget, _BUDGET)
        if self._may_be_enclosed():
            budget = min(budget, max(_TURN, _PATIENCE - self._expansions))
        if not self._is_sharp and self._expansions < _BLUNT:
            budget = min(budget, _BLUNT - self._expansions)
        left = self._left_to_improve()
        return max(0, budget if left is None else min(budget, left))

    def _left_to_improve(self) -> int | None:
        """Expansions left to spend on a better plan than the first; None without a limit."""
        if self.options.improve_expansions is None or self._best_um == search.NO_COST:
            return None
        return self.first_expansions + self.options.improve_expansions - self._expansions

    def _improved_enough(self) -> bool:
        left = self._left_to_improve()
        return left is not None and left <= 0

    def _limit_reached(self) -> str:
        """The limit that ended the search, in words; empty if none did."""
        if self._expansions >= self.options.max_expansions:
            return f"{self.options.max_expansions} expansions"
        limit_s = self.options.time_limit_s
        if limit_s is not None and time.perf_counter() - self.began >= limit_s:
            return f"{limit_s:g} s"
        return ""


def _next_epsilon(epsilon: float) -> float:
    """The next weight: two fifths of what is above 1, and 1 itself once that is little."""
    return 1.0 + 0.4 * (epsilon - 1.0) if epsilon > 1.3 else 1.0


# The planners that search the lattice anew: ARA* and A* from the start, ARA* from the goal.

_COARSE = 1_000_000  # expansions on a coarse lattice, whose plan helps the search of the fine one


def plan_ara(request: Request, options: PlannerOptions, began: float) -> Result:
    """Searches from the start until epsilon is proven or a limit of the options is reached.

    began: time.perf_counter() of the request's arrival, from which times count.
    """
    nodes, costs_um = first_nodes(request)
    if not len(nodes):
        return no_first_step(request)
    run = Run(request, options, began)
    quick = plan_on_coarse(request, nodes, costs_um, options, began)
    if quick is not None:
        run.options = replace(options, epsilon=1.0)  # only the proof is missing
    else:
        quick = quick_plan(request, nodes, costs_um, options)
    if quick is NO_WAY:
        return no_way()
    if quick is not None:
        run.take(quick)
        if options.stop_at_first or run.proven <= options.final_epsilon:
            return run.quick_result()
    return run.result(forward_task(request, nodes, costs_um))


def plan_on_coarse(
    request: Request, nodes: Int64s, costs_um: Int64s, options: PlannerOptions, began: float
) -> QuickPath | None:
    """A plan of the coarse lattice, improved there; None where there is none, or no such lattice.

    nodes (n,), costs_um (n,): first steps on the fine lattice.
    """
    coarse = on_coarse(request)
    if coarse is None:
        return None
    starts, starts_um = first_nodes(coarse)
    if not len(starts):
        return None
    quick = quick_plan(coarse, starts, starts_um, options)
    if quick is NO_WAY or (quick is None and options.stop_at_first):
        return None
    if not options.stop_at_first:
        run = Run(coarse, replace(options, max_expansions=_COARSE, record=False), began)
        if quick is not None:
            run.take(quick)
        run.result(forward_task(coarse, starts, starts_um))
        quick = run.best()
    if quick is None:
        return None
    if request.context.region.is_point:
        least_um = least_straight(request, nodes, costs_um)
    else:
        least_um = least_toward_goal(request, nodes, costs_um)
    return replace(
        quick,
        nodes=on_fine(coarse.lattice, request.lattice, quick.nodes),
        least_um=min(quick.cost_um, least_um),
    )


def quick_plan(
    request: Request, nodes: Int64s, costs_um: Int64s, options: PlannerOptions
) -> QuickPath | None:
    """A plan to the goal's own pose, if it is free, with a bound that holds for all that may be.

    NO_WAY where it is the only end and is cut off.

    Where more than the first plan is wanted and the goal is a region there is none: effort would go
    into improving a plan to its middle, the dearest end to come to.
    """
    context = request.context
    if context.region.is_point:
        return quick_path(request, nodes, costs_um, options)
    if not options.stop_at_first:
        return None
    if not np.all(np.isin(context.goal_nodes, context.ends)):
        return None
    quick = quick_path(request, nodes, costs_um, options)
    if quick is None or quick is NO_WAY:
        return None
    least_um = least_toward_goal(request, nodes, costs_um)
    return replace(quick, least_um=min(least_um, quick.cost_um))


def plan_astar(request: Request, options: PlannerOptions, began: float) -> Result:
    """One search with the heuristic as it is, until the least cost is proven."""
    options = replace(options, epsilon=1.0, final_epsilon=1.0, improve_expansions=None)
    return _plan(request, options, began, forward_task)


def plan_backward(request: Request, options: PlannerOptions, began: float) -> Result:
    """As `plan_ara`, from the goal feet to the first steps."""
    return _plan(request, options, began, backward_task)


def _plan(
    request: Request,
    options: PlannerOptions,
    began: float,
    task_of: Callable[[Request, Int64s, Int64s], Task],
) -> Result:
    """A search of the lattice alone, unless a look at the body's path says that there is no way."""
    nodes, costs_um = first_nodes(request)
    if not len(nodes):
        return no_first_step(request)
    if is_cut_off(request, nodes):
        return no_way()
    return Run(request, options, began).result(task_of(request, nodes, costs_um))
