"""Robot files: what is written is read back, what is wrong is named, every command takes them."""

from __future__ import annotations

import dataclasses
import json
import pickle
import shutil

import numpy as np
import pytest
import yaml

from app.cli import main
from app.viewer.page import open_page
from controller.checkpoint import _layout
from controller.policy import (
    POLICY_FOLDER,
    PolicyError,
    load_policy,
    own_policy_path,
    policy_for,
    save_policy,
)
from maps.yaml_files import YamlFileError
from sim.robot_file import KEYS, read_robot
from sim.robot_file_text import COMMENTS, document_of, robot_text, write_robot
from sim.robots import get_robot, robot_names
from sim.scene import build_scene
from tests.programs import ROOM, ROOT, refusal, run_python
from tests.scenes import HALL


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """JVRC-1 as a file; not to be changed."""
    place = tmp_path_factory.mktemp("robots") / "jvrc1"
    place.mkdir()
    write_robot(place, *document_of(get_robot("jvrc1")))
    return place


@pytest.fixture
def own(folder, tmp_path):
    """A copy of it that may be changed."""
    return shutil.copytree(folder, tmp_path / "own")


def changed(place, *keys, to):
    """Writes the file anew with one value changed, or its key left out for None."""
    document = yaml.safe_load((place / "robot.yaml").read_text())
    inner = document
    for key in keys[:-1]:
        inner = inner[key]
    if to is None:
        del inner[keys[-1]]
    else:
        inner[keys[-1]] = to
    (place / "robot.yaml").write_text(yaml.safe_dump(document, sort_keys=False))
    return place


@pytest.mark.parametrize("name", [n for n in robot_names() if not get_robot(n).passive])
def test_what_is_written_is_read_back(name, tmp_path):
    robot = get_robot(name)
    write_robot(tmp_path, *document_of(robot))
    read = pickle.loads(pickle.dumps(get_robot(str(tmp_path))))
    special = {"build", "add_meshes", "needs", "folder", "digest"}
    fields = {field.name for field in dataclasses.fields(robot)} - special
    assert {name: getattr(read, name) for name in fields} == {
        name: getattr(robot, name) for name in fields
    }
    mine, theirs = (build_scene(one, timestep_s=0.001).model for one in (read, robot))
    assert (mine.nbody, mine.ngeom, mine.njnt) == (theirs.nbody, theirs.ngeom, theirs.njnt)
    for kind, count, values in (
        ("body", theirs.nbody, ("mass", "pos", "quat", "ipos", "iquat", "inertia")),
        ("geom", theirs.ngeom, ("type", "pos", "quat", "size", "contype", "conaffinity")),
        ("joint", theirs.njnt, ("axis", "pos", "range")),
    ):
        for k in range(count):
            of_theirs = getattr(theirs, kind)(k)
            of_mine = getattr(mine, kind)(of_theirs.name)
            for value in values:
                expected = getattr(of_theirs, value)
                assert getattr(of_mine, value) == pytest.approx(expected, abs=1e-11), of_theirs.name
    assert np.array_equal(mine.dof_damping, theirs.dof_damping)
    assert np.array_equal(mine.dof_frictionloss, theirs.dof_frictionloss)


def test_every_key_has_its_comment_and_its_place_in_the_docs(folder):
    assert set(COMMENTS) == set(KEYS)
    text = (folder / "robot.yaml").read_text()
    assert text.count("\n\n") == len(yaml.safe_load(text)) - 1
    page = (ROOT / "docs" / "robot-file.md").read_text()
    for key in KEYS:
        assert f"`{key}`" in page, key


JOINT = ("joints", 3)


