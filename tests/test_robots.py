"""Laws of the robot models and of the batched simulation; every robot in the registry runs them."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from sim.batch import SimBatch
from sim.posture import PostureError, mirrored_qpos, mirrored_qvel, posture_over, standing
from sim.robot_checks import CHECKS
from sim.robots import get_robot, robot_names
from sim.scene import Scene, build_scene, min_clearance_m
from sim.terrain import BLOCK_HEIGHT_M, LANDINGS, PARKED_Z_M, TREADS, Ground
from tests.scenes import FREE_FALL_M, sunk_on_treads

CONTROL_PERIOD_S = 0.025


@pytest.fixture(scope="module", params=robot_names())
def scene(request) -> Scene:
    return build_scene(get_robot(request.param), timestep_s=0.001)


def test_unknown_robot_is_named_with_those_there_are():
    with pytest.raises(ValueError, match=r"no robot 'r2d2': choose one of .*jvrc1"):
        get_robot("r2d2")


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.name)
def test_every_robot_passes_every_check(scene, check):
    """What the checks see when something is wrong is in tests/test_robot_checks.py."""
    assert check(scene).problems == ()


def test_mirroring_twice_is_the_identity(scene):
    rng = np.random.default_rng(1)
    qpos, qvel = rng.normal(size=scene.model.nq), rng.normal(size=scene.model.nv)
    assert not np.allclose(mirrored_qpos(scene, qpos), qpos)
    assert mirrored_qpos(scene, mirrored_qpos(scene, qpos)) == pytest.approx(qpos)
    assert mirrored_qvel(scene, mirrored_qvel(scene, qvel)) == pytest.approx(qvel)


def test_sensors_agree_with_what_mujoco_computes(scene):
    """Ground force against the sum over contacts, the rest against sites and bodies."""
    model, sensors = scene.model, scene.sensors
    data = mujoco.MjData(model)
    data.qpos[:] = scene.standing_qpos
    data.ctrl[:] = scene.robot.half_sitting_rad
    for _ in range(60):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    read = data.sensordata
    for k, side in enumerate(("left", "right")):
        site = data.site(f"{side}_sole")
        assert read[sensors.sole_pos_world[k]] == pytest.approx(site.xpos)
        assert read[sensors.sole_x_axis_world[k]] == pytest.approx(site.xmat[[0, 3, 6]])
        total = np.zeros(3)
        for c, contact in enumerate(data.contact):
            if model.geom(f"{side}_foot").id in contact.geom:
                wrench = np.zeros(6)
                mujoco.mj_contactForce(model, data, c, wrench)
                towards = 1 if contact.geom[1] == model.geom(f"{side}_foot").id else -1
                total += towards * contact.frame.reshape(3, 3).T @ wrench[:3]
        assert total[2] > scene.robot.weight_n / 5
        assert read[sensors.ground_force_world[k]] == pytest.approx(total)
    assert read[sensors.head_pos_world] == pytest.approx(data.site("head").xpos)
    assert read[sensors.joint_torque] == pytest.approx(data.actuator_force)
    assert read[sensors.legs_touching] == 0
    assert read[sensors.wall_contacts] == 0


def test_servo_torque_is_the_pd_law_clipped_at_the_limit(scene):
    robot, data = scene.robot, standing(scene)
    data.qvel[scene.joint_qvel] = 0.5
    data.ctrl[:] = robot.half_sitting_rad + 0.1
    mujoco.mj_forward(scene.model, data)
    expected = [j.kp * 0.1 - j.kd * 0.5 for j in robot.joints]
    assert data.actuator_force == pytest.approx(expected)
    data.ctrl[:] = robot.half_sitting_rad + 1e3
    mujoco.mj_forward(scene.model, data)
    assert data.actuator_force == pytest.approx([j.torque_limit_nm for j in robot.joints])


def test_clearance_is_unknown_without_walls(scene):
    assert min_clearance_m(scene, scene.standing_qpos[None]) is None


def test_batch_equals_a_loop_over_mj_step_for_any_thread_count(scene):
    rng = np.random.default_rng(3)
    targets = scene.robot.half_sitting_rad + 0.1 * rng.normal(size=(5, 3, scene.model.nu))
    ends = []
    for threads in (1, 2):
        sim = SimBatch(scene, count=3, control_period_s=CONTROL_PERIOD_S, threads=threads)
        for row in targets:
            sim.step(row)
        ends.append(np.concatenate([sim.qpos, sim.qvel], axis=1).copy())
    assert np.array_equal(ends[0], ends[1])
    for k in range(3):
        data = mujoco.MjData(scene.model)
        data.qpos[:] = scene.standing_qpos
        for row in targets:
            data.ctrl[:] = row[k]
            for _ in range(25):
                mujoco.mj_step(scene.model, data)
        assert np.array_equal(ends[0][k], np.concatenate([data.qpos, data.qvel]))


def test_one_broken_simulation_is_told_and_harms_no_other(scene):
    sim = SimBatch(scene, count=3, control_period_s=CONTROL_PERIOD_S)
    whole = SimBatch(scene, count=3, control_period_s=CONTROL_PERIOD_S)
    targets = np.tile(scene.robot.half_sitting_rad, (3, 1))
    sim.qvel[1] = np.nan
    sim.step(targets)
    whole.step(targets)
    assert sim.failed.tolist() == [False, True, False]
    assert np.array_equal(sim.qpos[[0, 2]], whole.qpos[[0, 2]])
    sim.reset(np.array([1]), scene.standing_qpos[None])
    sim.step(targets)
    assert not sim.failed.any()
    assert np.isfinite(sim.qpos).all()


def test_control_period_must_be_whole_physics_steps(scene):
    with pytest.raises(ValueError, match="not a whole number of physics steps"):
        SimBatch(scene, count=1, control_period_s=0.0255)


def test_qpos_at_puts_the_feet_around_the_pose(scene):
    pose = np.array([1.5, -2.0, 2.5])
    soles = scene.soles_at(scene.qpos_at(pose))
    assert soles.mean(axis=0)[:2] == pytest.approx(pose[:2], abs=1e-9)
    assert soles[:, 3] == pytest.approx(2.5, abs=1e-6)
    left = soles[0, :2] - pose[:2]
    assert left @ [-np.sin(2.5), np.cos(2.5)] > 0.05


def test_reach_has_an_end():
    """The check would fail for steps that are too long, or too far across."""
    scene = build_scene(get_robot("jvrc1"), timestep_s=0.001)
    with pytest.raises(PostureError, match="no posture"):
        posture_over(scene, np.array([[1.5, 0.1, 0, 0], [0, -0.1, 0, 0]]))
    data = posture_over(scene, np.array([[0, 0.02, 0, 0], [0, -0.02, 0, 0]]))
    assert data.sensordata[scene.sensors.legs_touching] > 0


def test_robot_whose_package_is_missing_is_left_out_and_says_what_to_install(monkeypatch):
    robot = replace(get_robot("jvrc1"), needs=("no_such_module_at_all", "some_extra"))
    monkeypatch.setattr("sim.robots.jvrc1.ROBOT", robot)
    assert "jvrc1" not in robot_names()
    assert "hrp5p" in robot_names()
    with pytest.raises(
        ValueError, match=r"'jvrc1' needs .* python -m pip .*\[some_extra\]"
    ) as told:
        get_robot("jvrc1")
    assert "\n" not in str(told.value)


# Treads and floor per simulation, parked again at a reset.

POSE = np.array([[0.3, -0.2, 0.5, 1.0]])


@pytest.fixture(scope="module")
def sim():
    scene = build_scene(get_robot("jvrc1"), timestep_s=0.005, treads=True)
    return SimBatch(scene, count=3, control_period_s=CONTROL_PERIOD_S)


def restart(sim, rows):
    sim.reset(np.array(rows), np.tile(sim.scene.standing_qpos, (len(rows), 1)))


def placed(sim):
    """Which mocap bodies (B, n) are not parked; the floor, the first of them, never is."""
    return sim.ground_pose[0][:, :, 2] > PARKED_Z_M + 1


def test_each_simulation_has_its_own_ground_until_it_is_reset(sim):
    restart(sim, [0, 1, 2])
    assert placed(sim).sum(axis=1).tolist() == [1, 1, 1]
    sim.place_ground(0, Ground(floor_z_m=-0.4, treads=POSE))
    sim.place_ground(2, Ground(treads=np.repeat(POSE, 2, axis=0), landings=POSE))
    sim.step(np.tile(sim.scene.robot.half_sitting_rad, (3, 1)))
    assert placed(sim).sum(axis=1).tolist() == [2, 1, 4]
    position, quaternion = sim.ground_pose
    assert position[:, 0, 2].tolist() == [-0.4, 0, 0]
    # The pose is that of the upper face; turned by 1 rad about z.
    tread = np.flatnonzero(placed(sim)[0])[1]
    assert position[0, tread] == pytest.approx([0.3, -0.2, 0.5 - BLOCK_HEIGHT_M / 2])
    assert quaternion[0, tread] == pytest.approx([np.cos(0.5), 0, 0, np.sin(0.5)])
    restart(sim, [0])
    assert placed(sim).sum(axis=1).tolist() == [1, 1, 4]
    assert sim.ground_pose[0][0, 0, 2] == 0


def test_robots_stand_on_treads_and_fall_where_the_floor_is_lower(sim):
    restart(sim, [0, 1, 2])
    sunk = sunk_on_treads(sim)
    assert sunk[0] == pytest.approx(sunk[1], abs=1e-3)
    assert abs(sunk[1]) < 0.015
    assert sunk[2] == pytest.approx(FREE_FALL_M, abs=0.004)


def test_more_ground_than_the_scene_has_is_refused(sim):
    restart(sim, [0])
    for ground in (
        Ground(treads=np.repeat(POSE, TREADS + 1, axis=0)),
        Ground(landings=np.repeat(POSE, LANDINGS + 1, axis=0)),
    ):
        with pytest.raises(ValueError, match=f"at most {TREADS} and {LANDINGS}"):
            sim.place_ground(0, ground)
    assert placed(sim)[0].sum() == 1


def test_scene_without_treads_has_no_ground_to_place():
    scene = build_scene(get_robot("jvrc1"), timestep_s=0.005)
    plain = SimBatch(scene, count=1, control_period_s=CONTROL_PERIOD_S)
    assert plain.ground_pose is None
    with pytest.raises(ValueError, match="without treads"):
        plain.place_ground(0, Ground())
