"""Work on a real Ray cluster of two nodes on this machine, one of which is lost in mid-run."""

from __future__ import annotations

import contextlib
import functools
import importlib.util
import socket
import time
from pathlib import Path

import pytest

from app.cli import main
from app.cluster import on_cluster
from app.output import InputError
from app.workers import in_order
from planner.corpus.corpus import MANIFEST, PLANS
from tests.programs import refusal

# Where a port is left to an agent of Ray, a node waits 15 s for it, and on a busy machine in vain.
AGENT_PORTS = (
    *("metrics_agent_port", "metrics_export_port"),
    *("dashboard_agent_listen_port", "runtime_env_agent_port"),
)


def node_settings() -> dict[str, int]:
    """One core, and ports that are free now."""
    with contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket()) for _ in AGENT_PORTS]
        for one in sockets:
            one.bind(("127.0.0.1", 0))
        ports = [one.getsockname()[1] for one in sockets]
    return {"num_cpus": 1, **dict(zip(AGENT_PORTS, ports, strict=True))}


@pytest.fixture(scope="module")
def two_nodes():
    pytest.importorskip("ray", reason="it comes with the extra `cluster`")
    from ray.cluster_utils import Cluster

    head = {**node_settings(), "include_dashboard": False}
    cluster = Cluster(initialize_head=True, head_node_args=head)
    cluster.add_node(**node_settings())
    yield cluster
    cluster.shutdown()


def square(number: int) -> int:
    if number == 99:
        raise InputError("99 is too large")
    return number * number


def wait_and_note(folder: Path, number: int) -> int:
    """Leaves a file that tells on which node it has begun."""
    import ray

    (folder / f"{number}-{ray.get_runtime_context().get_node_id()}").touch()
    time.sleep(0.3)
    return number


@pytest.mark.slow
def test_results_are_those_of_one_process_and_errors_are_its_own(two_nodes):
    address, jobs = two_nodes.address, list(range(30))
    assert list(in_order(square, jobs, 0, cluster=address)) == list(map(square, jobs))
    # Two cores a job, where no machine has more than one.
    assert list(in_order(square, [3], 0, cluster=address, cpus=2)) == [9]
    with pytest.raises(InputError, match="99 is too large"):
        list(in_order(square, [1, 99, 2], 0, cluster=address))


@pytest.mark.slow
def test_corpus_has_the_same_bytes_as_from_one_process(two_nodes, tmp_path):
    words = ["dataset", "--count", "3", "--seed", "4"]
    for name, more in (("here", []), ("there", ["--cluster", two_nodes.address])):
        assert main([*words, "--workers", "1", *more, "--out", str(tmp_path / name)]) == 0
    for file in (PLANS, MANIFEST):
        assert (tmp_path / "here" / file).read_bytes() == (tmp_path / "there" / file).read_bytes()


@pytest.mark.slow
def test_jobs_of_a_lost_node_are_tried_again_on_another(two_nodes, tmp_path):
    two_nodes.wait_for_nodes()
    lost = next(iter(two_nodes.worker_nodes))
    results = []
    for number, result in on_cluster(
        functools.partial(wait_and_note, tmp_path), range(16), two_nodes.address
    ):
        results.append((number, result))
        nodes = {path.name.partition("-")[2] for path in tmp_path.iterdir()}
        if len(nodes) == 2 and lost is not None:  # both are at work
            two_nodes.remove_node(lost, allow_graceful=False)
            lost = None
    assert lost is None
    assert sorted(results) == [(number, number) for number in range(16)]


def test_ray_that_is_missing_is_named(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    error = refusal(capsys, "dataset", "--cluster", "auto", "--count", 1, "--out", tmp_path / "out")
    assert "--cluster needs ray, which the extra `cluster` installs" in error
    assert not (tmp_path / "out").exists()