@pytest.mark.parametrize(
    ("keys", "value", "told"),
    [
        (("mass_kg",), None, "key 'mass_kg' is missing"),
        (("masss_kg",), 3, "key 'masss_kg' is unknown"),
        (("format",), "robot/9", "format 'robot/9' must be robot/1"),
        (("name",), "../evil", "name '../evil' must be letters"),
        (("model",), None, "key 'model' is missing; only `plan` does without"),
        (("model",), "none.xml", "none.xml: cannot be read"),
        (("mass_kg",), -3, "mass_kg -3 must be above 0"),
        (("mass_kg",), "heavy", "mass_kg 'heavy' must be a finite number"),
        (("gait",), {"single_support_s": 0.7}, "key 'gait.double_support_s' is missing"),
        (("gait", "swing_ms"), 700, "key 'gait.swing_ms' is unknown"),
        (("head", "point_m"), [0, 1], "head.point_m [0, 1] must be three numbers"),
        (("head", "body"), "hat", "head.body 'hat' must be a body of the model"),
        (("bodies", "left_leg"), "leg", "bodies.left_leg 'leg' must be a body of the model"),
        ((*JOINT, "kp_nm_per_rad"), 0, "joints[3].kp_nm_per_rad 0 must be above 0"),
        ((*JOINT, "kp_nm_per_rad"), None, "key 'joints[3].kp_nm_per_rad' is missing"),
        ((*JOINT, "half_sitting_rad"), 1, "key 'joints[3].half_sitting_rad' is unknown"),
        ((*JOINT, "half_sitting_deg"), -5, "joints[3].half_sitting_deg -5 must lie within"),
        ((*JOINT, "range_deg"), [150, 0], "joints[3].range_deg [150, 0] must be LOW, HIGH"),
        ((*JOINT, "mirror_sign"), 0, "joints[3].mirror_sign 0 must be 1 or -1"),
        ((*JOINT, "role"), "elbow", "joints[3].role 'elbow' must be one of hip_yaw"),
        ((*JOINT, "role"), "hip_yaw", "joints: role 'hip_yaw' is there twice"),
        ((*JOINT, "names"), ["L_KNEE"], "joints[3].names ['L_KNEE'] must be 2 names"),
        ((*JOINT, "names"), ["L_KNEE", "X"], "names 'X', which the model does not have"),
        (("joints",), [], "joints has 0 rows, must have 6"),
        (("held_deg",), {"X": 3}, "held_deg: the model has no joint 'X'"),
        (("held_deg",), {"L_KNEE": 3}, "held_deg: 'L_KNEE' is one of `joints`"),
        (("soles", "thickness_m"), 0, "soles.thickness_m 0 must be above 0"),
        (("shapes", 0, "radius_m"), -1, "shapes[0].radius_m -1 must be above 0"),
        (("shapes", 0, "ends_m"), [[0, 0, 0], [0, 0, 0]], "must be two different points"),
        (("shapes", 0, "name"), "left_foot", "the name 'left_foot' is taken"),
        (("step_model", "foot", "width_m"), None, "key 'step_model.foot.width_m' is missing"),
        (("step_model", "steps"), [[0.1]], "step_model.steps must be a list of lists of 3 numbers"),
        (("step_model", "stance_width_m"), 0.05, "step_model: stance_width_m 0.05"),
        (("training_limits", "x_m"), 3, "training_limits.x_m 3 must be two numbers"),
    ],
)
def test_what_is_wrong_is_named_in_one_line(own, capsys, keys, value, told):
    assert told in refusal(capsys, "robot", "check", changed(own, *keys, to=value))


def test_a_model_that_is_none_is_named(own, capsys):
    (own / "model.xml").write_text("<robot/>")
    assert "must be a model of MuJoCo" in refusal(capsys, "robot", "check", own)
    (own / "model.xml").write_text("<mujoco")
    assert "model.xml: not XML" in refusal(capsys, "robot", "check", own)


def test_a_robot_that_is_nowhere_is_told_with_what_there_is(capsys, tmp_path):
    told = refusal(capsys, "plan", "--map", ROOM, "--goal", "1,0,0", "--robot", "robots/none")
    assert "choose one of" in told
    assert "or name the folder of a robot file" in told
    assert "robot.yaml: cannot be read" in refusal(capsys, "robot", "check", tmp_path)


def test_plans_need_no_model_and_load_no_mujoco(own):
    words = ("plan", "--map", ROOM, "--goal", "0.5,0,0", "--robot", own, "--json")
    code = (
        "import sys; from app.cli import main; code = main(sys.argv[1:]); "
        "assert 'mujoco' not in sys.modules; sys.exit(code)"
    )
    whole = run_python("-c", code, *words)
    assert whole.returncode == 0, whole.stderr
    text = (own / "robot.yaml").read_text()
    document = yaml.safe_load(text)
    alone = {key: document[key] for key in ("format", "name", "step_model")}
    (own / "robot.yaml").write_text(yaml.safe_dump(alone))
    (own / "model.xml").unlink()
    bare = run_python("-c", code, *words)
    assert bare.returncode == 0, bare.stderr
    steps = [json.loads(done.stdout)["steps"] for done in (whole, bare)]
    assert steps[0] == steps[1]


