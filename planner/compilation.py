"""Compiles a planner before its first plan, and tells how far that is."""

from __future__ import annotations

import contextlib
import gc
import hashlib
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numba
import numpy as np

from maps.grid import OccupancyGrid
from planner.cache import SOURCES, cache_folder
from planner.collision import terrain_of
from planner.compiled import FUNCTIONS, on_compiling
from planner.heuristics.distance_field import path_toward
from planner.heuristics.potential import build_potential
from planner.lattice.goal_region import POINT, ends_in, last_foot
from planner.lattice.lattice import build_lattice
from planner.lattice.steps import build_step_table
from planner.options import SAMPLING_PLANNERS, PlannerOptions
from planner.planner import Planner
from planner.refinement.refine import compile_refinement
from planner.robot_model import StepModel

_FLOOR = OccupancyGrid(cells=np.zeros((60, 100), np.uint8), resolution_m=0.05)
_START, _GOAL = (1.0, 1.5, 0.0), (4.0, 1.5, 0.0)
_TOLD_EVERY_S = 0.5


def compile_ahead(
    model: StepModel, options: PlannerOptions, on_progress: Callable[[int, int, str], None]
) -> float:
    """Compiles what plans of this kind need, if it is not in the cache; seconds that it took.

    0 if it is there, or where nothing can be kept: then it is compiled while planning.
    With two cores half of it is compiled in a process of its own, beside the search.
    on_progress: called with the number of functions that are compiled, that of all, a few of which
    are not needed, and the name of what is compiled next.
    """
    folder = cache_folder()
    if folder is None:
        return 0.0
    # The robot's tables are arrays of the same types for every robot.
    done = folder / f"compiled-{options.name}-{numba_takes(SOURCES)}"
    if done.exists():
        return 0.0
    began = time.perf_counter()
    elsewhere: set[str] = set()

    def tell(name: str) -> None:
        here = {_name(f) for f in FUNCTIONS if f.signatures}
        on_progress(len(here | elsewhere), len(FUNCTIONS), name)

    options = replace(options, time_limit_s=None, record=False)
    with _beside(model, options, elsewhere) as helper:
        with on_compiling(tell):
            planner = Planner(_FLOOR, model, replace(options, refine=False))
            planner.plan(start=_START, goal=_GOAL)
        while helper is not None and helper.is_alive():
            helper.join(_TOLD_EVERY_S)
            tell("")
    with on_compiling(tell):  # what is left, and loads the rest
        Planner(_FLOOR, model, options).plan(start=_START, goal=_GOAL)
    on_progress(len(FUNCTIONS), len(FUNCTIONS), "")
    with contextlib.suppress(OSError):
        done.touch()
    return time.perf_counter() - began


def numba_takes(sources: Path) -> str:
    """Twelve hexadecimal digits for all that numba goes by when it takes code from its cache.

    That is versions, the processor, and path and age of the sources: a cache that was copied along
    with its sources holds nothing for it.
    """
    files = [(str(file), file.stat().st_mtime_ns) for file in sorted(sources.rglob("*.py"))]
    taken = numba.__version__, sys.implementation.cache_tag, llvm.get_host_cpu_name(), files
    return hashlib.sha256(repr(taken).encode()).hexdigest()[:12]


@contextlib.contextmanager
def _beside(
    model: StepModel, options: PlannerOptions, compiled: set[str]
) -> Iterator[threading.Thread | None]:
    """Compiles `compile_parts` in another process, where there is a core for it.

    What it gives lives as long as that goes on, and adds the names of what is compiled there. A
    process that fails leaves all to this one.
    """
    if _cores() < 2:
        yield None
        return
    # Not by multiprocessing, for which the processes that plan may have no children.
    process = subprocess.Popen(
        [sys.executable, "-c", _BESIDE],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )

    def listen() -> None:
        with contextlib.suppress(OSError), process:
            assert process.stdin is not None
            assert process.stdout is not None
            pickle.dump((sys.path, gc.get_threshold()), process.stdin)
            pickle.dump((model, options), process.stdin)
            process.stdin.close()
            for line in process.stdout:
                compiled.add(line.decode().strip())

    thread = threading.Thread(target=listen, daemon=True, name="compiling")
    thread.start()
    try:
        yield thread
    finally:
        process.kill()
        thread.join()


# Where no package of this project may be importable before its path is known.
_BESIDE = """
import gc, pickle, sys
sys.path[:], threshold = pickle.load(sys.stdin.buffer)
gc.set_threshold(*threshold)
from planner.compilation import compile_beside
compile_beside(*pickle.load(sys.stdin.buffer))
"""


def compile_beside(model: StepModel, options: PlannerOptions) -> None:
    """Compiles what `compile_parts` does; prints the name of each function that is compiled.

    Ends where nobody reads them any more, and leaves Ctrl-C to the process that began it.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    said: set[str] = set()

    def tell(_: str) -> None:
        for name in {_name(f) for f in FUNCTIONS if f.signatures} - said:
            said.add(name)
            print(name, flush=True)

    with contextlib.suppress(BrokenPipeError), on_compiling(tell):
        compile_parts(model, options)
        tell("")


def compile_parts(model: StepModel, options: PlannerOptions) -> None:
    """Compiles the half of a plan for which neither a search nor the robot's tables are needed.

    Paths of the body, which a search soon comes to; what it comes to last; refinement.
    """
    steps = build_step_table(model)
    terrain = terrain_of(_FLOOR, unknown_is_free=False)
    lattice = build_lattice(_FLOOR, terrain, model, steps, _GOAL)
    if options.name not in SAMPLING_PLANNERS:
        path_toward(lattice, build_potential(model, steps), lattice.goal_cell)
        ends = ends_in(lattice, POINT)
        last_foot(lattice, int(ends[0]))
    if options.refine:
        compile_refinement(lattice, model)


def _name(function: Any) -> str:
    return f"{function.py_func.__module__}.{function.py_func.__name__}"


def _cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
