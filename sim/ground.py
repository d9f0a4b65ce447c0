"""Ground that is not flat, from a map: boxes that stand on the floor and are walked upon."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import mujoco
import numpy as np

from sim.robot import GROUND_PREFIX, SURROUNDINGS_BITS

_LOW_RGB, _HIGH_RGB = np.array([0.83, 0.84, 0.85]), np.array([0.80, 0.70, 0.56])


@dataclass(frozen=True, kw_only=True)
class MapGround:
    """The ground of a map in a scene.

    `boxes_m` is (n, 5): centre x, centre y, half length x, half length y and height of the upper
    face in the map's own frame, all higher than the floor at `lowest_m`; `origin` is that frame's
    pose x_m, y_m, yaw_rad in the world.
    """

    boxes_m: np.ndarray = field(default_factory=lambda: np.zeros((0, 5)))
    lowest_m: float = 0.0
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)


def add_ground(spec: mujoco.MjSpec, ground: MapGround) -> None:
    """Lower the floor and put the boxes on it; the higher the browner."""
    spec.geom("floor").pos = [0, 0, ground.lowest_m]
    x, y, yaw = ground.origin
    quat = [math.cos(yaw / 2), 0, 0, math.sin(yaw / 2)]
    body = spec.worldbody.add_body(name="ground", pos=[x, y, 0], quat=quat)
    contype, conaffinity = SURROUNDINGS_BITS
    highest_m = max(ground.boxes_m[:, 4], default=ground.lowest_m)
    for number, (centre_x, centre_y, half_x, half_y, top) in enumerate(ground.boxes_m):
        share = (top - ground.lowest_m) / (highest_m - ground.lowest_m)
        half_z = (top - ground.lowest_m) / 2
        body.add_geom(
            name=f"{GROUND_PREFIX}{number}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[centre_x, centre_y, ground.lowest_m + half_z],
            size=[half_x, half_y, half_z],
            contype=contype,
            conaffinity=conaffinity,
            rgba=(*((1 - share) * _LOW_RGB + share * _HIGH_RGB), 1.0),
        )