def test_the_digest_is_of_what_a_policy_learns_from(own):
    first = read_robot(own).digest
    assert len(first) == 64
    text = (own / "robot.yaml").read_text()
    (own / "robot.yaml").write_text(text.replace("title: JVRC-1", "title: Jay  # a comment"))
    assert read_robot(own / "robot.yaml").digest == first
    changed(own, "step_model", "body_margin_m", to=0.2)
    assert read_robot(own).digest == first
    changed(own, "soles", "thickness_m", to=0.03)
    second = read_robot(own).digest
    assert second != first
    model = own / "model.xml"
    model.write_text(model.read_text().replace('mass="3"', 'mass="3.5"', 1))
    assert read_robot(own).digest not in (first, second)


def test_a_policy_is_refused_by_a_robot_whose_file_has_changed(own, tmp_path):
    robot = read_robot(own)
    layers = load_policy(get_robot("jvrc1")).layers
    path = own_policy_path(robot)
    assert path == own / "jvrc1.safetensors"
    with pytest.raises(PolicyError, match="no policy file"):
        load_policy(robot)
    save_policy(policy_for(robot, layers), path)
    assert load_policy(robot).about["robot_digest"] == robot.digest
    changed(own, "soles", "thickness_m", to=0.03)
    with pytest.raises(PolicyError, match=rf"digest {robot.digest[:12]}, which is not that of"):
        load_policy(read_robot(own))
    with pytest.raises(PolicyError, match="which is not the jvrc1 that comes along"):
        load_policy(get_robot("jvrc1"), path)
    # One without a digest, from before or of a robot that comes along, stays valid.
    load_policy(read_robot(own), POLICY_FOLDER / "jvrc1.safetensors")
    assert "robot_digest" not in load_policy(get_robot("jvrc1")).about
    assert _layout(robot)["robot_digest"] == robot.digest
    assert "robot_digest" not in _layout(get_robot("jvrc1"))


def test_commands_walk_it(folder, tmp_path, capsys):
    robot, policy = str(folder), str(POLICY_FOLDER / "jvrc1.safetensors")
    goal = ["--map", ROOM, "--goal", "0.4,0,0"]
    words = [
        "navigate",
        *goal,
        "--robot",
        robot,
        "--policy",
        policy,
        "--out",
        str(tmp_path),
        "--json",
    ]
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out)["robot"] == "jvrc1"


def test_steps_of_a_corpus_are_those_of_the_file(own, tmp_path, capsys):
    limits = {"x_m": [-0.1, 0.12], "y_m": [0.18, 0.25], "yaw_rad": [-0.1, 0.2]}
    changed(own, "step_model", "limits", to=limits)
    changed(
        own, "step_model", "steps", to=[[0.1, 0.2, 0], [0, 0.2, 0], [-0.1, 0.2, 0], [0, 0.2, 0.2]]
    )
    out = tmp_path / "corpus"
    words = ["dataset", "--count", "2", "--robot", str(own), "--out", str(out), "--workers", "2"]
    assert main([*words, "--goal-x", "0.3,0.4", "--goal-y", "0,0", "--goal-yaw", "0,0"]) == 0
    manifest = json.loads((out / "manifest.json").read_text())
    assert manifest["robot"] == "jvrc1"
    assert main(["dataset", "check", str(out), "--robot", str(own)]) == 0


def test_a_gymnasium_environment_of_it(folder):
    import footfall

    env = footfall.make_env(str(folder))
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    env.close()


def test_the_page_lists_it(folder):
    robot = read_robot(folder)
    policy = load_policy(robot, POLICY_FOLDER / "jvrc1.safetensors")
    with open_page(HALL, robot, policy, title="own", robots=("robots/other",)) as page:
        assert page.panel.robot.options == (*robot_names(), "robots/other", str(folder))
        assert page.panel.robot.value == str(folder)


@pytest.mark.parametrize("name", ["talos", "romeo"])
def test_the_examples_are_robots(name):
    """Their meshes are in a package that is not always installed: without it shapes are drawn."""
    robot = read_robot(ROOT / "examples" / "robots" / name)
    model = build_scene(robot, timestep_s=0.001).model
    assert model.body_mass.sum() == pytest.approx(robot.mass_kg, abs=0.05)
    assert model.nu == len(robot.joints) == 12


def test_text_is_read_back_whatever_it_holds():
    document = {"format": "robot/1", "title": 'a: "b" # c', "mass_kg": 1e-7, "height_m": 1 / 3}
    assert yaml.safe_load(robot_text(document)) == document


def test_a_yaml_file_with_a_key_twice_is_refused(own):
    text = (own / "robot.yaml").read_text()
    (own / "robot.yaml").write_text(text + "mass_kg: 3\n")
    with pytest.raises(YamlFileError, match="mass_kg` is there twice"):
        read_robot(own)
