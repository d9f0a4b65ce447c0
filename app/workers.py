"""Work spread over processes, and the compiling of what they run."""

from __future__ import annotations

import contextlib
import fcntl
import multiprocessing
import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, TypeVar

from app.cluster import on_cluster
from app.output import InputError, ProgressBar, say
from planner.options import PlannerOptions
from planner.robot_model import StepModel

if TYPE_CHECKING:
    from concurrent.futures import ProcessPoolExecutor

Job = TypeVar("Job")
Result = TypeVar("Result")


def in_order(
    function: Callable[[Job], Result],
    jobs: Sequence[Job],
    workers: int,
    *,
    cluster: str | None = None,
    cpus: int = 1,
) -> Iterator[Result]:
    """The results in the order of the jobs, from so many processes; 0 takes all cores.

    function and jobs travel to new processes, so both must be importable there. When the reader
    stops early, by Ctrl-C or by an exception, the processes end at once. With the address of a Ray
    cluster its workers do it (`app/cluster.py`), each job on so many cpus, and 0 takes them all.

    Raises:
        InputError: A process died, which is hardly ever for another reason than want of memory; or
            the cluster is not there.
    """
    if cluster is not None:
        done: dict[int, Result] = {}
        results = on_cluster(function, jobs, cluster, at_once=workers, cpus=cpus)
        for number in range(len(jobs)):
            while number not in done:
                finished, result = next(results)
                done[finished] = result
            yield done.pop(number)
        return
    workers = min(workers or os.cpu_count() or 1, len(jobs))
    if workers <= 1:
        yield from map(function, jobs)
        return
    # Here and not above, as in `_worker_pool`: most commands need no processes.
    from concurrent.futures.process import BrokenProcessPool

    try:
        with _worker_pool(workers) as pool:
            # Not pool.map, which cancels from this thread what its own is giving up.
            waiting = deque(pool.submit(function, job) for job in jobs)
            while waiting:
                yield waiting.popleft().result()
    except BrokenProcessPool:
        raise InputError(
            "a process died, perhaps for want of memory: try fewer --workers"
        ) from None


@contextlib.contextmanager
def _worker_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """So many new processes, which end with the block: at once if it raises, Ctrl-C among that.

    They also end when this process is killed. What they are given must be importable there.
    """
    from concurrent.futures import ProcessPoolExecutor

    others = set(multiprocessing.active_children())
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_end_with_parent)
    try:
        yield pool
    except BaseException:
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _end_with_parent() -> None:
    """Leaves Ctrl-C to the process that started this one, and ends when that one has gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None
    _end_when_closed(parent.sentinel)

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _end_when_closed(pipe: int) -> None:
    """Has the system end this process when the other end of the pipe is closed.

    A thread that waits for that cannot run while compiled code plans, for as long as that takes.
    """
    if sys.platform != "linux":  # elsewhere the signal is ignored unless somebody handles it
        return
    signal.signal(signal.SIGIO, signal.SIG_DFL)
    fcntl.fcntl(pipe, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(pipe, fcntl.F_SETFL, fcntl.fcntl(pipe, fcntl.F_GETFL) | os.O_ASYNC)


def compile_planner(model: StepModel, options: PlannerOptions) -> float:
    """Compiles the planner if no run before has, and shows how far that is; seconds it took."""
    from planner.compilation import compile_ahead

    with contextlib.ExitStack() as stack:
        bar: ProgressBar | None = None

        def show(done: int, functions: int, name: str) -> None:
            nonlocal bar
            if bar is None:
                say("compiling the planner; later runs find it compiled")
                bar = stack.enter_context(ProgressBar("compiling, functions", functions))
            bar.update(done, name)

        return compile_ahead(model, options, show)


def portions(count: int, workers: int, most: int) -> list[range]:
    """The numbers below count in runs of at most so many, several for every worker."""
    size = max(1, min(most, count // (8 * (workers or os.cpu_count() or 1))))
    return [range(first, min(first + size, count)) for first in range(0, count, size)]
