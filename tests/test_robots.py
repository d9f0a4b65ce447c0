"""What every robot in the registry must keep, besides the laws of simulation in test_sim.py."""

from __future__ import annotations

import itertools
from dataclasses import replace

import mujoco
import numpy as np
import pytest

import sim.robots.jvrc1
from sim.robot import PHYSICS_GROUP
from sim.robots import get_robot, robot_names
from sim.scene import Scene, build_scene
from sim.sensors import SIDES
from tests.scenes import reach_m

# By how much the legs must stay off their joints' ends in every step that is planned.
SPARE_RAD = np.radians(2.0)
LEAN_RAD = np.radians(8.0)


@pytest.fixture(scope="module", params=robot_names())
def scene(request) -> Scene:
    return build_scene(get_robot(request.param), timestep_s=0.001)


def joint_ranges(scene: Scene) -> np.ndarray:
    return np.array([scene.model.joint(joint.name).range for joint in scene.robot.joints])


def test_height_is_the_one_the_robot_states(scene):
    data = mujoco.MjData(scene.model)
    data.qpos[:7] = [0, 0, 0, 1, 0, 0, 0]
    mujoco.mj_kinematics(scene.model, data)
    shapes = np.flatnonzero(
        (scene.model.geom_group == PHYSICS_GROUP) & (scene.model.geom_bodyid > 0)
    )
    top = max(data.geom_xpos[geom, 2] + reach_m(scene, data, int(geom))[2] for geom in shapes)
    assert top - data.site("left_sole").xpos[2] == pytest.approx(scene.robot.height_m, abs=0.02)


def test_every_joint_is_limited_and_the_two_legs_are_mirror_images(scene):
    joints, ranges = scene.robot.joints, joint_ranges(scene)
    half = len(joints) // 2
    assert all(scene.model.joint(joint.name).limited for joint in joints)
    assert (ranges[:, 0] < ranges[:, 1]).all()
    for left, right, of_left, of_right in zip(
        joints[:half], joints[half:], ranges[:half], ranges[half:], strict=True
    ):
        mirrored = of_left if left.mirror_sign > 0 else -of_left[::-1]
        assert of_right == pytest.approx(mirrored, abs=1e-6), right.name
        for field in ("kp", "kd", "torque_limit_nm", "speed_limit_rad_s", "armature_kg_m2"):
            assert getattr(left, field) == getattr(right, field) > 0
        assert right.half_sitting_rad == left.mirror_sign * left.half_sitting_rad


def test_joints_of_a_leg_lie_in_its_own_body(scene):
    half = len(scene.robot.joints) // 2
    for k, joint in enumerate(scene.robot.joints):
        body = int(scene.model.joint(joint.name).bodyid[0])
        while scene.model.body(body).name not in ("left_leg", "right_leg"):
            assert body > 0, f"{joint.name} is in no leg"
            body = int(scene.model.body_parentid[body])
        assert scene.model.body(body).name == f"{SIDES[k // half]}_leg"


def planned_steps(scene: Scene) -> list[tuple[float, float, float]]:
    """The step set and the corners of the limits."""
    model = scene.robot.step_model
    corners = itertools.product(model.limits.x_m, model.limits.y_m, model.limits.yaw_rad)
    within = [corner for corner in corners if model.limits.contain(corner)]
    vertices = ((*at, yaw) for at in model.limits.reach_m for yaw in model.limits.yaw_rad)
    within += [vertex for vertex in vertices if model.limits.contain(vertex)]
    return [*model.steps, *within]


