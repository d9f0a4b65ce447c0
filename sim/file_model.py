"""The MuJoCo model of a robot from a file: a light model, and the shapes that the file adds."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from maps.yaml_files import YamlFileError
from sim.robot import LEFT_LEG_BITS, RIGHT_LEG_BITS, UPPER_BODY_BITS
from sim.solids import Rod, Solid, Vector, add_mesh, add_shape, add_sole, fix_joint

if TYPE_CHECKING:
    import mujoco

SIDES = ("left", "right")


@dataclass(frozen=True, kw_only=True)
class Soles:
    """The boxes under the feet: their bodies, left and right, and the middle of the left one.

    `centre_m` is of the underside, `pitch_rad` by how much the toes are lower than the heel with
    all joints at 0.
    """

    bodies: tuple[str, str]
    centre_m: Vector
    size_m: Vector
    pitch_rad: float = 0.0


@dataclass(frozen=True, kw_only=True)
class PlacedShape:
    """A collision shape of one body, or of a left and a right one that mirror each other."""

    name: str
    bodies: tuple[str, ...]
    solid: Solid

    @property
    def names(self) -> tuple[str, ...]:
        """The names of its geoms."""
        if len(self.bodies) == 1:
            return (self.name,)
        return tuple(f"{side}_{self.name}" for side in SIDES)


@dataclass(frozen=True, kw_only=True)
class MeshSource:
    """The published model whose visual meshes the robot wears, and its packages' folders."""

    file: str
    packages: Mapping[str, str]
    folder: Path


@dataclass(frozen=True, kw_only=True)
class FileModel:
    """A light model and what makes it a robot.

    `path` is MJCF of bodies, masses and joints; `bodies` gives its names for `pelvis`, `left_leg`
    and `right_leg`. Of its joints `joints` move, within `ranges_rad`; the others are fixed at
    the angle in `held_rad`, or 0.
    """

    path: Path
    bodies: Mapping[str, str]
    joints: tuple[str, ...]
    ranges_rad: Mapping[str, tuple[float, float]]
    held_rad: Mapping[str, float]
    soles: Soles
    shapes: tuple[PlacedShape, ...]
    head: tuple[str, Vector]
    meshes: MeshSource | None = None

    def build(self) -> mujoco.MjSpec:
        """The model with the names and shapes that `sim/robot.py` asks for.

        Raises:
            YamlFileError: MuJoCo cannot read it.
        """
        import mujoco

        try:
            spec = mujoco.MjSpec.from_file(str(self.path))
            axes = pelvis_axes(spec, self.bodies["pelvis"])
        except ValueError as error:
            told = " ".join(str(error).split())
            raise YamlFileError(f"{self.path}: MuJoCo cannot read it: {told}") from None
        legs = [below(spec, self.bodies[f"{side}_leg"]) for side in SIDES]
        bits = [LEFT_LEG_BITS, RIGHT_LEG_BITS]
        for side in (0, 1):
            self._add_sole(spec, side, axes, bits[side])
            for shape in self.shapes:
                if side < len(shape.bodies):
                    body = shape.bodies[side]
                    leg = next((n for n in (0, 1) if body in legs[n]), None)
                    solid = shape.solid.mirrored() if side else shape.solid
                    shape_bits = UPPER_BODY_BITS if leg is None else bits[leg]
                    _add_turned(spec.body(body), shape.names[side], solid, shape_bits, axes[body])
        body, point_m = self.head
        spec.body(body).add_site(name="head", pos=axes[body].T @ point_m)
        self._fix_joints(spec)
        for ours, theirs in self.bodies.items():
            spec.body(theirs).name = ours
        return spec

    def add_meshes(self, spec: mujoco.MjSpec) -> None:
        """Adds the visual meshes to a spec made by `build`; warns where they are missing."""
        from sim.source_model import SourceError, read_source, source_path

        assert self.meshes is not None
        packages = {
            name: self.meshes.folder / place for name, place in self.meshes.packages.items()
        }
        try:
            path = source_path(self.meshes.file, self.meshes.folder)
            shapes = read_source(path, packages).shapes
        except SourceError as error:
            warnings.warn(f"drawn without its meshes: {error}", UserWarning, stacklevel=2)
            return
        ours = {theirs: name for name, theirs in self.bodies.items()}
        names = {body.name for body in spec.bodies}
        for shape in shapes:
            name = ours.get(shape.body, shape.body)
            if not shape.is_visual or name not in names:
                continue
            add_mesh(spec, spec.body(name), shape.vertices, shape.faces, shape.rgba)

    def _add_sole(
        self,
        spec: mujoco.MjSpec,
        side: int,
        axes: Mapping[str, np.ndarray],
        bits: tuple[int, int],
    ) -> None:
        import mujoco

        body = self.soles.bodies[side]
        x, y, z = self.soles.centre_m
        pitch = np.empty(9)
        half = self.soles.pitch_rad / 2
        mujoco.mju_quat2Mat(pitch, np.array([np.cos(half), 0, np.sin(half), 0]))
        turn = axes[body].T @ pitch.reshape(3, 3)
        centre_m = axes[body].T @ np.array([x, y if side == 0 else -y, z])
        geom, site = add_sole(spec.body(body), SIDES[side], (0, 0, 0), self.soles.size_m, bits)
        geom.pos, geom.quat = centre_m + turn @ geom.pos, quat_of(turn)
        site.pos, site.quat = centre_m, quat_of(turn)

    def _fix_joints(self, spec: mujoco.MjSpec) -> None:
        """Names the free joint `root`, sets the ranges of joints that move and fixes the others."""
        import mujoco

        kinds = mujoco.mjtJoint
        pelvis = spec.body(self.bodies["pelvis"])
        free = [joint for joint in spec.joints if joint.type == kinds.mjJNT_FREE]
        if not free:
            free = [pelvis.add_freejoint()]
        free[0].name = "root"
        spec.compiler.fusestatic = True
        unit = np.degrees(1.0) if spec.compiler.degree else 1.0
        for joint in list(spec.joints):
            if joint.name in self.ranges_rad:
                joint.range = unit * np.array(self.ranges_rad[joint.name])
                joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE
            elif joint.type == kinds.mjJNT_HINGE:
                fix_joint(spec, joint, self.held_rad.get(joint.name, 0.0))
            elif joint.type != kinds.mjJNT_FREE:
                spec.delete(joint)


