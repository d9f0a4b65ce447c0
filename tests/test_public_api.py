"""`import footfall`: the defaults of the command line, one-line texts, examples that run."""

from __future__ import annotations

import json
import re
import runpy
import subprocess
import sys
from pathlib import Path

import cv2
import pytest

import footfall
from app.cli import main

ROOT = Path(__file__).resolve().parent.parent
EXAMPLES = ROOT / "examples"
START, GOAL = (0, 0, 0), (2, 1, 1.57)


@pytest.fixture(scope="module")
def room():
    return footfall.read_map(ROOT / "maps" / "room.png")


@pytest.fixture(scope="module")
def robot():
    return footfall.load_robot("jvrc1")


def test_what_is_public_is_there_and_says_what_it_is():
    for name in footfall.__all__:
        assert getattr(footfall, name).__doc__, name


def test_what_is_not_public_is_not_there():
    with pytest.raises(AttributeError, match="no attribute 'walk_on_water'"):
        footfall.walk_on_water  # noqa: B018


def test_importing_it_loads_nothing_heavy():
    code = "import sys, footfall; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT
    )
    heavy = {"torch", "mujoco", "numba", "ompl", "gymnasium", "matplotlib", "viser", "rsl_rl"}
    assert set(done.stdout.split()) & heavy == set()


def test_a_plan_is_the_one_of_the_command_line(room, robot, capsys):
    plan = footfall.plan(room, robot, START, GOAL)
    assert main(["plan", "--map", str(ROOT / "maps/room.png"), "--goal", "2,1,1.57", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [step["x"] for step in document["steps"]] == plan.pose_world[:, 0].tolist()
    assert document["cost_m"] == plan.cost_m
    assert document["robot"] == plan.robot == "jvrc1"
    through = footfall.plan(room, robot, START, GOAL, via=[(0.5, 0, 0)])
    assert len(through) > len(plan)


def test_objects_are_told_in_one_short_line(room, robot):
    plan = footfall.plan(room, robot, START, (0.5, 0, 0))
    nowhere = footfall.plan(room, robot, START, (99, 0, 0))
    policy = footfall.load_policy(robot)
    for value in (room, robot, plan, nowhere, policy):
        assert "\n" not in repr(value)
        assert len(repr(value)) < 160
    assert repr(plan).startswith(f"FootstepPlan({len(plan)} steps, cost {plan.cost_m:.2f} m")
    assert repr(nowhere).startswith("FootstepPlan(off_map: ")
    assert repr(robot) == "Robot(jvrc1: 62 kg, 12 leg joints)"


def test_a_walk_ends_with_a_report(room, robot):
    walk = footfall.navigate(room, robot, START, (0.3, 0.2, 0.3))
    report = walk.report()
    assert report.outcome == "reached"
    assert report.steps_taken == len(walk.placed) == len(walk.plans[0])
    assert repr(report).startswith(f"NavigationReport(reached: {len(walk.placed)} steps, feet ")
    assert repr(walk) == f"Navigator(jvrc1: reached, {len(walk.placed)} steps taken)"


def test_environments_are_made_by_the_name_of_the_robot():
    env = footfall.make_env("jvrc1", mode="forward")
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    many = footfall.make_env("jvrc1", num_envs=3)
    assert many.reset(seed=0)[0].shape == (3, *observation.shape)


def test_maps_that_come_along_are_found_from_anywhere(tmp_path, monkeypatch, room):
    monkeypatch.chdir(tmp_path)
    assert (footfall.read_map("maps/room.png").cells == room.cells).all()
    with pytest.raises(footfall.MapError, match=r"maps/attic\.png: no such file"):
        footfall.read_map("maps/attic.png")


def test_the_command_line_says_which_map_it_takes(tmp_path, monkeypatch, capsys):
    words = ["plan", "--map", "maps/room.png", "--goal", "0.5,0,0"]
    monkeypatch.chdir(tmp_path)
    assert main(words) == 0
    assert "map maps/room.png: not in this folder; taking the one" in capsys.readouterr().err
    monkeypatch.chdir(ROOT)
    assert main(words) == 0
    assert "not in this folder" not in capsys.readouterr().err


def run_example(monkeypatch, name: str, *words: str) -> None:
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(sys, "argv", [name, *words])
    runpy.run_path(str(EXAMPLES / name))


def test_the_example_that_plans_draws_its_plan(tmp_path, monkeypatch, capsys):
    picture = tmp_path / "plan.png"
    run_example(monkeypatch, "plan_on_a_map.py", str(picture))
    assert cv2.imread(str(picture)) is not None
    assert capsys.readouterr().out.startswith("FootstepPlan(")


@pytest.mark.slow
def test_the_example_that_walks_tells_of_every_step(monkeypatch, capsys):
    run_example(monkeypatch, "walk_a_plan.py", "0.3,0.1,0")
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("  1 ")
    assert "reached" in lines


@pytest.mark.slow
def test_the_example_that_trains_trains(monkeypatch, capsys):
    pytest.importorskip("stable_baselines3")
    run_example(monkeypatch, "train_for_a_minute.py", "128")
    assert "after 128 control steps it stays up for" in capsys.readouterr().out


@pytest.mark.slow
def test_the_notebook_runs(monkeypatch, tmp_path):
    """Its cells one after the other, as a notebook runs them."""
    monkeypatch.chdir(ROOT)
    monkeypatch.setenv("MPLBACKEND", "agg")
    notebook = json.loads((EXAMPLES / "tour.ipynb").read_text(encoding="utf-8"))
    names: dict[str, object] = {}
    cells = ["".join(c["source"]) for c in notebook["cells"] if c["cell_type"] == "code"]
    assert len(cells) > 4
    for cell in cells:
        exec(compile(cell, "tour.ipynb", "exec"), names)
    assert str(names["walk"]).startswith("Navigator(jvrc1: reached")


def test_the_readme_s_python_runs_from_an_empty_folder(tmp_path, monkeypatch, capsys):
    (source,) = re.findall(
        r"^```python\n(.*?)^```$", (ROOT / "README.md").read_text(encoding="utf-8"), re.M | re.S
    )
    monkeypatch.chdir(tmp_path)
    exec(compile(source, "README.md", "exec"), {})
    assert cv2.imread("plan.png") is not None
    assert "NavigationReport(reached" in capsys.readouterr().out


def test_the_console_script_is_the_command_line(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["footfall", "--help"])
    assert footfall.main() == 0
    assert "usage: footfall COMMAND [OPTIONS]" in capsys.readouterr().out
