"""The robot of walk_plan.py behind a UDP socket, in real time, for loop.py to move.

    python examples/deploy/simulator.py policy.onnx robot.xml plan.json --jitter-ms 5 --loss 0.01

Packets both ways are delayed by up to the jitter, each on its own so that they overtake each other,
and some are lost. Servos can be made others than the model's. Ends when no command has come for a
while, and says where the robot stands then.
"""

from __future__ import annotations

import argparse
import heapq
import json
import math
import socket
import sys
import time
from collections import deque
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from loop import FADE_S, PRIORITY, command_type, run_in_real_time, state_type
from walk_plan import Robot, load_policy

STATE_EVERY = 5  # physics steps between two states: 200 Hz
SILENCE_S, END_S = 0.1, 1.0  # without a command: the drives let go; the program ends
BEHIND_S = 0.25  # so far behind the clock the simulation is not one of a robot any more


class Network:
    """Packets on their way, each delayed by up to the jitter, some lost."""

    def __init__(self, rng: np.random.Generator, jitter_s: float, loss: float):
        self._rng, self._jitter_s, self._loss = rng, jitter_s, loss
        self._due: list[tuple[float, int, bytes]] = []
        self._count = 0

    def put(self, packet: bytes, now_s: float) -> None:
        """Sends a packet off."""
        self._count += 1
        if self._rng.random() >= self._loss:
            due_s = now_s + self._rng.uniform(0, self._jitter_s)
            heapq.heappush(self._due, (due_s, self._count, packet))

    def get(self, now_s: float) -> list[tuple[float, bytes]]:
        """The packets that have arrived, with their times."""
        arrived = []
        while self._due and self._due[0][0] <= now_s:
            due_s, _, packet = heapq.heappop(self._due)
            arrived.append((due_s, packet))
        return arrived


class Machine(Robot):
    """The robot with drives that take commands, and let go where none come.

    Drives may be others than the model's: factors of gain and damping, friction, a delay of the
    targets and an offset of the encoder. With `hang` the pelvis is held, 1 m up.
    """

    def __init__(
        self,
        model_file: str,
        about: dict[str, Any],
        feet: np.ndarray,
        *,
        gain: float = 1.0,
        damping: float = 1.0,
        friction_nm: float = 0.0,
        delay_s: float = 0.0,
        offset_rad: float = 0.0,
        hang: bool = False,
    ):
        super().__init__(model_file, about, feet)
        self.model.actuator_biasprm[:, 2] *= damping
        self.model.dof_frictionloss[self.at_qvel] += friction_nm
        self._kp = gain * np.array(about["kp_nm_rad"])
        self._period_s, self._delay_s, self._offset_rad = 0.0, delay_s, offset_rad
        self._number, self._heard_s = -1, 0.0
        self._held = deque([(-math.inf, 1.0, np.array(about["half_sitting_rad"]))])
        self.commands, self._type = 0, command_type(len(about["joints"]))
        self._state = state_type(len(about["joints"]))
        self.last_soles = self.soles()
        if hang:
            pelvis = self.model.body("pelvis").id
            self.model.body_mass[pelvis] = self.model.body_inertia[pelvis] = 1e7
            self.model.body_gravcomp[pelvis] = 1.0
            mujoco.mj_setConst(self.model, mujoco.MjData(self.model))
            self.data.qpos[2] += 1.0
            mujoco.mj_forward(self.model, self.data)

    @property
    def time_s(self) -> float:
        """The robot's clock."""
        return float(self.data.time)

    @property
    def silent_s(self) -> float:
        """How long no command has come."""
        return self.time_s - self._heard_s

    def command(self, packet: bytes) -> None:
        """Takes a command, unless a later one has overtaken it."""
        if len(packet) != self._type.itemsize:
            return
        command = np.frombuffer(packet, self._type)[0]
        if command["number"] < self._number or not np.isfinite(command["target_rad"]).all():
            return
        self._number, self._heard_s = int(command["number"]), self.time_s
        self.commands += 1
        held = (self.time_s + self._delay_s, float(command["gain"]), command["target_rad"])
        self._held.append(held)
        self.last_soles = self.soles()

    def step(self) -> None:
        """A millisecond of physics."""
        while len(self._held) > 1 and self._held[1][0] <= self.time_s + 1e-9:
            self._held.popleft()
        _, gain, target = self._held[0]
        if self.silent_s > SILENCE_S:
            gain *= max(0.0, 1 - (self.silent_s - SILENCE_S) / FADE_S)
        self.model.actuator_gainprm[:, 0] = gain * self._kp
        self.model.actuator_biasprm[:, 1] = -gain * self._kp
        self.data.ctrl[:] = target - self._offset_rad
        mujoco.mj_step(self.model, self.data)

    def packet(self) -> bytes:
        """Its state."""
        state = np.zeros(1, self._state)
        state["stamp_s"], state["position_m"] = self.time_s, self.data.qpos[:3]
        state["quaternion"], state["angvel_rad_s"] = self.data.qpos[3:7], self.data.qvel[3:6]
        state["joint_pos_rad"] = self.data.qpos[self.at_qpos]
        state["joint_vel_rad_s"] = self.data.qvel[self.at_qvel]
        return state.tobytes()


