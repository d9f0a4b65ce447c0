"""The robot in a viser scene: one node for each moving body."""

from __future__ import annotations

import math

import numpy as np
import viser
from numpy.typing import ArrayLike

from app.viewer.robot_scene import Look

ROOT = "/robot"


class Figure:
    """The robot as drawn; `pose` moves it. A robot drawn before under the same name goes."""

    def __init__(self, scene: viser.SceneApi, look: Look) -> None:
        self._look = look
        self._root = scene.add_frame(ROOT, show_axes=False)
        self._bodies = []
        self._posed = np.zeros(0)
        for name, parts in zip(look.names, look.parts, strict=True):
            self._bodies.append(scene.add_frame(f"{ROOT}/{name}", show_axes=False))
            for index, part in enumerate(parts):
                scene.add_mesh_simple(
                    f"{ROOT}/{name}/{index}",
                    part.vertices_m.astype(np.float32),
                    part.faces.astype(np.uint32),
                    color=part.rgb,
                    side="double",
                )

    @property
    def length(self) -> int:
        """How many numbers a state of this robot has."""
        return int(self._look.model.nq)

    def pose(self, qpos: np.ndarray) -> None:
        """Puts every body where it is at qpos (nq,); nothing is to do where it is already."""
        if np.array_equal(qpos, self._posed):
            return
        self._posed = np.array(qpos)
        positions, quaternions = self._look.poses(qpos)
        for body, position, wxyz in zip(self._bodies, positions, quaternions, strict=True):
            body.position = position.round(4)
            body.wxyz = wxyz.round(5)

    def met_after_m(self, origin: ArrayLike, direction: ArrayLike) -> float:
        """How far from its origin (3,) a ray meets the robot as drawn; infinite if it does not."""
        if not len(self._posed):
            return math.inf
        return self._look.met_after_m(self._posed, origin, direction)

    def remove(self) -> None:
        """Takes the robot out of the scene."""
        self._root.remove()
