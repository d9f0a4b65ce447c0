"""The checks of robots see what is wrong, and name the key that mends it."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from app.cli import main
from sim.robot import Robot
from sim.robot_checks import CHECKS, check_robot
from sim.robots import get_robot
from sim.scene import build_scene

ROBOT = get_robot("jvrc1")
BY_NAME = {check.name: check for check in CHECKS}


def with_joint(name: str, **changes: Any) -> Robot:
    joints = tuple(replace(j, **changes) if j.name == name else j for j in ROBOT.joints)
    return replace(ROBOT, joints=joints)


def spoiled(spoil):
    """JVRC-1 with its model changed."""

    def build():
        spec = ROBOT.build()
        spoil(spec)
        return spec

    return replace(ROBOT, build=build)


def set_of(kind, name, **values):
    def spoil(spec):
        for key, value in values.items():
            setattr(getattr(spec, kind)(name), key, value)

    return spoil


def with_limits(**changes: Any) -> Robot:
    model = ROBOT.step_model
    return replace(
        ROBOT, step_model=replace(model, limits=replace(model.limits, **changes), steps=model.steps)
    )


CASSIE = get_robot("cassie")
SAGGING = tuple(
    replace(j, half_sitting=(1.4,)) if j.name.endswith("tarsus") else j for j in CASSIE.passive
)
FOOT = replace(ROBOT.step_model.foot, width_m=0.12)
BODY = replace(ROBOT.step_model.body, width_m=0.5)


@pytest.mark.parametrize(
    ("check", "robot", "told"),
    [
        ("mass", replace(ROBOT, mass_kg=64.0), "62.40 kg, the file says 64: mass_kg"),
        ("joints", with_joint("L_KNEE", kp=240.0), "kp of L_KNEE and R_KNEE must be the same"),
        ("joints", with_joint("L_KNEE", half_sitting_rad=-0.1), "L_KNEE is at -5.7 degrees"),
        (
            "joints",
            spoiled(set_of("joint", "R_HIP_R", range=[-0.5, 0.349066])),
            "range of R_HIP_R does not mirror that of L_HIP_R: joints, range_deg",
        ),
        ("roles", with_joint("L_KNEE", role="hip_yaw"), "L_KNEE is called hip_yaw and turns as"),
        (
            "half-sitting",
            replace(ROBOT, pelvis_height_m=0.85),
            "pelvis is at 0.8086 m, the file says 0.85: half_sitting, pelvis_height_m",
        ),
        ("half-sitting", replace(ROBOT, pelvis_pitch_rad=0.1), "degrees off the ground"),
        (
            "contacts at rest",
            spoiled(set_of("geom", "left_thigh", fromto=[0, -0.1, -0.1, 0, -0.1, -0.35])),
            "left_thigh and right_thigh touch in half-sitting: shapes",
        ),
        (
            "soles",
            replace(ROBOT, step_model=replace(ROBOT.step_model, foot=FOOT)),
            "the shape of the left foot is not the planner's foot: step_model, foot",
        ),
        (
            "soles",
            replace(CASSIE, step_model=replace(CASSIE.step_model, foot=FOOT)),
            "the shape of the left foot is not the planner's foot: step_model, foot",
        ),
        ("half-sitting", replace(CASSIE, passive=SAGGING), "m or rad: passive joints"),
        ("joints", replace(CASSIE, passive=()), "26 joints move and 10 are stated: joints"),
        (
            "body box",
            replace(ROBOT, step_model=replace(ROBOT.step_model, body=BODY)),
            "step_model, body.width_m",
        ),
        ("height", replace(ROBOT, height_m=1.6), "m high, the file says 1.6: height_m"),
        ("fallen height", replace(ROBOT, fallen_height_m=0.2), "25% of the pelvis's height"),
        (
            "mirror image",
            spoiled(set_of("body", "L_KNEE_S", mass=3.1)),
            "off the mirror image: mirror_sign, soles, or masses",
        ),
        (
            "crossed legs",
            spoiled(lambda spec: [set_of("geom", f"{s}_{n}", contype=0, conaffinity=0)(spec)
                                  for s in ("left", "right") for n in ("thigh", "shank", "foot")]),
            "legs that cross are not felt",
        ),
        ("reach of the steps", with_limits(x_m=(-0.15, 0.9)), "no posture over"),
        ("reach of the steps", with_limits(y_m=(0.1, 0.31)), "the legs touch: step_model, limits"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_seen_with_the_key_that_mends_it(check, robot, told):
    problems = BY_NAME[check](build_scene(robot, timestep_s=0.001)).problems
    assert any(told in problem for problem in problems), problems


def test_a_model_that_cannot_be_built_is_one_problem():
    def build():
        spec = ROBOT.build()
        spec.body("pelvis").name = "hips"
        return spec

    (finding,) = check_robot(replace(ROBOT, build=build))
    assert finding.check == "model"
    assert "cannot be built" in finding.problems[0]


def test_a_robot_that_falls_passes_and_one_that_cannot_stand_is_told(monkeypatch):
    scene = build_scene(ROBOT, timestep_s=0.001)
    found = BY_NAME["standing"](scene)
    assert found.problems == ()
    assert "falls after" in found.measured
    # Held at the pelvis it has no way to fall.
    held = replace(scene, model=scene.model)
    held.model.opt.gravity[:] = 0.0
    assert "stands for" in BY_NAME["standing"](held).measured


def test_the_command_prints_a_line_for_each_check_and_tells_by_its_exit_code(capsys, monkeypatch):
    few = tuple(BY_NAME[name] for name in ("mass", "soles"))
    monkeypatch.setattr("sim.robot_checks.CHECKS", few)
    assert main(["robot", "check", "jvrc1"]) == 0
    out, err = capsys.readouterr()
    assert [line[:5] for line in out.splitlines()] == ["pass "] * 3
    assert "3 of 3 checks pass" in err
    heavy = partial(replace, ROBOT, mass_kg=70.0)
    monkeypatch.setattr("app.commands.robot.find_robot", lambda name: heavy())
    assert main(["robot", "check", "jvrc1", "--json"]) == 2
    document = json.loads(capsys.readouterr().out)
    assert [bool(check["problems"]) for check in document["checks"]] == [False, True, False]
    assert np.all(["mass_kg" in p for p in document["checks"][1]["problems"]])
