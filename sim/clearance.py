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
    body = model.body("walls")
    walls = np.flatnonzero(model.geom_bodyid == body.id)
    # Collision geoms of the robot: those below the pelvis that can touch anything.
    mine = model.body_rootid[model.geom_bodyid] == model.body("pelvis").id
    robot = np.flatnonzero(mine & (model.geom_conaffinity > 0))
    to_walls, local = np.empty(4), np.empty(3)
    mujoco.mju_negQuat(to_walls, body.quat)
    least = FAR_M
    fromto = np.zeros(6)
    for state in qpos:
        data.qpos[:] = state
        mujoco.mj_kinematics(model, data)
        for geom in robot:
            # In the frame of the walls' body, in which wall boxes are axis-aligned.
            mujoco.mju_rotVecQuat(local, data.geom_xpos[geom] - body.pos, to_walls)
            reach = least + model.geom_rbound[geom]
            offset = np.abs(local - model.geom_pos[walls])
            gap = np.linalg.norm(np.maximum(offset - model.geom_size[walls], 0.0), axis=1)
            for wall in walls[gap < reach]:
                distance = mujoco.mj_geomDistance(model, data, geom, int(wall), least, fromto)
                least = min(least, distance)
    return None if least >= FAR_M else float(least)
