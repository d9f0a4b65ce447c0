"""Work spread over the machines of a Ray cluster, with the extra `cluster`: docs/scale.md."""

from __future__ import annotations

import contextlib
import importlib.util
import logging
import os
from collections.abc import Callable, Iterator, Sequence
from typing import Annotated, Any, Optional, TypeVar

from app.options import text
from app.output import InputError, one_line, say

Job = TypeVar("Job")
Result = TypeVar("Result")
ClusterOption = Annotated[Optional[str], text("auto|ADDRESS")]  # noqa: UP045
# How often a task is tried again whose worker or machine was lost; one that ends every worker it
# meets, for want of memory say, must not do so for ever.
RETRIES = 5
# Tasks that wait at the workers for each one that runs, so that none of them idles.
AHEAD = 2


def on_cluster(
    function: Callable[[Job], Result],
    jobs: Sequence[Job],
    address: str,
    *,
    at_once: int = 0,
    cpus: int = 1,
) -> Iterator[tuple[int, Result]]:
    """Number and result of each job as it is done, from the workers of a Ray cluster.

    The function, with all that is bound to it, goes to each machine once, a job to one worker. Jobs
    whose worker is lost are tried again on another. When the reader stops early the tasks end.

    Args:
        function: What a worker does; it must be importable there.
        jobs: What it is done to.
        address: Of the cluster's head; `auto` for the one that this machine is part of, or where
            there is none a new one of this machine's cores, for these jobs alone.
        at_once: Most jobs that run at the same time; 0 for as many as the cluster has room for.
        cpus: Cores that each of them uses.

    Raises:
        InputError: Ray is not installed, there is no cluster at the address, it is gone, or a job
            has lost its workers too often.
    """
    with connected(address, at_once * cpus):
        import ray
        from ray.exceptions import RayError, RayTaskError

        # A job that no machine has room for would wait for ever.
        cpus = min(cpus, max(int(node["Resources"].get("CPU", 1)) for node in ray.nodes()))
        room = at_once or AHEAD * max(1, int(ray.cluster_resources().get("CPU", 1)) // cpus)
        task = ray.remote(num_cpus=cpus, max_retries=RETRIES)(_call)
        waiting = iter(enumerate(jobs))
        numbers: dict[Any, int] = {}
        try:
            shared = ray.put(function)
            while True:
                while len(numbers) < room and (job := next(waiting, None)) is not None:
                    numbers[task.remote(shared, job[1])] = job[0]
                if not numbers:
                    return
                done, _ = ray.wait(list(numbers))
                for reference in done:
                    yield numbers.pop(reference), ray.get(reference)
        except RayTaskError as error:
            raise error.cause from None
        except RayError as error:
            raise InputError(
                f"--cluster: a job was lost {RETRIES + 1} times, or the cluster is gone: "
                f"{one_line(error)}"
            ) from error


def _call(function: Callable[[Job], Result], job: Job) -> Result:
    return function(job)


@contextlib.contextmanager
def connected(address: str, cpus: int = 0) -> Iterator[None]:
    """The cluster, left at the end; inside another such block it is the one of that.

    One that is started for this, of so many cpus or all, ends with it.

    Raises:
        InputError: Ray is not installed, or there is no cluster at the address.
    """
    if importlib.util.find_spec("ray") is None:
        raise InputError(
            "--cluster needs ray, which the extra `cluster` installs: "
            "python -m pip install -e '.[cluster]'"
        )
    # Nothing is reported to anybody, and what the cluster tells of itself is not ours to print.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    import ray

    if ray.is_initialized():
        yield
        return
    quiet = {"logging_level": logging.ERROR, "log_to_driver": False}
    try:
        ray.init(address=address, **quiet)
    except (ConnectionError, RuntimeError, ValueError, ImportError) as error:
        if address != "auto":
            raise InputError(
                f"--cluster: there is no Ray cluster at {address} ({one_line(error)}): start one "
                "with `ray start --head`, and give the address that it prints, or auto"
            ) from error
        say("no Ray cluster runs here: one of this machine's cores is started for this run")
        try:
            ray.init(address="local", num_cpus=cpus or None, include_dashboard=False, **quiet)
        except Exception as failure:  # Ray raises bare ones where a process of its own fails
            raise InputError(
                f"--cluster: Ray does not start here ({one_line(failure)}): free cores or memory, "
                "or leave --cluster away"
            ) from failure
    try:
        yield
    finally:
        ray.shutdown()
