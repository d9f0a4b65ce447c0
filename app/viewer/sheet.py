"""Rectangles on the floor of a viser scene."""

from __future__ import annotations

import numpy as np
import viser

from app.viewer.scene import Rgb, quad_faces

_OUT_OF_SIGHT_M = -1.0
# Rectangles that a mesh has room for at first.
_ROOM = 128


class Sheet:
    """Rectangles on the floor as one mesh with room for more.

    Only its vertices are ever sent anew, those that are not needed all at one point: a browser
    that gets a node of the same name again may show the old one for long, or none.
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        name: str,
        height_m: float,
        rgb: Rgb,
        *,
        opacity: float | None = None,
    ) -> None:
        """Sheets lie `height_m` above the floor."""
        self._scene, self._name, self._height_m, self._rgb = scene, name, height_m, rgb
        self._opacity, self._room = opacity, 0
        self._mesh: viser.MeshHandle | None = None

    def show(self, corners: np.ndarray, ground_m: np.ndarray) -> None:
        """Shows rectangles with corners (..., 4, 2), counter-clockwise in the world.

        ground_m (n,): the height of the floor on which each of them lies.
        """
        xy = corners.reshape(-1, 2)
        needed = len(xy) // 4
        if self._mesh is None or needed > self._room:
            self._room = max(_ROOM, 2 * needed)
            self._mesh = self._scene.add_mesh_simple(
                self._name,
                np.zeros((4 * self._room, 3), np.float32),
                quad_faces(self._room).astype(np.uint32),
                color=self._rgb,
                opacity=self._opacity,
                side="double",
                cast_shadow=False,
            )
        vertices = np.zeros((4 * self._room, 3), np.float32)
        vertices[:, 2] = _OUT_OF_SIGHT_M
        vertices[: len(xy), :2] = xy
        vertices[: len(xy), 2] = np.repeat(ground_m, 4) + self._height_m
        self._mesh.vertices = vertices
