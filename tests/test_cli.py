"""The command line as a person meets it: exit codes, one line for a mistake, no traceback."""

from __future__ import annotations

import errno
import functools
import os
import signal
import subprocess
import sys
from importlib.metadata import version
from typing import Any

import numpy as np
import pytest

import app.commands.plan
from app.cli import COMMANDS, main, overview
from app.output import ExitCode
from tests.programs import ROOM, ROOT, interrupted, refusal, run_python, write_map

GOAL = ("--goal", "2,1,1.57")


@pytest.fixture
def refused(capsys):
    """Runs a command line that must be refused; returns its one line."""
    return functools.partial(refusal, capsys)


@pytest.fixture
def unplanned(capsys):
    """Runs `plan` where there is no plan; returns the one line that says why."""

    def run(*words: str) -> str:
        code = main(("plan", *words))
        err = capsys.readouterr().err
        assert code == ExitCode.NO_PLAN
        *others, last = err.splitlines()
        assert all(line.startswith("warning: ") for line in others)
        assert last.startswith("no plan: ")
        return last

    return run


@pytest.fixture
def map_of(tmp_path):
    """Writes a map with its origin in the middle of 6 x 4 m, free unless said otherwise."""

    def write(grey: int = 254, **keys: Any) -> str:
        picture = np.full((80, 120), grey, np.uint8)
        return str(write_map(tmp_path, picture, origin=[-3.0, -2.0, 0.0], **keys))

    return write


@pytest.mark.parametrize("command", ["plan", "navigate"])
def test_a_map_that_is_not_there(refused, command):
    assert "nowhere.png" in refused(command, "--map", "nowhere.png", *GOAL)


def test_a_map_without_yaml_shows_what_to_write(map_of, tmp_path, capsys):
    path = map_of()
    (tmp_path / "m.yaml").unlink()
    assert main(("plan", "--map", path, *GOAL)) == ExitCode.BAD_INPUT
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 5
    assert "--resolution" in lines[0]
    assert [line.partition(":")[0] for line in lines[1:]] == [
        *("image", "resolution", "origin", "negate")
    ]


def test_a_map_without_yaml_is_read_with_its_resolution(map_of, tmp_path):
    path = map_of()
    (tmp_path / "m.yaml").unlink()
    words = ("plan", "--map", path, "--goal", "1,0,0", "--resolution", "0.05")
    assert main((*words, "--origin", "-3,-2,0")) == ExitCode.DONE
    # Without the origin the start is the corner of the map.
    assert main(words) == ExitCode.NO_PLAN


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--goal", "2,1,north"), "'2,1,north'"),
        ((*GOAL, "--resolution", "0"), "--resolution: '0'"),
        ((*GOAL, "--robot", "r2d2"), "jvrc1"),
        ((*GOAL, "--planner", "guess"), "'guess'"),
        ((*GOAL, "--epsilon", "0.9"), "'0.9'"),
        ((*GOAL, "--heuristic", "guess"), "'guess'"),
        ((*GOAL, "--heuristic", "path", "--planner", "adstar"), "for the planners ara, astar"),
        ((*GOAL, "--policy", "nobody.safetensors"), "no policy file nobody.safetensors"),
        ((*GOAL, "--planner", "fmt", "--epsilon", "3"), "--epsilon goes with the planners ara, a"),
        ((*GOAL, "--planner", "rrtstar", "--prove"), "--prove goes with the planners ara, astar"),
        ((*GOAL, "--planner", "fmt", "--search-image", "s.png"), "--search-image goes with the "),
        ((*GOAL, "--out", f"{ROOM}/plan.json"), "--out: cannot write"),
        ((*GOAL, "--image", "/nonexistent/plan.png"), "--image: cannot write"),
        ((*GOAL, "--image", "plan.gif"), "--image"),
    ],
)
def test_a_mistake_on_the_command_line(refused, words, told):
    assert told in refused("plan", "--map", ROOM, *words)


@pytest.mark.parametrize("words", [("--fps", "24"), ("--video-size", "640x360")])
def test_what_a_film_is_to_be_like_goes_with_a_film(refused, words):
    assert f"{words[0]} goes with --video" in refused("navigate", "--map", ROOM, *GOAL, *words)


@pytest.mark.parametrize("name", ["http://robot.lab", "robot lab", "a,,b"])
def test_what_can_be_no_name_of_a_host_is_refused(refused, name):
    assert f"--allow-host: {name!r} is not names of hosts" in refused("serve", "--allow-host", name)


def test_the_version_is_that_of_the_distribution(capsys):
    assert main(("--version",)) == ExitCode.DONE
    assert capsys.readouterr().out == f"footfall {version('footfall-navigation')}\n"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--goal", "99,0,0"), "off_map: goal 99,0"),
        (("--goal", "0,0,0", "--start", "-99,0,0"), "off_map: start -99,0"),
        (("--goal", "1,0.5,0"), "goal_blocked: goal"),
        ((*GOAL, "--start", "1,0.5,0"), "start_blocked: start"),
    ],
)
def test_goals_and_starts_where_nobody_can_stand(unplanned, words, told):
    assert told in unplanned("--map", ROOM, *words)


def test_a_map_that_fits_no_memory_is_refused(refused, map_of):
    told = refused("plan", "--map", map_of(), "--resolution", "100", "--goal", "1e3,1e3,0")
    assert told.startswith("error: not enough memory: the map is too large")


