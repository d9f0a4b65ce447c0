"""The first part of a plan, for a robot that must move though there was no time for all of it."""

from __future__ import annotations

import contextlib
import math
from dataclasses import replace

import numpy as np

from planner.compiled import BITS, njit_no_refcount, slots_of
from planner.heuristics.heuristic import Heuristic, estimate, simpler_heuristic
from planner.lattice.goal_region import may_end_at
from planner.lattice.lattice import Lattice
from planner.lattice.steps import final_cost_um
from planner.plan import PlanStatus
from planner.search.best_first import NO_COST, Tree, start_iteration
from planner.search.problem import (
    Request,
    Result,
    SearchTask,
    best_nodes,
    expand_up_to,
    result_of,
    trace,
)
from planner.time_limit import OutOfTime

_WEIGHT, _EXPANSIONS, _CHUNK = 3.0, 2_000, 250


def first_part(request: Request, task: SearchTask, tree: Tree, without: Result) -> Result:
    """A result without a plan, but with the steps of a forward search that lead nearest to the end.

    By the heuristic, and to where both feet may stand side by side. No steps lead nearer: the same.
    """
    start_um = request.heuristic_bound(task.heuristic)
    node = int(_nearest(task.lattice, task.heuristic, tree, start_um))
    return without if node < 0 else _with_steps(request, tree, node, without)


def soon_found(request: Request, without: Result) -> Result:
    """As `first_part`, by a short search of its own along the straight line to the end.

    A plan if that finds one.
    """
    context, lattice = request.context, request.lattice
    ends, (nodes, costs_um) = context.ends, request.first_steps
    if not len(ends) or not len(nodes):
        return without
    task = SearchTask(
        lattice=lattice,
        heuristic=simpler_heuristic("euclidean", lattice, request.model, context.tables, ends),
        is_backward=False,
        roots=nodes,
        root_um=costs_um,
        goals=ends,
        goal_um=np.full(len(ends), final_cost_um(request.model)),
    )
    tree = task.tree()
    start_iteration(lattice, task.heuristic, tree, _WEIGHT)
    with contextlib.suppress(OutOfTime):
        expand_up_to(task, tree, _WEIGHT, _EXPANSIONS, _CHUNK)
    if tree.best_um == NO_COST:
        return first_part(request, task, tree, without)
    return result_of(
        request,
        best_nodes(tree),
        cost_um=tree.best_um,
        epsilon=math.inf,
        expansions=without.expansions + tree.expansions,
        time_to_first_s=without.time_to_first_s,
    )


def _with_steps(request: Request, tree: Tree, node: int, without: Result) -> Result:
    at = slots_of(tree.slots, np.array([node]))[0]
    found = result_of(
        request,
        trace(tree, node),
        cost_um=int(tree.cost_um[at]) + final_cost_um(request.model),
        epsilon=math.inf,
        expansions=without.expansions,
        time_to_first_s=0.0,
    )
    return replace(found, status=PlanStatus.TIMED_OUT, reason=without.reason)


@njit_no_refcount
def _nearest(lattice: Lattice, heuristic: Heuristic, tree: Tree, most_um: int) -> int:
    """The node of a tree from which the heuristic is least, and below a bound; -1 for none."""
    of_block = tree.slots.of_block
    nearest, least_um = -1, most_um
    for block in range(len(of_block)):
        if of_block[block] == 0:
            continue
        for low in range(1 << BITS):
            slot = of_block[block] << BITS | low
            if tree.cost_um[slot] == 0:
                continue
            node = block << BITS | low
            value = estimate(lattice, heuristic, node)
            if value < least_um and may_end_at(lattice, node):
                nearest, least_um = node, value
    return nearest
