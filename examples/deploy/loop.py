"""A robot's own loop: exported policy and plan in, joint targets out, 40 times a second.

    python examples/deploy/loop.py policy.onnx plan.json --robot 127.0.0.1:7400 --log log.csv

The robot is behind a UDP socket: it sends `STATE`, it takes `COMMAND`. simulator.py is one. What a
loop on hardware must have besides a policy is here: a clock, limits, a watchdog that stops softly,
and a log, which `python main.py compare` reads. No import of Footfall; docs/deploying.md explains.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import gc
import json
import math
import os
import socket
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol, TextIO

import numpy as np
from walk_plan import gait, load_policy, observe

STALE_S = 0.06  # a state older than this stops the robot,
LATE_S = 0.05  # and so does a tick that comes so late,
MISSES = 3  # or so many in succession that come half a period late.
LEAST_HEIGHT, MOST_TILT_RAD = 0.7, 0.8  # share of the pelvis's height in half-sitting; its tilt
FASTEST = 1.5  # times a joint's greatest speed
PRIORITY = "of a real-time process, 1 to 99, such as 10; needs the right to (0: none)"
FADE_S, LIMP_S = 0.5, 1.0  # a soft stop: the gain goes to 0, and stays there


def state_type(joints: int) -> np.dtype[Any]:
    """A packet from the robot; `stamp_s` is its own clock."""
    return np.dtype(
        [
            ("stamp_s", "<f8"),
            ("position_m", "<f8", 3),  # of the pelvis in the plan's frame, by localisation
            ("quaternion", "<f8", 4),  # w, x, y, z
            ("angvel_rad_s", "<f8", 3),
            ("joint_pos_rad", "<f8", joints),
            ("joint_vel_rad_s", "<f8", joints),
        ]
    )


def command_type(joints: int) -> np.dtype[Any]:
    """A packet to the robot: torque = gain * kp (target - q) - kd dq; later numbers win."""
    return np.dtype([("number", "<i8"), ("gain", "<f8"), ("target_rad", "<f8", joints)])


class Link(Protocol):
    """What the loop needs of the robot. Times are the loop's own clock."""

    state: Any  # the newest packet, None before the first
    offset_s: float  # this clock less the robot's, by the packet that was fastest

    def now_s(self) -> float:
        """This clock."""
        ...

    def wait(self, until_s: float) -> None:
        """Receives until then."""
        ...

    def send(self, number: int, gain: float, target_rad: np.ndarray) -> None:
        """Sends a command."""
        ...


class UdpLink:
    """A robot behind a UDP socket."""

    def __init__(self, address: tuple[str, int], joints: int):
        self._state, self._command = state_type(joints), command_type(joints)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect(address)
        self.state: Any = None
        self.offset_s = math.inf

    def now_s(self) -> float:
        """Monotonic: it neither jumps nor goes back."""
        return time.monotonic()

    def wait(self, until_s: float) -> None:
        """Receives until then; of packets that overtook each other the newest state counts."""
        while (left_s := until_s - time.monotonic()) > 0:
            self._socket.settimeout(left_s)
            try:
                packet = self._socket.recv(4096)
            except (TimeoutError, BlockingIOError):
                return
            except ConnectionRefusedError:  # nobody there yet
                time.sleep(min(left_s, 0.01))
                continue
            if len(packet) == self._state.itemsize:
                state = np.frombuffer(packet, self._state)[0]
                self.offset_s = min(self.offset_s, time.monotonic() - state["stamp_s"])
                if self.state is None or state["stamp_s"] > self.state["stamp_s"]:
                    self.state = state

    def send(self, number: int, gain: float, target_rad: np.ndarray) -> None:
        """Sends a command; where nobody hears it, the watchdog will tell."""
        with contextlib.suppress(ConnectionRefusedError):
            self._socket.send(np.array([(number, gain, target_rad)], self._command).tobytes())


class Stop(Exception):
    """Why the robot must stop."""


