"""Models that others published, URDF or MJCF: bodies and joints as a spec, shapes as triangles.

Meshes may be STL, OBJ or Collada. A file is named by its path, or as DISTRIBUTION:FILE where an
installed Python package brings it: `jvrc-description:jvrc_description/urdf/jvrc1.urdf`.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sim.robot import VISUAL_GROUP
from sim.solids import Colour

if TYPE_CHECKING:
    import mujoco

_GREY = (0.80, 0.81, 0.84, 1.0)
_TRIANGLE_SHARE = 1e-6  # by how much moments of inertia may break the triangle inequality


class SourceError(ValueError):
    """A model cannot be read: the message names the element and what would be right."""


@dataclass(frozen=True, kw_only=True)
class SourceShape:
    """Triangles of a body: vertices (N, 3) in m in the body's frame, faces (M, 3) of indices.

    `is_visual` and `collides` tell what it is there for.
    """

    body: str
    vertices: np.ndarray
    faces: np.ndarray
    rgba: Colour
    is_visual: bool
    collides: bool


@dataclass(frozen=True, kw_only=True)
class SourceModel:
    """A published model: bodies and joints without shapes, the shapes, and what was mended.

    `is_free` is false where the base is fixed to the world. `efforts_nm` and `speeds_rad_s` are the
    limits of joints where the file states them.
    """

    name: str
    spec: mujoco.MjSpec
    shapes: tuple[SourceShape, ...]
    is_free: bool = True
    efforts_nm: Mapping[str, float] = field(default_factory=dict)
    speeds_rad_s: Mapping[str, float] = field(default_factory=dict)
    mended: tuple[str, ...] = ()


def source_path(file: str, folder: Path | None = None) -> Path:
    """The path of a file, relative to a folder, or of one in an installed distribution.

    Raises:
        SourceError: The distribution is not installed, or there is no such file.
    """
    distribution, colon, inside = file.partition(":")
    if colon and not Path(file).exists():
        try:
            path = Path(str(importlib.metadata.distribution(distribution).locate_file(inside)))
        except importlib.metadata.PackageNotFoundError:
            raise SourceError(
                f"{file}: the package {distribution} is not installed: "
                f"python -m pip install {distribution}"
            ) from None
    else:
        path = Path(file) if folder is None else folder / file
    if not path.is_file():
        raise SourceError(f"{path}: there is no such file; name a URDF or an MJCF")
    return path


def read_source(path: Path, packages: Mapping[str, Path] | None = None) -> SourceModel:
    """The model of a URDF or MJCF file.

    `packages` are the folders for `package://NAME/` in a URDF; of others a folder of that name
    above the file is taken.

    Raises:
        SourceError: It cannot be read, or a mesh is missing.
    """
    try:
        root = ET.parse(path).getroot()
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error.strerror}") from None
    except ET.ParseError as error:
        raise SourceError(f"{path}: not XML: {error}") from None
    if root.tag == "robot":
        return _from_urdf(path, root, packages or {})
    if root.tag == "mujoco":
        return _from_mjcf(path)
    raise SourceError(f"{path}: must be a URDF, <robot>, or MJCF, <mujoco>, not <{root.tag}>")


def _from_mjcf(path: Path) -> SourceModel:
    import mujoco

    try:
        spec = mujoco.MjSpec.from_file(str(path))
        # Closed loops and the like are kinematics of the original's own transmissions.
        spec.compiler.balanceinertia = True
        model = spec.compile()
    except (ValueError, FileNotFoundError) as error:
        raise SourceError(
            f"{path}: MuJoCo cannot read it: {' '.join(str(error).split())}"
        ) from None
    efforts: dict[str, float] = {}
    for k in range(model.nu):
        joint = model.joint(int(model.actuator_trnid[k, 0])).name
        forces = model.actuator_forcerange[k], model.actuator_ctrlrange[k]
        for is_limited, (_, most) in zip(
            (model.actuator_forcelimited[k], _is_motor(model, k)), forces, strict=True
        ):
            if is_limited and most > 0:
                efforts[joint] = float(most)
                break
    for k in range(model.njnt):
        if model.jnt_actfrclimited[k]:
            efforts.setdefault(model.joint(k).name, float(model.jnt_actfrcrange[k, 1]))
    return SourceModel(
        name=spec.modelname or path.stem,
        spec=spec,
        shapes=tuple(_mjcf_shapes(model)),
        is_free=mujoco.mjtJoint.mjJNT_FREE in model.jnt_type,
        efforts_nm=efforts,
    )


def _is_motor(model: mujoco.MjModel, actuator: int) -> bool:
    """Whether controls are torques, so that their range is that of the torque."""
    return bool(model.actuator_ctrllimited[actuator] and not model.actuator_biasprm[actuator].any())


def _mjcf_shapes(model: mujoco.MjModel) -> Iterator[SourceShape]:
    import mujoco

    for k in range(model.ngeom):
        body = model.body(int(model.geom_bodyid[k])).name
        kind, size = mujoco.mjtGeom(model.geom_type[k]), model.geom_size[k]
        if kind == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = int(model.geom_dataid[k])
            first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
            vertices = np.array(model.mesh_vert[first : first + count], float)
            first, count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
            faces = np.array(model.mesh_face[first : first + count])
        else:
            solid = _primitive(kind, size)
            if solid is None:
                continue
            vertices, faces = np.array(solid.vertices), np.array(solid.faces)
        turn = np.empty(9)
        mujoco.mju_quat2Mat(turn, model.geom_quat[k])
        material = int(model.geom_matid[k])
        rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[k]
        collides = bool(model.geom_contype[k] or model.geom_conaffinity[k])
        yield SourceShape(
            body=body,
            vertices=vertices @ turn.reshape(3, 3).T + model.geom_pos[k],
            faces=faces,
            rgba=(*map(float, rgba),),  # type: ignore[arg-type]
            is_visual=not collides or model.geom_group[k] < PHYSICS_GROUPS,
            collides=collides,
        )


PHYSICS_GROUPS = VISUAL_GROUP + 1  # MuJoCo shows geoms of lower groups


def _primitive(kind: mujoco.mjtGeom, size: np.ndarray) -> Any:
    """The triangles of a primitive shape of MuJoCo; None of planes and the like."""
    import mujoco
    import trimesh

    kinds, create = mujoco.mjtGeom, trimesh.creation
    if kind == kinds.mjGEOM_BOX:
        return create.box(2 * size)
    if kind == kinds.mjGEOM_SPHERE:
        return create.icosphere(subdivisions=2, radius=size[0])
    if kind == kinds.mjGEOM_ELLIPSOID:
        return create.icosphere(subdivisions=2).apply_scale(size)
    if kind == kinds.mjGEOM_CYLINDER:
        return create.cylinder(radius=size[0], height=2 * size[1], sections=24)
    if kind == kinds.mjGEOM_CAPSULE:
        return create.capsule(radius=size[0], height=2 * size[1], count=(12, 12))
    return None


def _from_urdf(path: Path, root: ET.Element, packages: Mapping[str, Path]) -> SourceModel:
    import mujoco

    _refuse_fixed_base(path, root)
    shapes = tuple(_urdf_shapes(path, root, packages))
    mended = tuple(_mend_inertias(root))
    efforts, speeds = {}, {}
    for joint in root.findall("joint"):
        limit = joint.find("limit")
        if limit is not None:
            name = joint.attrib.get("name", "")
            if limit.get("lower") and limit.get("lower") == limit.get("upper"):
                # MuJoCo would take it for one without limits.
                limit.attrib["upper"] = str(float(limit.attrib["lower"]) + 1e-7)
            with contextlib.suppress(KeyError, ValueError):
                efforts[name] = float(limit.attrib["effort"])
            with contextlib.suppress(KeyError, ValueError):
                speeds[name] = float(limit.attrib["velocity"])
    for link in root.findall("link"):
        for element in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(element)
    for tag in ("transmission", "gazebo", "mujoco", "material"):
        for element in root.findall(tag):
            root.remove(element)
    try:
        spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"))
    except ValueError as error:
        raise SourceError(
            f"{path}: MuJoCo cannot read it: {' '.join(str(error).split())}"
        ) from None
    return SourceModel(
        name=root.attrib.get("name", path.stem),
        spec=spec,
        shapes=shapes,
        efforts_nm=efforts,
        speeds_rad_s=speeds,
        mended=mended,
    )


def _refuse_fixed_base(path: Path, root: ET.Element) -> None:
    for joint in root.findall("joint"):
        parent, child = joint.find("parent"), joint.find("child")
        is_fixed = joint.get("type") == "fixed" and parent is not None
        if is_fixed and parent is not None and parent.get("link") == "world":
            name = "" if child is None else child.get("link")
            raise SourceError(
                f"{path}: joint {joint.get('name')} fixes {name} to the world: the base must be "
                "free; take this joint and the link world out"
            )


def _mend_inertias(root: ET.Element) -> Iterator[str]:
    """Mends tensors of inertia that no body can have, and tells of each."""
    for link in root.findall("link"):
        inertia, mass = link.find("inertial/inertia"), link.find("inertial/mass")
        if inertia is None or mass is None:
            continue
        names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
        xx, yy, zz, xy, xz, yz = (float(inertia.attrib.get(n, 0)) for n in names)
        mass_kg = float(mass.attrib.get("value", 0))
        moments, axes = np.linalg.eigh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
        if mass_kg <= 0 or (
            moments[0] > 0 and moments[2] <= (1 + _TRIANGLE_SHARE) * sum(moments[:2])
        ):
            continue
        # Not below those of a ball of water of that mass, and each at most the sum of the others.
        least = 0.4 * mass_kg * (mass_kg / 4189.0) ** (2 / 3)
        moments = np.maximum(moments, min(least, max(moments[2], 0.01 * least)))
        short = (moments[2] - moments[:2].sum()) / 2
        moments[:2] += max(short, 0.0) * 1.001
        whole = axes @ np.diag(moments) @ axes.T
        for name, (row, column) in zip(
            names, ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)), strict=True
        ):
            inertia.attrib[name] = repr(float(whole[row, column]))
        yield f"the inertia of link {link.attrib.get('name')} is that of no body: it was mended"


def _urdf_shapes(
    path: Path, root: ET.Element, packages: Mapping[str, Path]
) -> Iterator[SourceShape]:
    colours = {
        material.attrib.get("name", ""): colour
        for material in root.iter("material")
        if (colour := _colour(material)) is not None
    }
    for link in root.findall("link"):
        for kind in ("visual", "collision"):
            for element in link.findall(kind):
                solid = _urdf_solid(path, element, packages)
                if solid is None:
                    continue
                material = element.find("material")
                rgba = _GREY
                if material is not None:
                    name = material.attrib.get("name", "")
                    rgba = _colour(material) or colours.get(name, _GREY)
                yield SourceShape(
                    body=link.attrib["name"],
                    vertices=np.asarray(solid.vertices, float) @ _turn(element).T + _xyz(element),
                    faces=np.asarray(solid.faces),
                    rgba=rgba,
                    is_visual=kind == "visual",
                    collides=kind == "collision",
                )


def _colour(material: ET.Element) -> Colour | None:
    colour = material.find("color")
    if colour is None:
        return None
    r, g, b, a = (float(word) for word in colour.attrib["rgba"].split())
    return r, g, b, a


def _xyz(element: ET.Element) -> np.ndarray:
    origin = element.find("origin")
    return np.array(("0 0 0" if origin is None else origin.get("xyz", "0 0 0")).split(), float)


def _turn(element: ET.Element) -> np.ndarray:
    """The rotation (3, 3) of an element's origin."""
    import mujoco

    origin = element.find("origin")
    # URDF's roll, pitch, yaw are about the fixed axes x, y, z.
    rpy = np.array(("0 0 0" if origin is None else origin.get("rpy", "0 0 0")).split(), float)
    quat, turn = np.empty(4), np.empty(9)
    mujoco.mju_euler2Quat(quat, rpy, "XYZ")
    mujoco.mju_quat2Mat(turn, quat)
    return turn.reshape(3, 3)


