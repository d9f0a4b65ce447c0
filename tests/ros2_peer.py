"""A bare DDS participant beside the ROS 2 node, whose types are written by hand here.

They follow the message definitions of ROS 2 (common_interfaces, Humble) and not the project's code.
"""

# Cyclone DDS reads its types when the program runs; checkers know less of them.
# mypy: disable-error-code="valid-type,type-arg,arg-type,assignment,index"

import json
import math
import os
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float32, float64, int8, int32, sequence, uint8, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from tests.programs import ROOT

# Two that other programs hardly use: one test at a time may be in each.
DOMAIN = 150 + os.getpid() % 60
PATIENCE_S = 240.0


@dataclass
class Time(IdlStruct, typename="builtin_interfaces.msg.dds_.Time_"):
    sec: int32 = 0
    nanosec: uint32 = 0


@dataclass
class Header(IdlStruct, typename="std_msgs.msg.dds_.Header_"):
    stamp: Time = field(default_factory=Time)
    frame_id: str = "map"


@dataclass
class Text(IdlStruct, typename="std_msgs.msg.dds_.String_"):
    data: str


@dataclass
class Point(IdlStruct, typename="geometry_msgs.msg.dds_.Point_"):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs.msg.dds_.Vector3_"):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs.msg.dds_.Quaternion_"):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0
    w: float64 = 1.0


@dataclass
class Pose(IdlStruct, typename="geometry_msgs.msg.dds_.Pose_"):
    position: Point = field(default_factory=Point)
    orientation: Quaternion = field(default_factory=Quaternion)


@dataclass
class PoseStamped(IdlStruct, typename="geometry_msgs.msg.dds_.PoseStamped_"):
    header: Header
    pose: Pose


@dataclass
class PoseWithCovariance(IdlStruct, typename="geometry_msgs.msg.dds_.PoseWithCovariance_"):
    pose: Pose
    covariance: array[float64, 36]


@dataclass
class InitialPose(IdlStruct, typename="geometry_msgs.msg.dds_.PoseWithCovarianceStamped_"):
    header: Header
    pose: PoseWithCovariance


@dataclass
class Twist(IdlStruct, typename="geometry_msgs.msg.dds_.Twist_"):
    linear: Vector3
    angular: Vector3


@dataclass
class TwistWithCovariance(IdlStruct, typename="geometry_msgs.msg.dds_.TwistWithCovariance_"):
    twist: Twist
    covariance: array[float64, 36]


@dataclass
class Odometry(IdlStruct, typename="nav_msgs.msg.dds_.Odometry_"):
    header: Header
    child_frame_id: str
    pose: PoseWithCovariance
    twist: TwistWithCovariance


@dataclass
class MapMetaData(IdlStruct, typename="nav_msgs.msg.dds_.MapMetaData_"):
    map_load_time: Time
    resolution: float32
    width: uint32
    height: uint32
    origin: Pose


@dataclass
class Occupancy(IdlStruct, typename="nav_msgs.msg.dds_.OccupancyGrid_"):
    header: Header
    info: MapMetaData
    data: sequence[int8]


@dataclass
class Walkway(IdlStruct, typename="nav_msgs.msg.dds_.Path_"):
    header: Header
    poses: sequence[PoseStamped]


@dataclass
class Transform(IdlStruct, typename="geometry_msgs.msg.dds_.Transform_"):
    translation: Vector3
    rotation: Quaternion


@dataclass
class TransformStamped(IdlStruct, typename="geometry_msgs.msg.dds_.TransformStamped_"):
    header: Header
    child_frame_id: str
    transform: Transform


@dataclass
class TFMessage(IdlStruct, typename="tf2_msgs.msg.dds_.TFMessage_"):
    transforms: sequence[TransformStamped]


@dataclass
class JointState(IdlStruct, typename="sensor_msgs.msg.dds_.JointState_"):
    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


@dataclass
class Clock(IdlStruct, typename="rosgraph_msgs.msg.dds_.Clock_"):
    clock: Time


@dataclass
class ColorRGBA(IdlStruct, typename="std_msgs.msg.dds_.ColorRGBA_"):
    r: float32
    g: float32
    b: float32
    a: float32


@dataclass
class Duration(IdlStruct, typename="builtin_interfaces.msg.dds_.Duration_"):
    sec: int32
    nanosec: uint32


@dataclass
class CompressedImage(IdlStruct, typename="sensor_msgs.msg.dds_.CompressedImage_"):
    header: Header
    format: str
    data: sequence[uint8]


@dataclass
class UVCoordinate(IdlStruct, typename="visualization_msgs.msg.dds_.UVCoordinate_"):
    u: float32
    v: float32