class Limits:
    """The joints' limits: targets that keep to them, and how often one had to be changed."""

    def __init__(self, about: dict[str, Any]):
        self._low, self._high = np.array(about["joint_range_rad"]).T
        self._kp, self._kd = np.array(about["kp_nm_rad"]), np.array(about["kd_nm_s_rad"])
        self._torque, self._speed = (
            np.array(about[key]) for key in ("torque_limit_nm", "speed_limit_rad_s")
        )
        self.changed = 0

    def keep(self, target: np.ndarray, state: Any) -> np.ndarray:
        """The target nearest to this one with which range, torque and speed stay in their limits.

        A target itself may be out of range: soft servos lean on it. Where the joint is, it may not.
        """
        pos, vel = state["joint_pos_rad"], state["joint_vel_rad_s"]
        if np.any(np.abs(vel) > FASTEST * self._speed):
            raise Stop(f"a joint turns at {np.abs(vel).max():.1f} rad/s")
        free = pos + self._kd * vel / self._kp  # the target at which the torque is 0
        span = self._torque / self._kp
        kept = np.clip(target, free - span, free + span)
        # At its greatest speed, or at an end of its range, a joint is not pushed on.
        kept = np.where((vel >= self._speed) | (pos >= self._high), np.minimum(kept, free), kept)
        kept = np.where((vel <= -self._speed) | (pos <= self._low), np.maximum(kept, free), kept)
        self.changed += int(np.any(kept != target))
        return kept


def tilt_and_heading(quaternion: np.ndarray) -> np.ndarray:
    """Roll, pitch, yaw."""
    w, x, y, z = quaternion
    return np.array(
        [
            math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
            math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x)))),
            math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
        ]
    )


class Walk:
    """Targets of the policy along a plan."""

    def __init__(self, policy: Any, about: dict[str, Any], plan: dict[str, Any]):
        self._policy, self._about = policy, about
        self._ticks = gait(plan, about)
        self._half_sitting = np.array(about["half_sitting_rad"])
        self._previous = np.zeros(len(self._half_sitting))

    def target(self, state: Any) -> np.ndarray | None:
        """The next joint targets, None at the end; raises `Stop` at a fall or nonsense."""
        tick = next(self._ticks, None)
        if tick is None:
            return None
        clock, window, step_s, _ = tick
        angles = tilt_and_heading(state["quaternion"])
        height_m = state["position_m"][2] - window[:, 2].min()
        if height_m < LEAST_HEIGHT * self._about["pelvis_height_m"]:
            raise Stop(f"it falls: the pelvis is {height_m:.2f} m high")
        if np.abs(angles[:2]).max() > MOST_TILT_RAD:
            raise Stop("it falls: the pelvis is tilted")
        known = {name: state[name] for name in state.dtype.names} | {"roll_pitch_yaw_rad": angles}
        observation = observe(self._about, known, clock, window, step_s)
        (action,) = self._policy.run(["action"], {"observation": observation})[0].astype(float)
        if not np.isfinite(action).all():
            raise Stop("the policy's action is not finite")
        target: np.ndarray = self._half_sitting + 0.5 * (action + self._previous)
        self._previous = action
        return target


class Excitation:
    """Targets for a robot that hangs in a stand: a chirp of each joint in turn.

    Both legs do the same, side by side, so that they do not meet.
    """

    def __init__(self, about: dict[str, Any], seconds_each: float = 5.0, amplitude: float = 0.2):
        self._half_sitting = np.array(about["half_sitting_rad"])
        self._targets = self._chirps(about["control_period_s"], seconds_each, amplitude)

    def _chirps(self, period_s: float, each_s: float, amplitude: float) -> Iterator[np.ndarray]:
        low_hz, high_hz, leg = 0.3, 4.0, len(self._half_sitting) // 2
        for joint in range(leg):
            for tick in range(round(each_s / period_s)):
                t = tick * period_s
                cycles = low_hz * t + (high_hz - low_hz) * t * t / (2 * each_s)
                turn = amplitude * math.sin(2 * math.pi * cycles) * min(1.0, 2 * (each_s - t))
                target = self._half_sitting.copy()
                target[[joint, joint + leg]] += turn
                yield target

    def target(self, state: Any) -> np.ndarray | None:
        """The next joint targets, None at the end."""
        return next(self._targets, None)


class Log:
    """The log that `compare` reads: a line for each state that was acted on."""

    def __init__(self, file: TextIO | None, joints: list[str]):
        self._writer = None if file is None else csv.writer(file)
        self._last_s = -math.inf
        head = ["time_s", "sent_s", *(f"q_{name}_rad" for name in joints)]
        head += [f"target_{name}_rad" for name in joints]
        head += [f"quat_{axis}" for axis in "wxyz"] + [f"gyro_{axis}_rad_s" for axis in "xyz"]
        if self._writer is not None:
            self._writer.writerow([*head, "gain"])

    def write(self, state: Any, sent_s: float, target: np.ndarray, gain: float) -> None:
        """Writes a line; not where the state is the one of the last line."""
        if self._writer is None or state["stamp_s"] <= self._last_s:
            return
        self._last_s = state["stamp_s"]
        numbers = [state["joint_pos_rad"], target, state["quaternion"], state["angvel_rad_s"]]
        row = [self._last_s, sent_s, *np.concatenate(numbers), gain]
        self._writer.writerow([f"{number:.7g}" for number in row])


