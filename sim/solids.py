"""What robots are built from: collision shapes, soles, fixed joints, and visuals.

All sizes are in metres, in the frame of the solid's body.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from sim.robot import PHYSICS_GROUP, VISUAL_GROUP

if TYPE_CHECKING:
    import mujoco

Vector = tuple[float, float, float]
Colour = tuple[float, float, float, float]
_LIGHT = (0.92, 0.93, 0.95, 1.0)


# Arguments of `add_geom` for what is seen and never touched, without mass.
VISUAL: Mapping[str, Any] = MappingProxyType(
    {"group": VISUAL_GROUP, "contype": 0, "conaffinity": 0, "mass": 0}
)


class Solid:
    """Base of all solids; `POINTS` names their fields that are points."""

    POINTS: ClassVar[tuple[str, ...]]

    def mirrored(self) -> Self:
        """The solid of the other side: y negated."""
        solid: Any = self  # a dataclass, each of its own
        return replace(solid, **{name: mirrored(getattr(self, name)) for name in self.POINTS})


@dataclass(frozen=True, kw_only=True)
class Block(Solid):
    """An upright block with bevelled edges whose cross-section changes from below to above.

    `below` and `above` are the centres of its end faces, `size_below` and `size_above` their
    extents along x and y.
    """

    POINTS = ("below", "above")

    below: Vector
    above: Vector
    size_below: tuple[float, float]
    size_above: tuple[float, float]
    bevel: float = 0.015

    def vertices(self) -> np.ndarray:
        """Corners (32, 3), of which the block is the convex hull."""
        below, above = np.array(self.below), np.array(self.above)
        inset = self.bevel / np.linalg.norm(above - below)
        rings = []
        for share, shrink in ((0, self.bevel), (inset, 0), (1 - inset, 0), (1, self.bevel)):
            size = (1 - share) * np.array(self.size_below) + share * np.array(self.size_above)
            half_x, half_y = size / 2 - shrink
            cut = min(self.bevel, half_x, half_y)
            quarter = np.array([[half_x, half_y - cut], [half_x - cut, half_y]])
            ring = np.concatenate([quarter * [sx, sy] for sx in (1, -1) for sy in (1, -1)])
            centre = (1 - share) * below + share * above
            rings.append(np.column_stack([ring, np.zeros(len(ring))]) + centre)
        return np.concatenate(rings)


@dataclass(frozen=True, kw_only=True)
class Rod(Solid):
    """A cylinder, or with `is_round` a capsule, between the centres of its ends."""

    POINTS = ("first", "last")

    first: Vector
    last: Vector
    radius: float
    is_round: bool = False


@dataclass(frozen=True, kw_only=True)
class Box(Solid):
    """A box along the axes of its body's frame, with its extents along x, y and z."""

    POINTS = ("centre",)

    centre: Vector
    size: Vector


@dataclass(frozen=True, kw_only=True)
class Ellipsoid(Solid):
    """An ellipsoid along the axes of its body's frame, with its radii along x, y and z."""

    POINTS = ("centre",)

    centre: Vector
    radii: Vector


def capsule(first: Vector, last: Vector, radius: float) -> Rod:
    """The capsule between two points."""
    return Rod(first=first, last=last, radius=radius, is_round=True)


# Body -> name of the shape -> shape, in the body's frame.
Shapes = Mapping[str, Mapping[str, Solid]]


def mirrored(point: Vector) -> Vector:
    """The point (x, y, z) of the other side."""
    return point[0], -point[1], point[2]


def add_shape(
    body: mujoco.MjsBody, name: str, solid: Solid, bits: tuple[int, int]
) -> mujoco.MjsGeom:
    """Adds the solid as a collision shape without mass, with these contact bits of `sim.robot`."""
    return body.add_geom(
        name=name,
        group=PHYSICS_GROUP,
        contype=bits[0],
        conaffinity=bits[1],
        mass=0,
        **_primitive(solid),
    )


def set_mass(
    body: mujoco.MjsBody, mass_kg: float, com_m: ArrayLike, inertia_kg_m2: ArrayLike
) -> None:
    """Gives the body its mass, its centre and its inertia about that.

    com_m (3,) and inertia_kg_m2 (6,), xx yy zz xy xz yz, in the body's frame.
    """
    body.mass, body.ipos, body.fullinertia = mass_kg, np.array(com_m), np.array(inertia_kg_m2)
    body.explicitinertial = True


def add_shapes(
    spec: mujoco.MjSpec, shapes: Shapes, bits: tuple[int, int], *, body: str = "", name: str = ""
) -> None:
    """Adds shapes, with these beginnings to the names of their bodies and to their own."""
    for body_name, named in shapes.items():
        for shape_name, shape in named.items():
            add_shape(spec.body(f"{body}{body_name}"), f"{name}{shape_name}", shape, bits)


def add_sole(
    foot: mujoco.MjsBody, side: str, sole_m: Vector, size_m: Vector, bits: tuple[int, int]
) -> tuple[mujoco.MjsGeom, mujoco.MjsSite]:
    """Adds the sole's box to the body of a foot, and the site in the middle of its underside."""
    centre = (sole_m[0], sole_m[1], sole_m[2] + size_m[2] / 2)
    geom = add_shape(foot, f"{side}_foot", Box(centre=centre, size=size_m), bits)
    return geom, foot.add_site(name=f"{side}_sole", pos=sole_m)


