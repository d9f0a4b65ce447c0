"""Robot files drafted from published models: a humanoid of boxes, JVRC-1, and bad input."""

from __future__ import annotations

import json
import math
import re

import pytest
import yaml

from app.cli import main
from sim.posture import standing
from sim.robot_checks import check_robot, com_over_soles_m
from sim.robot_file import read_robot
from sim.robots import get_robot
from sim.scene import build_scene
from tests.humanoid_urdf import LEG, NAMES, Humanoid
from tests.programs import refusal

ROLES = ("hip_yaw", "hip_roll", "hip_pitch", "knee", "ankle_pitch", "ankle_roll")


def drafted(folder, urdf: str, *words: str):
    """The document of the robot file drafted from this text."""
    folder.mkdir(exist_ok=True)
    (folder / "boxes.urdf").write_text(urdf)
    assert main(["robot", "draft", str(folder / "boxes.urdf"), "--out", str(folder), *words]) == 0
    return yaml.safe_load((folder / "robot.yaml").read_text())


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plain")
    return folder, drafted(folder, Humanoid().urdf())


def test_a_humanoid_of_boxes_by_hand(plain):
    folder, document = plain
    assert [row["role"] for row in document["joints"]] == list(ROLES)
    assert [row["names"] for row in document["joints"]] == [
        [NAMES[side].format(joint=joint) for side in ("left", "right")] for joint, *_ in LEG
    ]
    assert [row["mirror_sign"] for row in document["joints"]] == [-1, -1, 1, 1, 1, -1]
    assert document["mass_kg"] == pytest.approx(20 + 3 + 2 * 12 + 2 * 3.5)
    # The sole: the underside of the foot's box, 6 cm + 2 cm below the ankle.
    assert document["soles"]["centre_m"] == pytest.approx([0.03, 0, -0.08], abs=1e-4)
    assert document["step_model"]["foot"] == pytest.approx({"length_m": 0.22, "width_m": 0.10})
    assert document["bodies"]["pelvis"] == "trunk"
    assert document["head"]["body"] == "skull"
    knee = document["joints"][3]
    assert knee["half_sitting_deg"] == pytest.approx(40, abs=0.1)
    assert knee["range_deg"] == pytest.approx([0, math.degrees(2.4)], abs=0.02)
    assert (knee["torque_limit_nm"], knee["speed_limit_rad_s"]) == (120, 10)
    # Thigh and shank lean against each other by 40 degrees; the hip is 0.1 m below the base.
    hip, _, ankle = (math.radians(document["joints"][k]["half_sitting_deg"]) for k in (2, 3, 4))
    height = 0.1 + 0.40 * math.cos(hip) + 0.38 * math.cos(ankle) + 0.08
    assert document["half_sitting"]["pelvis_height_m"] == pytest.approx(height, abs=1e-3)
    robot = read_robot(folder)
    scene = build_scene(robot, timestep_s=0.001)
    assert com_over_soles_m(scene, standing(scene)) == pytest.approx(0, abs=2e-3)
    # Arms that point sideways at 0 hang.
    held = document["held_deg"]
    assert 60 <= -held["shoulder_a"] <= 95
    assert held["shoulder_b"] == pytest.approx(-held["shoulder_a"])
    assert robot.step_model.body.width_m < 0.75


def test_it_passes_every_check(plain):
    folder, _ = plain
    for finding in check_robot(read_robot(folder)):
        assert finding.problems == (), finding.check


@pytest.mark.parametrize(
    ("flipped", "yaw_rad"),
    [
        (frozenset({"pitch_a", "knee_b", "ankle_a", "ankle_b", "roll_b", "yaw_a"}), 0.0),
        (frozenset({"tilt_b", "knee_a"}), math.pi),
        (frozenset(), math.pi / 2),
        (frozenset({"roll_a"}), -math.pi / 2),
    ],
)
def test_axes_and_forward_may_be_any(plain, tmp_path, flipped, yaw_rad):
    """Only senses of joints change: the robot is the same."""
    _, expected = plain
    document = drafted(tmp_path, Humanoid(flipped=flipped, yaw_rad=yaw_rad).urdf())
    for row, like in zip(document["joints"], expected["joints"], strict=True):
        # A robot that looks back has its other leg on the left of its base's axes.
        assert row["role"] == like["role"]
        left, right = (-1 if name in flipped else 1 for name in row["names"])
        assert row["names"] == like["names"]
        assert row["mirror_sign"] == left * right * like["mirror_sign"]
        assert row["half_sitting_deg"] == pytest.approx(left * like["half_sitting_deg"], abs=0.05)
        low, high = sorted(left * end for end in like["range_deg"])
        assert row["range_deg"] == pytest.approx([low, high], abs=0.02)
    assert document["soles"]["centre_m"] == pytest.approx(expected["soles"]["centre_m"], abs=1e-4)
    data = standing(build_scene(read_robot(tmp_path), timestep_s=0.001))
    assert data.site("left_sole").xpos == pytest.approx([0, 0.1, 0], abs=1e-3)
    assert document["half_sitting"] == pytest.approx(expected["half_sitting"], abs=1e-3)


