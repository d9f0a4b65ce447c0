"""ROS 1 messages: those of humanoid_nav_msgs, made at run time, and copies of ROS 2's.

The package humanoid_nav_msgs is in no distribution. Where it is not installed its classes are made
from the definitions below, whose names, types and order of fields are the package's (humanoid_msgs,
BSD): what they send is the same to the bit, and so are the md5 sums by which ROS 1 tells types.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from app.output import InputError

# Where Debian and Ubuntu have the packages of ROS 1 for Python, which a virtual environment hides.
_SYSTEM_PACKAGES = Path("/usr/lib/python3/dist-packages")
_PACKAGES = (
    *("rospy", "rosgraph", "genpy", "geometry_msgs", "nav_msgs", "sensor_msgs"),
    "visualization_msgs",
)
_BESIDE = "humanoid_nav_msgs"
_ANSWER = f"""bool result
{_BESIDE}/StepTarget[] footsteps
float64 costs
float64 final_eps
float64 planning_time
int64 expanded_states
"""
_MESSAGES = {
    "geometry_msgs/Pose2D": "float64 x\nfloat64 y\nfloat64 theta\n",
    f"{_BESIDE}/StepTarget": (
        "geometry_msgs/Pose2D pose\nuint8 leg\nuint8 right=0\nuint8 left=1\n"
    ),
}
_REQUESTS = {
    "PlanFootsteps": "geometry_msgs/Pose2D start\ngeometry_msgs/Pose2D goal\n",
    "PlanFootstepsBetweenFeet": "".join(
        f"{_BESIDE}/StepTarget {name}\n"
        for name in ("start_left", "start_right", "goal_left", "goal_right")
    ),
}
RIGHT, LEFT = 0, 1  # values of StepTarget.leg


class HumanoidNavMsgs(NamedTuple):
    """Classes of humanoid_nav_msgs: of the message StepTarget, and of the two services."""

    StepTarget: Any
    PlanFootsteps: Any
    PlanFootstepsBetweenFeet: Any


def require_ros1() -> None:
    """Makes sure that rospy and the messages can be imported.

    Those of the system are taken where there are no others; what is in this environment as well is
    taken from here.

    Raises:
        InputError: They are not there; the message names the packages.
    """
    if importlib.util.find_spec("rospy") is None and (_SYSTEM_PACKAGES / "rospy").is_dir():
        sys.path.append(str(_SYSTEM_PACKAGES))
    missing = [name for name in _PACKAGES if importlib.util.find_spec(name) is None]
    if missing:
        debian = " ".join(f"python3-{name.replace('_', '-')}" for name in missing)
        raise InputError(
            f"ros1 needs {', '.join(missing)} of ROS 1: on Debian 12 `apt-get install {debian}`, "
            "elsewhere source the setup of your ROS"
        )
    if importlib.util.find_spec("rosbags") is None:
        raise InputError("ros1 needs the package rosbags: python -m pip install -e '.[ros1]'")


@cache
def humanoid_nav_msgs() -> HumanoidNavMsgs:
    """The classes of the installed package, else their like made from the definitions here."""
    if importlib.util.find_spec(_BESIDE) is not None:
        services = importlib.import_module(f"{_BESIDE}.srv")
        target = importlib.import_module(f"{_BESIDE}.msg").StepTarget
        return HumanoidNavMsgs(target, *(getattr(services, name) for name in _REQUESTS))
    target = _made(f"{_BESIDE}/StepTarget", _MESSAGES[f"{_BESIDE}/StepTarget"])
    return HumanoidNavMsgs(target, *(_service(name) for name in _REQUESTS))


def _made(kind: str, definition: str) -> Any:
    """The class of a message."""
    from genpy.dynamic import generate_dynamic

    line = "=" * 80
    parts = [f"{line}\nMSG: {name}\n{words}" for name, words in _MESSAGES.items() if name != kind]
    return generate_dynamic(kind, "".join([definition, *parts]))[kind]


def _service(name: str) -> Any:
    """The class of a service, as rospy wants it."""
    from genmsg import MsgContext, compute_md5
    from genmsg.msg_loader import load_msg_from_string, load_srv_from_string

    kind, request = f"{_BESIDE}/{name}", _REQUESTS[name]
    context = MsgContext.create_default()
    for part, definition in _MESSAGES.items():
        load_msg_from_string(context, definition, part)
    service = load_srv_from_string(context, f"{request}---\n{_ANSWER}", kind)
    members = {
        "_type": kind,
        "_md5sum": compute_md5(context, service),
        "_request_class": _made(f"{kind}Request", request),
        "_response_class": _made(f"{kind}Response", _ANSWER),
    }
    return type(name, (), members)


def ros1_class(kind: str) -> Any:
    """The class of a ROS 1 message of a kind such as nav_msgs/Path."""
    package, name = kind.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def as_ros1(kind: str, message: Any, frame: str) -> Any:
    """A message of `app/ros/messages.py` as one of ROS 1, in another frame.

    kind: its name in ROS 1, such as nav_msgs/Path. Fields go by their names; those that only one
    of the two has are left out, or as they are by default.
    """
    import genpy

    inner, is_list, _ = kind.partition("[")
    if is_list:
        return [as_ros1(inner, one, frame) for one in message]
    if kind in ("time", "duration"):
        return (genpy.Time if kind == "time" else genpy.Duration)(message.sec, message.nanosec)
    if "/" not in kind:
        return message
    made = ros1_class(kind)()
    for name, field in zip(made.__slots__, made._slot_types, strict=True):
        if hasattr(message, name):
            setattr(made, name, as_ros1(field, getattr(message, name), frame))
    if kind == "std_msgs/Header":
        made.frame_id = frame
    return made
