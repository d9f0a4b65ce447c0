"""What touches what in Drake's contact results: forces under the feet, legs, walls."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
from pydrake.geometry import GeometryId

from sim.drake.plant import ScenePlant
from sim.scene import Scene
from sim.sensors import SIDES

# One contact: the two geoms, where (3,), the force (3,) on the first, both in the world.
Contact = tuple[int, int, np.ndarray, np.ndarray]


class ContactReader:
    """Fills the sensors of contact of a scene from Drake's contact results."""

    def __init__(self, scene: Scene, plant: ScenePlant):
        model = scene.model
        self._sensors = scene.sensors
        self._geom_of = plant.geom_of
        self._feet = {model.geom(f"{side}_foot").id: k for k, side in enumerate(SIDES)}
        below = {name: _below(model, name) for name in ("left_leg", "right_leg", "pelvis")}
        self._left, self._right, self._robot = below.values()
        self._walls = _below(model, "walls")

    def read(self, results: Any, sensordata: np.ndarray) -> None:
        """Write forces, centres of pressure and numbers of contacts into sensordata (N,)."""
        force, weight = np.zeros((2, 3)), np.zeros(2)
        moment = np.zeros((2, 3))
        legs = walls = 0
        for first, second, place, on_first in self._contacts(results):
            legs += _joins(first, second, self._left, self._right)
            walls += _joins(first, second, self._robot, self._walls)
            for geom, sign in ((first, 1.0), (second, -1.0)):
                side = self._feet.get(geom)
                if side is not None:
                    force[side] += sign * on_first
                    size = math.sqrt(on_first @ on_first)
                    moment[side] += size * place
                    weight[side] += size
        sensors = self._sensors
        sensordata[sensors.ground_force_world] = force
        sensordata[sensors.pressure_pos_world] = moment / np.maximum(weight, 1e-12)[:, None]
        sensordata[sensors.legs_touching[0]] = legs
        sensordata[sensors.wall_contacts[0]] = walls

    def _contacts(self, results: Any) -> Iterator[Contact]:
        for k in range(results.num_point_pair_contacts()):
            info = results.point_pair_contact_info(k)
            pair = info.point_pair()
            # The force is that on the second.
            yield self._geoms(pair.id_A, pair.id_B, info.contact_point(), -info.contact_force())
        for k in range(results.num_hydroelastic_contacts()):
            info = results.hydroelastic_contact_info(k)
            surface, wrench = info.contact_surface(), info.F_Ac_W()
            force = wrench.translational()
            place = pressure_centre(surface, force, wrench.rotational())
            yield self._geoms(surface.id_M(), surface.id_N(), place, force)

    def _geoms(
        self, first: GeometryId, second: GeometryId, place: np.ndarray, force: np.ndarray
    ) -> Contact:
        return self._geom_of[first], self._geom_of[second], place, force


def pressure_centre(surface: Any, force: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Where on a contact surface its force acts, from force and torque at its centroid.

    On the plane through the centroid along its normal n, n x torque / (n . force) from it. The
    normal is that of a face of at least the mean area: the others may be slivers of an edge.
    """
    faces = surface.num_faces()
    enough = surface.total_area() / faces * (1 - 1e-9)
    x, y, z = surface.face_normal(next(k for k in range(faces) if surface.area(k) >= enough))
    press = x * force[0] + y * force[1] + z * force[2]
    if not press:
        return surface.centroid()
    # numpy's cross product takes longer than the rest together.
    along = y * torque[2] - z * torque[1], z * torque[0] - x * torque[2]
    return surface.centroid() + np.array([*along, x * torque[1] - y * torque[0]]) / press


def _joins(first: int, second: int, one: set[int], other: set[int]) -> bool:
    return (first in one and second in other) or (first in other and second in one)


def _below(model: mujoco.MjModel, name: str) -> set[int]:
    """The geoms of a body and of all bodies below it."""
    top, bodies = model.body(name).id, set()
    for body in range(model.nbody):
        above = body
        while above and above != top:
            above = int(model.body_parentid[above])
        if above == top:
            bodies.add(body)
    return {geom for geom in range(model.ngeom) if int(model.geom_bodyid[geom]) in bodies}
