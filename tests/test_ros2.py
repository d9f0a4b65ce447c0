"""The ROS 2 node seen from outside: a bare DDS participant whose types are written by hand here.

They follow the message definitions of ROS 2 (common_interfaces, Humble) and not the project's code.
"""

# Cyclone DDS reads its types when the program runs; checkers know less of them.
# mypy: disable-error-code="valid-type,type-arg,arg-type,assignment,index"

import json
import math
import os
import re
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")
import itertools

from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float32, float64, int8, int32, sequence, uint8, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from tests.programs import refusal

ROOT = Path(__file__).resolve().parent.parent
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
        self._readers = {
            name: DataReader(self._participant, Topic(self._participant, f"rt/{name}", kind), qos)
            for name, kind, qos in (
                ("footsteps", MarkerArray, LATCHED),
                ("path", Walkway, LATCHED),
                ("robot_description", Text, LATCHED),
                ("tf_static", TFMessage, LATCHED),
                ("tf", TFMessage, VOLATILE),
                ("odom", Odometry, VOLATILE),
                ("joint_states", JointState, VOLATILE),
                ("plan_events", Text, VOLATILE),
                ("clock", Clock, VOLATILE),
            )
        }
        self.got: dict[str, list[Any]] = {name: [] for name in self._readers}

    def _writer(self, name: str, kind: Any, qos: Any) -> Any:
        return DataWriter(self._participant, Topic(self._participant, f"rt/{name}", kind), qos)

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


def udp_addresses(pid: int) -> set[str]:
    """Addresses of a process's UDP sockets, each with the device it is bound to."""
    done = subprocess.run(["ss", "-lunp"], capture_output=True, text=True, check=False)
    lines = [line for line in done.stdout.splitlines() if f"pid={pid}," in line]
    return {re.sub(r":\d+$", "", line.split()[3]) for line in lines}


