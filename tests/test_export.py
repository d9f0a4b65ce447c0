"""The command `export`: the ONNX file does what the policy does, alone, and says what it is."""

from __future__ import annotations

import hashlib
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest

from app.cli import main
from controller.env import WalkTask
from controller.onnx_export import FORMAT, to_onnx
from controller.policy import POLICY_FOLDER, Policy, load_policy
from controller.walker import Walker
from sim.robots import get_robot
from sim.scene import build_scene
from tests.programs import refusal

JVRC1 = str(POLICY_FOLDER / "jvrc1.safetensors")


@pytest.fixture(scope="module")
def exported(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("export") / "policy.onnx"
    assert main(["export", "--robot", "jvrc1", "--out", str(path)]) == 0
    return path


@pytest.fixture(scope="module")
def told(exported) -> dict[str, str]:
    return {entry.key: entry.value for entry in onnx.load(exported).metadata_props}


@pytest.mark.slow
def test_the_runtime_that_people_use_gives_the_actions_of_the_policy(exported):
    runtime = pytest.importorskip("onnxruntime", reason="comes with the extra `test`")
    robot = get_robot("jvrc1")
    policy, task = load_policy(robot), WalkTask(robot, count=4, seed=0)
    seen = []
    for _ in range(60):
        seen.append(task.walker.observe())
        task.step(policy.act(seen[-1]))
    observation = np.concatenate(seen)[:, : len(policy.offset)]
    session = runtime.InferenceSession(exported, providers=["CPUExecutionProvider"])
    (action,) = session.run(["action"], {"observation": observation.astype(np.float32)})
    assert action.shape == (240, 12)
    assert np.abs(action).max() > 0.1
    assert action == pytest.approx(policy.act(observation), abs=1e-5)


def test_it_is_one_file_and_the_same_every_time(exported, tmp_path):
    assert list(exported.parent.iterdir()) == [exported]
    model = onnx.load(exported, load_external_data=False)
    # Normaliser, limits of the clip, what marks NaN, and the layers.
    layers = len(load_policy(get_robot("jvrc1")).layers)
    assert len(model.graph.initializer) == 2 + 2 + 3 + 2 * layers
    assert all(tensor.raw_data and not tensor.external_data for tensor in model.graph.initializer)
    again = tmp_path / "again.onnx"
    assert main(["export", "--out", str(again)]) == 0
    assert again.read_bytes() == exported.read_bytes()


@pytest.fixture(scope="module", params=["onnxruntime", "onnx.reference"])
def run_model(request):
    """Runs a file on an observation; what is promised of NaN holds in both runtimes."""
    module = pytest.importorskip(request.param, reason="comes with the extra `test`")

    def run(path: Path, observation: np.ndarray) -> np.ndarray:
        if request.param == "onnxruntime":
            session = module.InferenceSession(path, providers=["CPUExecutionProvider"])
        else:
            session = module.ReferenceEvaluator(str(path))
        (action,) = session.run(["action"], {"observation": observation.astype(np.float32)})
        return action

    return run


def outliers(policy: Policy) -> np.ndarray:
    """Observations (2, N), the first of which has numbers far out."""
    observation = np.tile(policy.offset, (2, 1))
    observation[0, [2, 20, 33]] += policy.scale[[2, 20, 33]] * [40.0, -25.0, 12.0]
    return observation


def test_it_clips_outliers_as_training_does(exported, run_model):
    policy = load_policy(get_robot("jvrc1"))
    clipped = np.zeros((2, len(policy.offset)))
    clipped[0, [2, 20, 33]] = 10.0, -10.0, 10.0
    action = run_model(exported, outliers(policy))
    assert action == pytest.approx(policy.act_scaled(clipped), abs=1e-4)
    infinite = outliers(policy)
    infinite[0, [2, 20, 33]] = np.inf, -np.inf, np.inf
    assert run_model(exported, infinite) == pytest.approx(action, abs=1e-6)


def test_without_clip_outliers_go_in_as_they_are(tmp_path, run_model, capsys):
    policy, path = load_policy(get_robot("jvrc1")), tmp_path / "p.onnx"
    assert main(["export", "--no-clip", "--json", "--out", str(path)]) == 0
    assert json.loads(capsys.readouterr().out)["metadata"]["scaled_limit"] == "null"
    seen = outliers(policy)
    action = run_model(path, seen)
    assert action == pytest.approx(policy.act(seen), abs=1e-4)
    scaled = (seen - policy.offset) / policy.scale
    assert np.abs(action - policy.act_scaled(np.clip(scaled, -10, 10))).max() > 0.1


@pytest.mark.parametrize("words", [[], ["--no-clip"]])
def test_a_row_with_nan_gives_nan_and_no_other_does(words, tmp_path, run_model):
    policy, path = load_policy(get_robot("jvrc1")), tmp_path / "p.onnx"
    assert main(["export", *words, "--out", str(path)]) == 0
    width = len(policy.offset)
    # One row for each field, and one without.
    observation = np.tile(policy.offset, (width + 1, 1))
    observation[np.arange(width), np.arange(width)] = np.nan
    action = run_model(path, observation)
    assert np.isnan(action[:width]).all()
    assert action[width] == pytest.approx(policy.act(policy.offset[None])[0], abs=1e-5)


def test_it_says_what_it_is_made_for_and_of(told):
    about = json.loads((POLICY_FOLDER / "jvrc1.json").read_text())
    content = (POLICY_FOLDER / "jvrc1.safetensors").read_bytes()
    assert told["format"] == FORMAT
    assert told["robot"] == "jvrc1"
    assert json.loads(told["joints"]) == about["joints"]
    assert json.loads(told["observation"]) == about["observation"]
    assert told["weights_sha256"] == hashlib.sha256(content).hexdigest()
    assert told["mujoco_version"] == about["mujoco_version"]
    assert told["git_revision"] == about["trained"]["git_revision"]
    assert json.loads(told["trained"])["command"] == about["trained"]["command"]
    assert json.loads(told["control_period_s"]) == 0.025
    # 0.75 s and 0.35 s at 40 Hz.
    assert json.loads(told["gait_ticks"]) == {"swing": 30, "double_support": 14}
    assert json.loads(told["scaled_limit"]) == 10.0
    assert json.loads(told["step_range_s"]) == [0.7, 1.4]
    drawn = about["trained"]["config"]["task"]["randomization"]
    assert json.loads(told["randomization"]) == drawn
    servos = "kp_nm_rad", "kd_nm_s_rad", "torque_limit_nm", "armature_kg_m2"
    for key in ("half_sitting_rad", *servos):
        assert len(json.loads(told[key])) == 12


def test_the_targets_that_it_describes_are_those_that_are_sent(told, monkeypatch):
    walker = Walker(build_scene(get_robot("jvrc1"), timestep_s=0.005))
    sent: list[np.ndarray] = []
    monkeypatch.setattr(walker.sim, "step", lambda targets: sent.append(targets[0].copy()))
    actions = np.random.default_rng(0).normal(size=(3, 12))
    for action in actions:
        walker.act(action[None])
    known = {"half_sitting_rad": np.array(json.loads(told["half_sitting_rad"]))}
    for k in (1, 2):
        now = {"action": actions[k], "previous_action": actions[k - 1]}
        assert eval(told["joint_target_rad"], known | now) == pytest.approx(sent[k])


def test_json_is_all_on_standard_output(tmp_path, capsys):
    assert main(["export", "--json", "--out", str(tmp_path / "p.onnx")]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["bytes"] == (tmp_path / "p.onnx").stat().st_size
    assert 0 < document["greatest_difference_rad"] < 1e-4
    assert document["metadata"]["robot"] == "jvrc1"


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--out", "p.pt"], "--out: p.pt must end in .onnx"),
        (["--out", "p.onnx", "--mjcf", "robot.urdf"], "--mjcf: robot.urdf must end in .xml"),
        (["--out", "none/p.onnx"], "none is not a folder that exists"),
        (["--out", "p.onnx", "--robot", "atlas"], "no robot 'atlas': choose one of"),
        (["--out", "p.onnx", "--robot", "hrp5p", "--policy", JVRC1], "its robot is jvrc1"),
        (["--out", "p.onnx", "--policy", "x.safetensors"], "no policy file x.safetensors"),
        ([], "--out FILE must be given"),
    ],
)
def test_wrong_input_is_told_in_one_line(words, says, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert says in refusal(capsys, "export", *words)
    assert list(tmp_path.iterdir()) == []


def test_without_onnx_one_line_says_what_to_install(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "onnx", None)
    error = refusal(capsys, "export", "--out", tmp_path / "p.onnx")
    assert error == ("error: export needs the package onnx: python -m pip install -e '.[export]'\n")
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_acts_otherwise_never_gets_its_name(tmp_path, monkeypatch, capsys):
    path = tmp_path / "p.onnx"
    path.write_bytes(b"what was there")

    def wrong(policy, robot, **options):
        weight, bias = policy.layers[-1]
        layers = (*policy.layers[:-1], (weight, bias + np.float32(1e-3)))
        return to_onnx(replace(policy, layers=layers), robot, **options)

    monkeypatch.setattr("controller.onnx_export.to_onnx", wrong)
    told = refusal(capsys, "export", "--out", path)
    assert "differs from its original by 0.001 rad" in told
    assert path.read_bytes() == b"what was there"
    assert list(tmp_path.iterdir()) == [path]
