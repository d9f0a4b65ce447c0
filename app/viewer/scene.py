"""What stands in a viser scene: the map's floor, walls and unknown ground, and the robot.

The robot is drawn body by body, as triangles that move with its state.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import trimesh
import viser
from numpy.typing import ArrayLike, NDArray

from maps.boxes import Terraces, plates_of, terraces_of
from maps.grid import Cell, OccupancyGrid
from sim.robot import PHYSICS_GROUP, VISUAL_GROUP, Robot
from sim.scene import WALL_HEIGHT_M, build_scene

_FLOOR_THICKNESS_M = 0.02
# So deep that the colour does not shine through the floor far from the camera.
_SLAB_DEPTH_M = 0.3
_UNKNOWN_HEIGHT_M = 0.02
_LINES_HEIGHT_M = 0.001
_SHADES = 24
# Any timestep will do: nothing is simulated with the model that is drawn.
_TIMESTEP_S = 0.001
_CAPSULE_SIDES = 16
ROBOT_ROOT = "/robot"
FloatArray = NDArray[np.float64]
Rgb = tuple[int, int, int]


@dataclass(frozen=True, kw_only=True)
class Palette:
    """The colours of a map: floor, the lines on it, walls, unknown ground, the highest floor."""

    floor: Rgb
    line: Rgb
    wall: Rgb
    unknown: Rgb
    highest: Rgb


LIGHT = Palette(
    floor=(186, 189, 194),
    line=(178, 182, 188),
    wall=(150, 134, 114),
    unknown=(150, 153, 158),
    highest=(214, 190, 152),
)
DARK = Palette(
    floor=(58, 62, 68),
    line=(82, 87, 95),
    wall=(112, 100, 85),
    unknown=(36, 38, 42),
    highest=(112, 94, 66),
)
FLOOR_RGB = LIGHT.floor
# viser's own sun stands in the north: walls would show their dark side to a page's first view.
_SUN_M = (-3.0, -4.0, 8.0)
_SUN, _SKY = 2.6, 0.1


def map_colours(palette: Palette) -> dict[str, dict[str, Rgb]]:
    """The colours of all nodes that `add_floor` may draw: by the node's name, by its property."""
    shades = {
        f"ground/{shade}": blended(palette.floor, palette.highest, shade / _SHADES)
        for shade in range(1, _SHADES + 1)
    }
    plain = {"floor": palette.floor, "slab": palette.floor, "walls": palette.wall}
    return {
        f"/map/{name}": {"color": rgb}
        for name, rgb in (plain | {"unknown": palette.unknown} | shades).items()
    } | {"/map/lines": {"cell_color": palette.line, "section_color": palette.line}}


