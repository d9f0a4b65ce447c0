"""ROS 2 messages of maps, poses, plans and footprints.

A message is a value of rosbags' types (ROS 2 Humble's definitions, which later releases share), so
that recording, bag and node say the same, and CDR bytes are made in one place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from maps.grid import Cell, OccupancyGrid
from planner.plan import FootstepPlan, pair_pose
from planner.robot_model import FootShape, Side

MAP_FRAME = "map"
LEFT_RGB, RIGHT_RGB = (0.16, 0.44, 0.86), (0.93, 0.49, 0.10)
_FOOT_HEIGHT_M = 0.01
_CUBE, _ADD, _DELETE = 1, 0, 2
# Occupancy in per cent, as nav_msgs/OccupancyGrid counts it.
_OCCUPANCY = {Cell.FREE: 0, Cell.OCCUPIED: 100, Cell.UNKNOWN: -1}
OCCUPIED_FROM = 65  # what map_server saves as occupied: its occupied_thresh of 0.65


@cache
def _store() -> Any:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE)


def new(kind: str, **fields: Any) -> Any:
    """A message of the kind `std_msgs/msg/String`, whose fields must all be given."""
    return _store().types[kind](**fields)


def encoded(kind: str, message: Any) -> bytes:
    """The message as CDR with its encapsulation header, little endian."""
    return bytes(_store().serialize_cdr(message, kind))


def decoded(kind: str, cdr: bytes) -> Any:
    """The message that CDR bytes hold; what rosbags raises where they hold none."""
    return _store().deserialize_cdr(cdr, kind)


def definition(kind: str) -> str:
    """The text of the message's definition, with those that it is made of."""
    return str(_store().generate_msgdef(kind, ros_version=2)[0])


def field_types(kind: str) -> list[tuple[str, tuple[str, Any, int]]]:
    """Names and types of the message's fields.

    A type is ("base", "float64", 0), ("name", "std_msgs/msg/Header", 0), or ("array", type, N) and
    ("sequence", type, 0) of another type.
    """

    def of(field: Any) -> tuple[str, Any, int]:
        shape, inside = field
        name = shape.name.lower()
        if name in ("array", "sequence"):
            return name, of(inside[0]), inside[1]
        return name, inside[0] if name == "base" else inside, 0

    return [(name, of(field)) for name, field in _store().fielddefs[kind][1]]


def type_hash(kind: str) -> str:
    """RIHS01 hash of the message's definition, by which ROS 2 from Iron on tells types apart."""
    return str(_store().hash_rihs01(kind))


@dataclass(frozen=True)
class Told:
    """A message on its way: where it goes, what it is, and whether late comers get the last one."""

    topic: str
    kind: str
    message: Any
    is_latched: bool = False


