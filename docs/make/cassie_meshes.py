"""The meshes that Cassie is dressed in: `sim/robots/cassie_meshes.npz`, made light.

    python -m pip install example-robot-data fast-simplification
    python -m docs.make.cassie_meshes

They are those of DAIRLab/cassie-gazebo-sim (ISC, copyright 2018 Agility Robotics), which the wheel
`example-robot-data` 6.0.0 has as STL: 13 parts of the pelvis and the left leg, each in the frame of
its body, 44,000 triangles. Quadric decimation keeps a quarter of them.
"""

from __future__ import annotations

import fast_simplification
import numpy as np
import trimesh

from maps.files import written_whole
from sim.robots.cassie import MESHES
from sim.source_model import source_path

FOLDER = "cmeel.prefix/share/example-robot-data/robots/cassie_description/meshes"
KEPT = 0.25


def main() -> None:
    """Writes the meshes, and prints the triangles of each part before and after."""
    arrays = {}
    for path in sorted(source_path(f"example-robot-data:{FOLDER}/pelvis.stl").parent.glob("*.stl")):
        shape = trimesh.load_mesh(path)
        shape.merge_vertices()
        vertices, faces = fast_simplification.simplify(
            shape.vertices.astype(np.float32), shape.faces.astype(np.int32), 1 - KEPT
        )
        name = path.stem.replace("-", "_")
        arrays[f"{name}_vertices"] = np.round(vertices, 5).astype(np.float32)
        arrays[f"{name}_faces"] = faces.astype(np.uint16)
        print(f"{name}: {len(shape.faces)} triangles, {len(faces)} kept")
    with written_whole(MESHES) as path:
        np.savez_compressed(path, allow_pickle=False, **arrays)


if __name__ == "__main__":
    main()
