"""A first plan soon: a search in the strip of ground that the path of the body lies in.

The path comes from A* over the body's cells, from the goal toward the start, among those where it
has room to walk ahead; where that leads nowhere, among all that the bound of the full search counts
as open, which are more than any body fits into. It looks at a few of the cells that the heuristic
of the full search wants to know; the search for steps then keeps to those cells, weighs their path
cost more than it is due, and goes from place to place rather than from state to state
(`places.py`). Where it finds nothing nothing is lost: the full search follows in any case, or
proves what is asked.
"""

from __future__ import annotations

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
from planner.heuristics.heuristic import Heuristic
from planner.heuristics.turning import no_detours
from planner.lattice.lattice import Int64s
from planner.lattice.steps import final_cost_um
from planner.options import PlannerOptions
from planner.search import best_first as search
from planner.search.best_first import EVERY_STATE, places_of, trace
from planner.search.coarse_to_fine import least_straight
from planner.search.problem import Request, body_cells_of
from planner.search.search_task import Task

# Weights, with as many expansions as each may take, and whether by places or by all states.
_TRIES = (2.0, 1500, True), (3.0, 1500, True), (3.0, 12000, False)


@dataclass(frozen=True, kw_only=True)
class QuickPath:
    """Nodes of a plan but for its last, its cost, and what any plan costs at least."""

    nodes: Int64s
    cost_um: int
    least_um: int
    expansions: int


NO_WAY = QuickPath(nodes=np.zeros(0, np.int64), cost_um=0, least_um=0, expansions=0)


def is_cut_off(request: Request, nodes: Int64s) -> bool:
    """Whether the goal's own pose is the only end, and no path of the body leads there.

    nodes (n,): first steps. A region is never said to be cut off.
    """
    if not request.context.region.is_point:
        return False
    cells = np.unique(body_cells_of(request.context, nodes))
    path = path_toward(request.lattice, request.context.tables.potential, cells, margin_moves=0)
    return not path.reaches_any(cells)


def quick_path(
    request: Request, nodes: Int64s, costs_um: Int64s, options: PlannerOptions
) -> QuickPath | None:
    """A plan from the first steps (n,) with their costs; None where the strip holds none.

    NO_WAY where no path of the body leads to the goal's own pose.
    """
    lattice, potential = request.lattice, request.context.tables.potential
    bodies = body_cells_of(request.context, nodes)
    cells = np.unique(bodies)
    # With room to walk ahead steps can follow it nearly always.
    roomy = replace(potential, reach_m=max(lattice.body[1], potential.reach_m))
    wide = path_toward(lattice, roomy, cells)
    is_wide = wide.reaches_any(cells)
    if not is_wide and wide.is_large and not leads_to_goal(lattice, potential, cells):
        return NO_WAY
    values_um = costs_um + potential.potential_um.reshape(-1)[nodes % (2 * lattice.headings)]
    least_um = least_straight(request, nodes, costs_um)
    # Where the wide path is as short as the straight way there is nothing more to know.
    if not is_wide or least_um < (values_um + wide.least_um(bodies)).min():
        # Beside a wide path this one says only what any plan costs at least: that takes no margin.
        path = path_toward(lattice, potential, cells, margin_moves=0 if is_wide else MARGIN_MOVES)
        if not path.reaches_any(cells):
            return NO_WAY
        least_um = int((values_um + path.least_um(bodies)).min())
    quick = replace(NO_WAY, least_um=least_um)
    if is_wide:
        quick = _along(request, wide, nodes, costs_um, options, _TRIES[:2], quick)
        if len(quick.nodes):
            return quick
        path = path_toward(lattice, potential, cells)
    quick = _along(request, path, nodes, costs_um, options, _TRIES, quick)
    return quick if len(quick.nodes) else None


def _along(
    request: Request,
    strip: Strip,
    nodes: Int64s,
    costs_um: Int64s,
    options: PlannerOptions,
    tries: Sequence[tuple[float, int, bool]],
    so_far: QuickPath,
) -> QuickPath:
    """A plan along a strip, with the expansions so far; without nodes if none is found."""
    task, expansions = _task_in(request, strip, nodes, costs_um), so_far.expansions
    for epsilon, budget, by_places in tries:
        places = places_of(task.lattice, budget) if by_places else EVERY_STATE
        tree = task.tree()._replace(places=places)
        weight = max(options.epsilon, epsilon)
        search.begin_round(task.lattice, task.heuristic, tree, weight)
        budget = min(budget, options.max_expansions - expansions)
        search.expand(task.lattice, task.heuristic, tree, weight, budget)
        expansions += int(tree.scalars[search.EXPANSIONS])
        if tree.scalars[search.BEST_UM] < search.NO_COST:
            return replace(
                so_far,
                nodes=task.in_order(trace(tree, int(tree.scalars[search.BEST_NODE]))),
                cost_um=int(tree.scalars[search.BEST_UM]),
                expansions=expansions,
            )
    return replace(so_far, expansions=expansions)


def _task_in(request: Request, path: Strip, nodes: Int64s, costs_um: Int64s) -> Task:
    """The search along a strip from the first steps (n,); changes the strip's costs."""
    context, exits = request.context, request.context.tables.exits
    start = int(body_cells_of(context, nodes)[np.argmin(costs_um)])
    arrive_um = _lift(request, path, start)
    return Task(
        lattice=request.lattice,
        heuristic=Heuristic(
            path.cost_um,
            path.settled_um + arrive_um,  # off the strip it is as far as from the start
            context.body_cell,
            context.tables.potential.potential_um.reshape(-1),
            context.tables.goal_table.cost_um,
            context.tables.goal_table.cap_um,
            context.tables.facing.depart_um,
            no_detours(request.lattice.cols, request.lattice.rows),
            exits.ring,
            exits.radius_cells,
        ),
        steps=request.lattice.steps,
        is_backward=False,
        roots=nodes,
        root_um=costs_um,
        goals=context.goal_nodes,
        goal_um=np.full(2, final_cost_um(request.model)),
    )


def _lift(request: Request, path: Strip, start: int) -> int:
    """Raises the path costs by what arriving costs; by how much far from the goal.

    Near the goal the exact table counts every turn, farther off nothing does. A search that weighs
    the heuristic would go along the border between the two and look everywhere outside first.
    """
    lattice, tables = request.lattice, request.context.tables
    goal = path.ahead._replace(col=lattice.origin_col, row=lattice.origin_row, slack_um=0)
    table = tables.goal_table.inside, tables.facing.arrive_um, tables.facing.exact_um
    return raise_by_arrival(lattice, path.cost_um, start, goal, *table)
