"""Step models read from YAML: the project's format, and the old package's pair of files."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest
import yaml

from app.cli import main
from planner.plan import FootstepPlan
from planner.robot_model import Side
from planner.step_model_file import StepModelError, load_step_model
from tests.programs import ROOM, refusal

OWN: dict[str, Any] = {
    "format": "step-model/1",
    "name": "small",
    "foot": {"length_m": 0.16, "width_m": 0.08},
    "body": {"length_m": 0.2, "width_m": 0.3},
    "limits": {"x_m": [-0.05, 0.1], "y_m": [0.09, 0.16], "yaw_rad": [-0.1, 0.4]},
    "steps": [[0.1, 0.1, 0], [0, 0.1, 0], [-0.05, 0.1, 0], [0, 0.15, 0], [0, 0.12, 0.4]],
    "stance_width_m": 0.1,
    "turn_cost_m": 0.02,
    "headings": 32,
}
# Values of no real robot, in the places where the old package had them.
OLD_PARAMS: dict[str, Any] = {
    "planner_type": "ARAPlanner",
    "initial_epsilon": 8.0,
    "accuracy": {"collision_check": 2, "cell_size": 0.02, "num_angle_bins": 48},
    "step_cost": 0.07,
    "diff_angle_cost": 0.03,
    "foot": {
        "size": {"x": 0.16, "y": 0.08, "z": 0.02},
        "separation": 0.1,
        "origin_shift": {"x": 0.0, "y": 0.0},
        "max": {
            "step": {"x": 0.1, "y": 0.16, "theta": 0.4},
            "inverse": {"step": {"x": -0.05, "y": 0.09, "theta": -0.1}},
        },
    },
}
OLD_STEPS = {
    "footsteps": {
        "x": [0.1, 0.0, -0.04, 0.0, 0.0],
        "y": [0.1, 0.1, 0.1, 0.15, 0.12],
        "theta": [0.0, 0.0, 0.0, 0.0, 0.39],
    },
    # Clockwise and closed.
    "step_range": {"x": [0.1, 0.1, -0.05, -0.05, 0.1], "y": [0.16, 0.09, 0.09, 0.16, 0.16]},
}


def written(folder, document, name="small.yaml"):
    (folder / name).write_text(yaml.safe_dump(document))
    return folder / name


def old_files(folder, **params):
    written(folder, OLD_STEPS, "footsteps_small.yaml")
    return written(folder, OLD_PARAMS | params, "planning_params_small.yaml")


def test_the_own_format(tmp_path):
    name, model, unknown = load_step_model(written(tmp_path, OWN))
    assert (name, unknown) == ("small", ())
    assert model.foot.length_m == 0.16
    assert model.limits.yaw_rad == (-0.1, 0.4)
    assert model.steps[4] == (0, 0.12, 0.4)
    assert (model.turn_cost_m, model.headings, model.cell_m) == (0.02, 32, 0.05)


@pytest.mark.parametrize("name", ["footsteps_small.yaml", "planning_params_small.yaml"])
def test_the_old_pair_of_files_by_either_name(tmp_path, name):
    old_files(tmp_path)
    robot, model, unknown = load_step_model(tmp_path / name)
    assert (robot, unknown) == ("small", ())
    assert (model.foot.length_m, model.foot.width_m, model.stance_width_m) == (0.16, 0.08, 0.1)
    assert model.body.width_m == pytest.approx(0.18)
    assert model.limits.x_m == (-0.05, 0.1)
    assert model.limits.y_m == (0.09, 0.16)
    assert model.limits.yaw_rad == (-0.1, 0.4)
    assert model.limits.reach_m == ((-0.05, 0.16), (-0.05, 0.09), (0.1, 0.09), (0.1, 0.16))
    assert model.steps[0] == (0.1, 0.1, 0.0)
    assert (model.step_cost_m, model.turn_cost_m) == (0.07, 0.03)
    assert (model.cell_m, model.headings) == (0.02, 48)


def without(key):
    return {k: v for k, v in OWN.items() if k != key}


@pytest.mark.parametrize(
    ("document", "told"),
    [
        ([1], "must hold keys and values"),
        (OWN | {"format": "step-model/9"}, "must be 'step-model/1'"),
        (without("foot"), "key 'foot' is missing"),
        (OWN | {"foott": 1}, "key 'foott' is unknown"),
        (OWN | {"foot": {"length_m": 0.1}}, "key 'foot.width_m' is missing"),
        (OWN | {"foot": {"length_m": 0.1, "width_m": -1}}, "foot.width_m -1 must be above 0"),
        (OWN | {"foot": 3}, "foot must hold length_m, width_m"),
        (OWN | {"turn_cost_m": "much"}, "turn_cost_m 'much' must be a finite number"),
        (OWN | {"turn_cost_m": math.nan}, "turn_cost_m nan must be a finite number"),
        (OWN | {"headings": 16.5}, "headings 16.5 must be a whole number"),
        (OWN | {"steps": [[0.1, 0.1]]}, "steps must be a list of lists of 3 numbers"),
        (OWN | {"steps": [[0.3, 0.1, 0]]}, "lies outside the step limits"),
        (OWN | {"limits": OWN["limits"] | {"x_m": 1}}, "limits.x_m 1 must be two numbers"),
        (OWN | {"stance_width_m": 0.5}, "stance_width_m 0.5"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, document, told):
    with pytest.raises(StepModelError, match=told):
        load_step_model(written(tmp_path, document))


def test_what_is_wrong_in_old_files_is_named(tmp_path):
    file = old_files(tmp_path, foot={"size": {"x": 0.1, "y": 0.1}})
    with pytest.raises(StepModelError, match="key 'foot/separation' is missing"):
        load_step_model(file)
    steps = {"footsteps": {"x": [0.1], "y": [0.1, 0.1], "theta": [0.0]}}
    written(tmp_path, steps, "footsteps_small.yaml")
    with pytest.raises(StepModelError, match="has 1 x, 2 y, 1 theta"):
        load_step_model(old_files(tmp_path) and written(tmp_path, steps, "footsteps_small.yaml"))
    (tmp_path / "footsteps_small.yaml").unlink()
    with pytest.raises(StepModelError, match=r"footsteps_small.yaml: cannot be read"):
        load_step_model(tmp_path / "planning_params_small.yaml")


@pytest.mark.parametrize("option", ["--robot", "--step-model"])
@pytest.mark.parametrize("is_old", [False, True])
def test_plans_keep_to_the_file(tmp_path, option, is_old, capsys):
    file = old_files(tmp_path, wheels=4) if is_old else written(tmp_path, OWN)
    words = ["plan", "--map", ROOM, "--goal", "0.5,-0.4,0.5", option, str(file), "--json"]
    assert main(words) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["robot"] == "small"
    assert ("unknown keys are left out: wheels" in err) == is_old
    plan = FootstepPlan.from_json(out)
    _, model, _ = load_step_model(file)
    from planner.plan import relative_step

    feet = plan.start_feet_world.copy()
    assert len(plan)
    for side, pose in zip(plan.side, plan.pose_world, strict=True):
        swing = Side(int(side))
        assert model.limits.contain(relative_step(feet[swing.other], pose, swing), 1e-6)
        feet[swing] = pose
    middle = feet[:, :2].mean(axis=0)
    assert middle == pytest.approx((0.5, -0.4), abs=1e-6)


def test_a_file_has_no_policy(tmp_path, capsys):
    file = written(tmp_path, OWN)
    words = ("plan", "--map", ROOM, "--goal", "1,0,0")
    told = refusal(capsys, *words, "--step-model", file, "--policy", "a.b")
    assert "leave it out" in told
    told = refusal(capsys, *words, "--robot", tmp_path / "none.yaml")
    assert "none.yaml: cannot be read" in told
