"""States of a robot in its scene: at rest, in the mirror, and how far its shapes reach."""

from __future__ import annotations

import mujoco
import numpy as np

from sim.scene import Scene


def standing(scene: Scene, *, sunk_m: float = 0.0) -> mujoco.MjData:
    """Half-sitting, with all that MuJoCo computes of it."""
    data = mujoco.MjData(scene.model)
    data.qpos[:] = scene.standing_qpos
    data.qpos[2] -= sunk_m
    mujoco.mj_forward(scene.model, data)
    return data


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
