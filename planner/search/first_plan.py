"""A first plan soon: an inflated search in a strip around the path of the body.

docs/notes/planner_design.md tells the steps. Where they find nothing the full search follows, so no
plan is missed.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planner.heuristics.distance_field import (
    MARGIN_MOVES,
    Strip,
    leads_to_goal,
    path_toward,
    raise_by_arrival,
)
from planner.heuristics.heuristic import full_heuristic
from planner.lattice.lattice import Int64s
from planner.lattice.steps import final_cost_um
from planner.options import PlannerOptions
from planner.search.best_first import (
    NO_COST,
    start_iteration,
)
from planner.search.problem import Request, SearchTask, best_nodes, expand_up_to
from planner.search.shut_passages import shut_passages
from planner.search.state_bins import NO_BINS, new_bins
from planner.time_limit import OutOfTime

# Weights on the heuristic, most expansions with each, and whether states are binned.
_TRIES = (2.0, 1500, True), (3.0, 1500, True), (3.0, 12000, False)
# A plan of more than so many times the bound is compared with one along the path of the bound.
_FAR_ABOVE = 1.5
_SECOND = ((2.0, 250, True),)


@dataclass(frozen=True, kw_only=True)
class FirstPlan:
    """Nodes of a plan but for its last, its cost, a lower bound on any plan, and expansions."""

    nodes: Int64s
    cost_um: int
    lower_bound_um: int
    expansions: int


CUT_OFF = FirstPlan(nodes=np.zeros(0, np.int64), cost_um=0, lower_bound_um=0, expansions=0)


def find_first_plan(request: Request, options: PlannerOptions) -> FirstPlan | None:
    """A plan from the first steps to the goal's own pose, or None.

    Its bound holds for plans to all of the goal region. CUT_OFF where the goal's own pose is the
    only end and no path of the body leads there, or no steps through its narrow passages. If more
    than the first plan is wanted and the goal is a region there is none: it would cost effort to
    improve a plan to the middle of the region, the dearest end.
    """
    context = request.context
    if context.region.is_point:
        return _plan_to_point(request, options)
    if not options.stop_at_first or not np.all(np.isin(context.lattice.goal_nodes, context.ends)):
        return None
    first = _plan_to_point(request, options)
    if first is None or first is CUT_OFF:
        return None
    return replace(first, lower_bound_um=min(request.heuristic_bound(), first.cost_um))


def is_cut_off(request: Request) -> bool:
    """Whether no path of the body leads from the first steps to the goal's own pose.

    False for every goal that is a region.
    """
    if not request.context.region.is_point:
        return False
    cells = np.unique(request.context.body_cells(request.first_steps[0]))
    path = path_toward(request.lattice, request.context.tables.potential, cells, margin_moves=0)
    return not path.reaches_any(cells)


def _plan_to_point(request: Request, options: PlannerOptions) -> FirstPlan | None:
    lattice, context = request.lattice, request.context
    potential, (nodes, costs_um) = context.tables.potential, request.first_steps
    bodies = context.body_cells(nodes)
    cells = np.unique(bodies)
    # With room to walk ahead steps can follow it nearly always.
    roomy = replace(potential, reach_m=max(lattice.body[1] + lattice.body[2], potential.reach_m))
    wide = path_toward(lattice, roomy, cells)
    is_wide = wide.reaches_any(cells)
    if not is_wide and wide.is_large and not leads_to_goal(lattice, potential, cells):
        return CUT_OFF
    values_um = costs_um + context.potentials_um(nodes)
    bound_um = request.straight_bound()
    # No path is shorter than the straight line, so a wide one as short gives the same bound.
    if not is_wide or bound_um < (values_um + wide.least_um(bodies)).min():
        # Beside a wide path this one gives only the bound, which takes no margin.
        path = path_toward(lattice, potential, cells, margin_moves=0 if is_wide else MARGIN_MOVES)
        if not path.reaches_any(cells):
            return CUT_OFF
        bound_um = int((values_um + path.least_um(bodies)).min())
    first = replace(CUT_OFF, lower_bound_um=bound_um)
    if is_wide:
        first = _plan_along(request, wide, options, _TRIES[:2], first)
        if len(first.nodes) and first.cost_um <= _FAR_ABOVE * bound_um:
            return first
        if len(first.nodes):
            # A way that is a little too narrow to walk ahead may be far shorter.
            with contextlib.suppress(OutOfTime):
                path = path_toward(lattice, potential, cells)
                first = _plan_along(request, path, options, _SECOND, first)
            return first
        path = path_toward(lattice, potential, cells)
    first = _plan_along(request, path, options, _TRIES, first)
    return first if len(first.nodes) else _plan_around(request, options, first)


def _plan_around(request: Request, options: PlannerOptions, so_far: FirstPlan) -> FirstPlan | None:
    """A plan around narrow places that no steps lead through; CUT_OFF if there is no way."""
    shut, context = shut_passages(request), request.context
    if shut.is_proven:
        return CUT_OFF
    if not len(shut.cells):
        return None
    cells = np.unique(context.body_cells(request.first_steps[0]))
    path = path_toward(request.lattice, context.tables.potential, cells, shut=shut.cells)
    if not path.reaches_any(cells):
        return None
    first = _plan_along(request, path, options, _TRIES, so_far)
    return first if len(first.nodes) else None


def _plan_along(
    request: Request,
    strip: Strip,
    options: PlannerOptions,
    tries: Sequence[tuple[float, int, bool]],
    so_far: FirstPlan,
) -> FirstPlan:
    """The cheaper of a plan along a strip and the one so far, with the expansions for both.

    Without nodes if there is neither. Changes the strip's costs.
    """
    task, expansions = _task_in(request, strip), so_far.expansions
    for epsilon, budget, is_binned in tries:
        bins = new_bins(task.lattice, budget) if is_binned else NO_BINS
        tree = task.tree()._replace(bins=bins)
        weight = max(options.epsilon, epsilon)
        start_iteration(task.lattice, task.heuristic, tree, weight)
        expand_up_to(task, tree, weight, min(budget, options.max_expansions - expansions))
        expansions += tree.expansions
        if tree.best_um < NO_COST:
            found = replace(so_far, nodes=best_nodes(tree), cost_um=tree.best_um)
            if len(so_far.nodes) and so_far.cost_um <= found.cost_um:
                found = so_far
            return replace(found, expansions=expansions)
    return replace(so_far, expansions=expansions)


def _task_in(request: Request, strip: Strip) -> SearchTask:
    """The search in a strip, whose path costs get the cost of arriving at the goal added.

    The exact table near the goal counts every turn, the path costs outside count none. An inflated
    search would expand everything outside before crossing the border between the two.
    """
    lattice, tables = request.lattice, request.context.tables
    nodes, costs_um = request.first_steps
    start = int(request.context.body_cells(nodes)[np.argmin(costs_um)])
    goal = strip.ahead._replace(col=lattice.origin_col, row=lattice.origin_row, slack_um=0)
    table = tables.goal_table.inside, tables.turns.arrive_um, tables.turns.exact_um
    arrive_um = raise_by_arrival(lattice, strip.cost_um, start, goal, *table)
    return SearchTask(
        lattice=lattice,
        heuristic=full_heuristic(lattice, tables, strip.cost_um)._replace(
            frontier_um=strip.settled_um + arrive_um,  # off the strip it is as far as the start
            turn_um=tables.turns.depart_um,
            rim=tables.exits.ring,
        ),
        is_backward=False,
        roots=nodes,
        root_um=costs_um,
        goals=lattice.goal_nodes,
        goal_um=np.full(2, final_cost_um(request.model)),
    )
