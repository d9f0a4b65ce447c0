"""Cassie: springs, closed loops and passive joints, and its twin without them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from app.cli import main
from app.commands.trials import TrialsOptions
from app.output import InputError
from controller.env import TaskConfig, WalkTask
from controller.gait import CONTROL_PERIOD_S
from controller.observation import policy_fields
from controller.policy import PolicyError, load_policy, policy_for, save_policy
from sim.batch import SimBatch
from sim.posture import loop_residual, state_at
from sim.robots import get_robot
from sim.scene import build_scene

FAITHFUL, RIGID = get_robot("cassie"), get_robot("cassie-rigid")
ROBOTS = pytest.mark.parametrize("robot", [FAITHFUL, RIGID], ids=lambda robot: robot.name)


def scene_of(robot, timestep_s=0.001):
    return build_scene(robot, timestep_s=timestep_s)


@ROBOTS
def test_mass_motors_and_what_a_policy_sees(robot):
    """33.312 kg published; ten motors, and of the passive joints no policy knows anything."""
    model = scene_of(robot).model
    assert model.body_mass.sum() == pytest.approx(33.312, abs=1e-6)
    assert model.nu == len(robot.joints) == 10
    widths = {field.name: field.width for field in policy_fields(robot)}
    assert widths["joint_pos_rad"] == widths["joint_vel_rad_s"] == 10
    assert [joint.name for joint in robot.joints] == [joint.name for joint in RIGID.joints]


def test_the_model_has_the_counts_of_the_published_one():
    """Free joint, 2 x (5 hinges with motors, 5 without, one ball); four loops of three rows."""
    scene = scene_of(FAITHFUL)
    data = state_at(scene, scene.standing_qpos)
    assert (scene.model.nq, scene.model.nv, scene.model.neq, data.ne) == (35, 32, 4, 12)
    # Rigid: 12 hinges, of which two are coupled to others.
    assert (scene_of(RIGID).model.nv, scene_of(RIGID).model.neq) == (18, 2)


@pytest.mark.parametrize(
    ("knee_deg", "tarsus_deg"), [(-160, 171.54), (-130, 142.15), (-100, 112.43), (-50, 62.91)]
)
def test_the_rod_fits_where_the_published_model_has_it(knee_deg, tarsus_deg):
    """Angles of the original's linkage with unbent springs: there the rod is 0.5012 m long."""
    scene = scene_of(FAITHFUL)
    qpos = scene.standing_qpos.copy()
    for side in ("left", "right"):
        for name, angle_deg in (("knee", knee_deg), ("tarsus", tarsus_deg)):
            qpos[scene.model.joint(f"{side}-{name}").qposadr] = np.radians(angle_deg)
        for name in ("shin", "heel-spring"):
            qpos[scene.model.joint(f"{side}-{name}").qposadr] = 0.0
    data = state_at(scene, qpos)
    for side in ("left", "right"):
        loop = scene.model.equality(f"{side}_achilles_rod")
        heel = data.body(f"{side}_heel_spring")
        end = heel.xpos + heel.xmat.reshape(3, 3) @ loop.data[3:6]
        length_m = np.linalg.norm(end - data.body(f"{side}_achilles_rod").xpos)
        assert length_m == pytest.approx(0.5012, abs=5e-5)


def test_the_rigid_leg_follows_the_closed_linkage():
    """Through the knee's range, springs bent as in half-sitting: the rod keeps its length."""
    rigid, scene = scene_of(RIGID), scene_of(FAITHFUL)
    for knee_deg in (-150, -120, -90, -68.74, -40):
        start = rigid.standing_qpos.copy()
        start[rigid.model.joint("left-knee").qposadr] = np.radians(knee_deg)
        # The residual of the coupling is linear in the tarsus.
        data = state_at(rigid, start)
        start[rigid.model.joint("left-tarsus").qposadr] -= left_coupling(data)
        qpos = scene.standing_qpos.copy()
        for name in ("knee", "tarsus"):
            angle = start[rigid.model.joint(f"left-{name}").qposadr]
            qpos[scene.model.joint(f"left-{name}").qposadr] = angle
        data = state_at(scene, qpos)
        heel, loop = data.body("left_heel_spring"), scene.model.equality("left_achilles_rod")
        end = heel.xpos + heel.xmat.reshape(3, 3) @ loop.data[3:6]
        length_m = np.linalg.norm(end - data.body("left_achilles_rod").xpos)
        # A degree of the tarsus is 2 mm of the rod.
        assert length_m == pytest.approx(0.5012, abs=2e-4), knee_deg


def left_coupling(data):
    rows = np.flatnonzero(data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY)
    return data.efc_pos[rows[0]]