@pytest.mark.slow
def test_a_robot_walks_where_a_bare_participant_sends_it(tmp_path):
    node = Node("--sim-time", "--robot", "jvrc1")
    try:
        peer = Participant(DOMAIN)
        peer.until(lambda: peer.goal.get_matched_subscriptions(), "the node")
        goal = pose_at(0.8, -0.4, 0.5)
        peer.goal.write(PoseStamped(Header(), goal))
        peer.until(lambda: len(node.warnings()) == 1, "a warning: no map")
        assert "goal_pose: there is no map yet" in node.warnings()[0]

        empty = room()
        empty.info.width, empty.data = 0, []
        peer.map.write(empty)
        peer.until(lambda: len(node.warnings()) == 2, "a warning: no cells")
        short = room()
        short.data = short.data[:-1]
        peer.map.write(short)
        peer.until(lambda: len(node.warnings()) == 3, "a warning: too few cells")
        assert "must have 100 x 60" in node.warnings()[2]

        peer.map.write(room())
        peer.until(lambda: peer.got["robot_description"] and peer.got["odom"], "the robot")
        assert peer.got["robot_description"][0].data.startswith("<?xml")
        at = peer.got["odom"][-1].pose.pose.position
        assert (at.x, at.y) == pytest.approx((0, 0), abs=0.1)

        for bad, told in (
            (PoseStamped(Header(), pose_at(math.nan, 0, 0)), "not finite"),
            (PoseStamped(Header(frame_id="odom"), goal), "frame is 'odom'"),
            (PoseStamped(Header(), Pose(Point(), Quaternion(w=0.3))), "length 0.3"),
            (PoseStamped(Header(), pose_at(9, 9, 0)), "no plan"),
        ):
            count = len(node.warnings())
            peer.goal.write(bad)
            peer.until(lambda count=count: len(node.warnings()) > count, told)
            assert told in node.warnings()[-1]
            assert len(node.warnings()) == count + 1

        asked_s = time.monotonic()
        peer.goal.write(PoseStamped(Header(), goal))
        peer.until(lambda: any(m.markers for m in peer.got["footsteps"]), "footsteps")
        print(f"goal to first marker: {1000 * (time.monotonic() - asked_s):.0f} ms")
        markers = next(m for m in peer.got["footsteps"] if m.markers).markers
        assert {marker.action for marker in markers} == {0}
        assert [marker.id for marker in markers] == list(range(len(markers)))
        left = [marker.color.b > marker.color.r for marker in markers]
        assert all(a != b for a, b in itertools.pairwise(left))
        peer.until(lambda: any(p.poses for p in peer.got["path"]), "the path")
        end = [p for p in peer.got["path"] if p.poses][-1].poses[-1].pose.position
        assert (end.x, end.y) == pytest.approx((0.8, -0.4), abs=1e-6)

        peer.until(lambda: any(e["event"] == "reached" for e in peer.events()), "the goal")
        at = peer.got["odom"][-1].pose.pose.position
        assert math.dist((at.x, at.y), (0.8, -0.4)) < 0.2
        legs = peer.got["joint_states"][-1]
        assert len(legs.name) == len(legs.position) == len(legs.velocity) == len(legs.effort) == 12
        frames = {t.child_frame_id: t.header.frame_id for t in peer.got["tf"][-1].transforms}
        assert frames["pelvis"] == "map"
        fixed = {t.child_frame_id for t in peer.got["tf_static"][0].transforms}
        assert {"left_sole", "right_sole"} <= fixed
        ticks = [c.clock.sec * 40 + c.clock.nanosec // 25_000_000 for c in peer.got["clock"]]
        assert np.all(np.diff(ticks) > 0)

        # A wall comes up on the way: the robot plans again, and arrives all the same.
        peer.got["footsteps"].clear()
        peer.goal.write(PoseStamped(Header(), pose_at(2.6, -0.6, 0.0)))
        peer.until(lambda: any(m.markers for m in peer.got["footsteps"]), "footsteps")
        straight = len([m for m in peer.got["footsteps"] if m.markers][-1].markers)
        peer.got["footsteps"].clear()
        peer.map.write(room(wall=True))
        peer.until(
            lambda: any(
                sum(marker.action == 0 for marker in m.markers) > straight
                for m in peer.got["footsteps"]
            ),
            "a way round the wall",
        )
        reached = sum(e["event"] == "reached" for e in peer.events())
        peer.until(
            lambda: (
                sum(e["event"] == "reached" for e in peer.events()) > reached
                or any(e["event"] in ("fell", "collided") for e in peer.events())
            ),
            "the second goal",
        )
        at = peer.got["odom"][-1].pose.pose.position
        assert math.dist((at.x, at.y), (2.6, -0.6)) < 0.2

        # RViz puts the robot somewhere else: its footprints go.
        there = PoseWithCovariance(pose_at(-0.2, 0.5, 1.0), [0.0] * 36)
        peer.got["odom"].clear()
        peer.start.write(InitialPose(Header(), there))
        peer.until(
            lambda: peer.got["odom"] and peer.got["odom"][-1].pose.pose.position.x < 0.1,
            "the robot at its new place",
        )
        addresses = udp_addresses(node.process.pid)
        assert all(one.startswith("127.0.0.1") or one.endswith("%lo") for one in addresses)
        assert node.process.poll() is None
    finally:
        node.process.terminate()
        code = node.process.wait(timeout=60)
    assert code == 143
    assert len(node.warnings()) == 7, node.lines


def test_options_that_do_not_go_together(capsys):
    assert "give --network too" in refusal(capsys, "ros2", "--interface", "eth0")
    assert "must be from 0 to 232" in refusal(capsys, "ros2", "--domain", "233")
    assert "no-such-interface" in refusal(
        capsys, "ros2", "--network", "--interface", "no-such-interface", "--domain", DOMAIN + 1
    )
