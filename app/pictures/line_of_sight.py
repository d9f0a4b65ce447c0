"""What hides a robot from a camera: boxes that cut a line of sight, and obstacles made of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from app.pictures.canvas import FloatArray
from sim.robot import GROUND_PREFIX

if TYPE_CHECKING:
    import mujoco

# Boxes that touch are one obstacle, cut as a whole, unless that is longer than this, as walls are.
_WHOLE_M = 1.5
_MOST_BOXES = 4000  # beyond this each box is cut alone
# Heights above the floor (m) and offsets sideways (m) of the points of the robot to be seen.
_SEEN_HEIGHTS_M = (0.05, 0.5, 1.0, 1.5)
_SEEN_OFFSETS_M = (-0.25, 0.0, 0.25)


@dataclass(frozen=True, kw_only=True)
class Boxes:
    """Boxes that never move: geom (n,) index in the model; the rest in the world frame.

    centre_m (n, 3); T_world_box (n, 3, 3) takes directions of the box to the world;
    half_m (n, 3) half lengths.
    """

    geom: NDArray[np.intp]
    centre_m: FloatArray
    T_world_box: FloatArray
    half_m: FloatArray


def fixed_boxes(model: mujoco.MjModel, data: mujoco.MjData) -> Boxes:
    """The box geoms of the model that are welded to the world; data holds their poses.

    Not those that are ground: a robot stands on them.
    """
    import mujoco

    is_box = model.geom_type == int(mujoco.mjtGeom.mjGEOM_BOX)
    is_fixed = model.body_weldid[model.geom_bodyid] == 0
    names = [model.geom(geom).name for geom in range(model.ngeom)]
    is_ground = np.array([name.startswith(GROUND_PREFIX) for name in names])
    geom = np.flatnonzero(is_box & is_fixed & ~is_ground)
    return Boxes(
        geom=geom,
        centre_m=np.array(data.geom_xpos[geom]),
        T_world_box=np.array(data.geom_xmat[geom]).reshape(-1, 3, 3),
        half_m=np.array(model.geom_size[geom]),
    )


def hides(boxes: Boxes, eye_m: FloatArray, points_m: FloatArray) -> NDArray[np.bool_]:
    """Whether each box (n,) cuts the line from the eye (3,) to any of the points (m, 3)."""
    # Slab test in each box's own frame: line = eye + t (point - eye), 0 <= t <= 1.
    eye = np.einsum("nji,nj->ni", boxes.T_world_box, eye_m - boxes.centre_m)[:, None, :]
    along = np.einsum("nji,mj->nmi", boxes.T_world_box, points_m - eye_m)
    along = np.where(np.abs(along) < 1e-12, 1e-12, along)
    half = boxes.half_m[:, None, :]
    one, other = (-half - eye) / along, (half - eye) / along
    enter = np.minimum(one, other).max(axis=2)
    leave = np.maximum(one, other).min(axis=2)
    cut: NDArray[np.bool_] = ((enter <= leave) & (leave >= 0) & (enter <= 1)).any(axis=1)
    return cut


def obstacles_of(boxes: Boxes) -> NDArray[np.intp]:
    """The number (n,) of the obstacle that each box belongs to: those of small ones that touch.

    Assumes boxes that are turned alike, as those of a map; others count as apart.
    """
    count = len(boxes.geom)
    label = np.arange(count)
    if not 0 < count <= _MOST_BOXES:
        return label
    frame = boxes.T_world_box[0]
    alike = np.abs(boxes.T_world_box - frame).max(axis=(1, 2)) < 1e-6
    centre, half = (boxes.centre_m @ frame)[:, :2], boxes.half_m[:, :2]
    touch = alike[:, None] & alike
    for axis in range(2):
        apart = np.abs(centre[:, None, axis] - centre[:, axis])
        touch &= apart <= half[:, None, axis] + half[:, axis] + 1e-3
    while True:
        least = np.where(touch, label, count).min(axis=1, initial=count)
        least = np.minimum(label, least)
        if np.array_equal(least, label):
            break
        label = least[least]
    for number in np.unique(label):
        mine = label == number
        low, high = (centre - half)[mine].min(axis=0), (centre + half)[mine].max(axis=0)
        if (high - low).max() > _WHOLE_M:
            label[mine] = np.flatnonzero(mine)
    return label


def points_to_see(place_m: FloatArray, eye_m: FloatArray, ground_m: float = 0.0) -> FloatArray:
    """Points (m, 3) of a robot that stands at the place (2,), spread as the eye (3,) sees it.

    ground_m: the height of the ground there.
    """
    towards = place_m - eye_m[:2]
    sideways = np.array([-towards[1], towards[0]]) / max(1e-9, float(np.hypot(*towards)))
    return np.array(
        [
            [*(place_m + offset_m * sideways), ground_m + height_m]
            for height_m in _SEEN_HEIGHTS_M
            for offset_m in _SEEN_OFFSETS_M
        ]
    )


def eye_position(
    lookat_m: FloatArray, distance_m: float, azimuth_deg: float, elevation_deg: float
) -> FloatArray:
    """Where MuJoCo's free camera with these settings is, (3,) in the world frame."""
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    forward = np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )
    return np.asarray(lookat_m, dtype=float) - distance_m * forward
