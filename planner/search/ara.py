"""The planners that search the lattice anew: ARA* and A* from the start, ARA* from the goal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from planner.lattice.lattice import Int64s
from planner.options import PlannerOptions
from planner.search.ara_star import Run
from planner.search.coarse_to_fine import least_straight, on_coarse, on_fine
from planner.search.first_plan import NO_WAY, QuickPath, is_cut_off, quick_path
from planner.search.problem import Request, Result, first_nodes, no_first_step, no_way
from planner.search.search_task import Task, backward_task, forward_task, least_toward_goal

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
    if request.toward.region.is_point:
        least_um = least_straight(request, nodes, costs_um)
    else:
        least_um = least_toward_goal(request, nodes, costs_um)
    return replace(
        quick,
        nodes=on_fine(coarse.space, request.space, quick.nodes),
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
    toward = request.toward
    if toward.region.is_point:
        return quick_path(request, nodes, costs_um, options)
    if not options.stop_at_first:
        return None
    if not np.all(np.isin(toward.goal_nodes, toward.ends)):
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