def test_a_map_whose_unknown_cells_read_as_free_is_warned_of(map_of, capsys):
    path = map_of(205, free_thresh=0.25)
    assert main(("plan", "--map", path, "--goal", "1,0,0")) == ExitCode.DONE
    err = capsys.readouterr().err
    assert err.startswith("warning: ")
    assert err.count("\n") == 1
    assert "9600" in err


def test_unknown_cells_block_unless_said_otherwise(unplanned, map_of):
    words = ("--map", map_of(205), "--goal", "1,0,0")
    assert "start_blocked" in unplanned(*words)
    assert main(("plan", *words, "--unknown-is-free")) == ExitCode.DONE


LONG = "9" * 400


@pytest.mark.parametrize(
    "words",
    [
        ["plan", "--map", LONG, "--goal", "1,1,0"],
        ["plan", "--map", str(ROOM), "--goal", "1,1,0", "--robot", LONG],
        ["plan", "--map", str(ROOM), "--goal", "1,1,0", "--step-model", LONG],
        ["navigate", "--map", str(ROOM), "--goal", "1,1,0", "--policy", LONG],
        ["export", "--policy", LONG, "--out", "policy.onnx"],
        ["export", "--out", f"{LONG}/policy.onnx"],
        ["dataset", "check", LONG],
        ["evaluate", "--policy", LONG, "--out", "evaluation"],
        ["trials", "--map", str(ROOM), "--count", "1", "--out", LONG],
        ["train", "--out", LONG, "--resume"],
        ["robot", "check", LONG],
    ],
)
def test_a_path_that_the_system_refuses_to_look_up(refused, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert "File name too long" in refused(*words)


@pytest.mark.parametrize("number", [errno.EACCES, errno.EMFILE, errno.EIO])
def test_a_file_that_the_system_refuses(refused, monkeypatch, number):
    def refuse(options: app.commands.plan.PlanOptions):
        raise OSError(number, os.strerror(number), "place/file")

    monkeypatch.setattr(app.commands.plan, "run", refuse)
    told = refused("plan", "--map", "m.png", "--goal", "1,1,0")
    assert f"place/file: {os.strerror(number)}" in told


def test_an_error_of_the_system_that_names_no_file_is_a_fault(monkeypatch):
    def fail(options: app.commands.plan.PlanOptions):
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(app.commands.plan, "run", fail)
    with pytest.raises(PermissionError):
        main(["plan", "--map", "m.png", "--goal", "1,1,0"])


def test_no_command_and_an_unknown_one(refused):
    assert all(name in refused() for name in COMMANDS)
    assert "'fly'" in refused("fly")


def test_the_overview_names_every_command(capsys):
    assert main(("--help",)) == ExitCode.DONE
    assert capsys.readouterr().out == overview() + "\n"
    assert all(f"\n  {name} " in overview() for name in COMMANDS)


@pytest.mark.slow
def test_planning_loads_neither_torch_nor_mujoco():
    done = run_python("-X", "importtime", "main.py", "plan", "--map", ROOM, *GOAL)
    assert done.returncode == ExitCode.DONE
    loaded = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines()}
    assert "planner.planner" in loaded
    heavy = {"torch", "mujoco", "matplotlib", "av", "gymnasium"}
    assert loaded & heavy == set()


HELP = """
import contextlib, io, sys
from app.cli import COMMANDS, main
for name in COMMANDS:
    told = io.StringIO()
    with contextlib.redirect_stdout(told):
        try:
            main([*name.split(), "--help"])
        except SystemExit as left:
            assert left.code == 0
    assert "--out" in told.getvalue() or "--robot" in told.getvalue(), name
    print(name, *{"torch", "mujoco", "numba"} & sys.modules.keys(), sep=" loads ")
"""


def test_help_loads_no_simulator():
    done = run_python("-c", HELP)
    assert done.returncode == ExitCode.DONE, done.stderr
    assert done.stdout.splitlines() == list(COMMANDS)


@pytest.mark.slow
def test_it_runs_from_anywhere(tmp_path):
    words = (ROOT / "main.py", "plan", "--map", ROOM, *GOAL, "--out", "plan.json")
    done = run_python(*words, cwd=tmp_path)
    assert done.returncode == ExitCode.DONE, done.stderr
    assert (tmp_path / "plan.json").is_file()


@pytest.mark.slow
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
    try:
        threading.Event().wait(60)
    except KeyboardInterrupt:
        if "--partial" in sys.argv:  # as libraries do that are being imported
            raise ImportError("initialization failed") from None
        raise
app.commands.plan.run = stall
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.parametrize(
    ("by", "code", "line"),
    [
        (signal.SIGINT, ExitCode.INTERRUPTED, "interrupted"),
        (signal.SIGTERM, ExitCode.TERMINATED, "terminated"),
    ],
)
@pytest.mark.parametrize("swallowed", [(), ("--partial",)])
def test_ctrl_c_and_sigterm_end_in_one_line(by, code, line, swallowed):
    def stalled(process):
        assert process.stdout.readline() == "stalled\n"

    words = ("plan", "--map", ROOM, *GOAL, *swallowed)
    done = interrupted("-c", STALL, *words, when=stalled, by=by)
    assert done == (code, [line])


def test_a_mistyped_command_gets_a_guess(capsys):
    assert "'naviagte'; did you mean navigate?" in refusal(capsys, "naviagte")
    assert "did you mean" not in refusal(capsys, "xyz")
