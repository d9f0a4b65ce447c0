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

LIGHT = (0.92, 0.93, 0.95, 1.0)


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
    textures, which are not read.

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
            mesh = spec.add_mesh(
                name=f"{name}_{len(spec.meshes)}",
                uservert=np.asarray(shape.vertices, np.float32).ravel(),
                userface=np.asarray(shape.faces, np.int32).ravel(),
                # A sheet of metal has no inside, and MuJoCo is to ask for none.
                inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
            )
            origin = visual.find("origin")
            at = {} if origin is None else origin.attrib
            quat = np.empty(4)
            # URDF's roll, pitch, yaw are about the fixed axes x, y, z.
            rpy = np.array(at.get("rpy", "0 0 0").split(), float)
            mujoco.mju_euler2Quat(quat, rpy, "XYZ")
            spec.body(renamed.get(name, name)).add_geom(
                type=mujoco.mjtGeom.mjGEOM_MESH,
                meshname=mesh.name,
                rgba=accents.get(name, LIGHT),
                pos=np.array(at.get("xyz", "0 0 0").split(), float),
                quat=quat,
                **VISUAL,
            )
