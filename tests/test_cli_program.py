"""The program as its own process: what it loads, where it runs, how it ends; no traceback."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from app.cli import COMMANDS
from app.output import ExitCode

ROOT = Path(__file__).resolve().parent.parent

ROOM = str(ROOT / "maps" / "room.png")

GOAL = ("--goal", "2,1,1.57")


def run_program(*words: str, **options) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *options.pop("python", ()), str(ROOT / "main.py"), *words]
    return subprocess.run(command, capture_output=True, text=True, check=False, **options)


def test_planning_loads_neither_torch_nor_mujoco():
    done = run_program("plan", "--map", ROOM, *GOAL, python=("-X", "importtime"))
    assert done.returncode == ExitCode.DONE
    loaded = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines()}
    assert "planner.planner" in loaded
    heavy = {"torch", "mujoco", "matplotlib", "av", "gymnasium"}
    assert loaded & heavy == set()


@pytest.mark.parametrize("name", COMMANDS)
def test_help_loads_no_simulator(name):
    done = run_program(*name.split(), "--help", python=("-X", "importtime"))
    assert done.returncode == ExitCode.DONE
    assert "--robot" in done.stdout
    loaded = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines()}
    assert loaded & {"torch", "mujoco", "numba"} == set()


def test_it_runs_from_anywhere(tmp_path):
    done = run_program("plan", "--map", ROOM, *GOAL, "--out", "plan.json", cwd=tmp_path)
    assert done.returncode == ExitCode.DONE, done.stderr
    assert (tmp_path / "plan.json").is_file()


def test_a_reader_that_leaves_early_is_no_trouble():
    command = f"'{sys.executable}' '{ROOT}/main.py' plan --map '{ROOM}' --goal 2,1,1.57 --json"
    done = subprocess.run(
        ["bash", "-c", f"{command} | true; exit ${{PIPESTATUS[0]}}"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")


STALL = """
import os, signal, sys, threading
import app.commands.plan
from app.cli import main
def stall(options: app.commands.plan.PlanOptions):
    print("stalled", flush=True)
    threading.Event().wait(60)
app.commands.plan.run = stall
sys.exit(main(sys.argv[1:]))
"""


def test_ctrl_c_ends_in_one_line():
    words = ["plan", "--map", ROOM, *GOAL]
    with subprocess.Popen(
        [sys.executable, "-c", STALL, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        # A shell that runs the tests in the background lets its children ignore Ctrl-C.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "stalled\n"
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=300)
    assert (process.returncode, err) == (ExitCode.INTERRUPTED, "interrupted\n")
