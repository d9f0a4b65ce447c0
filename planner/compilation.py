"""Compiles a planner before its first plan, and tells how far that is."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from maps.grid import OccupancyGrid
from planner.cache import cache_folder
from planner.compiled import FUNCTIONS, on_compiling
from planner.options import PlannerOptions
from planner.planner import Planner
from planner.robot_model import StepModel

_FLOOR = OccupancyGrid(cells=np.zeros((60, 100), np.uint8), resolution_m=0.05)
_START, _GOAL = (1.0, 1.5, 0.0), (4.0, 1.5, 0.0)


def compile_ahead(
    model: StepModel, options: PlannerOptions, on_progress: Callable[[int, int, str], None]
) -> float:
    """Compiles what plans of this kind need, if it is not in the cache; seconds that it took.

    0 if it is there, or where nothing can be kept: then it is compiled while planning.
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

    def tell(name: str) -> None:
        on_progress(sum(bool(f.signatures) for f in FUNCTIONS), len(FUNCTIONS), name)

    options = replace(options, time_limit_s=None, record=False)
    with on_compiling(tell):
        Planner(_FLOOR, model, options).plan(start=_START, goal=_GOAL)
    on_progress(len(FUNCTIONS), len(FUNCTIONS), "")
    with contextlib.suppress(OSError):
        done.touch()
    return time.perf_counter() - began
