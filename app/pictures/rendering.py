"""Pictures of a recorded walk: the cameras, and the drawing of single frames."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from app.pictures.cutaway import GLASS_ALPHA, eye_position, fixed_boxes, hides, points_to_see
from app.pictures.footmarks import Footmarks
from sim.gl import NoGlError
from sim.robot import PHYSICS_GROUP, VISUAL_GROUP

if TYPE_CHECKING:
    import mujoco

FloatArray = NDArray[np.floating]
Picture = NDArray[np.uint8]


@dataclass(frozen=True, kw_only=True)
class Recording:
    """A walk as it happened: qpos (T, nq) of the model at the times time_s (T,), in order.

    ground_m (T,): height of the ground below the robot, 0 unless given.
    """

    qpos: FloatArray
    time_s: FloatArray
    ground_m: FloatArray | None = None

    def __post_init__(self) -> None:
        if self.ground_m is not None and self.ground_m.shape != self.time_s.shape:
            raise ValueError(f"ground_m {self.ground_m.shape} must be as time_s")
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
    ground_m = np.zeros(len(yaw_rad)) if recording.ground_m is None else recording.ground_m
    place_m = np.column_stack([recording.qpos[:, :2], yaw_rad, ground_m])
    smooth = _smooth(place_m, recording.time_s, view.smooth_s)
    return CameraPath(
        lookat_m=np.column_stack([smooth[:, :2], smooth[:, 3] + view.height_m]),
        azimuth_deg=np.degrees(smooth[:, 2]) + view.azimuth_deg,
    )


def _smooth(values: FloatArray, time_s: FloatArray, width_s: float) -> FloatArray:
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
        marks: Footmarks | None = None,
    ) -> None:
        import mujoco

        self._renderer = renderer
        self._marks = marks
        self._data = data
        self._recording = recording
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
        self._walls = fixed_boxes(renderer.model, data)
        self._alpha = np.array(renderer.model.geom_rgba[self._walls.geom, 3])

    def draw(self, index: int) -> Picture:
        """The picture (height, width, 3), red green blue, of moment `index`."""
        import mujoco

        self._data.qpos[:] = self._recording.qpos[index]
        mujoco.mj_kinematics(self._renderer.model, self._data)
        mujoco.mj_camlight(self._renderer.model, self._data)
        self._camera.lookat[:] = self._path.lookat_m[index]
        self._camera.azimuth = self._path.azimuth_deg[index]
        self._make_glass(index)
        self._renderer.update_scene(self._data, self._camera, self._shown)
        if self._marks is not None:
            self._marks.add_to(self._renderer.scene, float(self._recording.time_s[index]))
        return np.array(self._renderer.render())

    def _make_glass(self, index: int) -> None:
        """Makes the walls that hide the robot from the camera see-through, the others as were."""
        camera = self._camera
        eye_m = eye_position(camera.lookat, camera.distance, camera.azimuth, camera.elevation)
        ground_m = self._recording.ground_m
        points_m = points_to_see(
            np.array(self._data.qpos[:2]), eye_m, 0.0 if ground_m is None else ground_m[index]
        )
        hidden_by = hides(self._walls, eye_m, points_m)
        self._renderer.model.geom_rgba[self._walls.geom, 3] = np.where(
            hidden_by, np.minimum(GLASS_ALPHA, self._alpha), self._alpha
        )


@contextmanager
def drawing(
    model: mujoco.MjModel,
    recording: Recording,
    view: View,
    *,
    width: int,
    height: int,
    fine: bool = False,
    marks: Footmarks | None = None,
) -> Iterator[Drawer]:
    """Gives a Drawer of pictures of this size, with the footprints `marks` on the floor.

    Shadows, reflections and smooth edges are drawn when `fine`: without a graphics card they
    take six times as long. Walls that hide the robot are drawn as glass. What this changes of the
    model are rendering settings and colours.

    Raises:
        NoGlError: The renderer cannot be had. Was `prepare_gl` called before MuJoCo's import?
    """
    import mujoco

    if recording.qpos.shape[1] != model.nq:
        raise ValueError(f"qpos {recording.qpos.shape} must be (T, {model.nq}) for this model")
    model.vis.global_.offwidth = max(width, model.vis.global_.offwidth)
    model.vis.global_.offheight = max(height, model.vis.global_.offheight)
    model.vis.quality.offsamples = 4 if fine else 0
    # Sides that no light reaches would be black; walls have many of them.
    model.vis.headlight.ambient[:] = 0.2
    try:
        renderer = mujoco.Renderer(model, height, width, max_geom=20_000)
    except Exception as error:
        # Each backend fails in its own way: ImportError, RuntimeError, GLError, FatalError.
        raise NoGlError from error
    with renderer:
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            renderer.scene.flags[flag] = fine
        yield Drawer(renderer, mujoco.MjData(model), recording, view, marks)
