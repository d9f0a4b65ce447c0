"""Logs of robots read from CSV and from MCAP: docs/files.md, Logs of robots."""

from __future__ import annotations

import csv
import difflib
import importlib.util
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from app.output import InputError, as_bad_input
from sim.identification.robot_log import LogError, RobotLog, checked, continuous
from sim.scene import Scene

TIME, SENT = "time_s", "sent_s"
POSITION, TARGET = "q_{joint}_rad", "target_{joint}_rad"
QUATERNION = ("quat_w", "quat_x", "quat_y", "quat_z")
GYROSCOPE = ("gyro_x_rad_s", "gyro_y_rad_s", "gyro_z_rad_s")
ACCELEROMETER = ("accel_x_m_s2", "accel_y_m_s2", "accel_z_m_s2")
STATES, TARGETS = "/joint_states", "/joint_targets"
_JOINT_STATE = "sensor_msgs/msg/JointState"
# The first kind that is there gives the orientation and the rates of the pelvis.
_IMU, _ODOMETRY = "sensor_msgs/msg/Imu", "nav_msgs/msg/Odometry"
MOST_BYTES = 200_000_000


def read_log(path: Path, scene: Scene) -> RobotLog:
    """The log in a CSV or MCAP file, checked, for the robot of a scene.

    Raises:
        InputError: It cannot be read, or is no log of this robot; names the column or the time.
    """
    try:
        size = os.path.getsize(path)
        if size > MOST_BYTES:
            raise InputError(f"{path}: {size / 1e6:.0f} MB, at most {MOST_BYTES / 1e6:.0f} MB")
        if path.suffix.lower() == ".mcap":
            log, named = _from_mcap(path, scene)
        elif path.suffix.lower() == ".csv":
            log, named = _from_csv(path, scene)
        else:
            raise InputError(f"{path} must end in .csv or .mcap")
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from error
    with as_bad_input(LogError):
        return checked(log, scene, named={key: f"{path}: {name}" for key, name in named.items()})


def _from_csv(path: Path, scene: Scene) -> tuple[RobotLog, dict[str, str]]:
    joints = [joint.name for joint in scene.robot.joints]
    positions = [POSITION.format(joint=joint) for joint in joints]
    targets = [TARGET.format(joint=joint) for joint in joints]
    needed = [TIME, *positions, *targets, *QUATERNION, *GYROSCOPE]
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            lines = csv.reader(file)
            head = [name.strip() for name in next(lines, [])]
            found = {name: k for k, name in enumerate(head)}
            for name in needed:
                if name not in found:
                    near = [other for other in head if other.startswith(name[: name.rfind("_")])]
                    near = near or difflib.get_close_matches(name, head, n=1)
                    instead = f"there is {near[0]}; " if near else ""
                    raise InputError(f"{path}: no column {name}; {instead}docs/files.md has them")
            felt = all(name in found for name in ACCELEROMETER)
            read = [*needed, *((SENT,) if SENT in found else ()), *(ACCELEROMETER if felt else ())]
            for name in read:
                if head.count(name) > 1:
                    raise InputError(f"{path}: column {name} is there twice; keep the right one")
            table = _numbers(path, lines, {name: found[name] for name in read}, len(head))
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path} is not a CSV file: {error}") from error

    def columns(names: list[str] | tuple[str, ...]) -> np.ndarray:
        return np.stack([table[name] for name in names], axis=1)

    log = RobotLog(
        time_s=table[TIME],
        joint_pos_rad=columns(positions),
        quat_world_pelvis=columns(QUATERNION),
        angvel_rad_s=columns(GYROSCOPE),
        accel_m_s2=columns(ACCELEROMETER) if felt else None,
        sent_s=table.get(SENT, table[TIME]),
        target_rad=columns(targets),
    )
    return log, {
        "time_s": TIME,
        "sent_s": SENT if SENT in table else TIME,
        "joint_pos_rad": POSITION,
        "target_rad": TARGET,
        "quat_world_pelvis": "quat_w, quat_x, quat_y, quat_z",
        "angvel_rad_s": "gyro_x_rad_s, gyro_y_rad_s, gyro_z_rad_s",
    }


def _numbers(
    path: Path, lines: Iterator[list[str]], places: dict[str, int], width: int
) -> dict[str, np.ndarray]:
    """The numbers of the columns, all finite."""
    rows: list[list[float]] = []
    for line, words in enumerate(lines, start=2):
        if not words:
            continue
        if len(words) > width:
            raise InputError(
                f"{path}: line {line} has {len(words)} cells, the first {width}; numbers are "
                "written with points"
            )
        row = []
        for name, place in places.items():
            try:
                row.append(float(words[place]))
            except (ValueError, IndexError):
                word = repr(words[place]) if place < len(words) else "nothing"
                raise InputError(
                    f"{path}: {name} in line {line} is {word}, must be a number"
                ) from None
        rows.append(row)
    table = np.array(rows).reshape(-1, len(places))
    wrong = np.argwhere(~np.isfinite(table))
    if len(wrong):
        row_at, column = wrong[0]
        raise InputError(
            f"{path}: {list(places)[column]} is {table[row_at, column]} at "
            f"{TIME} {table[row_at, 0]:.6g}, must be finite"
        )
    return {name: table[:, k] for k, name in enumerate(places)}