def fix_joint(spec: mujoco.MjSpec, joint: mujoco.MjsJoint, angle_rad: float) -> None:
    """Turns the joint's body to the angle and deletes the joint."""
    import mujoco

    body, anchor = joint.parent, np.asarray(joint.pos, float)
    turn, held, before, after = np.empty(4), np.empty(4), np.empty(3), np.empty(3)
    mujoco.mju_axisAngle2Quat(turn, np.asarray(joint.axis, float), angle_rad)
    mujoco.mju_mulQuat(held, np.asarray(body.quat, float), turn)
    # The point that the joint turns about stays where it is.
    mujoco.mju_rotVecQuat(before, anchor, np.asarray(body.quat, float))
    mujoco.mju_rotVecQuat(after, anchor, held)
    body.pos, body.quat = body.pos + before - after, held
    spec.delete(joint)


def add_look(spec: mujoco.MjSpec, body: mujoco.MjsBody, solid: Solid, rgba: Colour) -> None:
    """Adds the solid to the body as a visual, without mass and contacts."""
    import mujoco

    if isinstance(solid, Block):
        # Without faces MuJoCo takes the convex hull.
        vertices = solid.vertices().astype(np.float32).ravel()
        mesh = spec.add_mesh(name=f"block_{len(spec.meshes)}", uservert=vertices)
        shape = {"type": mujoco.mjtGeom.mjGEOM_MESH, "meshname": mesh.name}
    else:
        shape = _primitive(solid)
    body.add_geom(rgba=rgba, **shape, **VISUAL)


def add_mesh(
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    vertices: np.ndarray,
    faces: np.ndarray,
    rgba: Colour,
    **placed: Any,
) -> None:
    """Adds triangles to the body as a visual, without mass and contacts.

    vertices (N, 3) in m, faces (M, 3) of their indices; `placed` are `pos` and `quat` in the body.
    """
    import mujoco

    mesh = spec.add_mesh(
        name=f"{body.name}_{len(spec.meshes)}",
        uservert=np.asarray(vertices, np.float32).ravel(),
        userface=np.asarray(faces, np.int32).ravel(),
        # A sheet of metal has no inside, and MuJoCo is to ask for none.
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    kind = mujoco.mjtGeom.mjGEOM_MESH
    body.add_geom(type=kind, meshname=mesh.name, rgba=rgba, **placed, **VISUAL)


def add_urdf_meshes(
    spec: mujoco.MjSpec,
    urdf_path: str | Path,
    meshes_path: str | Path,
    *,
    renamed: Mapping[str, str],
    accents: Mapping[str, Colour],
) -> None:
    """Adds every visual mesh of the URDF to the body of its link, without mass and contacts.

    A link is the body of the same name, or of the name that `renamed` gives it. All meshes are
    light, but for those of the links in `accents`: most Collada files keep their colours in
    textures, which are not read. MuJoCo does not read these files; trimesh does.

    Raises:
        FileNotFoundError: The folder lacks a mesh that the URDF names.
    """
    import mujoco
    import trimesh

    for link in ET.parse(urdf_path).getroot().findall("link"):
        name = link.attrib["name"]
        for visual in link.findall("visual"):
            source = visual.find("geometry/mesh")
            if source is None:
                continue
            shape: Any = trimesh.load(Path(meshes_path) / Path(source.attrib["filename"]).name)
            if isinstance(shape, trimesh.Scene):
                shape = shape.to_geometry()  # in metres
            origin = visual.find("origin")
            at = {} if origin is None else origin.attrib
            quat = np.empty(4)
            # URDF's roll, pitch, yaw are about the fixed axes x, y, z.
            rpy = np.array(at.get("rpy", "0 0 0").split(), float)
            mujoco.mju_euler2Quat(quat, rpy, "XYZ")
            add_mesh(
                spec,
                spec.body(renamed.get(name, name)),
                shape.vertices,
                shape.faces,
                accents.get(name, _LIGHT),
                pos=np.array(at.get("xyz", "0 0 0").split(), float),
                quat=quat,
            )


def _primitive(solid: Solid) -> dict[str, Any]:
    """Arguments of `add_geom` for the primitive shapes of MuJoCo."""
    import mujoco

    kinds = mujoco.mjtGeom
    if isinstance(solid, Box):
        half = np.array(solid.size) / 2
        return {"type": kinds.mjGEOM_BOX, "pos": solid.centre, "size": half}
    if isinstance(solid, Ellipsoid):
        return {"type": kinds.mjGEOM_ELLIPSOID, "pos": solid.centre, "size": solid.radii}
    if not isinstance(solid, Rod):
        raise TypeError(f"{solid} is no primitive shape: take a Rod, a Box or an Ellipsoid")
    return {
        "type": kinds.mjGEOM_CAPSULE if solid.is_round else kinds.mjGEOM_CYLINDER,
        "fromto": [*solid.first, *solid.last],
        "size": [solid.radius, 0, 0],
    }
