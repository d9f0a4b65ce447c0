"""The robot's moving bodies as triangles, and where each of them is at a state."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import trimesh
import viser
from numpy.typing import ArrayLike

from sim.robot import PHYSICS_GROUP, VISUAL_GROUP, Robot
from sim.scene import build_scene

# Any timestep will do: nothing is simulated with the model that is drawn.
_TIMESTEP_S = 0.001
_CAPSULE_SIDES = 16
ROOT = "/robot"
Rgb = tuple[int, int, int]


@dataclass(frozen=True, kw_only=True)
class RobotMeshes:
    """What a robot looks like: the model's bodies that are drawn, and their triangles by colour."""

    model: mujoco.MjModel
    body_ids: np.ndarray
    names: tuple[str, ...]
    parts: tuple[dict[Rgb, Any], ...]

    def poses(self, qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions (N, 3) in m and quaternions (N, 4) w, x, y, z in the world at qpos (nq,)."""
        data = self._at(qpos)
        return data.xpos[self.body_ids], data.xquat[self.body_ids]

    def hit_distance_m(self, qpos: np.ndarray, origin: ArrayLike, direction: ArrayLike) -> float:
        """How far from its origin (3,) a ray meets the robot at qpos (nq,); infinite if never."""
        along = np.array(direction, float)
        along /= np.linalg.norm(along)
        nothing_static, geom = 0, np.zeros(1, np.int32)
        groups = np.zeros(mujoco.mjNGROUP, np.uint8)
        groups[_drawn_group(self.model)] = 1
        data, begin = self._at(qpos), np.array(origin, float)
        away_m = mujoco.mj_ray(self.model, data, begin, along, groups, nothing_static, -1, geom)
        return float(away_m) if geom[0] >= 0 else math.inf

    def _at(self, qpos: np.ndarray) -> mujoco.MjData:
        data = mujoco.MjData(self.model)
        data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, data)
        return data


def robot_meshes_of(robot: Robot) -> RobotMeshes:
    """The robot's meshes, or its collision shapes if it has none, gathered by body and colour."""
    model = build_scene(robot, timestep_s=_TIMESTEP_S, visuals=True).model
    group = _drawn_group(model)
    gathered: dict[int, dict[Rgb, list[trimesh.Trimesh]]] = defaultdict(lambda: defaultdict(list))
    for geom in np.flatnonzero((model.geom_group == group) & (model.geom_bodyid > 0)):
        red, green, blue = (int(255 * value) for value in model.geom_rgba[geom, :3])
        shape = _shape(model, int(geom))
        gathered[int(model.geom_bodyid[geom])][red, green, blue].append(shape)
    body_ids = sorted(gathered)
    return RobotMeshes(
        model=model,
        body_ids=np.array(body_ids),
        names=tuple(model.body(body).name for body in body_ids),
        parts=tuple(
            {rgb: trimesh.util.concatenate(shapes) for rgb, shapes in gathered[body].items()}
            for body in body_ids
        ),
    )


def _drawn_group(model: mujoco.MjModel) -> int:
    return VISUAL_GROUP if np.any(model.geom_group == VISUAL_GROUP) else PHYSICS_GROUP


def _shape(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh:
    """The geom's triangles in the frame of its body; a ValueError for kinds that no robot has."""
    kind = mujoco.mjtGeom(int(model.geom_type[geom]))
    size = model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.mesh(model.geom_dataid[geom])
        vertex, face = int(mesh.vertadr[0]), int(mesh.faceadr[0])
        shape = trimesh.Trimesh(
            vertices=model.mesh_vert[vertex : vertex + int(mesh.vertnum[0])],
            faces=model.mesh_face[face : face + int(mesh.facenum[0])],
        )
    elif kind == mujoco.mjtGeom.mjGEOM_BOX:
        shape = trimesh.creation.box(extents=2 * size)
    elif kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        shape = trimesh.creation.icosphere(subdivisions=2, radius=size[0])
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        shape = trimesh.creation.cylinder(radius=size[0], height=2 * size[1])
    elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        sides = [_CAPSULE_SIDES, _CAPSULE_SIDES]
        shape = trimesh.creation.capsule(height=2 * size[1], radius=size[0], count=sides)
    else:
        raise ValueError(f"geom {model.geom(geom).name!r} is a {kind.name}, which nobody draws yet")
    placed = np.eye(4)
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
    placed[:3, :3], placed[:3, 3] = rotation.reshape(3, 3), model.geom_pos[geom]
    return shape.apply_transform(placed)


class RobotScene:
    """The robot as drawn, a node for each body; `pose` moves it. One drawn before goes."""

    def __init__(self, scene: viser.SceneApi, meshes: RobotMeshes) -> None:
        self.meshes = meshes
        self._root = scene.add_frame(ROOT, show_axes=False)
        self._bodies = []
        self._posed = np.zeros(0)
        for name, parts in zip(meshes.names, meshes.parts, strict=True):
            self._bodies.append(scene.add_frame(f"{ROOT}/{name}", show_axes=False))
            for index, (rgb, shape) in enumerate(parts.items()):
                vertices, faces = np.array(shape.vertices), np.array(shape.faces)
                scene.add_mesh_simple(
                    f"{ROOT}/{name}/{index}",
                    vertices.astype(np.float32),
                    faces.astype(np.uint32),
                    color=rgb,
                    side="double",
                )

    def pose(self, qpos: np.ndarray) -> None:
        """Puts every body where it is at qpos (nq,); nothing is to do where it is already."""
        if np.array_equal(qpos, self._posed):
            return
        self._posed = np.array(qpos)
        positions, quaternions = self.meshes.poses(qpos)
        for body, position, wxyz in zip(self._bodies, positions, quaternions, strict=True):
            body.position = position.round(4)
            body.wxyz = wxyz.round(5)

    def hit_distance_m(self, origin: ArrayLike, direction: ArrayLike) -> float:
        """How far from its origin (3,) a ray meets the robot as drawn; infinite if it does not."""
        if not len(self._posed):
            return math.inf
        return self.meshes.hit_distance_m(self._posed, origin, direction)

    def remove(self) -> None:
        """Takes the robot out of the scene."""
        self._root.remove()
