"""Compiles a planner before its first plan, independent parts of it in several processes at once.

What one process has compiled the others take from the cache. Each part calls the functions that
planning calls, on an empty floor, so their arguments have the types that they have in planning.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import replace

import numpy as np

from maps.grid import OccupancyGrid
from planner.cache import cache_folder
from planner.collision import terrain_of
from planner.compiled import on_compiling
from planner.heuristics.distance_field import path_costs_to_goal, path_toward
from planner.heuristics.heuristic import full_heuristic, tables_of
from planner.lattice.lattice import build_lattice
from planner.lattice.steps import final_cost_um
from planner.options import SAMPLING_PLANNERS, PlannerOptions
from planner.plan import PlanStatus, feet_at, to_frame
from planner.planner import Planner
from planner.processes import worker_pool
from planner.refinement.refine import refine
from planner.robot_model import StepModel
from planner.search.best_first import expand, start_iteration
from planner.search.problem import GoalContext, Request, Result, SearchTask, best_nodes

_FLOOR = OccupancyGrid(cells=np.zeros((60, 100), np.uint8), resolution_m=0.05)
_START, _GOAL = (1.0, 1.5, 0.0), (4.0, 1.5, 0.0)


def compile_ahead(
    model: StepModel, options: PlannerOptions, on_progress: Callable[[int, int, str], None]
) -> float:
    """Compiles what plans of this kind need, if it is not in the cache; seconds that it took.

    0 if it is there, or where nothing can be kept: then it is compiled while planning.
    on_progress: called with the number of parts that are compiled, that of all, and the name of
    what is compiled next. Starts processes, so a script that calls it must be importable.
    """
    folder = cache_folder()
    if folder is None:
        return 0.0
    # The robot's tables are arrays of the same types for every robot.
    done = folder / f"compiled-{options.name}"
    if done.exists():
        return 0.0
    began = time.perf_counter()
    parts = () if options.name in SAMPLING_PLANNERS else (_refinement, _paths, _first_steps)
    whole = len(parts) + 2
    with _elsewhere(parts, model) as futures:

        def tell(name: str) -> None:
            on_progress(sum(future.done() for future in futures), whole, name)

        tell(options.name)
        with on_compiling(tell):
            if futures:
                _search(model)
            while waiting := [future for future in futures if not future.done()]:
                tell("")
                with contextlib.suppress(TimeoutError):
                    waiting[0].exception(timeout=0.5)
            for future in futures:
                future.result()
            _plan(model, options)
    on_progress(whole, whole, "")
    with contextlib.suppress(OSError):
        done.touch()
    return time.perf_counter() - began


@contextlib.contextmanager
def _elsewhere(
    parts: Sequence[Callable[[StepModel], None]], model: StepModel
) -> Iterator[list[Future[None]]]:
    """Parts that other processes compile meanwhile; none where there is one core."""
    helpers = min((os.cpu_count() or 1) - 1, len(parts))
    if helpers < 1:
        yield []
        return
    with worker_pool(helpers) as pool:
        yield [pool.submit(part, model) for part in parts]


def _plan(model: StepModel, options: PlannerOptions) -> None:
    """Compiles what no other part has."""
    options = replace(options, time_limit_s=None, record=False)
    Planner(_FLOOR, model, options).plan(start=_START, goal=_GOAL)


def _context(model: StepModel) -> GoalContext:
    terrain, tables = terrain_of(_FLOOR, unknown_is_free=False), tables_of(model)
    lattice = build_lattice(_FLOOR, terrain, model, tables.steps, _GOAL)
    return GoalContext(lattice=lattice, model=model, tables=tables)


def _request(model: StepModel, context: GoalContext) -> Request:
    feet = feet_at(_START, model.stance_width_m)
    return Request(
        context=context,
        feet_lattice=to_frame(feet[:, [0, 1, 3]], _GOAL),
        feet_m=np.zeros(2),
        stands=False,
        first_side=None,
    )


def _search(model: StepModel) -> None:
    """Compiles the search over the lattice."""
    context = _context(model)
    lattice, tables = context.lattice, context.tables
    cost_um = np.ones(lattice.cols * lattice.rows, np.int32)
    heuristic = full_heuristic(lattice, tables, cost_um)
    task = SearchTask(
        lattice=lattice,
        heuristic=heuristic,
        is_backward=False,
        roots=lattice.goal_nodes,
        root_um=np.zeros(2, np.int64),
        goals=lattice.goal_nodes,
        goal_um=np.full(2, final_cost_um(model)),
    )
    tree = task.tree()
    start_iteration(lattice, heuristic, tree, 1.0)
    expand(lattice, heuristic, tree, 1.0, 1)
    best_nodes(tree)


def _refinement(model: StepModel) -> None:
    """Compiles the refinement, by that of steps on the spot."""
    context = _context(model)
    request = _request(model, context)
    side = np.tile(np.arange(2, dtype=np.int8), 2)
    step_m = final_cost_um(model) / 1e6
    refine(
        request,
        Result(
            status=PlanStatus.FOUND,
            side=side,
            pose_lattice=request.feet_lattice[side],
            z_m=np.zeros(len(side)),
            cost_m=len(side) * step_m,
        ),
    )


def _paths(model: StepModel) -> None:
    """Compiles the paths of the body."""
    context = _context(model)
    potential = context.tables.potential
    path_costs_to_goal(context.lattice, potential, context.tables.goal_table)
    path_toward(context.lattice, potential, context.lattice.goal_cell)


def _first_steps(model: StepModel) -> None:
    """Compiles the first steps, and where plans may end."""
    context = _context(model)
    assert _request(model, context).has_first_step
    assert len(context.ends)