def posture_over(scene: Scene, feet_world: np.ndarray) -> mujoco.MjData:
    """Both soles flat on the poses (2, 4), pelvis midway at its walking height.

    Inverse kinematics by damped least squares on MuJoCo's Jacobians, one leg after the other,
    blind to joint ranges: with six joints to a leg there is one posture near half-sitting. Legs of
    five joints have no ankle roll: their soles lean as the legs do, by `LEAN_RAD` at most.
    """
    model, data = scene.model, mujoco.MjData(scene.model)
    middle = feet_world.mean(axis=0)
    data.qpos[:] = scene.qpos_at(middle[[0, 1, 3]])
    half = len(scene.robot.joints) // 2
    to_soles = np.full((2, 6), np.inf)
    for _ in range(30):
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        for k, side in enumerate(SIDES):
            site = model.site(f"{side}_sole").id
            joints = slice(k * half, (k + 1) * half)
            jacobian = np.zeros((6, model.nv))
            mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], site)
            # All in the foot's own axes: position, roll, pitch, yaw.
            along = np.kron(np.eye(2), data.site_xmat[site].reshape(3, 3).T)
            to_soles[k] = along @ to_pose(data, site, feet_world[k])
            jacobian = along @ jacobian[:, scene.joint_qvel[joints]]
            task = [0, 1, 2, 4, 5] if half == 5 else range(6)
            damped = jacobian[task] @ jacobian[task].T + 1e-6 * np.eye(half)
            move = jacobian[task].T @ np.linalg.solve(damped, to_soles[k, task])
            data.qpos[scene.joint_qpos[joints]] += 0.5 * move
    off = np.abs(to_soles) - ([0, 0, 0, LEAN_RAD, 0, 0] if half == 5 else 0)
    assert off.max() < 1e-4, f"no posture over {feet_world}: off by {to_soles}"
    mujoco.mj_forward(model, data)
    return data


def to_pose(data: mujoco.MjData, site: int, pose: np.ndarray) -> np.ndarray:
    """Way (6,) in m and rad from the site to the level pose x, y, z, yaw."""
    cos, sin = np.cos(pose[3]), np.sin(pose[3])
    level = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    quat, turn = np.empty(4), np.empty(3)
    mujoco.mju_mat2Quat(quat, (level @ data.site_xmat[site].reshape(3, 3).T).ravel())
    mujoco.mju_quat2Vel(turn, quat, 1.0)
    return np.concatenate([pose[:3] - data.site_xpos[site], turn])


@pytest.mark.parametrize("swing", [0, 1])
def test_legs_reach_every_step_within_their_joints_ranges(scene, swing):
    ranges, steps = joint_ranges(scene), planned_steps(scene)
    for step in steps:
        x, y, yaw = step
        feet = np.zeros((2, 4))
        outward = 1 - 2 * swing
        feet[swing] = [x, outward * y, 0, outward * yaw]
        data = posture_over(scene, feet)
        angles = data.qpos[scene.joint_qpos]
        spare = np.minimum(angles - ranges[:, 0], ranges[:, 1] - angles)
        worst = int(spare.argmin())
        assert spare[worst] >= SPARE_RAD, f"{step}: {scene.robot.joints[worst].name}"
        assert data.sensordata[scene.sensors.legs_touching] == 0, f"{step}: the legs touch"
    assert len(steps) > 8


def test_reach_has_an_end():
    """The check would fail for steps that are too long, or too far across."""
    scene = build_scene(get_robot("jvrc1"), timestep_s=0.001)
    with pytest.raises(AssertionError, match="no posture"):
        posture_over(scene, np.array([[1.5, 0.1, 0, 0], [0, -0.1, 0, 0]]))
    data = posture_over(scene, np.array([[0, 0.02, 0, 0], [0, -0.02, 0, 0]]))
    assert data.sensordata[scene.sensors.legs_touching] > 0


def test_robot_whose_package_is_missing_is_left_out_and_says_what_to_install(monkeypatch):
    robot = replace(get_robot("jvrc1"), needs=("no_such_module_at_all", "some_extra"))
    monkeypatch.setattr(sim.robots.jvrc1, "ROBOT", robot)
    assert "jvrc1" not in robot_names()
    assert "hrp5p" in robot_names()
    with pytest.raises(
        ValueError, match=r"'jvrc1' needs .* python -m pip .*\[some_extra\]"
    ) as told:
        get_robot("jvrc1")
    assert "\n" not in str(told.value)
