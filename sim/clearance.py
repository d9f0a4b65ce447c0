"""Clearance between robot and walls, measured on MuJoCo's geoms."""

from __future__ import annotations

import mujoco
import numpy as np

from sim.scene import Scene

FAR_M = 1.0


def min_clearance_m(scene: Scene, qpos: np.ndarray) -> float | None:
    """Least distance in m between any robot geom and any wall over the states qpos (T, nq).

    Walls farther than `FAR_M` from the robot are ignored; None when all are.
    """
    model = scene.model
    data = mujoco.MjData(model)
    walls, robot = _wall_geoms(model), _robot_geoms(model)
    least = FAR_M
    fromto = np.zeros(6)
    for state in qpos:
        data.qpos[:] = state
        mujoco.mj_kinematics(model, data)
        for geom in robot:
            reach = least + model.geom_rbound[geom]
            offset = np.abs(_in_wall_frame(model, data.geom_xpos[geom]) - model.geom_pos[walls])
            gap = np.linalg.norm(np.maximum(offset - model.geom_size[walls], 0.0), axis=1)
            for wall in walls[gap < reach]:
                distance = mujoco.mj_geomDistance(model, data, geom, int(wall), least, fromto)
                least = min(least, distance)
    return None if least >= FAR_M else float(least)


def _wall_geoms(model: mujoco.MjModel) -> np.ndarray:
    return np.flatnonzero(model.geom_bodyid == model.body("walls").id)


def _robot_geoms(model: mujoco.MjModel) -> np.ndarray:
    """Collision geoms of the robot: those below the pelvis that can touch anything."""
    root = model.body("pelvis").id
    mine = model.body_rootid[model.geom_bodyid] == root
    return np.flatnonzero(mine & (model.geom_conaffinity > 0))


def _in_wall_frame(model: mujoco.MjModel, point_world: np.ndarray) -> np.ndarray:
    """The point (3,) in the frame of the walls' body, in which wall boxes are axis-aligned."""
    body = model.body("walls")
    conjugate, local = np.empty(4), np.empty(3)
    mujoco.mju_negQuat(conjugate, body.quat)
    mujoco.mju_rotVecQuat(local, point_world - body.pos, conjugate)
    return local
