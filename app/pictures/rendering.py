"""Frames of a recorded walk: camera, footprints on the floor, obstacles in the way cut away."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from app.pictures.canvas import LEFT, RIGHT, Colour, FloatArray, Picture
from app.pictures.line_of_sight import (
    Boxes,
    eye_position,
    fixed_boxes,
    hides,
    obstacles_of,
    points_to_see,
)
from planner.plan import FootstepPlan
from planner.robot_model import FootShape, Side
from sim.gl import NoGlError
from sim.robot import PHYSICS_GROUP, VISUAL_GROUP

if TYPE_CHECKING:
    import mujoco

    from app.navigation.placed import Placed

# Height of what is left of an obstacle that is cut away, so that one sees where it stands.
STUMP_M = 0.06
# Footprints: planned ones below placed ones, so that no two fight for the same pixels. Pale ones
# are mixed with white: glassy ones would lie in a shadow that they cast themselves, and look dark.
PALE = 0.4
_PLANNED_THICKNESS_M, _PLACED_THICKNESS_M = 0.004, 0.007
# Light from the sky lies in shadows too and on sides that the sun does not reach; the headlight is
# at the camera. What a level floor gets from all three comes to about 1.
_SKY, _HEADLIGHT, _SUN, _SHINE = 0.5, 0.25, 0.45, 0.1
# Shadows are drawn within this distance of what the camera looks at, so that the shadow map is
# fine there: spread over a whole map it is coarse, and walls get dark dashes along their edges.
_SHADOWS_M = 6.0


@dataclass(frozen=True, kw_only=True)
class Footmark:
    """A footprint on the floor of films and strips, shown from from_s until before until_s.

    pose_world (4,): x, y, z, yaw of the ground below it. It is pale unless a foot has been placed.
    """

    foot: FootShape
    side: Side
    pose_world: FloatArray
    is_placed: bool
    from_s: float
    until_s: float = math.inf


def add_footmarks(scene: mujoco.MjvScene, marks: Sequence[Footmark], time_s: float) -> None:
    """Adds those that are shown at this time, as plates, to a scene that is about to be drawn."""
    import mujoco

    for mark in marks:
        if scene.ngeom >= scene.maxgeom or not mark.from_s <= time_s < mark.until_s:
            continue
        x_m, y_m, z_m, yaw_rad = mark.pose_world
        cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
        half_m = (_PLACED_THICKNESS_M if mark.is_placed else _PLANNED_THICKNESS_M) / 2
        # The colours of plans' pictures are written blue, green, red.
        colour = LEFT if mark.side is Side.LEFT else RIGHT
        colour = shade(colour[::-1], is_pale=not mark.is_placed)
        mujoco.mjv_initGeom(
            scene.geoms[scene.ngeom],
            mujoco.mjtGeom.mjGEOM_BOX.value,
            np.array([mark.foot.length_m / 2, mark.foot.width_m / 2, half_m]),
            np.array([x_m, y_m, z_m + half_m]),
            np.array([cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0]),
            np.array([*(value / 255 for value in colour), 1.0], np.float32),
        )
        scene.ngeom += 1


def shade(colour: Colour, *, is_pale: bool) -> Colour:
    """The colour of a footprint and of its legend: as it is, or mixed with white."""
    share = PALE if is_pale else 1.0
    first, second, third = (round(share * value + (1 - share) * 255) for value in colour)
    return first, second, third


def footmarks_of(
    foot: FootShape,
    followed: Sequence[tuple[float, FootstepPlan]],
    placed: Sequence[Placed],
) -> list[Footmark]:
    """The marks of a walk: pale ones for steps that lie ahead, full ones where feet came to rest.

    followed: the plans with the times at which they were taken up, in order.
    """
    marks = []
    ends = [*(begun_s for begun_s, _ in followed[1:]), np.inf]
    for (begun_s, plan), end_s in zip(followed, ends, strict=False):
        taken = [step.time_s for step in placed if begun_s < step.time_s <= end_s]
        # A step whose foot has come down gives way to the print of it.
        until = [*taken, *[end_s] * len(plan)]
        for side, pose, until_s in zip(plan.side, plan.pose_world, until, strict=False):
            marks.append(
                Footmark(
                    foot=foot,
                    side=Side(int(side)),
                    pose_world=pose,
                    is_placed=False,
                    from_s=begun_s,
                    until_s=until_s,
                )
            )
    for step in placed:
        pose, from_s = step.placed_world, step.time_s
        marks.append(
            Footmark(foot=foot, side=step.side, pose_world=pose, is_placed=True, from_s=from_s)
        )
    return marks


@dataclass(frozen=True, kw_only=True)
class Recording:
    """A walk as it happened: qpos (T, nq) of the model at the times time_s (T,), in order.

    ground_m (T,), or one for all: height of the ground below the robot.
    """

    qpos: FloatArray
    time_s: NDArray[np.floating]
    ground_m: FloatArray | float = 0.0

    def __post_init__(self) -> None:
        if np.shape(self.ground_m) not in ((), self.time_s.shape):
            raise ValueError(f"ground_m {np.shape(self.ground_m)} must be as time_s")
        if self.qpos.ndim != 2 or self.time_s.shape != self.qpos.shape[:1]:
            raise ValueError(
                f"qpos {self.qpos.shape} must be (T, nq) with T as in time_s {self.time_s.shape}"
            )
        if len(self.time_s) == 0:
            raise ValueError("a recording needs at least one moment")

    def nearest(self, times_s: FloatArray) -> NDArray[np.intp]:
        """Indices of the moments nearest to the times (N,)."""
        after = np.clip(np.searchsorted(self.time_s, times_s), 1, max(1, len(self.time_s) - 1))
        before = after - 1
        after = np.minimum(after, len(self.time_s) - 1)
        is_before = times_s - self.time_s[before] <= self.time_s[after] - times_s
        return np.where(is_before, before, after)


def resampled(recording: Recording, times_s: FloatArray) -> Recording:
    """The walk at other times (N,), between its moments by straight lines; no place is jumped."""
    after = np.clip(np.searchsorted(recording.time_s, times_s), 1, len(recording.time_s) - 1)
    if len(recording.time_s) < 2:
        after = np.zeros(len(times_s), np.intp)
    before = np.maximum(after - 1, 0)
    span_s = np.maximum(recording.time_s[after] - recording.time_s[before], 1e-9)
    share = np.clip((times_s - recording.time_s[before]) / span_s, 0, 1)
    first, last = recording.qpos[before], recording.qpos[after].copy()
    # Both signs of a quaternion are the same rotation.
    last[:, 3:7] *= np.where((first[:, 3:7] * last[:, 3:7]).sum(axis=1) < 0, -1, 1)[:, None]
    qpos = first + share[:, None] * (last - first)
    qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
    ground_m = np.broadcast_to(recording.ground_m, recording.time_s.shape)
    return Recording(
        qpos=qpos, time_s=times_s, ground_m=np.where(share < 0.5, ground_m[before], ground_m[after])
    )


@dataclass(frozen=True, kw_only=True)
class View:
    """Where the camera is, as seen from the robot.

    The camera looks at the robot in the direction that lies azimuth_deg to the left of the
    robot's heading and elevation_deg above level: 0 is from behind, 90 from the robot's right.
    Robot and heading are averaged over smooth_s, so that the picture does not sway with the gait.
    """

    distance_m: float = 3.2
    azimuth_deg: float = 35.0
    elevation_deg: float = -22.0
    height_m: float = 0.75
    smooth_s: float = 1.5


FOLLOW = View()
SIDE = View(distance_m=3.0, azimuth_deg=90.0, elevation_deg=-8.0, smooth_s=0.6)


@dataclass(frozen=True, kw_only=True)
class CameraPath:
    """lookat_m (T, 3) and azimuth_deg (T,) of the camera at each moment of a recording."""

    lookat_m: FloatArray
    azimuth_deg: FloatArray


def camera_path(recording: Recording, view: View) -> CameraPath:
    """The smooth path of a camera that stays with the robot.

    Assumes that qpos begins with the free joint of the robot: position, then w, x, y, z.
    """
    w, x, y, z = recording.qpos[:, 3:7].T
    yaw_rad = np.unwrap(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
    ground_m = np.broadcast_to(recording.ground_m, yaw_rad.shape)
    place_m = np.column_stack([recording.qpos[:, :2], yaw_rad, ground_m])
    smooth = _smooth(place_m, recording.time_s, view.smooth_s)
    return CameraPath(
        lookat_m=np.column_stack([smooth[:, :2], smooth[:, 3] + view.height_m]),
        azimuth_deg=np.degrees(smooth[:, 2]) + view.azimuth_deg,
    )


def _smooth(values: FloatArray, time_s: NDArray[np.floating], width_s: float) -> FloatArray:
    """Values (T, n) averaged by a bell curve of this width; the ends count as if they went on."""
    if len(values) < 2 or width_s <= 0:
        return values
    step_s = float(np.median(np.diff(time_s)))
    sigma = width_s / 2 / step_s
    reach = int(3 * sigma) + 1
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    weights /= weights.sum()
    padded = np.pad(values, ((reach, reach), (0, 0)), mode="edge")
    return np.column_stack([np.convolve(column, weights, mode="valid") for column in padded.T])


class Drawer:
    """Draws moments of one recording; made by `drawing`, which also frees what it holds."""

    def __init__(
        self,
        renderer: mujoco.Renderer,
        data: mujoco.MjData,
        recording: Recording,
        view: View,
        marks: Sequence[Footmark],
        moments: Sequence[int],
    ) -> None:
        import mujoco

        self._renderer = renderer
        self._marks = marks
        self._data = data
        self._recording = recording
        self._ground_m = np.broadcast_to(recording.ground_m, recording.time_s.shape)
        self._path = camera_path(recording, view)
        self._camera = mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        self._camera.distance = view.distance_m
        self._camera.elevation = view.elevation_deg
        self._shown = mujoco.MjvOption()
        # A robot without meshes is drawn by the shapes that it collides with.
        has_meshes = np.any(renderer.model.geom_group == VISUAL_GROUP)
        self._shown.geomgroup[PHYSICS_GROUP] = not has_meshes
        mujoco.mj_kinematics(renderer.model, data)
        self._cut_away(fixed_boxes(renderer.model, data), moments)

    def draw(self, index: int) -> Picture:
        """The picture (height, width, 3), red green blue, of moment `index`."""
        import mujoco

        self._data.qpos[:] = self._recording.qpos[index]
        mujoco.mj_kinematics(self._renderer.model, self._data)
        mujoco.mj_camlight(self._renderer.model, self._data)
        self._aim(index)
        self._renderer.update_scene(self._data, self._camera, self._shown)
        for light in self._renderer.scene.lights[: self._renderer.scene.nlight]:
            if light.castshadow:
                light.pos[:] = self._camera.lookat - _SHADOWS_M * np.asarray(light.dir)
        add_footmarks(self._renderer.scene, self._marks, float(self._recording.time_s[index]))
        return np.array(self._renderer.render())

    def _aim(self, index: int) -> None:
        self._camera.lookat[:] = self._path.lookat_m[index]
        self._camera.azimuth = self._path.azimuth_deg[index]

    def _cut_away(self, boxes: Boxes, moments: Sequence[int]) -> None:
        """Leaves stumps of the obstacles that hide the robot from the camera at any moment.

        They are cut in all pictures, so that nothing comes and goes.
        """
        import mujoco

        hidden_by = np.zeros(len(boxes.geom), dtype=bool)
        for index in moments:
            self._aim(index)
            camera, place_m = self._camera, self._recording.qpos[index, :2]
            eye_m = eye_position(camera.lookat, camera.distance, camera.azimuth, camera.elevation)
            points_m = points_to_see(place_m, eye_m, float(self._ground_m[index]))
            hidden_by |= hides(boxes, eye_m, points_m)
        label = obstacles_of(boxes)
        model = self._renderer.model
        for geom in boxes.geom[np.isin(label, label[hidden_by])]:
            lowered_m = max(0.0, model.geom_size[geom, 2] - STUMP_M / 2)
            down_m = np.zeros(3)
            mujoco.mju_rotVecQuat(down_m, np.array([0, 0, -lowered_m]), model.geom_quat[geom])
            model.geom_size[geom, 2] -= lowered_m
            model.geom_pos[geom] += down_m


def _set_light(model: mujoco.MjModel) -> None:
    model.vis.headlight.ambient[:] = _SKY
    model.vis.headlight.diffuse[:] = _HEADLIGHT
    model.light_diffuse[:] = _SUN
    model.vis.headlight.specular[:] = model.light_specular[:] = _SHINE
    model.vis.map.shadowclip = _SHADOWS_M / model.stat.extent


@contextmanager
def drawing(
    model: mujoco.MjModel,
    recording: Recording,
    view: View,
    *,
    width: int,
    height: int,
    fine: bool = False,
    marks: Sequence[Footmark] = (),
    moments: Sequence[int] | None = None,
) -> Iterator[Drawer]:
    """Gives a Drawer of pictures of this size, with the footprints `marks` on the floor.

    Shadows, reflections and smooth edges are drawn when `fine`: without a graphics card they
    take six times as long. Obstacles that hide the robot at any of the moments that are to be drawn
    (None: all of the recording) are cut away; afterwards the model has them again. What else this
    changes of the model are rendering settings.

    Raises:
        NoGlError: The renderer cannot be had. Was `prepare_gl` called before MuJoCo's import?
    """
    import mujoco

    if recording.qpos.shape[1] != model.nq:
        raise ValueError(f"qpos {recording.qpos.shape} must be (T, {model.nq}) for this model")
    model.vis.global_.offwidth = max(width, model.vis.global_.offwidth)
    model.vis.global_.offheight = max(height, model.vis.global_.offheight)
    model.vis.quality.offsamples = 4 if fine else 0
    _set_light(model)
    try:
        renderer = mujoco.Renderer(model, height, width, max_geom=20_000)
    except Exception as error:
        # Each backend fails in its own way: ImportError, RuntimeError, GLError, FatalError.
        raise NoGlError from error
    whole = model.geom_size.copy(), model.geom_pos.copy()
    if moments is None:
        moments = range(len(recording.time_s))
    with renderer:
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            renderer.scene.flags[flag] = fine
        try:
            yield Drawer(renderer, mujoco.MjData(model), recording, view, marks, moments)
        finally:
            model.geom_size[:], model.geom_pos[:] = whole
