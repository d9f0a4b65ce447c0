"""A robot, its policy and a hall to walk in; states in a scene: at rest, mirrored, over feet."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

import mujoco
import numpy as np

from controller.policy import load_policy
from maps.grid import OccupancyGrid
from sim.robots import get_robot
from sim.scene import Scene
from sim.sensors import SIDES

ROBOT = get_robot("jvrc1")
POLICY = load_policy(ROBOT)
# An empty hall of 8 by 6 m, with the start near its left end.
HALL = OccupancyGrid(cells=np.zeros((120, 160), np.uint8), resolution_m=0.05, origin=(-2, -3, 0))
WAIT_LIMIT_S = 300.0
T = TypeVar("T")


def wait_until(wanted: Callable[[], T], what: str = "") -> T:
    """What `wanted` returns as soon as that is true; fails after long."""
    until_s = time.monotonic() + WAIT_LIMIT_S
    while not (found := wanted()):
        assert time.monotonic() < until_s, f"waited {WAIT_LIMIT_S} s in vain {what}"
        time.sleep(0.01)
    return found


def state_at(scene: Scene, qpos: np.ndarray) -> mujoco.MjData:
    """A state with all that MuJoCo computes of it."""
    data = mujoco.MjData(scene.model)
    data.qpos[:] = qpos
    mujoco.mj_forward(scene.model, data)
    return data


def standing(scene: Scene, *, sunk_m: float = 0.0) -> mujoco.MjData:
    """Half-sitting, lower by so much."""
    qpos = scene.standing_qpos.copy()
    qpos[2] -= sunk_m
    return state_at(scene, qpos)


def mirrored_qpos(scene: Scene, qpos: np.ndarray) -> np.ndarray:
    """The state seen in a mirror that lies in the plane y = 0."""
    index, sign = scene.robot.mirror_joints
    mirrored = qpos.copy()
    mirrored[1] *= -1
    mirrored[[4, 6]] *= -1
    mirrored[scene.joint_qpos] = sign * qpos[scene.joint_qpos][index]
    return mirrored


def mirrored_qvel(scene: Scene, qvel: np.ndarray) -> np.ndarray:
    index, sign = scene.robot.mirror_joints
    mirrored = qvel.copy()
    mirrored[[1, 3, 5]] *= -1
    mirrored[scene.joint_qvel] = sign * qvel[scene.joint_qvel][index]
    return mirrored


def reach_m(scene: Scene, data: mujoco.MjData, geom: int) -> np.ndarray:
    """Half extents (3,) along the world's axes of a collision shape about its centre."""
    turn, size = np.abs(data.geom_xmat[geom].reshape(3, 3)), scene.model.geom_size[geom]
    kind = mujoco.mjtGeom(scene.model.geom_type[geom])
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return turn @ size
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return np.full(3, size[0])
    assert kind == mujoco.mjtGeom.mjGEOM_CAPSULE, f"{scene.model.geom(geom).name} is a {kind.name}"
    return turn[:, 2] * size[1] + size[0]


# In a step, legs without ankle roll lean by this much at most.
LEAN_RAD = np.radians(8.0)


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