def stamp(time_ns: int) -> Any:
    """A point of time."""
    return new("builtin_interfaces/msg/Time", sec=time_ns // 10**9, nanosec=time_ns % 10**9)


def header(time_ns: int, frame: str = MAP_FRAME) -> Any:
    """The head of a stamped message."""
    return new("std_msgs/msg/Header", stamp=stamp(time_ns), frame_id=frame)


def vector(values: ArrayLike, kind: str = "Vector3") -> Any:
    """A Vector3 or Point of x, y, z."""
    x, y, z = (float(value) for value in np.asarray(values))
    return new(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)


def quaternion(wxyz: ArrayLike) -> Any:
    """A Quaternion of w, x, y, z."""
    w, x, y, z = (float(value) for value in np.asarray(wxyz))
    return new("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def pose(x_m: float, y_m: float, z_m: float, yaw_rad: float) -> Any:
    """A Pose turned about the vertical."""
    turn = quaternion((math.cos(yaw_rad / 2), 0.0, 0.0, math.sin(yaw_rad / 2)))
    position = vector((x_m, y_m, z_m), "Point")
    return new("geometry_msgs/msg/Pose", position=position, orientation=turn)


def text(words: str) -> Any:
    """A String."""
    return new("std_msgs/msg/String", data=words)


def occupancy(grid: OccupancyGrid, time_ns: int) -> Any:
    """The map as an OccupancyGrid."""
    x_m, y_m, yaw_rad = grid.origin
    rows, cols = grid.shape
    table = np.array([_OCCUPANCY[cell] for cell in sorted(Cell)], np.int8)
    info = new(
        "nav_msgs/msg/MapMetaData",
        map_load_time=stamp(time_ns),
        resolution=float(grid.resolution_m),
        width=cols,
        height=rows,
        origin=pose(x_m, y_m, 0.0, yaw_rad),
    )
    data = table[grid.cells].ravel()
    return new("nav_msgs/msg/OccupancyGrid", header=header(time_ns), info=info, data=data)


def grid_of(message: Any) -> OccupancyGrid:
    """The map in an OccupancyGrid; cells from 65 per cent on are occupied, below free.

    Raises:
        ValueError: It has no cells, another number of them than it says, or no place.
    """
    info = message.info
    rows, cols, data = int(info.height), int(info.width), np.asarray(message.data)
    if rows * cols == 0:
        raise ValueError(f"the map has {cols} x {rows} cells, must have at least one")
    if data.size != rows * cols:
        raise ValueError(f"the map has {data.size} cells, must have {cols} x {rows}")
    if data.min() < -1 or data.max() > 100:
        raise ValueError("the map's cells must be from -1 (unknown) to 100 (occupied)")
    cells = np.full(rows * cols, Cell.FREE, np.uint8)
    cells[data >= OCCUPIED_FROM] = Cell.OCCUPIED
    cells[data < 0] = Cell.UNKNOWN
    resolution_m = round(float(info.resolution), 7)  # it comes as 32 bits: 0.05 is 0.0500000007
    origin = pose2d_of(info.origin)
    return OccupancyGrid(cells=cells.reshape(rows, cols), resolution_m=resolution_m, origin=origin)


def pose2d_of(message: Any) -> tuple[float, float, float]:
    """x_m, y_m, yaw_rad of a Pose.

    Raises:
        ValueError: A number is not finite, the quaternion is not of length 1 or tilts the pose.
    """
    at, turn = message.position, message.orientation
    numbers = np.array([at.x, at.y, at.z, turn.w, turn.x, turn.y, turn.z], float)
    if not np.all(np.isfinite(numbers)):
        raise ValueError("the pose has a number that is not finite")
    w, x, y, z = numbers[3:]
    length = float(np.linalg.norm(numbers[3:]))
    if abs(length - 1.0) > 0.01:
        raise ValueError(f"the pose's quaternion has length {length:.3g}, must be 1")
    if 1 - 2 * (x * x + y * y) < 0.98:
        raise ValueError("the pose is tilted: only a turn about the vertical can be stood in")
    yaw_rad = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return float(at.x), float(at.y), yaw_rad


def footprint(
    side: Side,
    where: ArrayLike,
    foot: FootShape,
    *,
    name: str,
    number: int,
    time_ns: int,
    opacity: float,
) -> Any:
    """A Marker on the ground as large as the sole; blue is left, orange right."""
    x_m, y_m, z_m, yaw_rad = (float(value) for value in np.asarray(where))
    red, green, blue = LEFT_RGB if side is Side.LEFT else RIGHT_RGB
    return _marker(
        name,
        number,
        time_ns,
        action=_ADD,
        pose=pose(x_m, y_m, z_m + _FOOT_HEIGHT_M / 2, yaw_rad),
        scale=vector((foot.length_m, foot.width_m, _FOOT_HEIGHT_M)),
        color=new("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=opacity),
    )


def _marker(name: str, number: int, time_ns: int, **fields: Any) -> Any:
    values: dict[str, Any] = {
        "type": _CUBE,
        "pose": pose(0.0, 0.0, 0.0, 0.0),
        "scale": vector((0.0, 0.0, 0.0)),
        "color": new("std_msgs/msg/ColorRGBA", r=0.0, g=0.0, b=0.0, a=0.0),
        **fields,
    }
    no_bytes = np.zeros(0, np.uint8)
    return new(
        "visualization_msgs/msg/Marker",
        header=header(time_ns),
        ns=name,
        id=number,
        lifetime=new("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
        frame_locked=False,
        points=[],
        colors=[],
        texture_resource="",
        texture=new(
            "sensor_msgs/msg/CompressedImage", header=header(0, ""), format="", data=no_bytes
        ),
        uv_coordinates=[],
        text="",
        mesh_resource="",
        mesh_file=new("visualization_msgs/msg/MeshFile", filename="", data=no_bytes),
        mesh_use_embedded_materials=False,
        **values,
    )


class FootprintMarkers:
    """Footprints under one name, numbered from 0; those of before that are no more are deleted."""

    def __init__(self, name: str, foot: FootShape, *, opacity: float) -> None:
        self.name, self._foot, self._opacity = name, foot, opacity
        self._shown = 0

    def show(self, side: Sequence[Any], poses_world: ArrayLike, time_ns: int) -> Any:
        """A MarkerArray of sides (N,) and poses (N, 4) x, y, z, yaw."""
        markers = [
            footprint(
                Side(int(one)),
                where,
                self._foot,
                name=self.name,
                number=number,
                time_ns=time_ns,
                opacity=self._opacity,
            )
            for number, (one, where) in enumerate(zip(side, np.asarray(poses_world), strict=True))
        ]
        gone = range(len(markers), self._shown)
        self._shown = len(markers)
        markers += [_marker(self.name, number, time_ns, action=_DELETE) for number in gone]
        return new("visualization_msgs/msg/MarkerArray", markers=markers)


def body_poses(plan: FootstepPlan | None) -> np.ndarray:
    """The middle (n, 4) x, y, z, yaw between the feet before the first step and after each.

    (0, 4) for None.
    """
    if plan is None:
        return np.zeros((0, 4))
    feet = np.array(plan.start_feet_world)
    found = [_middle(feet)]
    for side, where in zip(plan.side, plan.pose_world, strict=True):
        feet[side] = where
        found.append(_middle(feet))
    return np.array(found)


def _middle(feet: np.ndarray) -> tuple[float, float, float, float]:
    x_m, y_m, yaw_rad = (float(value) for value in pair_pose(feet))
    return x_m, y_m, float(feet[:, 2].mean()), yaw_rad


def path(poses_world: ArrayLike, time_ns: int) -> Any:
    """A Path of poses (n, 4) x, y, z, yaw."""
    stamped = [
        new("geometry_msgs/msg/PoseStamped", header=header(time_ns), pose=pose(*map(float, where)))
        for where in np.asarray(poses_world)
    ]
    return new("nav_msgs/msg/Path", header=header(time_ns), poses=stamped)


def told_map(grid: OccupancyGrid, time_ns: int) -> Told:
    """The map, for those who come late too."""
    return Told("map", "nav_msgs/msg/OccupancyGrid", occupancy(grid, time_ns), is_latched=True)
