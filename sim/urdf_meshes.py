"""The meshes of a URDF as geoms that are seen and never touched.

MuJoCo does not read the Collada files that most URDFs name; trimesh does.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sim.solids import VISUAL, Colour

if TYPE_CHECKING:
    import mujoco


def add_urdf_meshes(
    spec: mujoco.MjSpec,
    urdf_path: str | Path,
    meshes_path: str | Path,
    *,
    renamed: Mapping[str, str] | None = None,
    rgba: Colour = (0.92, 0.93, 0.95, 1.0),
    accents: Mapping[str, Colour] | None = None,
) -> int:
    """Adds every visual mesh of the URDF to the body of its link; returns how many.

    A link is the body of the same name, or of the name that `renamed` gives it. All meshes have one
    colour, but for those of the links in `accents`: most Collada files keep theirs in textures,
    which are not read. The meshes have neither mass nor contacts.

    Raises:
        FileNotFoundError: The folder lacks a mesh that the URDF names.
    """
    import mujoco

    count = 0
    for link in ET.parse(urdf_path).getroot().findall("link"):
        name = link.attrib["name"]
        for visual in link.findall("visual"):
            source = visual.find("geometry/mesh")
            if source is None:
                continue
            shape = _read_mesh(Path(meshes_path) / Path(source.attrib["filename"]).name)
            mesh = spec.add_mesh(
                name=f"{name}_{count}",
                uservert=np.asarray(shape.vertices, np.float32).ravel(),
                userface=np.asarray(shape.faces, np.int32).ravel(),
                # A sheet of metal has no inside, and MuJoCo is to ask for none.
                inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
            )
            spec.body((renamed or {}).get(name, name)).add_geom(
                type=mujoco.mjtGeom.mjGEOM_MESH,
                meshname=mesh.name,
                rgba=(accents or {}).get(name, rgba),
                **_origin(visual),
                **VISUAL,
            )
            count += 1
    return count


def _read_mesh(path: Path) -> Any:
    """The whole file as one trimesh.Trimesh, in metres."""
    import trimesh

    loaded = trimesh.load(path)
    return loaded.to_geometry() if isinstance(loaded, trimesh.Scene) else loaded


def _origin(visual: ET.Element) -> dict[str, np.ndarray]:
    """Position (3,) and quaternion w, x, y, z (4,) of the mesh in the link."""
    import mujoco

    origin = visual.find("origin")
    at = {} if origin is None else origin.attrib
    rpy = np.array(at.get("rpy", "0 0 0").split(), float)
    quat = np.empty(4)
    # URDF's roll, pitch, yaw are about the fixed axes x, y, z.
    mujoco.mju_euler2Quat(quat, rpy, "XYZ")
    return {"pos": np.array(at.get("xyz", "0 0 0").split(), float), "quat": quat}