@dataclass
class MeshFile(IdlStruct, typename="visualization_msgs.msg.dds_.MeshFile_"):
    filename: str
    data: sequence[uint8]


@dataclass
class Marker(IdlStruct, typename="visualization_msgs.msg.dds_.Marker_"):
    header: Header
    ns: str
    id: int32
    type: int32
    action: int32
    pose: Pose
    scale: Vector3
    color: ColorRGBA
    lifetime: Duration
    frame_locked: bool
    points: sequence[Point]
    colors: sequence[ColorRGBA]
    texture_resource: str
    texture: CompressedImage
    uv_coordinates: sequence[UVCoordinate]
    text: str
    mesh_resource: str
    mesh_file: MeshFile
    mesh_use_embedded_materials: bool


@dataclass
class MarkerArray(IdlStruct, typename="visualization_msgs.msg.dds_.MarkerArray_"):
    markers: sequence[Marker]


RELIABLE = Policy.Reliability.Reliable(duration(seconds=1))
LATCHED = Qos(RELIABLE, Policy.Durability.TransientLocal, Policy.History.KeepLast(1))
VOLATILE = Qos(RELIABLE, Policy.Durability.Volatile, Policy.History.KeepLast(100))
LOOPBACK = (
    "<CycloneDDS><Domain Id='any'><General><Interfaces><NetworkInterface address='127.0.0.1'/>"
    "</Interfaces><AllowMulticast>false</AllowMulticast></General><Discovery>"
    "<ParticipantIndex>auto</ParticipantIndex><Peers><Peer address='127.0.0.1'/></Peers>"
    "</Discovery></Domain></CycloneDDS>"
)


class Participant:
    """Writes to the node's topics and keeps what comes back."""

    def __init__(self, domain: int) -> None:
        self._domain = Domain(domain, LOOPBACK)
        self._participant = DomainParticipant(domain)
        self.map = self._writer("map", Occupancy, LATCHED)
        self.goal = self._writer("goal_pose", PoseStamped, VOLATILE)
        self.start = self._writer("initialpose", InitialPose, VOLATILE)
        self.request = self._writer("plan_request", Text, VOLATILE)
        self._readers = {
            name: DataReader(self._participant, self._topic(name, kind), qos)
            for name, kind, qos in (
                ("footsteps", MarkerArray, LATCHED),
                ("path", Walkway, LATCHED),
                ("robot_description", Text, LATCHED),
                ("tf_static", TFMessage, LATCHED),
                ("tf", TFMessage, VOLATILE),
                ("odom", Odometry, VOLATILE),
                ("joint_states", JointState, VOLATILE),
                ("plan_events", Text, VOLATILE),
                ("plan", Text, VOLATILE),
                ("clock", Clock, VOLATILE),
            )
        }
        self.got: dict[str, list[Any]] = {name: [] for name in self._readers}

    def _topic(self, name: str, kind: Any) -> Any:
        return Topic(self._participant, f"rt/{name}", kind)

    def _writer(self, name: str, kind: Any, qos: Any) -> Any:
        return DataWriter(self._participant, self._topic(name, kind), qos)

    def until(self, is_so: Any, what: str) -> None:
        """Listens until something is so; fails after a long time."""
        ends_s = time.monotonic() + PATIENCE_S
        while not is_so():
            assert time.monotonic() < ends_s, f"waited in vain for {what}"
            for name, reader in self._readers.items():
                self.got[name] += reader.take(200)
            time.sleep(0.005)

    def events(self) -> list[dict[str, Any]]:
        return [json.loads(event.data) for event in self.got["plan_events"]]


def pose_at(x: float, y: float, yaw: float) -> Pose:
    turn = Quaternion(z=math.sin(yaw / 2), w=math.cos(yaw / 2))
    return Pose(Point(x, y, 0.0), turn)


def room(*, wall: bool = False) -> Occupancy:
    """5 x 3 m from -1,-1.5, walled in; with a wall across it at x = 1.5 that has a gap."""
    cells = np.zeros((60, 100), int)
    cells[[0, -1]] = 100
    cells[:, [0, -1]] = 100
    if wall:
        cells[:26, 50:52] = 100
    info = MapMetaData(Time(), 0.05, 100, 60, pose_at(-1.0, -1.5, 0.0))
    return Occupancy(Header(), info, cells.ravel().tolist())


class Node:
    """The program in a process of its own, and the lines that it says."""

    def __init__(self, *words: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "main.py", "ros2", "--domain", str(DOMAIN), *words],
            cwd=ROOT,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.lines: list[str] = []
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.lines.append(line.rstrip("\n"))

    def warnings(self) -> list[str]:
        return [line for line in self.lines if line.startswith("warning: ")]