def _from_mcap(path: Path, scene: Scene) -> tuple[RobotLog, dict[str, str]]:
    for name in ("mcap", "rosbags"):
        if importlib.util.find_spec(name) is None:
            raise InputError(
                f"{path} needs the package {name}: python -m pip install -e '.[record]'"
            )
    messages, kinds = _messages(path)
    state_s, position = _joints(path, messages, kinds, STATES, scene)
    sent_s, target = _joints(path, messages, kinds, TARGETS, scene)
    topic = next((t for kind in (_IMU, _ODOMETRY) for t, k in kinds.items() if k == kind), None)
    if topic is None:
        raise InputError(f"{path}: no topic of {_IMU} or {_ODOMETRY}; it has {_told(kinds)}")
    if kinds[topic] == _IMU:
        turns = [(m.orientation, m.angular_velocity) for _, m in messages[topic]]
        linear = [m.linear_acceleration for _, m in messages[topic]]
        accel = np.array([[a.x, a.y, a.z] for a in linear])
    else:
        turns = [(m.pose.pose.orientation, m.twist.twist.angular) for _, m in messages[topic]]
        accel = None
    pelvis_s = np.array([time_s for time_s, _ in messages[topic]])
    quat = np.array([[q.w, q.x, q.y, q.z] for q, _ in turns])
    rates = np.array([[w.x, w.y, w.z] for _, w in turns])
    for name, values in ((topic, quat), (topic, rates), (STATES, position), (TARGETS, target)):
        if not np.isfinite(values).all():
            raise InputError(f"{path}: {name} has numbers that are not finite")
    kept = (state_s >= pelvis_s[0]) & (state_s <= pelvis_s[-1])

    def at_states(values: np.ndarray) -> np.ndarray:
        parts = [np.interp(state_s[kept], pelvis_s, part) for part in values.T]
        return np.stack(parts, axis=1)

    log = RobotLog(
        time_s=state_s[kept],
        joint_pos_rad=position[kept],
        quat_world_pelvis=at_states(continuous(quat)),
        angvel_rad_s=at_states(rates),
        accel_m_s2=None if accel is None else at_states(accel),
        sent_s=sent_s,
        target_rad=target,
    )
    return log, {
        "time_s": f"stamps of {STATES}",
        "sent_s": f"stamps of {TARGETS}",
        "joint_pos_rad": f"{STATES}, {{joint}}",
        "target_rad": f"{TARGETS}, {{joint}}",
        "quat_world_pelvis": f"orientation of {topic}",
        "angvel_rad_s": f"angular velocity of {topic}",
    }


def _messages(path: Path) -> tuple[dict[str, list[tuple[float, Any]]], dict[str, str]]:
    """Messages with their times in s, by topic, of the kinds that are read; and all kinds."""
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    from app.ros.messages import decoded

    wanted = (_JOINT_STATE, _IMU, _ODOMETRY)
    found: dict[str, list[tuple[int, int, Any]]] = {}
    logged: dict[str, list[int]] = {}
    kinds: dict[str, str] = {}
    try:
        with path.open("rb") as stream:
            for schema, channel, message in make_reader(stream).iter_messages():
                kind = "" if schema is None else schema.name
                kinds[channel.topic] = kind
                if kind in wanted and channel.message_encoding == "cdr":
                    value = decoded(kind, message.data)
                    stamp = value.header.stamp
                    found.setdefault(channel.topic, []).append((stamp.sec, stamp.nanosec, value))
                    logged.setdefault(channel.topic, []).append(message.log_time)
    except OSError:
        raise
    except (McapError, Exception) as error:  # the readers raise what they like
        raise InputError(f"{path} is not an MCAP file of ROS 2 messages: {error}") from error
    timed = {}
    for topic, stamped in found.items():
        if any(sec or nanosec for sec, nanosec, _ in stamped):
            times = [sec + 1e-9 * nanosec for sec, nanosec, _ in stamped]
        else:  # nobody stamped them
            times = [1e-9 * time_ns for time_ns in logged[topic]]
        timed[topic] = [
            (time_s, value) for time_s, (_, _, value) in zip(times, stamped, strict=True)
        ]
    return timed, kinds


def _joints(
    path: Path,
    messages: dict[str, list[tuple[float, Any]]],
    kinds: dict[str, str],
    topic: str,
    scene: Scene,
) -> tuple[np.ndarray, np.ndarray]:
    """Times (N,) and positions (N, J) of a topic of joint states."""
    if kinds.get(topic) != _JOINT_STATE or not messages.get(topic):
        raise InputError(f"{path}: no topic {topic} of {_JOINT_STATE}; it has {_told(kinds)}")
    joints = [joint.name for joint in scene.robot.joints]
    rows = []
    for time_s, message in messages[topic]:
        at: Callable[[str], int] = list(message.name).index
        try:
            rows.append([float(message.position[at(joint)]) for joint in joints])
        except (ValueError, IndexError):
            missing = next(
                (joint for joint in joints if joint not in message.name), "a position for each name"
            )
            raise InputError(f"{path}: {topic} at {time_s:.6g} s lacks {missing}") from None
    return np.array([time_s for time_s, _ in messages[topic]]), np.array(rows)


def _told(kinds: dict[str, str]) -> str:
    return ", ".join(sorted(kinds)) or "none"