LIMIT = '<limit lower="0.0" upper="2.4" effort="120" velocity="10"/>'
FOOT = '<geometry><box size="0.22 0.1 0.04"/></geometry>'


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({'xyz="0.0 0.1 -0.1"': 'xyz="0.0 0.3 -0.1"'}, "no two chains of joints are mirror images"),
        ({f'"revolute"><parent link="{name}': f'"fixed"><parent link="{name}' for name in
          ("yaw", "roll")}, "a leg has 4 joints (yaw_a, knee_a, ankle_a, tilt_a)"),
        ({'"revolute"><parent link="roll': '"fixed"><parent link="roll'},
         "the left leg (yaw_a, roll_a, knee_a, ankle_a, tilt_a): 2 joints turn about"),
        ({LIMIT: LIMIT.replace("2.4", "0.0")}, "limits of joint knee_a are both 0"),
        ({LIMIT: LIMIT.replace("120", "0")}, "torque limit of joint knee_a is 0, must be above 0"),
        ({LIMIT: LIMIT.replace("10", "0")}, "speed limit of joint knee_a is 0, must be above 0"),
        ({'<mass value="3.0"/>': '<mass value="0"/>'}, "which knee_a moves, has no mass"),
        ({FOOT: "<geometry/>"}, "the foot tilt_a_link has no shapes"),
        ({FOOT: '<geometry><mesh filename="package://a/f.stl"/></geometry>'}, "--package a=DIR"),
        ({FOOT: '<geometry><mesh filename="f.stl"/></geometry>'}, "the mesh f.stl is not found"),
        ({"-0.38": "-380.0", "-0.4\"": "-400.0\""}, "lengths seem to be in millimetres"),
        (
            {
                "</robot>": '<link name="world"/><joint name="weld" type="fixed">'
                '<parent link="world"/><child link="trunk"/></joint></robot>'
            },
            "joint weld fixes trunk to the world: the base must be free",
        ),
        ({"<robot": "<robt", "</robot": "</robt"}, "must be a URDF, <robot>, or MJCF"),
        ({"</robot>": ""}, "not XML"),
    ],
)  # fmt: skip
def test_what_cannot_be_drafted_is_one_line(tmp_path, capsys, changes, told):
    file = tmp_path / "bad.urdf"
    file.write_text(Humanoid(changes=changes).urdf())
    assert told in refusal(capsys, "robot", "draft", file, "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_options_decide_what_the_model_does_not_tell(tmp_path, capsys):
    changes = {LIMIT: LIMIT.replace("120", "0").replace("10", "0"), FOOT: "<geometry/>"}
    text = Humanoid(changes=changes).urdf()
    words = ["--torque-limit", "90", "--speed-limit", "8", "--sole", "0.2,0.08,0.07"]
    document = drafted(tmp_path, text, *words, "--name", "own")
    assert document["name"] == "own"
    assert {row["torque_limit_nm"] for row in document["joints"]} == {90}
    assert {row["speed_limit_rad_s"] for row in document["joints"]} == {8}
    assert document["soles"]["centre_m"][2] == -0.07
    told = refusal(capsys, "robot", "draft", tmp_path / "boxes.urdf", "--out", tmp_path)
    assert "add --force" in told
    own = ("robot", "draft", "jvrc1", "--out", tmp_path / "new", "--feet", "a,b")
    assert "--feet is for a URDF" in refusal(capsys, *own)
    told = refusal(capsys, "robot", "draft", tmp_path / "none.urdf", "--out", tmp_path / "new")
    assert "there is no such file" in told


def test_a_model_without_shapes_gets_a_trunk(tmp_path):
    text = re.sub("<collision>.*?</collision>", "", Humanoid().urdf())
    document = drafted(tmp_path, text, "--sole", "0.22,0.1,0.08")
    assert [shape["name"] for shape in document["shapes"]] == ["trunk", "thigh", "shank"]
    wrong = [f.check for f in check_robot(read_robot(tmp_path)) if f.problems]
    assert wrong == []


def test_broken_inertias_are_mended_and_told(tmp_path, capsys):
    thigh = Humanoid().urdf().partition('name="pitch_a_link"')[2]
    inertia = thigh[thigh.index("<inertia ") : thigh.index("</inertial>")]
    broken = '<inertia ixx="0.01" iyy="0.01" izz="0.9" ixy="0" ixz="0" iyz="0"/>'
    drafted(tmp_path, Humanoid(changes={inertia: broken}).urdf(), "--json")
    guessed = json.loads(capsys.readouterr().out)["guessed"]
    assert sum("is that of no body: it was mended" in line for line in guessed) == 2
    build_scene(read_robot(tmp_path), timestep_s=0.001)


def test_jvrc1_from_its_urdf_is_the_registrys(tmp_path):
    import jvrc_description

    assert main(["robot", "draft", jvrc_description.urdf_path, "--out", str(tmp_path)]) == 0
    mine, theirs = read_robot(tmp_path), get_robot("jvrc1")
    assert [joint.name for joint in mine.joints] == [joint.name for joint in theirs.joints]
    assert mine.mirror_joints[1].tolist() == theirs.mirror_joints[1].tolist()
    assert [joint.role for joint in mine.joints[:6]] == [
        *("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_roll", "ankle_pitch"),
    ]
    assert mine.mass_kg == pytest.approx(theirs.mass_kg, abs=0.01)
    assert mine.pelvis_height_m == pytest.approx(theirs.pelvis_height_m, abs=0.02)
    scenes = [build_scene(robot, timestep_s=0.001) for robot in (mine, theirs)]
    for body in ("left_leg", "L_KNEE_S", "R_ANKLE_P_S"):
        masses = [scene.model.body(body).mass[0] for scene in scenes]
        assert masses[0] == pytest.approx(masses[1], abs=1e-6)
    # The flat part of the mesh: 1 cm further forward and 8 mm narrower on each side than the box of
    # the reference's MJCF, which the registry has.
    soles = [scene.model.site("left_sole").pos for scene in scenes]
    assert soles[0][2] == pytest.approx(soles[1][2], abs=1e-3)
    assert soles[0] == pytest.approx([0.038, 0, -0.10774], abs=2e-3)
    foot = mine.step_model.foot
    assert foot.length_m == pytest.approx(theirs.step_model.foot.length_m, abs=0.005)
    assert foot.width_m == pytest.approx(0.084, abs=1e-3)