def run(link: Link, moves: Walk | Excitation, about: dict[str, Any], log: Log) -> dict[str, Any]:
    """Moves the robot to the end, or stops it softly; what happened, with times in ms."""
    period_s, limits = about["control_period_s"], Limits(about)
    target, number, misses = np.array(about["half_sitting_rad"]), 0, 0
    begun_s = link.now_s()
    while link.state is None:  # tell the robot that somebody is here, until it answers
        link.send(number, 1.0, target)
        link.wait(link.now_s() + 0.1)
        if link.now_s() > begun_s + 10:
            return {"outcome": "no robot", "reason": "no state within 10 s", "ticks": 0}
    ages_s, late_s, ticks_s, sends_s, reason = [], [], [], [], ""
    due_s = link.now_s()
    try:
        while True:
            due_s += period_s
            link.wait(due_s)
            begin_s = link.now_s()
            state = link.state
            late_s.append(begin_s - due_s)
            ages_s.append(begin_s - link.offset_s - state["stamp_s"])
            misses = misses + 1 if late_s[-1] > period_s / 2 else 0
            if late_s[-1] > LATE_S or misses >= MISSES:
                raise Stop(f"{misses} deadlines missed, the last by {1e3 * late_s[-1]:.0f} ms")
            if ages_s[-1] > STALE_S:
                raise Stop(f"the newest state is {1e3 * ages_s[-1]:.0f} ms old")
            if misses:
                due_s = begin_s  # the next tick is a whole period away again
            wanted = moves.target(state)
            if wanted is None:
                break
            target = limits.keep(wanted, state)
            number += 1
            link.send(number, 1.0, target)
            sends_s.append(link.now_s())
            ticks_s.append(sends_s[-1] - begin_s)
            log.write(state, sends_s[-1] - link.offset_s, target, 1.0)
    except Stop as stop:
        reason = str(stop)
        for tick in range(round((FADE_S + LIMP_S) / period_s)):
            gain = max(0.0, 1 - tick * period_s / FADE_S)
            number += 1
            link.send(number, gain, target)
            log.write(link.state, link.now_s() - link.offset_s, target, gain)
            link.wait(link.now_s() + period_s)

    def spread(values_s: Any) -> dict[str, float]:
        values = [1e3 * value for value in values_s] or [math.nan]
        median, p99, most = np.percentile(values, (50, 99, 100))
        return {
            "median": round(float(median), 3),
            "p99": round(float(p99), 3),
            "max": round(float(most), 3),
        }

    return {
        "outcome": "stopped" if reason else "done",
        "reason": reason,
        "ticks": len(sends_s),
        "tick_ms": spread(ticks_s),
        "period_ms": spread(np.diff(sends_s)),
        "late_ms": spread(late_s),
        "state_age_ms": spread(ages_s),
        "ticks_limited": limits.changed,
    }


def run_in_real_time(priority: int) -> None:
    """From now on: no collection of garbage, which takes longer than a tick, and this priority."""
    gc.collect()
    gc.disable()
    if priority:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))


def main(words: list[str] | None = None) -> int:
    """Runs the loop; 0 when it came to its end, 4 when it stopped the robot."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("policy", help="the exported policy, such as policy.onnx")
    parser.add_argument("plan", nargs="?", help="the plan, such as plan.json")
    parser.add_argument("--robot", default="127.0.0.1:7400", help="its address (%(default)s)")
    parser.add_argument("--log", type=Path, help="write this log, such as log.csv")
    parser.add_argument("--excite", action="store_true", help="chirps, for a robot that hangs")
    parser.add_argument("--priority", type=int, default=0, help=PRIORITY)
    asked = parser.parse_args(words)
    if asked.excite == bool(asked.plan):
        parser.error("give either a plan or --excite")
    policy, about = load_policy(asked.policy)
    if asked.excite:
        moves: Walk | Excitation = Excitation(about)
    else:
        moves = Walk(policy, about, json.loads(Path(asked.plan).read_text(encoding="utf-8")))
    host, port = asked.robot.rsplit(":", 1)
    link = UdpLink((host, int(port)), len(about["joints"]))
    run_in_real_time(asked.priority)
    file = None if asked.log is None else asked.log.open("w", newline="", encoding="utf-8")
    report = run(link, moves, about, Log(file, about["joints"]))
    if file is not None:
        file.close()
    print(json.dumps(report))
    return 0 if report["outcome"] == "done" else 4


if __name__ == "__main__":
    sys.exit(main())
