"""examples/deploy/walk_plan.py: walks on the exported file alone, by the project's own gait."""

from __future__ import annotations

import ast
import importlib.util
import json
import re
import runpy
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

from app.cli import main
from controller.gait import GaitTicks
from controller.observation import observe
from controller.onnx_export import metadata
from controller.policy import load_policy, own_policy_path
from controller.step_cursor import StepCursor, StepSequence
from maps.map_files import load_map
from planner.plan import FootstepPlan
from planner.planner import Planner
from planner.robot_model import Side
from sim.robots import get_robot, robot_names
from sim.scene import build_scene, robot_mjcf
from tests.programs import ROOM, ROOT, run_python

pytest.importorskip("onnxruntime", reason="comes with the extra `test`")
PROGRAM = ROOT / "examples" / "deploy" / "walk_plan.py"
# Held by the ONNX file as texts; everything else is JSON.
TEXTS = ("format", "robot", "joint_target_rad", "mujoco_version", "git_revision", "weights_sha256")


@pytest.fixture(scope="module")
def program():
    spec = importlib.util.spec_from_file_location("walk_plan", PROGRAM)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def about():
    robot = get_robot("jvrc1")
    told = metadata(load_policy(robot), robot)
    return {key: text if key in TEXTS else json.loads(text) for key, text in told.items()}


def feet_of(document: dict) -> np.ndarray:
    return np.array([document["start_feet"][side] for side in ("left", "right")])


def drawn_plan(seed: int, *, steps: int, paced: bool) -> dict:
    """Steps of no meaning: what is compared is their order and their time."""
    rng = np.random.default_rng(seed)
    sides = [("left", "right")[(k + seed) % 2] for k in range(steps)]
    poses = rng.normal(size=(steps + 2, 4))
    document = {
        "start_feet": {"left": poses[0].tolist(), "right": poses[1].tolist()},
        "steps": [
            {"side": side, **dict(zip(("x", "y", "z", "yaw"), pose.tolist(), strict=True))}
            for side, pose in zip(sides, poses[2:], strict=True)
        ],
    }
    if paced:
        document["step_s"] = rng.uniform(0.7, 1.4, steps).tolist()
    return document


def test_it_imports_nothing_of_ours():
    tree = ast.parse(PROGRAM.read_text(encoding="utf-8"))
    imported = {
        name.split(".")[0]
        for node in ast.walk(tree)
        for name in (
            [alias.name for alias in node.names]
            if isinstance(node, ast.Import)
            else [node.module or ""]
            if isinstance(node, ast.ImportFrom)
            else []
        )
    }
    others = imported - set(sys.stdlib_module_names)
    assert others == {"mujoco", "numpy", "onnxruntime"}


@pytest.mark.parametrize("steps", [0, 1, 2, 7])
@pytest.mark.parametrize("paced", [False, True])
def test_its_gait_is_that_of_the_step_cursor(program, about, steps, paced):
    document = drawn_plan(steps, steps=steps, paced=paced and steps > 0)
    robot = get_robot("jvrc1")
    cursor = StepCursor(GaitTicks.of(robot.gait), 1, 16)
    side = np.array([Side[step["side"].upper()] for step in document["steps"]], dtype=np.int64)
    pose = np.array([[step[key] for key in ("x", "y", "z", "yaw")] for step in document["steps"]])
    step_s = np.array(document["step_s"]) if "step_s" in document else None
    sequence = StepSequence.of(feet_of(document), side, pose.reshape(-1, 4), step_s)
    # A wait of n ticks is over in the tick after it.
    wait_ticks = round(program.WAIT_S / 0.025) - 1
    cursor.follow(0, sequence, wait_ticks=wait_ticks)
    landings = 0
    for clock, window, seconds, lands in program.gait(document, about):
        assert clock == pytest.approx(cursor.clock[0], abs=1e-9)
        assert np.array_equal(window, cursor.shown_window[0])
        assert seconds == pytest.approx(cursor.step_s[0])
        side_now = Side(int(cursor.side[0])).name.lower()
        stepped = bool(cursor.advance()[0])
        assert lands == (side_now if stepped else "")
        landings += stepped
    assert landings == steps
    assert cursor.arrived[0]


