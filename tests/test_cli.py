"""The command line as a person meets it: exit codes, one line for a mistake, no traceback."""

from __future__ import annotations

import functools
import subprocess
import sys
import time

import cv2
import numpy as np
import pytest

from app.cli import COMMANDS, main, overview
from app.output import ExitCode
from tests.programs import ROOM, ROOT, interrupted, refusal, run_python

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
def write_map(tmp_path):
    """Writes a free map of 6 x 4 m with its origin in the middle and returns its path."""

    def write(cells: np.ndarray | None = None, **changes: object) -> str:
        keys: dict[str, object] = {
            "image": "map.png",
            "resolution": 0.05,
            "origin": [-3.0, -2.0, 0.0],
            "negate": 0,
            "occupied_thresh": 0.65,
            "free_thresh": 0.196,
        }
        keys.update(changes)
        lines = [f"{key}: {value}" for key, value in keys.items() if value is not ...]
        (tmp_path / "map.yaml").write_text("\n".join(lines))
        image = np.full((80, 120), 254, np.uint8) if cells is None else cells
        cv2.imwrite(str(tmp_path / "map.png"), image)
        return str(tmp_path / "map.png")

    return write


@pytest.mark.parametrize("command", ["plan", "navigate"])
def test_a_map_that_is_not_there(refused, command):
    assert "nowhere.png" in refused(command, "--map", "nowhere.png", *GOAL)


def test_a_map_that_is_no_image(refused, tmp_path):
    path = tmp_path / "map.png"
    path.write_text("not an image")
    (tmp_path / "map.yaml").write_text(
        "image: map.png\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0"
    )
    assert str(path) in refused("plan", "--map", str(path), *GOAL)


def test_a_map_without_yaml_shows_what_to_write(write_map, tmp_path, capsys):
    path = write_map()
    (tmp_path / "map.yaml").unlink()
    assert main(("plan", "--map", path, *GOAL)) == ExitCode.BAD_INPUT
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 5
    assert "--resolution" in lines[0]
    assert [line.partition(":")[0] for line in lines[1:]] == [
        *("image", "resolution", "origin", "negate")
    ]


def test_a_map_without_yaml_is_read_with_its_resolution(write_map, tmp_path):
    path = write_map()
    (tmp_path / "map.yaml").unlink()
    words = ("plan", "--map", path, "--goal", "1,0,0", "--resolution", "0.05")
    assert main((*words, "--origin", "-3,-2,0")) == ExitCode.DONE
    # Without the origin the start is the corner of the map.
    assert main(words) == ExitCode.NO_PLAN


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"resolution": ...}, "resolution"),
        ({"resolution": "wide"}, "'wide'"),
        ({"origin": 3}, "origin 3"),
        ({"negate": "maybe"}, "'maybe'"),
        ({"image": "gone.png"}, "gone.png"),
    ],
)
def test_a_yaml_with_a_mistake(refused, write_map, changes, told):
    path = write_map(**changes)
    if "image" in changes:
        path = path.replace(".png", ".yaml")
    assert told in refused("plan", "--map", path, *GOAL)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--goal", "2,1"), "'2,1'"),
        (("--goal", "2,1,north"), "'2,1,north'"),
        ((*GOAL, "--start", "nan,0,0"), "'nan,0,0'"),
        ((*GOAL, "--resolution", "0"), "--resolution: '0'"),
        ((*GOAL, "--robot", "r2d2"), "jvrc1"),
        ((*GOAL, "--planner", "guess"), "'guess'"),
        ((*GOAL, "--epsilon", "0.9"), "'0.9'"),
        ((*GOAL, "--heuristic", "guess"), "'guess'"),
        ((*GOAL, "--heuristic", "path", "--planner", "adstar"), "for the planners ara, astar"),
        ((*GOAL, "--out", f"{ROOM}/plan.json"), "--out: cannot write"),
        ((*GOAL, "--image", "/nonexistent/plan.png"), "--image: cannot write"),
        ((*GOAL, "--image", "plan.gif"), "--image"),
        ((*GOAL, "--what"), "--what"),
        ((), "--goal"),
    ],
)
def test_a_mistake_on_the_command_line(refused, words, told):
    assert told in refused("plan", "--map", ROOM, *words)


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


def test_a_goal_that_is_walled_in(unplanned, write_map):
    cells = np.full((80, 120), 254, np.uint8)
    cells[:, 60:62] = 0
    path = write_map(cells)
    begun = time.perf_counter()
    assert "no_path: " in unplanned("--map", path, "--start", "-1.5,0,0", "--goal", "1.5,0,0")
    assert time.perf_counter() - begun < 5


def test_a_map_whose_unknown_cells_read_as_free_is_warned_of(write_map, capsys):
    path = write_map(np.full((80, 120), 205, np.uint8), free_thresh=0.25)
    assert main(("plan", "--map", path, "--goal", "1,0,0")) == ExitCode.DONE
    err = capsys.readouterr().err
    assert err.startswith("warning: ")
    assert err.count("\n") == 1
    assert "9600" in err


def test_unknown_cells_block_unless_said_otherwise(unplanned, write_map):
    path = write_map(np.full((80, 120), 205, np.uint8))
    words = ("--map", path, "--goal", "1,0,0")
    assert "start_blocked" in unplanned(*words)
    assert main(("plan", *words, "--unknown-is-free")) == ExitCode.DONE


def test_no_command_and_an_unknown_one(refused):
    assert all(name in refused() for name in COMMANDS)
    assert "'fly'" in refused("fly")


def test_the_overview_names_every_command(capsys):
    assert main(("--help",)) == ExitCode.DONE
    assert capsys.readouterr().out == overview() + "\n"
    assert all(f"\n  {name} " in overview() for name in COMMANDS)


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
    assert "--robot" in told.getvalue(), name
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
    threading.Event().wait(60)
app.commands.plan.run = stall
sys.exit(main(sys.argv[1:]))
"""


def test_ctrl_c_ends_in_one_line():
    def stalled(process):
        assert process.stdout.readline() == "stalled\n"

    code, lines = interrupted("-c", STALL, "plan", "--map", ROOM, *GOAL, when=stalled)
    assert (code, lines) == (ExitCode.INTERRUPTED, ["interrupted"])