def _urdf_solid(path: Path, element: ET.Element, packages: Mapping[str, Path]) -> Any:
    """The triangles of a URDF's visual or collision, before its origin; None without geometry."""
    import trimesh

    geometry = element.find("geometry")
    for shape in () if geometry is None else geometry:
        get = shape.attrib
        if shape.tag == "box":
            return trimesh.creation.box(np.array(get["size"].split(), float))
        if shape.tag == "cylinder":
            return trimesh.creation.cylinder(
                radius=float(get["radius"]), height=float(get["length"]), sections=24
            )
        if shape.tag == "sphere":
            return trimesh.creation.icosphere(subdivisions=2, radius=float(get["radius"]))
        if shape.tag == "mesh":
            mesh = load_mesh(mesh_path(path, get["filename"], packages)).copy()
            return mesh.apply_scale(np.array(get.get("scale", "1 1 1").split(), float))
    return None


def load_mesh(path: Path) -> Any:
    """The triangles of an STL, OBJ or Collada file, as trimesh has them.

    Raises:
        SourceError: It cannot be read.
    """
    import trimesh

    try:
        mesh: Any = trimesh.load(path)
        if isinstance(mesh, trimesh.Scene):
            mesh = mesh.to_geometry()  # in metres
    except Exception as error:
        # trimesh's readers raise whatever goes wrong in them.
        raise SourceError(f"{path}: cannot be read as a mesh: {error}") from None
    return mesh


def mesh_path(urdf: Path, name: str, packages: Mapping[str, Path]) -> Path:
    """Where a mesh that a URDF names lies.

    Raises:
        SourceError: It is nowhere; the message names the package to tell.
    """
    plain = name.removeprefix("file://")
    package, _, inside = name.removeprefix("package://").partition("/")
    if not name.startswith("package://"):
        places = [urdf.parent / plain]
    elif package in packages:
        places = [packages[package] / inside]
    else:
        above = list(urdf.absolute().parents)
        places = [folder / package / inside for folder in above]
        # A package's folder may have another name than the package.
        places += [folder / inside for folder in above[:3]]
    for place in places:
        if place.is_file():
            return place
    if name.startswith("package://"):
        raise SourceError(
            f"{urdf}: the mesh {name} is not found: add --package {package}=DIR with the folder "
            f"that holds {inside}"
        )
    raise SourceError(f"{urdf}: the mesh {name} is not found: there is no {places[0]}")