@pytest.mark.parametrize(
    "name", [name for name in robot_names() if own_policy_path(get_robot(name)).exists()]
)
def test_its_robot_and_observation_are_those_of_the_scene(program, name, tmp_path):
    robot = get_robot(name)
    scene = build_scene(robot, timestep_s=0.001)
    told = metadata(load_policy(robot), robot)
    about = {key: text if key in TEXTS else json.loads(text) for key, text in told.items()}
    model = tmp_path / "robot.xml"
    model.write_text(robot_mjcf(robot), encoding="utf-8")
    qpos = scene.qpos_at(np.array([1.0, -2.0, 2.5]), 0.1)
    feet = scene.soles_at(qpos)
    machine = program.Robot(str(model), about, feet)
    assert machine.data.qpos == pytest.approx(qpos, abs=1e-4)
    assert machine.model.body_mass.sum() == pytest.approx(scene.model.body_mass.sum(), rel=1e-4)
    for field in ("actuator_gainprm", "actuator_biasprm", "actuator_forcerange"):
        assert getattr(machine.model, field) == pytest.approx(getattr(scene.model, field))
    rng = np.random.default_rng(0)
    machine.data.qpos[3:7] = rng.normal(size=4)
    mujoco.mju_normalize4(machine.data.qpos[3:7])
    machine.data.qpos[7:] = rng.normal(size=scene.model.nq - 7)
    machine.data.qvel[:] = rng.normal(size=scene.model.nv)
    clock, window, step_s = (0.6, 0.8), rng.normal(size=(2, 4)), (0.9, 1.1)
    seen = program.observe(about, machine.state(), clock, window, step_s)
    expected = observe(
        robot,
        qpos=machine.data.qpos[None],
        qvel=machine.data.qvel[None],
        joint_qpos=scene.joint_qpos,
        joint_qvel=scene.joint_qvel,
        clock=np.array([clock]),
        window=window[None],
        step_s=np.array([step_s]),
    )
    assert seen.dtype == np.float32
    assert seen == pytest.approx(expected[:, : seen.shape[1]], abs=1e-5)


@pytest.mark.slow
def test_it_walks_to_the_goal_of_a_plan(tmp_path):
    policy, model, plan = (tmp_path / name for name in ("p.onnx", "robot.xml", "plan.json"))
    assert main(["export", "--out", str(policy), "--mjcf", str(model)]) == 0
    found = Planner(load_map(Path(ROOM)), get_robot("jvrc1").step_model).plan(
        start=(0.2, -0.3, 2.0), goal=(1.3, -1.15, 0.5)
    )
    assert isinstance(found, FootstepPlan)
    assert found.found
    plan.write_text(found.to_json(), encoding="utf-8")
    # Isolated and elsewhere, so that no file of the project can come in by chance.
    done = run_python("-I", PROGRAM, policy, model, plan, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    told = re.fullmatch(
        r"(\d+) steps, ([\d.]+) cm median, ([\d.]+) cm at most from the plan\n"
        r"stands within ([\d.]+) cm of the last steps\n",
        done.stdout,
    )
    assert told is not None, done.stdout
    assert int(told[1]) == len(found)
    # As with `navigate`: docs/evaluation.
    assert 0.0 < float(told[2]) < float(told[3]) < 5.0
    assert float(told[4]) < 3.0


@pytest.mark.slow
def test_a_robot_that_falls_is_told(tmp_path, program, capsys):
    policy, model, plan = (tmp_path / name for name in ("p.onnx", "robot.xml", "plan.json"))
    assert main(["export", "--out", str(policy), "--mjcf", str(model)]) == 0
    steep = model.read_text().replace("<option ", '<option gravity="6 0 -9.81" ')
    model.write_text(steep, encoding="utf-8")
    document = {
        "start_feet": {"left": [0, 0.1, 0, 0], "right": [0, -0.1, 0, 0]},
        "steps": [{"side": "left", "x": 0.2, "y": 0.1, "z": 0.0, "yaw": 0.0}],
    }
    plan.write_text(json.dumps(document))
    capsys.readouterr()
    assert program.main(str(policy), str(model), str(plan)) == 4
    assert capsys.readouterr().out == "fell after 0 of 1 steps\n"


def test_without_its_three_files_it_says_how_it_is_called(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["walk_plan.py", "policy.onnx"])
    with pytest.raises(SystemExit) as left:
        runpy.run_path(str(PROGRAM), run_name="__main__")
    assert "walk_plan.py policy.onnx robot.xml plan.json" in str(left.value.code)