class World:
    """Machine and network, advanced together."""

    def __init__(self, machine: Machine, there: Network, back: Network):
        self.machine, self.there, self.back = machine, there, back
        self._steps = 0

    def advance(self, until_s: float) -> None:
        """Steps up to a time of the robot's clock; commands take effect when they arrive."""
        while self.machine.time_s + self.machine.model.opt.timestep <= until_s:
            for _, packet in self.there.get(self.machine.time_s):
                self.machine.command(packet)
            if self._steps % STATE_EVERY == 0:
                self.back.put(self.machine.packet(), self.machine.time_s)
            self.machine.step()
            self._steps += 1


def served(world: World, listener: socket.socket) -> str:
    """Lets the world run by the clock from the first packet on; why it ended."""
    packet, peer = listener.recvfrom(4096)
    listener.setblocking(False)
    began_s = time.monotonic()
    while world.machine.silent_s < END_S:
        now_s = time.monotonic() - began_s
        if now_s - world.machine.time_s > BEHIND_S:
            return f"the simulation is {now_s - world.machine.time_s:.2f} s behind the clock"
        while True:
            try:
                packet, peer = listener.recvfrom(4096)
            except (BlockingIOError, ConnectionRefusedError):
                break
            world.there.put(packet, now_s)
        world.advance(now_s)
        for _, packet in world.back.get(now_s):
            try:
                listener.sendto(packet, peer)
            except ConnectionRefusedError:  # the loop has ended
                break
        time.sleep(0.0005)
    return ""


def verdict(machine: Machine, plan: dict[str, Any]) -> dict[str, Any]:
    """Where the soles were when the last command came, against the plan's last steps."""
    last = {step["side"]: (step["x"], step["y"]) for step in plan["steps"][-2:]}
    off_m = [math.dist(machine.last_soles[side][:2], xy) for side, xy in last.items()]
    return {"commands": machine.commands, "off_m": round(max(off_m, default=0.0), 4)}


def main(words: list[str] | None = None) -> int:
    """Runs the simulator; 0 when the robot ends within 0.10 m of its last steps."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name, told in (("policy", "policy.onnx"), ("model", "robot.xml"), ("plan", "plan.json")):
        parser.add_argument(name, help=f"such as {told}")
    parser.add_argument("--port", type=int, default=7400, help="UDP port (%(default)s)")
    for option, default, told in (
        ("--jitter-ms", 0.0, "greatest delay of a packet, each way"),
        ("--loss", 0.0, "share of packets lost, each way"),
        ("--gain", 1.0, "factor of the servos' gain"),
        ("--damping", 1.0, "factor of their damping"),
        ("--friction-nm", 0.0, "friction of the joints"),
        ("--delay-ms", 0.0, "delay of the targets in the drives"),
        ("--offset-deg", 0.0, "offset of the drives' zero"),
    ):
        parser.add_argument(option, type=float, default=default, help=f"{told} (%(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of delays and losses (%(default)s)")
    parser.add_argument("--hang", action="store_true", help="hold the pelvis, feet in the air")
    parser.add_argument("--priority", type=int, default=0, help=PRIORITY)
    asked = parser.parse_args(words)
    _, about = load_policy(asked.policy)
    plan = json.loads(Path(asked.plan).read_text(encoding="utf-8"))
    machine = Machine(
        asked.model,
        about,
        np.array([plan["start_feet"][side] for side in ("left", "right")]),
        gain=asked.gain,
        damping=asked.damping,
        friction_nm=asked.friction_nm,
        delay_s=asked.delay_ms / 1e3,
        offset_rad=math.radians(asked.offset_deg),
        hang=asked.hang,
    )
    rng = np.random.default_rng(asked.seed)
    there, back = (Network(rng, asked.jitter_ms / 1e3, asked.loss) for _ in range(2))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", asked.port))
        run_in_real_time(asked.priority)
        print(f"listening on port {listener.getsockname()[1]}", flush=True)
        reason = served(World(machine, there, back), listener)
    report = {"reason": reason, **verdict(machine, plan)}
    print(json.dumps(report))
    return 0 if not reason and report["off_m"] < 0.10 else 4


if __name__ == "__main__":
    sys.exit(main())
