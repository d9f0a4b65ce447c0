"""Terrain: the floor, stairs that differ per simulation, and the uneven ground of a map.

Treads and landings are boxes, each a mocap body parked far below until it is placed: their poses
are part of each simulation's state, and a reset parks them again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import mujoco
import numpy as np

from maps.boxes import Terraces
from sim.robot import GROUND_PREFIX, SURROUNDINGS_BITS

TREADS = 9
LANDINGS = 2
TREAD_DEPTH_M, TREAD_WIDTH_M = 0.33, 1.2
LANDING_DEPTH_M, LANDING_WIDTH_M = 3.0, 2.4
BLOCK_HEIGHT_M = 2.4
PARKED_Z_M = -20.0
FLOOR_BODY = "movable_floor"
_BITS = dict(zip(("contype", "conaffinity"), SURROUNDINGS_BITS, strict=True))


@dataclass(frozen=True, kw_only=True)
class Ground:
    """Poses of the ground of one simulation.

    `treads` (n, 4) and `landings` (m, 4) are x_m, y_m, z_m, yaw_rad of the middle of each upper
    face in the world, at most `TREADS` and `LANDINGS` of them. All are solid down to the floor.
    """

    floor_z_m: float = 0.0
    treads: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))
    landings: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))


def add_treads(spec: mujoco.MjSpec) -> None:
    """Put the floor into a body of its own and add the treads and landings, parked."""
    add_floor(spec.worldbody.add_body(name=FLOOR_BODY, mocap=True))
    sizes = {
        "tread": (TREADS, TREAD_DEPTH_M, TREAD_WIDTH_M),
        "landing": (LANDINGS, LANDING_DEPTH_M, LANDING_WIDTH_M),
    }
    for name, (count, depth_m, width_m) in sizes.items():
        for k in range(count):
            body = spec.worldbody.add_body(name=f"{name}_{k}", mocap=True, pos=[0, 0, PARKED_Z_M])
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX,
                size=[depth_m / 2, width_m / 2, BLOCK_HEIGHT_M / 2],
                rgba=(0.66, 0.62, 0.56, 1.0),
                **_BITS,
            )


class GroundBatch:
    """The ground of each of B simulations of a scene that has treads."""

    def __init__(self, model: mujoco.MjModel, position: np.ndarray, quaternion: np.ndarray):
        """Over the arrays (B, n, 3) and (B, n, 4) that hold the poses of the mocap bodies."""
        self._position, self._quaternion = position, quaternion

        def mocap(name: str) -> int:
            return int(model.body(name).mocapid[0])

        self._floor = mocap(FLOOR_BODY)
        self._treads = [mocap(f"tread_{k}") for k in range(TREADS)]
        self._landings = [mocap(f"landing_{k}") for k in range(LANDINGS)]

    @property
    def pose(self) -> tuple[np.ndarray, np.ndarray]:
        """Copies of all positions (B, n, 3) and quaternions (B, n, 4)."""
        return self._position.copy(), self._quaternion.copy()

    def place(self, row: int, ground: Ground) -> None:
        """Give simulation `row`, just reset, its ground.

        Raises:
            ValueError: more treads or landings than the scene has.
        """
        if len(ground.treads) > TREADS or len(ground.landings) > LANDINGS:
            raise ValueError(
                f"{len(ground.treads)} treads and {len(ground.landings)} landings: "
                f"at most {TREADS} and {LANDINGS}"
            )
        self._position[row, self._floor, 2] = ground.floor_z_m
        for bodies, poses in ((self._treads, ground.treads), (self._landings, ground.landings)):
            for body, (x, y, z, yaw) in zip(bodies, poses, strict=False):
                self._position[row, body] = x, y, z - BLOCK_HEIGHT_M / 2
                self._quaternion[row, body] = yaw_quaternion(yaw)


_WALL_RGBA = (0.72, 0.66, 0.58, 1.0)
_LOW_RGB, _HIGH_RGB = np.array([0.83, 0.84, 0.85]), np.array([0.80, 0.70, 0.56])


def add_ground(spec: mujoco.MjSpec, terraces: Terraces) -> None:
    """Lower the floor to the lowest ground and add what is higher, browner with height."""
    spec.geom("floor").pos = [0, 0, terraces.lowest_m]
    if len(terraces.ground) > 0:
        heights_m = terraces.ground[:, 4:] - terraces.lowest_m
        share = heights_m / max(heights_m.max(), 1e-9)
        rgb = (1 - share) * _LOW_RGB + share * _HIGH_RGB
        rgba = np.column_stack([rgb, np.ones(len(rgb))])
        _add_boxes(spec, "ground", terraces, terraces.ground, rgba, geom_prefix=GROUND_PREFIX)


def add_walls(spec: mujoco.MjSpec, terraces: Terraces, height_m: float) -> None:
    """Add all walls in one body named `walls`, which is there also when the map has none."""
    boxes = terraces.walls + np.array([0.0, 0.0, 0.0, 0.0, height_m])
    _add_boxes(spec, "walls", terraces, boxes, np.tile(_WALL_RGBA, (len(boxes), 1)))


def _add_boxes(
    spec: mujoco.MjSpec,
    name: str,
    terraces: Terraces,
    boxes_m: np.ndarray,
    rgba: np.ndarray,
    geom_prefix: str = "",
) -> None:
    """Add static boxes (n, 5) up from the lowest ground in a body of that name; rgba (n, 4)."""
    x, y, yaw = terraces.origin
    body = spec.worldbody.add_body(name=name, pos=[x, y, 0], quat=yaw_quaternion(yaw))
    for number, (centre_x, centre_y, half_x, half_y, top) in enumerate(boxes_m):
        half_z = (top - terraces.lowest_m) / 2
        body.add_geom(
            name=f"{geom_prefix}{number}" if geom_prefix else "",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[centre_x, centre_y, terraces.lowest_m + half_z],
            size=[half_x, half_y, half_z],
            rgba=rgba[number],
            **_BITS,
        )


def add_floor(body: mujoco.MjsBody) -> None:
    """Add the floor, a plane, to a body."""
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    body.add_geom(name="floor", type=plane, size=[0, 0, 0.05], **_BITS)


def yaw_quaternion(yaw_rad: float) -> np.ndarray:
    """Quaternion w, x, y, z of a rotation about z."""
    return np.array([math.cos(yaw_rad / 2), 0.0, 0.0, math.sin(yaw_rad / 2)])
