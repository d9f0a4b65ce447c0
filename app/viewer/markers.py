"""Footprints, the path of the body and arrows at goals in a viser scene."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import viser

from app.pictures.canvas import GOAL, LEFT, RIGHT
from app.viewer.scene import FLOOR_RGB, Rgb, blended, turned
from app.viewer.sheet import Sheet
from app.viewer.snapshot import Snapshot
from maps.grid import OccupancyGrid
from planner.plan import FootstepPlan, Pose
from planner.robot_model import FootShape, Side

# The pictures of plans have the same colours, written blue, green, red.
SIDE_RGB: dict[Side, Rgb] = {Side.LEFT: LEFT[::-1], Side.RIGHT: RIGHT[::-1]}
GOAL_RGB: Rgb = GOAL[::-1]
PATH_RGB: Rgb = (112, 60, 150)
_PALE_RGB = (240, 170, 160)
_REFUSED_RGB = (105, 108, 115)
# As the button that takes what is on offer.
_ALTERNATIVE_RGB = (253, 126, 20)
PATH_WIDTH_M = 0.025
# Above one another, so that no two fight for the same pixels.
_PLANNED_Z_M, _PATH_Z_M, _PLACED_Z_M, _NEXT_Z_M = 0.005, 0.008, 0.011, 0.014
_EDGE_M = 0.016
_ARROW_Z_M = 0.04
_WORD_M = (0.18, 0.0, 0.12)
_NO_STEPS = np.zeros(0, np.int8), np.zeros((0, 4))


class Footprints:
    """Footprints on the floor: planned (pale), the next two (full), placed (their edges)."""

    def __init__(self, scene: viser.SceneApi, grid: OccupancyGrid, foot: FootShape) -> None:
        self._scene, self._grid = scene, grid
        self._sheets: dict[str, Sheet] = {}
        length_m, width_m = foot.length_m, foot.width_m
        x_m, y_m = (length_m - _EDGE_M) / 2, (width_m - _EDGE_M) / 2
        plate = _rectangles((0, 0, length_m, width_m))
        edge = _rectangles(
            (0, y_m, length_m, _EDGE_M),
            (0, -y_m, length_m, _EDGE_M),
            (x_m, 0, _EDGE_M, width_m),
            (-x_m, 0, _EDGE_M, width_m),
        )
        # Of each kind its rectangles in the frame of a foot, height, and how pale it is.
        self._looks = {
            "planned": (plate, _PLANNED_Z_M, 0.35),
            "next": (plate, _NEXT_Z_M, 0.0),
            "placed": (edge, _PLACED_Z_M, 0.0),
        }

    def clear(self) -> None:
        """Takes all footprints away, and the path."""
        self.plan(None)
        self.placed(*_NO_STEPS)
        self.path(np.zeros((0, 2)))

    def plan(self, plan: FootstepPlan | None, done: int = 0) -> None:
        """Shows the steps of a plan after the first `done`; the next two are those in full."""
        side, pose_world = _NO_STEPS if plan is None else (plan.side, plan.pose_world)
        near, far = slice(done, done + 2), slice(done + 2, None)
        self._show("planned", side[far], pose_world[far])
        self._show("next", side[near], pose_world[near])

    def placed(self, side: np.ndarray, pose_world: np.ndarray) -> None:
        """Shows where feet came to rest: side (N,), pose_world (N, 4) x, y, z, yaw."""
        self._show("placed", side, pose_world)

    def path(self, xy_world: np.ndarray) -> None:
        """Shows where the body was: points (T, 2)."""
        along = np.diff(xy_world, axis=0)
        length = np.linalg.norm(along, axis=1)
        moved = length > 1e-4
        across = np.column_stack([-along[:, 1], along[:, 0]])[moved] / length[moved, None]
        across *= PATH_WIDTH_M / 2
        begin, end = xy_world[:-1][moved], xy_world[1:][moved]
        corners = np.stack([begin + across, begin - across, end - across, end + across], axis=1)
        # Each piece lies on the higher floor of its ends, so that no step hides it.
        ground_m = np.maximum(self._grid.height_m(begin), self._grid.height_m(end))
        self._sheet("/path", _PATH_Z_M, PATH_RGB).show(corners, ground_m)

    def _show(self, kind: str, side: np.ndarray, pose_world: np.ndarray) -> None:
        shape, height_m, paleness = self._looks[kind]
        for foot in Side:
            poses = pose_world[np.asarray(side) == foot]
            cos, sin = np.cos(poses[:, 3]), np.sin(poses[:, 3])
            turn = np.stack([np.stack([cos, sin], -1), np.stack([-sin, cos], -1)], axis=1)
            corners = np.einsum("rki,nij->nrkj", shape, turn) + poses[:, None, None, :2]
            rgb = blended(SIDE_RGB[foot], FLOOR_RGB, paleness)
            sheet = self._sheet(f"/steps/{kind}_{foot.name.lower()}", height_m, rgb)
            sheet.show(corners, np.repeat(poses[:, 2], len(shape)))

    def _sheet(self, name: str, height_m: float, rgb: Rgb) -> Sheet:
        if name not in self._sheets:
            self._sheets[name] = Sheet(self._scene, name, height_m, rgb)
        return self._sheets[name]


def _rectangles(*rectangles: tuple[float, float, float, float]) -> np.ndarray:
    """Corners (n, 4, 2), counter-clockwise; of each rectangle: middle x, y and extents in x, y."""
    boxes = np.array(rectangles)[:, None]
    return boxes[..., :2] + np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) / 2 * boxes[..., 2:]


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
        self._word: viser.LabelHandle | None = None
        if word:
            self._word = scene.add_label(
                f"{name}/word", word, position=_WORD_M, anchor="bottom-center"
            )

    def show(self, pose: Sequence[float] | None) -> None:
        """Puts it at the pose x_m, y_m, yaw_rad; None hides it."""
        self._arrow.visible = pose is not None
        if pose is not None:
            self._arrow.position = (pose[0], pose[1], self._height_m(pose) + _ARROW_Z_M)
            self._arrow.wxyz = turned(pose[2])

    def hang_word(self, *, is_below: bool) -> None:
        """Writes its word below it, or as usual above."""
        if self._word is not None:
            x_m, y_m, z_m = _WORD_M
            self._word.anchor = "top-center" if is_below else "bottom-center"
            self._word.position = (x_m, y_m, -z_m / 4 if is_below else z_m)

    def say(self, word: str) -> None:
        """Writes another word at it, if it has one."""
        if self._word is not None:
            self._word.text = word


def is_above(pose: Pose, other: Pose, height_m: Callable[[Sequence[float]], float]) -> bool:
    """Whether a pose is seen above another one from the south and above, as when a page begins."""
    return pose[1] + height_m(pose) > other[1] + height_m(other)


class PoseMarkers:
    """The arrows of a page. `height_m` of a pose is that of floor, wall or box there."""

    def __init__(self, scene: viser.SceneApi, height_m: Callable[[Sequence[float]], float]) -> None:
        self._height_m = height_m
        self._markers = (
            Marker(scene, "/goal", height_m=height_m),
            Marker(scene, "/requested", _PALE_RGB, height_m=height_m),
            Marker(scene, "/refused", _REFUSED_RGB, word="refused", height_m=height_m),
            Marker(scene, "/alternative", _ALTERNATIVE_RGB, word="nearest free", height_m=height_m),
        )
        self._pointed: Pose | None = None
        self._shown: tuple[Pose | None, ...] = (None,) * 4

    def point(self, pose: Pose | None) -> None:
        """Shows what somebody points at before it is set; None when they have let go."""
        self._pointed = pose

    def show(self, snapshot: Snapshot) -> None:
        """Shows what holds; what has not changed is left alone."""
        notice = snapshot.notice
        told = (None, None) if notice is None else (notice.refused, notice.alternative)
        refused, alternative = told
        if notice is not None and notice.waypoint is not None:
            told = None, alternative  # its own arrow says that it is refused
        new = snapshot.goal, self._pointed or snapshot.requested, *told
        for marker, pose, before in zip(self._markers, new, self._shown, strict=True):
            if pose != before:
                marker.show(pose)
        if new != self._shown and refused is not None and alternative is not None:
            # So neither word covers the other.
            is_upper = is_above(refused, alternative, self._height_m)
            self._markers[2].hang_word(is_below=not is_upper)
            self._markers[3].hang_word(is_below=is_upper)
        self._shown = new
