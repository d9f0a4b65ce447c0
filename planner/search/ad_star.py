"""Anytime search that is asked again while the robot walks: what earlier searches found is kept.

The first plan to a goal is improved as far as the options say. After that a plan is good enough as
soon as it is proven to cost at most `epsilon` times the least: mostly that is so before any search,
by the tree that is kept (`kept.py`) or by the heuristic toward the goal. Else the search goes on
where the last one stopped.
"""

from __future__ import annotations

import time
from dataclasses import replace

from planner.options import PlannerOptions
from planner.search import best_first as search
from planner.search.ara import quick_plan
from planner.search.ara_star import Run
from planner.search.best_first import NO_COST
from planner.search.first_plan import NO_WAY
from planner.search.kept import KeptTree
from planner.search.problem import Request, Result, first_nodes, found, no_first_step, no_way

_NAME = "adstar"


def plan_adstar(request: Request, options: PlannerOptions, began: float) -> Result:
    """Plans from the tree that is kept in the request's memory, searching only where it must."""
    nodes, costs_um = first_nodes(request)
    if not len(nodes):
        return no_first_step(request)
    memory, expansions, least_um = request.toward.memory, 0, 0
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
            kept.graft(request.space, quick.nodes)
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
