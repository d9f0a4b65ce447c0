"""A ROS master and a client of the old package's footstep_planner, in a process of their own.

It reads one JSON command a line and answers with one JSON line. Requests and answers of services
are packed by hand, after the definitions of humanoid_nav_msgs, and share no code with the project.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import socket
import struct
import sys
import time
from typing import Any

sys.path.append("/usr/lib/python3/dist-packages")

NODE = "/footstep_planner"


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def md5(text: str) -> str:
    return hashlib.md5(text.encode()).hexdigest()


# How ROS 1 sums up a definition: constants first, then fields, sums in place of names of messages.
POSE_2D = md5("float64 x\nfloat64 y\nfloat64 theta")
STEP_TARGET = md5(f"uint8 right=0\nuint8 left=1\n{POSE_2D} pose\nuint8 leg")
ANSWER = (
    f"bool result\n{STEP_TARGET} footsteps\nfloat64 costs\nfloat64 final_eps\n"
    "float64 planning_time\nint64 expanded_states"
)
PLAN_FOOTSTEPS = md5(f"{POSE_2D} start\n{POSE_2D} goal{ANSWER}")
FEET = ("start_left", "start_right", "goal_left", "goal_right")
PLAN_FOOTSTEPS_FEET = md5("\n".join(f"{STEP_TARGET} {name}" for name in FEET) + ANSWER)


def services() -> dict[str, Any]:
    """Classes of the two services, as rospy wants them, by their names."""
    import genpy

    class Request(genpy.Message):  # type: ignore[misc]
        __slots__ = ("packed",)
        _slot_types = ("string",)
        _type, _md5sum, _full_text = "Request", "*", ""

        def serialize(self, buff: Any) -> None:
            buff.write(self.packed)

    class Answer(genpy.Message):  # type: ignore[misc]
        __slots__ = ("told",)
        _slot_types = ("string",)
        _type, _md5sum, _full_text = "Answer", "*", ""

        def deserialize(self, data: bytes) -> Any:
            result, count = struct.unpack_from("<BI", data)
            step = struct.Struct("<dddB")
            steps = [step.unpack_from(data, 5 + step.size * k) for k in range(count)]
            end = 5 + step.size * count
            costs, eps, seconds, expanded = struct.unpack_from("<dddq", data, end)
            assert len(data) == end + 32
            self.told = {
                "result": bool(result),
                "footsteps": steps,
                "costs": costs,
                "final_eps": eps if math.isfinite(eps) else None,
                "planning_time": seconds,
                "expanded_states": expanded,
            }
            return self

    def service(kind: str, md5sum: str) -> Any:
        members: dict[str, Any] = {"_type": kind, "_md5sum": md5sum}
        members |= {"_request_class": Request, "_response_class": Answer}
        return type(kind.rpartition("/")[2], (), members)

    package = "humanoid_nav_msgs"
    return {
        "plan_footsteps": service(f"{package}/PlanFootsteps", PLAN_FOOTSTEPS),
        "plan_footsteps_feet": service(f"{package}/PlanFootstepsBetweenFeet", PLAN_FOOTSTEPS_FEET),
    }


class Client:
    """What it sends on topics and by services, and what it has heard."""

    def __init__(self) -> None:
        from rosmaster.master import Master

        self.port = free_port()
        os.environ["ROS_MASTER_URI"] = f"http://127.0.0.1:{self.port}"
        os.environ["ROS_IP"] = "127.0.0.1"
        self._master = Master(self.port)
        self._master.start()
        import rospy
        from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
        from nav_msgs.msg import OccupancyGrid, Path
        from rosgraph_msgs.msg import Log
        from sensor_msgs.msg import PointCloud
        from visualization_msgs.msg import MarkerArray

        self._rospy = rospy
        rospy.init_node("client", disable_signals=True)
        self._kinds = {
            "map": OccupancyGrid,
            "goal": PoseStamped,
            "initialpose": PoseWithCovarianceStamped,
        }
        self._publishers = {
            # Where ROS 1's RViz sends its goals.
            topic: rospy.Publisher(
                "/move_base_simple/goal" if topic == "goal" else topic, kind, queue_size=10
            )
            for topic, kind in self._kinds.items()
        }
        self.heard: dict[str, list[Any]] = {}
        for topic, kind in (
            ("footsteps_array", MarkerArray),
            ("path", Path),
            ("heuristic_path", Path),
            ("expanded_states", PointCloud),
            ("start", PoseStamped),
        ):
            self._listen(topic, f"{NODE}/{topic}", kind)
        self._listen("log", "/rosout", Log)
        self._services: dict[str, Any] = {}

    def _listen(self, name: str, topic: str, kind: Any) -> None:
        kept = self.heard.setdefault(name, [])
        self._rospy.Subscriber(topic, kind, kept.append)

    def parameters(self, values: dict[str, Any]) -> None:
        """Sets those of the node, as roslaunch does before the node starts."""
        self._rospy.set_param(NODE, values)

    def send(self, topic: str, **fields: Any) -> None:
        """A message whose fields are named by paths, such as info.width."""
        message = self._kinds[topic]()
        message.header.frame_id = "map"
        for path, value in fields.items():
            *way, last = path.split(".")
            part = message
            for name in way:
                part = getattr(part, name)
            setattr(part, last, value)
        while not self._publishers[topic].get_num_connections():
            time.sleep(0.02)
        self._publishers[topic].publish(message)

    def ask(self, service: str, numbers: list[float]) -> Any:
        """Poses of 3 numbers; for feet the leg comes with each."""
        if service not in self._services:
            self._services[service] = self._rospy.ServiceProxy(service, services()[service])
        pose = struct.Struct("<ddd")
        poses = [pose.pack(*numbers[k : k + 3]) for k in range(0, len(numbers), 3)]
        legs = [b""] * 2 if len(poses) == 2 else [b"\1", b"\0", b"\1", b"\0"]
        packed = b"".join(at + leg for at, leg in zip(poses, legs, strict=True))
        return self._services[service](packed).told

    def serves(self, service: str) -> bool:
        """Whether there is a node that does."""
        with contextlib.suppress(Exception):
            self._rospy.wait_for_service(service, 0.1)
            return True
        return False

    def latest(self, topic: str) -> Any:
        """How many messages came on a topic, and the numbers of the last one."""
        kept = self.heard[topic]
        return [len(kept), told(kept[-1]) if kept else None]

    def log(self) -> list[str]:
        """The node's warnings so far."""
        return [m.msg for m in self.heard["log"] if m.name == NODE and m.level >= m.WARN]


def told(message: Any) -> Any:
    """What a test asks of a message."""
    if hasattr(message, "markers"):
        return [
            [m.action, m.id, m.pose.position.x, m.pose.position.y, m.color.b > m.color.r]
            for m in message.markers
        ]
    if hasattr(message, "poses"):
        return [[p.pose.position.x, p.pose.position.y] for p in message.poses]
    if hasattr(message, "points"):
        return [[p.x, p.y] for p in message.points]
    return [message.header.frame_id, message.pose.position.x, message.pose.position.y]


def main() -> None:
    """Commands as [name, words, named words], until standard input ends."""
    # rospy prints on standard output too: answers go where nothing else does.
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    client = Client()
    print(json.dumps(client.port), file=answers, flush=True)
    for line in sys.stdin:
        name, words, named = json.loads(line)
        answer = getattr(client, name)(*words, **named)
        print(json.dumps(answer), file=answers, flush=True)
    with contextlib.suppress(Exception):
        client._rospy.signal_shutdown("done")
    os._exit(0)


if __name__ == "__main__":
    main()