def pelvis_axes(spec: mujoco.MjSpec, pelvis: str) -> dict[str, np.ndarray]:
    """For every body the rotation (3, 3) from its axes to the pelvis's, with all joints at 0."""
    import mujoco

    is_fused, spec.compiler.fusestatic = spec.compiler.fusestatic, False
    model = spec.compile()
    spec.compiler.fusestatic = is_fused
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    for joint in range(model.njnt):
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            data.qpos[model.jnt_qposadr[joint] + 3] = 1.0
    mujoco.mj_kinematics(model, data)
    of_pelvis = data.body(pelvis).xmat.reshape(3, 3)
    turns = {
        model.body(k).name: of_pelvis.T @ data.xmat[k].reshape(3, 3) for k in range(model.nbody)
    }
    # Exact where it is the identity or a permutation, so that what is read is what was written.
    return {name: np.where(np.abs(t - t.round()) < 1e-9, t.round(), t) for name, t in turns.items()}


def below(spec: mujoco.MjSpec, name: str) -> set[str]:
    """The names of a body and of all bodies below it."""
    import mujoco

    body = spec.body(name)
    return {name, *(one.name for one in body.find_all(mujoco.mjtObj.mjOBJ_BODY))}


def _add_turned(
    body: mujoco.MjsBody, name: str, solid: Solid, bits: tuple[int, int], axes: np.ndarray
) -> None:
    """Adds a solid that is given along the pelvis's axes."""
    geom = add_shape(body, name, solid, bits)
    if isinstance(solid, Rod):
        ends = np.array([solid.first, solid.last]) @ axes
        geom.fromto = ends.ravel()
    else:
        geom.pos, geom.quat = axes.T @ geom.pos, quat_of(axes.T)


def quat_of(turn: np.ndarray) -> np.ndarray:
    """The quaternion w, x, y, z of a rotation (3, 3)."""
    import mujoco

    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(turn).ravel())
    return quat