@ROBOTS
def test_half_sitting_is_at_rest_on_its_springs(robot):
    """Servos of 40 times the stiffness hold it: springs bear half the weight each, and stay put."""
    stiff = [replace(j, kp=40 * j.kp, kd=10 * j.kd, torque_limit_nm=1e4) for j in robot.joints]
    scene = scene_of(replace(robot, joints=tuple(stiff)), timestep_s=0.0005)
    data = state_at(scene, scene.standing_qpos)
    data.ctrl[:] = robot.half_sitting_rad
    joints = [joint for joint in robot.passive if len(joint.half_sitting) == 1]
    angles, heights_m = [], []
    while data.time < 0.4:
        mujoco.mj_step(scene.model, data)
        angles.append([data.joint(joint.name).qpos[0] for joint in joints])
        heights_m.append(data.qpos[2])
    # Soft contacts and servos give by 4 mm and 0.3 degrees; it swings about where it rests.
    assert np.mean(heights_m) == pytest.approx(robot.pelvis_height_m, abs=0.006)
    expected = [joint.half_sitting[0] for joint in joints]
    assert np.mean(angles, axis=0) == pytest.approx(expected, abs=0.01)
    bent = [joint.name.endswith(("shin", "heel-spring")) for joint in joints]
    assert np.mean(angles, axis=0)[bent] == pytest.approx(np.array(expected)[bent], abs=0.003)


@ROBOTS
def test_loops_stay_closed_at_the_longest_physics_step(robot):
    """Within 3 mm (or 3 mrad) while the targets jump by up to 6 degrees, and nothing blows up."""
    rng = np.random.default_rng(0)
    scene = scene_of(robot, timestep_s=robot.longest_timestep_s)
    sim = SimBatch(scene, count=4, control_period_s=CONTROL_PERIOD_S)
    worst = 0.0
    for _ in range(16):
        sim.step(robot.half_sitting_rad + 0.1 * rng.uniform(-1, 1, (4, 10)))
        worst = max(worst, *(loop_residual(scene, state_at(scene, q)) for q in sim.qpos))
        assert not sim.failed.any()
    assert 1e-6 < worst < 3e-3
    assert sim.qpos[:, 2].min() > 0.9


def test_training_takes_steps_as_long_as_the_model_allows():
    for robot, timestep_s in ((FAITHFUL, 0.0025), (RIGID, 0.005), (get_robot("jvrc1"), 0.005)):
        task = WalkTask(robot, count=1, seed=0, config=TaskConfig(stairs_share=0.0))
        assert task.walker.scene.model.opt.timestep == timestep_s


def a_policy(robot):
    inputs = sum(field.width for field in policy_fields(robot))
    return policy_for(robot, ((np.zeros((10, inputs)), np.zeros(10)),))


def test_a_policy_of_the_rigid_one_walks_the_faithful_one(tmp_path, capsys):
    path = tmp_path / "cassie-rigid.safetensors"
    save_policy(a_policy(RIGID), path)
    assert load_policy(FAITHFUL, path).about["robot"] == "cassie-rigid"
    words = ["export", "--policy", str(path), "--out", str(tmp_path / "policy.onnx")]
    assert main([*words, "--robot", "cassie"]) == 0
    assert "warning: this policy was trained on cassie-rigid, and walks cassie" in (
        capsys.readouterr().err
    )
    assert main([*words, "--robot", "cassie-rigid"]) == 0
    assert "warning" not in capsys.readouterr().err
    save_policy(a_policy(FAITHFUL), path)
    with pytest.raises(PolicyError, match="its robot is cassie, cassie-rigid needs cassie-rigid"):
        load_policy(RIGID, path)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (
            ["robot", "draft", "cassie", "--out", "robots"],
            "cassie has passive joints (left-achilles-rod, ...), which robot files do not know",
        ),
        (
            ["navigate", "--robot", "cassie", "--controller", "lipm", "--goal", "1,0,0"],
            "--controller lipm cannot walk cassie: it needs legs of 6 joints with an ankle that",
        ),
    ],
)
def test_what_cannot_take_it_says_so_in_one_line(words, told, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    if words[0] == "navigate":
        words = [*words, "--map", "maps/room.png"]
    assert main(words) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("error: ")
    assert told in error


def test_a_robot_with_passive_joints_cannot_go_by_its_legs():
    with pytest.raises(InputError, match="nothing measures its passive joints"):
        TrialsOptions(map=Path("maps/room.png"), robot="cassie", sensed=True).load()
    TrialsOptions(map=Path("maps/room.png"), sensed=True).load()


@ROBOTS
def test_meshes_are_mirror_images_and_end_at_the_floor(robot):
    """Left and right of the middle plane; the lowest point of the feet is the sole's."""
    scene = build_scene(robot, timestep_s=0.001, visuals=True)
    model, data = scene.model, state_at(scene, scene.standing_qpos)
    sides: dict[str, list[np.ndarray]] = {"left": [], "right": []}
    for geom in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH):
        side = model.body(model.geom_bodyid[geom]).name.split("_")[0]
        mesh = model.mesh(model.geom_dataid[geom])
        vertices = model.mesh_vert[mesh.vertadr[0] : mesh.vertadr[0] + mesh.vertnum[0]]
        turn = data.geom_xmat[geom].reshape(3, 3)
        if side in sides:
            sides[side].append(vertices @ turn.T + data.geom_xpos[geom])
    left, right = (np.concatenate(parts) for parts in sides.values())
    assert len(left) > 3000
    # MuJoCo turns each mesh to its principal axes, so vertices differ by rounding.
    np.testing.assert_allclose(right * [1, -1, 1], left, atol=1e-4)
    assert abs(left[:, 2].min()) < 0.01
    # Nothing is added to what moves.
    assert model.body_mass.sum() == pytest.approx(33.312, abs=1e-6)
