"""Arrows that stand for poses: where the robot goes, where it is wished, what was refused."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import viser

from app.pictures.canvas import GOAL
from app.viewer.map_scene import turned
from app.viewer.markers import Rgb
from app.viewer.snapshot import Snapshot
from planner.plan import Pose

# The pictures of plans have the same colour, written blue, green, red.
GOAL_RGB: Rgb = GOAL[::-1]
_PALE_RGB = (240, 170, 160)
_REFUSED_RGB = (105, 108, 115)
# As the button that takes what is on offer.
_OFFER_RGB = (253, 126, 20)
_ABOVE_M = 0.04
_LABEL_M = (0.18, 0.0, 0.12)


class Marker:
    """An arrow that stands for a pose, with a word if there is one."""

    def __init__(
        self,
        scene: viser.SceneApi,
        name: str,
        rgb: Rgb = GOAL_RGB,
        *,
        word: str = "",
        height_m: Callable[[Sequence[float]], float],
    ) -> None:
        """`height_m` of a pose is that of what it lies on."""
        self._height_m = height_m
        self._arrow = scene.add_arrows(
            name,
            points=np.array([[[-0.05, 0, 0.0], [0.4, 0, 0.0]]], np.float32),
            colors=rgb,
            shaft_radius=0.025,
            head_radius=0.07,
            head_length=0.14,
            visible=False,
        )
        if word:
            scene.add_label(f"{name}/word", word, position=_LABEL_M, anchor="bottom-center")

    def show(self, pose: Sequence[float] | None) -> None:
        """Puts it at the pose x_m, y_m, yaw_rad; None hides it."""
        self._arrow.visible = pose is not None
        if pose is not None:
            self._arrow.position = (pose[0], pose[1], self._height_m(pose) + _ABOVE_M)
            self._arrow.wxyz = turned(pose[2])


class Signs:
    """The arrows of a page. `height_m` of a pose is that of floor, wall or box there."""

    def __init__(self, scene: viser.SceneApi, height_m: Callable[[Sequence[float]], float]) -> None:
        self._goal = Marker(scene, "/goal", height_m=height_m)
        self._wished = Marker(scene, "/wished", _PALE_RGB, height_m=height_m)
        self._refused = Marker(scene, "/refused", _REFUSED_RGB, word="refused", height_m=height_m)
        self._offer = Marker(scene, "/offer", _OFFER_RGB, word="nearest free", height_m=height_m)
        self._pointed: Pose | None = None
        self._shown: tuple[Pose | None, ...] = (None,) * 4

    def point(self, pose: Pose | None) -> None:
        """Shows what somebody points at before it is set; None when they have let go."""
        self._pointed = pose

    def show(self, snapshot: Snapshot) -> None:
        """Shows what holds; what has not changed is left alone."""
        notice = snapshot.notice
        refused, offer = (None, None) if notice is None else (notice.refused, notice.offer)
        new = snapshot.goal, self._pointed or snapshot.wished, refused, offer
        markers = self._goal, self._wished, self._refused, self._offer
        for marker, pose, before in zip(markers, new, self._shown, strict=True):
            if pose != before:
                marker.show(pose)
        self._shown = new
