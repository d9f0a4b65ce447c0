"""How far a walking body reaches beyond the boxes that its plan was checked with.

The planner keeps a box around each pair of feet off the walls, grown by `body_margin_m`. A body
sways beyond that box; the margin must cover how far.
"""

from __future__ import annotations

import mujoco
import numpy as np

from planner.plan import pair_pose
from planner.robot_model import BodyShape
from sim.robot import PHYSICS_GROUP
from sim.scene import Scene

FEET = ("left_foot", "right_foot")


class Reach:
    """Measures the reach of every collision shape above the feet, robot by robot."""

    def __init__(self, scene: Scene, body: BodyShape):
        self._model, self._body = scene.model, body
        self._data = mujoco.MjData(scene.model)
        model = scene.model
        self._geoms = [
            k
            for k in range(model.ngeom)
            if model.geom_group[k] == PHYSICS_GROUP and model.geom(k).name not in FEET
        ]
        self.names = [model.geom(k).name for k in self._geoms]

    def beyond_m(self, qpos: np.ndarray, stances: np.ndarray) -> np.ndarray:
        """How far each shape (G,) leaves the nearest of some boxes; negative is within.

        Args:
            qpos: the robot's state (nq,).
            stances: both feet (n, 2, 4) of each stance that the plan was checked at nearby.
        """
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        return np.min([self._beyond_box(pair_pose(feet)) for feet in stances], axis=0)

    def _beyond_box(self, pose: np.ndarray) -> np.ndarray:
        """How far each shape (G,) leaves the box at a pair pose (3,), along its farther axis."""
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        axes = np.array([[cos, sin, 0.0], [-sin, cos, 0.0]])
        half = np.array([self._body.length_m, self._body.width_m]) / 2
        offset = self._data.geom_xpos[self._geoms] - [pose[0], pose[1], 0.0]
        centre = np.abs(offset @ axes.T)
        turned = np.abs(
            self._data.geom_xmat[self._geoms].reshape(-1, 3, 3).transpose(0, 2, 1) @ axes.T
        )
        reach = [half_extent(self._model, k, turned[i]) for i, k in enumerate(self._geoms)]
        return np.asarray((centre + np.array(reach) - half).max(axis=1))


def half_extent(model: mujoco.MjModel, geom: int, direction: np.ndarray) -> np.ndarray:
    """Half the width (n,) of a shape along directions (3, n) given in its own axes, absolute.

    Exact for spheres, capsules and boxes; of others the bounding box is taken.
    """
    size, kind = model.geom_size[geom], model.geom_type[geom]
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return np.full(direction.shape[1], size[0])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return size[0] + size[1] * direction[2]
    centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
    return (np.abs(centre) + half) @ direction
