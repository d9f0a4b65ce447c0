"""ARA*, A* and backward ARA*: iterations of falling epsilon over the footstep lattice.

After Likhachev, Gordon and Thrun, "ARA*: Anytime A* with Provable Bounds on Sub-Optimality", 2003.
A search without a plan alternates with a reachability search, which may prove that there is none.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from planner.heuristics.heuristic import tables_of
from planner.lattice.lattice import Int64s, Lattice, node_free
from planner.lattice.steps import MICRO
from planner.options import PlannerOptions
from planner.plan import PlanStatus
from planner.robot_model import StepModel
from planner.search.best_first import (
    BASE_UM,
    BEST_NODE,
    BEST_UM,
    CURSOR,
    EXHAUSTED,
    FINISHED,
    IMPROVED,
    NO_COST,
    OUT_OF_ENTRIES,
    SHIFT,
    USED,
    Tree,
    expand,
    start_iteration,
)
from planner.search.first_part import first_part
from planner.search.first_plan import CUT_OFF, FirstPlan, find_first_plan, is_cut_off
from planner.search.problem import (
    CLOCK_EXPANSIONS,
    Request,
    Result,
    SearchTask,
    backward_task,
    best_nodes,
    failure,
    forward_task,
    no_body_path,
    no_first_step,
    result_of,
    with_longer_queue,
)
from planner.search.reachability import Floods, Verdict
from planner.search.search_record import Moment, search_record
from planner.search.shut_passages import is_shut
from planner.time_limit import OutOfTime, is_late

_FIRST = -1  # in place of a node: the best plan is the one that was found before this search
_QUICK_ENTRIES = 1 << 15  # of an open list that is looked through though it is late
# After FLOOD_AFTER expansions without a plan the search alternates with the floods: SEARCH_TURN
# expansions, then FLOOD_TURN nodes of each flood, which double up to FLOOD_TURN_MOST, because the
# longer there is no plan the likelier there is none.
FLOOD_AFTER, SEARCH_TURN, FLOOD_TURN, FLOOD_TURN_MOST = 1 << 15, 1 << 13, 1 << 12, 1 << 14

# The effort to improve a plan is `PlannerOptions.improve_expansions` up to the first gap between
# its cost and the bound, in proportion to the gap beyond, and no more than so many times that.
_GAP, _MOST_TIMES = 0.1, 10.0

# Lattices of finer cells are first searched on one of coarse cells, with so many expansions.
_FINE_CELL_M, _COARSE_CELL_M = 0.03, 0.05
_COARSE_EXPANSIONS = 1_000_000


class AraStar:
    """One search: its iterations, limits, bound and record."""

    def __init__(self, request: Request, options: PlannerOptions, began: float) -> None:
        self.request = request
        self.options = options
        self.began = began
        self.time_to_first_s = 0.0
        self.lower_bound_um = 0
        self.open_bound_um = 0  # no open state's cost + heuristic is less
        self.proven = math.inf
        self.first_expansions = 0
        self.task: SearchTask
        self.tree: Tree
        self._first: FirstPlan | None = None
        self._spent = 0  # expansions before this search
        self._floods: Floods | None = None
        self._is_shut = False
        self._flood_turn = FLOOD_TURN
        self._moments: list[Moment] = []

    def start_with(self, first: FirstPlan) -> None:
        """Takes over a plan that was found before this search."""
        self._first = first
        self.note_known_plan(first.cost_um, first.lower_bound_um, first.expansions)

    def note_known_plan(self, cost_um: int, lower_bound_um: int, expansions: int) -> None:
        """Notes the cost of a known plan, NO_COST if there is none, and a bound on all plans.

        expansions: so many were spent on both.
        """
        self._spent, self.lower_bound_um = expansions, lower_bound_um
        if cost_um < NO_COST:
            self.time_to_first_s = time.perf_counter() - self.began
            self.proven = proven_ratio(cost_um, lower_bound_um)
            self._record_moment(cost_um)

    def first_result(self) -> Result:
        """The plan that was taken over."""
        assert self._first is not None
        return self._result(self._first.nodes, self._first.cost_um, self._first.expansions)

    def run(self, task: SearchTask, tree: Tree | None = None) -> Result:
        """Runs all iterations, on a new tree unless one is given; the plan or why there is none."""
        self.task, self.tree = task, tree or task.tree()
        scalars = self.tree.scalars
        if self._first is not None and self._first.cost_um < scalars[BEST_UM]:
            scalars[BEST_UM], scalars[BEST_NODE] = self._first.cost_um, _FIRST
        if not task.is_connected:
            return no_body_path()
        epsilon = self.options.epsilon
        while self._improve_path(epsilon):
            epsilon = _next_epsilon(epsilon)
        if self._best_um < NO_COST:
            return self._best_plan()
        return self._recorded(self._no_plan())

    def best(self) -> FirstPlan | None:
        """The best plan after `run`, if there is one."""
        if self._best_um == NO_COST:
            return None
        return FirstPlan(
            nodes=self._best_nodes(),
            cost_um=self._best_um,
            lower_bound_um=self.lower_bound_um,
            expansions=self._expansions,
        )

    def _improve_path(self, epsilon: float) -> bool:
        """One iteration with a weight; whether another one is to follow."""
        self._reorder_open(epsilon)
        self._record_moment(self._best_um)
        if self.proven <= self.options.final_epsilon:
            return False
        task = self.task
        while True:
            self._tighten_on_the_way(epsilon)
            outcome = expand(task.lattice, task.heuristic, self.tree, epsilon, self._budget())
            if outcome == OUT_OF_ENTRIES:
                self.tree = with_longer_queue(self.tree)
            elif outcome == IMPROVED:
                self._record_moment(self._best_um)
                if self.time_to_first_s == 0.0:
                    self.time_to_first_s = time.perf_counter() - self.began
                    self.first_expansions = self._expansions
                if self.options.stop_at_first:
                    return False
            elif outcome in (FINISHED, EXHAUSTED):
                if self._best_um < NO_COST and epsilon == 1.0:
                    self.proven = 1.0
                    self.open_bound_um = max(self.open_bound_um, self._best_um)
                return self._best_um < NO_COST and self.proven > self.options.final_epsilon
            if self._limit_reached() or self._left_to_improve() <= 0 or self._is_enclosed():
                return False

    def _reorder_open(self, epsilon: float) -> None:
        """Orders the open list by a weight; the least g + h of all open states is a bound."""
        task = self.task
        least_um = int(start_iteration(task.lattice, task.heuristic, self.tree, epsilon))
        self.open_bound_um = max(self.open_bound_um, least_um)
        self._raise_bound(least_um)

    def _tighten_bound(self) -> None:
        """Takes the bound of the open states after an iteration that was cut short."""
        if self.proven <= 1.0:
            return
        if self.tree.scalars[USED] <= _QUICK_ENTRIES or not is_late():
            self._reorder_open(1.0)
        elif self.request.context.region.is_point:
            self._raise_bound(self.request.straight_bound())

    def _tighten_on_the_way(self, epsilon: float) -> None:
        """Takes the lower edge of the first bucket as a bound: with epsilon 1 it is one."""
        if epsilon == 1.0 and self._best_um < NO_COST:
            scalars = self.tree.scalars
            least_um = int(scalars[BASE_UM] + (scalars[CURSOR] << scalars[SHIFT]))
            self._raise_bound(least_um)

    def _raise_bound(self, least_um: int) -> None:
        """Takes the least cost of all plans that may still be found as a bound."""
        self.lower_bound_um = max(self.lower_bound_um, min(least_um, self._best_um))
        if self._best_um < NO_COST:
            self.proven = min(self.proven, proven_ratio(self._best_um, self.lower_bound_um))

    def _is_enclosed(self) -> bool:
        """Whether floods, if it is their turn, prove that no steps lead to the goal."""
        if self._may_be_enclosed() and self._expansions >= FLOOD_AFTER:
            task = self.task
            if self._floods is None:
                with contextlib.suppress(OutOfTime):
                    self._is_shut = is_shut(self.request)
                if self._is_shut:
                    return True
                ends = (task.goals, task.roots) if task.is_backward else (task.roots, task.goals)
                self._floods = Floods(task.lattice, *ends)
            with contextlib.suppress(OutOfTime):
                self._floods.expand(self._flood_turn)
            self._flood_turn = min(2 * self._flood_turn, FLOOD_TURN_MOST)
        return self._floods is not None and bool(self._floods.reason)

    def _may_be_enclosed(self) -> bool:
        is_open = self._floods is None or self._floods.verdict is Verdict.OPEN
        return is_open and self._best_um == NO_COST

    def _budget(self) -> int:
        """Expansions until one of the limits is to be checked again."""
        budget = self.options.max_expansions - self._expansions
        if self.options.time_limit_s:
            budget = min(budget, CLOCK_EXPANSIONS)
        if self._may_be_enclosed():
            budget = min(budget, max(SEARCH_TURN, FLOOD_AFTER - self._expansions))
        return max(0, min(budget, self._left_to_improve()))

    def _left_to_improve(self) -> int:
        """Expansions left for a better plan than the first, by the gap that is left."""
        most = self.options.improve_expansions
        if most is None or self._best_um == NO_COST:
            return self.options.max_expansions
        gap = proven_ratio(self._best_um, self.lower_bound_um) - 1.0
        times = min(max(gap / _GAP, 1.0), _MOST_TIMES)
        return self.first_expansions + int(times * most) - self._expansions

    def _limit_reached(self) -> str:
        """The limit that ended the search, in words; empty if none did."""
        if self._expansions >= self.options.max_expansions:
            return f"{self.options.max_expansions} expansions"
        return f"{self.options.time_limit_s:g} s" if is_late() else ""

    @property
    def _best_um(self) -> int:
        return self.tree.best_um

    @property
    def _expansions(self) -> int:
        return self._spent + self.tree.expansions

    def _best_nodes(self) -> Int64s:
        if self._first is not None and self.tree.scalars[BEST_NODE] == _FIRST:
            return self._first.nodes
        return best_nodes(self.tree)

    def _best_plan(self) -> Result:
        self._tighten_bound()
        self.lower_bound_um = int(self._best_um / self.proven)
        self._record_moment(self._best_um)
        plan = self._result(self._best_nodes(), self._best_um, self._expansions)
        return self._recorded(plan)

    def _no_plan(self) -> Result:
        expansions = self._expansions
        if self._is_shut:
            return replace(no_body_path(), expansions=expansions)
        if self._floods is not None and self._floods.reason:
            return failure(PlanStatus.NO_PATH, self._floods.reason, expansions)
        if self._limit_reached():
            self._tighten_bound()
            reason = (
                f"no plan found within {self._limit_reached()}; "
                f"any plan costs at least {self.lower_bound_um / MICRO:.2f} m"
            )
            without = failure(PlanStatus.TIMED_OUT, reason, expansions)
            if self.options.partial and not self.task.is_backward:
                return first_part(self.request, self.task, self.tree, without)
            return without
        reason = (
            "the goal cannot be reached: all poses that steps lead to were searched "
            f"({expansions} expansions)"
        )
        return failure(PlanStatus.NO_PATH, reason, expansions)

    def _result(self, nodes: Int64s, cost_um: int, expansions: int) -> Result:
        return result_of(
            self.request,
            nodes,
            cost_um=cost_um,
            epsilon=self.proven,
            expansions=expansions,
            time_to_first_s=self.time_to_first_s,
        )

    def _record_moment(self, best_um: int) -> None:
        if self.options.record:
            cost_m = best_um / MICRO if best_um < NO_COST else math.inf
            elapsed_s = time.perf_counter() - self.began
            self._moments.append((elapsed_s, cost_m, self.lower_bound_um / MICRO))

    def _recorded(self, result: Result) -> Result:
        if not self.options.record:
            return result
        record = search_record(self._moments, self.task.lattice, self.tree)
        return replace(result, record=record)


def proven_ratio(cost_um: int, lower_bound_um: int) -> float:
    """The proven bound on cost / optimum."""
    return cost_um / min(cost_um, max(lower_bound_um, 1))


def _next_epsilon(epsilon: float) -> float:
    """The next weight: two fifths of what is above 1, and 1 itself once that is little."""
    return 1.0 + 0.4 * (epsilon - 1.0) if epsilon > 1.3 else 1.0


def plan_ara(request: Request, options: PlannerOptions, began: float) -> Result:
    """Searches from the start until epsilon is proven or a limit of the options is reached.

    began: time.perf_counter() of the request's arrival, from which times count.
    """
    if not request.has_first_step:
        return no_first_step(request)
    search = AraStar(request, options, began)
    first = _plan_on_coarse_lattice(request, options, began)
    if first is not None:
        search.options = replace(options, epsilon=1.0)  # only the proof is missing
    else:
        first = find_first_plan(request, options)
    return improved(search, first)


def improved(search: AraStar, first: FirstPlan | None) -> Result:
    """A first plan, if it is good enough, or what the search makes of it."""
    if first is CUT_OFF:
        return no_body_path()
    if first is None:
        return search.run(forward_task(search.request))
    search.start_with(first)
    if search.options.stop_at_first or search.proven <= search.options.final_epsilon:
        return search.first_result()
    try:
        task = forward_task(search.request)
    except OutOfTime:
        return search.first_result()
    return search.run(task)


def plan_astar(request: Request, options: PlannerOptions, began: float) -> Result:
    """One search with epsilon 1, until the least cost is proven."""
    options = replace(options, epsilon=1.0, final_epsilon=1.0, improve_expansions=None)
    return _plan_without_first(request, options, began, forward_task)


def plan_backward(request: Request, options: PlannerOptions, began: float) -> Result:
    """As `plan_ara`, from the goal feet to the first steps."""
    return _plan_without_first(request, options, began, backward_task)


def _plan_without_first(
    request: Request,
    options: PlannerOptions,
    began: float,
    task_of: Callable[[Request], SearchTask],
) -> Result:
    if not request.has_first_step:
        return no_first_step(request)
    if is_cut_off(request):
        return no_body_path()
    return AraStar(request, options, began).run(task_of(request))


def coarse_model(model: StepModel) -> StepModel | None:
    """The robot on a lattice of coarse cells; None if its cells are not fine, or have none such.

    Both lattices are laid out from the goal with the same headings, and a coarse cell is a whole
    number of fine ones, so a node of the coarse one is a node of the fine one. Steps are rounded to
    the coarse cells within the limits and have their own cost.
    """
    if model.cell_m > _FINE_CELL_M:
        return None
    coarse = replace(model, cell_m=round(_COARSE_CELL_M / model.cell_m) * model.cell_m)
    try:
        tables_of(coarse)
    except ValueError:  # no step of some heading and side is within the limits there
        return None
    return coarse


def nodes_on_fine(coarse: Lattice, fine: Lattice, nodes: Int64s) -> Int64s:
    """Nodes (n,) of the fine lattice for nodes (n,) of the coarse one."""
    times = round(coarse.cell_m / fine.cell_m)
    rows = 2 * fine.headings
    cell, row = nodes // rows, nodes % rows
    col = (cell % coarse.cols - coarse.origin_col) * times + fine.origin_col
    up = (cell // coarse.cols - coarse.origin_row) * times + fine.origin_row
    found = np.asarray((up * fine.cols + col) * rows + row, np.int64)
    for node in found:
        node_free(fine, int(node))  # notes its height
    return found


def _plan_on_coarse_lattice(
    request: Request, options: PlannerOptions, began: float
) -> FirstPlan | None:
    """A plan improved on the coarse lattice; None without one, or without such a lattice."""
    if request.context.coarse is None:
        return None
    coarse = replace(request, context=request.context.coarse)
    if not coarse.has_first_step:
        return None
    first = find_first_plan(coarse, options)
    if first is CUT_OFF or (first is None and options.stop_at_first):
        return None
    if not options.stop_at_first:
        limited = replace(options, max_expansions=_COARSE_EXPANSIONS, record=False)
        search = AraStar(coarse, limited, began)
        if first is not None:
            search.start_with(first)
        with contextlib.suppress(OutOfTime):
            search.run(forward_task(coarse))
            first = search.best()
    if first is None:
        return None
    return replace(
        first,
        nodes=nodes_on_fine(coarse.lattice, request.lattice, first.nodes),
        lower_bound_um=min(first.cost_um, request.quick_bound()),
    )
