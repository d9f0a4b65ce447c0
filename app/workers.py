"""Work spread over processes, and the compiling of what they run."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from app.output import InputError, ProgressBar, say
from planner.options import PlannerOptions
from planner.processes import worker_pool
from planner.robot_model import StepModel

Job = TypeVar("Job")
Result = TypeVar("Result")


def in_order(
    function: Callable[[Job], Result], jobs: Sequence[Job], workers: int
) -> Iterator[Result]:
    """The results in the order of the jobs, from so many processes; 0 takes all cores.

    function and jobs travel to new processes, so both must be importable there. When the reader
    stops early, by Ctrl-C or by an exception, the processes end at once.

    Raises:
        InputError: A process died, which is hardly ever for another reason than want of memory.
    """
    workers = min(workers or os.cpu_count() or 1, len(jobs))
    if workers <= 1:
        yield from map(function, jobs)
        return
    try:
        with worker_pool(workers) as pool:
            yield from pool.map(function, jobs)
    except BrokenProcessPool:
        raise InputError(
            "a process died, perhaps for want of memory: try fewer --workers"
        ) from None


def compile_planner(model: StepModel, options: PlannerOptions) -> float:
    """Compiles the planner if no run before has, and shows how far that is; seconds it took."""
    from planner.compilation import compile_ahead

    with contextlib.ExitStack() as stack:
        bar: ProgressBar | None = None

        def show(done: int, parts: int, name: str) -> None:
            nonlocal bar
            if bar is None:
                say("compiling the planner; later runs find it compiled")
                bar = stack.enter_context(ProgressBar("compiling, parts", parts))
            bar.update(done, name)

        return compile_ahead(model, options, show)


def portions(count: int, workers: int, most: int) -> list[range]:
    """The numbers below count in runs of at most so many, several for every worker."""
    size = max(1, min(most, count // (8 * (workers or os.cpu_count() or 1))))
    return [range(first, min(first + size, count)) for first in range(0, count, size)]