def solid(
    boxes: FloatArray, *, base_m: float, rise_m: float, cell_m: float
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Vertices (V, 3) and triangles (F, 3), counter-clockwise as seen from outside, of boxes.

    boxes (n, 5) as in `maps.boxes`; they rise `rise_m` above their heights, from `base_m`, and
    cover whole cells of the side `cell_m`. There are no faces below, nor where two of them touch:
    their edges would flicker through the tops.
    """
    edges = np.round(
        np.stack([boxes[:, :2] - boxes[:, 2:4], boxes[:, :2] + boxes[:, 2:4]], axis=1) / cell_m
    ).astype(int)
    tops_m = boxes[:, 4] + rise_m
    first = edges[:, 0].min(axis=0) - 1
    cols, rows = edges[:, 1].max(axis=0) + 1 - first
    top_m = np.full((rows, cols), base_m)
    for ((x0, y0), (x1, y1)), reach_m in zip(edges - first, tops_m, strict=True):
        top_m[y0:y1, x0:x1] = reach_m
    (x0, y0), (x1, y1) = cell_m * edges.transpose(1, 2, 0)
    lids = np.stack([x0, x1, x1, x0, y0, y0, y1, y1, *[tops_m] * 4], axis=1)
    upright = [_upright(top_m, first, cell_m, axis) for axis in (0, 1)]
    quads = np.concatenate([lids.reshape(-1, 3, 4).transpose(0, 2, 1), *upright])
    return quads.reshape(-1, 3), quad_faces(len(quads))


def quad_faces(count: int) -> NDArray[np.int64]:
    """Two triangles for each four vertices, (2 * count, 3)."""
    corner = 4 * np.arange(count)[:, None, None]
    return (corner + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)


def _upright(top_m: FloatArray, first: NDArray[np.int64], cell_m: float, axis: int) -> FloatArray:
    """The faces (n, 4, 3) that look along x or y, the axis 0 or 1, to where it is lower.

    top_m (rows, cols): how high each cell reaches. first (2,): the column and row of the first.
    """
    heights_m = top_m if axis == 0 else top_m.T
    runs = _runs(heights_m[:, :-1], heights_m[:, 1:])
    corner = runs[:, :3] + np.array([1, 0, 0]) + first[[axis, 1 - axis, 1 - axis]]
    at, low, high = (cell_m * corner).T
    begin, end = np.stack([at, low], axis=1), np.stack([at, high], axis=1)
    if axis == 1:
        begin, end = end[:, ::-1], begin[:, ::-1]
    ahead = runs[:, 3] > runs[:, 4]
    left, right = np.where(ahead[:, None], begin, end), np.where(ahead[:, None], end, begin)
    bottom_m, reach_m = np.sort(runs[:, 3:], axis=1).T
    xy = np.stack([left, right, right, left], axis=1)
    z = np.stack([bottom_m, bottom_m, reach_m, reach_m], axis=1)
    return np.concatenate([xy, z[:, :, None]], axis=2)


def _runs(near_m: FloatArray, far_m: FloatArray) -> FloatArray:
    """Where two neighbours differ in height: column, first row, row after the last, both heights.

    Neighbours one below the other with the same two heights make one run; (n, 5).
    """
    found = [np.zeros((0, 5))]
    for col in np.flatnonzero((near_m != far_m).any(axis=0)):
        pair = np.stack([near_m[:, col], far_m[:, col]], axis=1)
        starts = np.flatnonzero(np.append(True, (pair[1:] != pair[:-1]).any(axis=1)))
        ends = np.append(starts[1:], len(pair))
        is_face = pair[starts, 0] != pair[starts, 1]
        runs = np.column_stack([np.full(len(starts), col), starts, ends, pair[starts]])
        found.append(runs[is_face])
    return np.concatenate(found)


def add_lights(scene: viser.SceneApi) -> None:
    """A sun in the south-west, where a page's first view is from, and light from everywhere."""
    scene.configure_default_lights(enabled=False)
    scene.add_light_directional("/light/sun", intensity=_SUN, cast_shadow=True, position=_SUN_M)
    scene.add_light_ambient("/light/sky", intensity=_SKY)


def add_floor(
    scene: viser.SceneApi, grid: OccupancyGrid, palette: Palette = LIGHT
) -> viser.BoxHandle:
    """Draws the map; returns a slab of the size of the floor, to be clicked on.

    The slab lies out of sight below the floor, because browsers colour what the pointer is on.
    Everything hangs below the node `/map`, which is the grid frame: metres from the lower-left
    corner of the map.
    """
    x_m, y_m, yaw_rad = grid.origin
    width_m, height_m = grid.size_m
    scene.add_frame("/map", show_axes=False, position=(x_m, y_m, 0.0), wxyz=turned(yaw_rad))
    centre = (width_m / 2, height_m / 2)
    terraces = terraces_of(grid, grid.cells == Cell.OCCUPIED)
    lowest_m, colours = terraces.lowest_m, map_colours(palette)
    for name, depth_m in (("floor", _FLOOR_THICKNESS_M / 2), ("slab", _SLAB_DEPTH_M)):
        # Nobody sees the slab past the floor's edge from where nothing but the floor hides it.
        inset_m = 0.0 if name == "floor" else min(_SLAB_DEPTH_M, width_m / 4, height_m / 4)
        slab = scene.add_box(
            f"/map/{name}",
            color=colours[f"/map/{name}"]["color"],
            dimensions=(width_m - 2 * inset_m, height_m - 2 * inset_m, _FLOOR_THICKNESS_M),
            position=(*centre, lowest_m - depth_m),
            cast_shadow=False,
        )
    scene.add_grid(
        "/map/lines",
        width=width_m,
        height=height_m,
        cell_size=0.5,
        section_size=1.0,
        cell_color=palette.line,
        section_color=palette.line,
        cell_thickness=0.6,
        section_thickness=1.0,
        position=(*centre, lowest_m + _LINES_HEIGHT_M),
        shadow_opacity=0.0,
    )
    plates = plates_of(grid, grid.cells == Cell.UNKNOWN)
    for name, boxes, rise_m in (
        ("walls", terraces.walls, WALL_HEIGHT_M),
        ("unknown", plates, _UNKNOWN_HEIGHT_M),
        *_ground_by_shade(terraces),
    ):
        if len(boxes):
            mesh = solid(boxes, base_m=lowest_m, rise_m=rise_m, cell_m=grid.resolution_m)
            scene.add_mesh_simple(
                f"/map/{name}",
                mesh[0].astype(np.float32),
                mesh[1].astype(np.uint32),
                color=colours[f"/map/{name}"]["color"],
                flat_shading=True,
            )
    return slab


def _ground_by_shade(terraces: Terraces) -> Iterator[tuple[str, FloatArray, float]]:
    """The floor that is higher than the lowest, browner with height: name, boxes and rise."""
    above_m = terraces.ground[:, 4] - terraces.lowest_m
    shades = np.ceil(_SHADES * above_m / max(above_m, default=1.0)).astype(int)
    for shade in range(1, _SHADES + 1):
        yield f"ground/{shade}", terraces.ground[shades == shade], 0.0


def blended(rgb: Rgb, other: Rgb, share: float) -> Rgb:
    """A colour between two, with so large a share of the other one."""
    red, green, blue = (
        round(mine + share * (others - mine)) for mine, others in zip(rgb, other, strict=True)
    )
    return red, green, blue


def turned(yaw_rad: float) -> tuple[float, float, float, float]:
    """The quaternion w, x, y, z of a turn about the vertical."""
    return math.cos(yaw_rad / 2), 0.0, 0.0, math.sin(yaw_rad / 2)


def on_floor(
    origin: Sequence[float] | np.ndarray,
    direction: Sequence[float] | np.ndarray,
    height_m: float = 0.0,
) -> tuple[float, float] | None:
    """Where a ray meets level ground of this height; None if it never does."""
    if direction[2] >= -1e-9:
        return None
    along = (height_m - origin[2]) / direction[2]
    return float(origin[0] + along * direction[0]), float(origin[1] + along * direction[1])


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
    elif kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        shape = trimesh.creation.icosphere(subdivisions=2).apply_scale(size)
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
        self._root = scene.add_frame(ROBOT_ROOT, show_axes=False)
        self._bodies = []
        self._posed = np.zeros(0)
        for name, parts in zip(meshes.names, meshes.parts, strict=True):
            self._bodies.append(scene.add_frame(f"{ROBOT_ROOT}/{name}", show_axes=False))
            for index, (rgb, shape) in enumerate(parts.items()):
                vertices, faces = np.array(shape.vertices), np.array(shape.faces)
                scene.add_mesh_simple(
                    f"{ROBOT_ROOT}/{name}/{index}",
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
