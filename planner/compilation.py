"""Compiles a planner before its first plan, and tells how far that is."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from maps.grid import OccupancyGrid
from planner.cache import cache_folder
from planner.compiled import FUNCTIONS, on_compiling
from planner.options import PlannerOptions
from planner.planner import Planner
from planner.refinement.refine import compile_refinement
from planner.robot_model import StepModel

_FLOOR = OccupancyGrid(cells=np.zeros((60, 100), np.uint8), resolution_m=0.05)
_START, _GOAL = (1.0, 1.5, 0.0), (4.0, 1.5, 0.0)

Tell = Callable[[str], None]


def compile_ahead(
    model: StepModel, options: PlannerOptions, on_progress: Callable[[int, int, str], None]
) -> float:
    """Compiles what plans of this kind need, if it is not in the cache; seconds that it took.

    0 if it is there, or where nothing can be kept: then it is compiled while planning.
    With two cores refinement is compiled in a process of its own, beside the search.
    on_progress: called with the number of functions that are compiled, that of all, a few of which
    are not needed, and the name of what is compiled next.
    """
    folder = cache_folder()
    if folder is None:
        return 0.0
    # The robot's tables are arrays of the same types for every robot.
    done = folder / f"compiled-{options.name}"
    if done.exists():
        return 0.0
    began = time.perf_counter()
    elsewhere: set[str] = set()

    def tell(name: str) -> None:
        here = {_name(f) for f in FUNCTIONS if f.signatures}
        on_progress(len(here | elsewhere), len(FUNCTIONS), name)

    options = replace(options, time_limit_s=None, record=False)
    with _beside(model, options, elsewhere) as follow:

        def tell_both(name: str) -> None:
            follow(wait=False)
            tell(name)

        with on_compiling(tell_both):
            planner = Planner(_FLOOR, model, replace(options, refine=False))
            planner.plan(start=_START, goal=_GOAL)
        while follow(wait=True):
            tell("")
    with on_compiling(tell):  # what is left, and loads the rest
        Planner(_FLOOR, model, options).plan(start=_START, goal=_GOAL)
    on_progress(len(FUNCTIONS), len(FUNCTIONS), "")
    with contextlib.suppress(OSError):
        done.touch()
    return time.perf_counter() - began


@contextlib.contextmanager
def _beside(
    model: StepModel, options: PlannerOptions, compiled: set[str]
) -> Iterator[Callable[..., bool]]:
    """Compiles refinement in another process, where there is a core for it.

    What it gives adds the names of what is compiled there, and says whether more may come; it can
    wait for the next one. A process that fails leaves all to this one.
    """
    if not options.refine or _cores() < 2:
        yield lambda wait: False
        return
    context = multiprocessing.get_context("spawn")
    names, far_end = context.Pipe(duplex=False)
    process = context.Process(
        target=_compile_refinement, args=(model, options, far_end), daemon=True
    )
    process.start()
    far_end.close()
    alive = True

    def follow(wait: bool) -> bool:
        nonlocal alive
        try:
            while alive and (wait or names.poll()):
                compiled.add(names.recv())
                wait = False
        except (EOFError, OSError):
            alive = False
        return alive

    try:
        yield follow
    finally:
        process.terminate()
        process.join()
        names.close()


def _compile_refinement(model: StepModel, options: PlannerOptions, names: Connection) -> None:
    """Compiles what moves the steps of a plan, and sends the names of what is compiled."""
    sent: set[str] = set()

    def tell(_: str) -> None:
        for name in {_name(f) for f in FUNCTIONS if f.signatures} - sent:
            sent.add(name)
            names.send(name)

    # Ctrl-C is for the process that started this one; it has gone where nobody listens.
    with contextlib.suppress(KeyboardInterrupt, BrokenPipeError), on_compiling(tell):
        compile_refinement(Planner(_FLOOR, model, options).goal_context(_GOAL).lattice, model)
        tell("")


def _name(function: Any) -> str:
    return f"{function.py_func.__module__}.{function.py_func.__name__}"


def _cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
