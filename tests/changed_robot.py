"""Logs of a simulated JVRC-1 whose servos were changed, hanging in a stand or walking."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from controller.gait import GaitTicks
from controller.observation import observe
from controller.policy import load_policy
from controller.step_cursor import StepCursor, StepSequence
from planner.robot_model import Side
from sim.robots import get_robot
from sim.scene import Scene, build_scene

TICK_S, STEP_S = 0.025, 0.001


@dataclass(frozen=True, kw_only=True)
class Changes:
    """What is other than in the model, by joint (J,): factors of gain and damping, and the rest."""

    gain: np.ndarray
    damping: np.ndarray
    friction_nm: np.ndarray
    delay_s: np.ndarray
    offset_rad: np.ndarray

    @classmethod
    def drawn(cls, seed: int) -> Changes:
        """Gains off by up to 20 %, 3 N m of friction, 15 ms of delay, a degree of offset."""
        rng = np.random.default_rng(seed)
        return cls(
            gain=rng.uniform(0.8, 1.2, 12),
            damping=rng.uniform(0.8, 1.2, 12),
            friction_nm=rng.uniform(0.0, 3.0, 12),
            delay_s=rng.integers(0, 16, 12) / 1000,
            offset_rad=np.radians(rng.uniform(-1.0, 1.0, 12)),
        )


class ChangedRobot:
    """The robot, stepped at 1 kHz, and the log that it writes at 40 Hz."""

    def __init__(self, changes: Changes, *, hanging: bool):
        self.scene: Scene = build_scene(get_robot("jvrc1"), timestep_s=STEP_S)
        model, self._changes = self.scene.model, changes
        model.actuator_gainprm[:, 0] *= changes.gain
        model.actuator_biasprm[:, 1] *= changes.gain
        model.actuator_biasprm[:, 2] *= changes.damping
        model.dof_frictionloss[self.scene.joint_qvel] = changes.friction_nm
        if hanging:
            # Too heavy to be moved, and without weight.
            pelvis = model.body("pelvis").id
            model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
            model.body_mass[pelvis] = model.body_inertia[pelvis] = 1e7
            model.body_gravcomp[pelvis] = 1.0
        self.data = mujoco.MjData(model)
        mujoco.mj_setConst(model, self.data)
        self.data.qpos[:] = self.scene.standing_qpos
        self.rows: list[list[float]] = []
        self._sent = [(-1.0, self.scene.robot.half_sitting_rad)]

    def tick(self, target_of: Callable[[], np.ndarray]) -> None:
        """Logs the state, asks for a target, and holds it for 25 ms, delayed."""
        data, time_s = self.data, len(self.rows) * TICK_S
        joint_pos = data.qpos[self.scene.joint_qpos].copy()
        target = target_of()
        self.rows.append([time_s, *joint_pos, *target, *data.qpos[3:7], *data.qvel[3:6]])
        self._sent.append((time_s, target))
        for k in range(round(TICK_S / STEP_S)):
            now_s = time_s + k * STEP_S
            for j, delay_s in enumerate(self._changes.delay_s):
                at_s = now_s - delay_s + 1e-9
                held = next(held for sent_s, held in reversed(self._sent) if sent_s <= at_s)
                data.ctrl[j] = held[j] - self._changes.offset_rad[j]
            mujoco.mj_step(self.scene.model, data)

    def write(self, path: Path) -> None:
        """The log as docs/files.md has it."""
        names = [joint.name for joint in self.scene.robot.joints]
        with path.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(
                [
                    "time_s",
                    *(f"q_{name}_rad" for name in names),
                    *(f"target_{name}_rad" for name in names),
                    *(f"quat_{axis}" for axis in "wxyz"),
                    *(f"gyro_{axis}_rad_s" for axis in "xyz"),
                ]
            )
            writer.writerows(self.rows)


def hanging(changes: Changes, *, seconds_each: float) -> ChangedRobot:
    """A chirp of every joint in turn, both legs at once, in opposite directions."""
    robot = ChangedRobot(changes, hanging=True)
    half_sitting = robot.scene.robot.half_sitting_rad
    low_hz, high_hz = 0.3, 4.0
    for j in range(6):
        for k in range(round(seconds_each / TICK_S)):
            time_s = k * TICK_S
            cycles = low_hz * time_s + (high_hz - low_hz) * time_s**2 / (2 * seconds_each)
            target = half_sitting.copy()
            target[[j, j + 6]] += np.array([0.2, -0.2]) * math.sin(2 * math.pi * cycles)
            robot.tick(target.copy)
    return robot


def walking(changes: Changes, *, steps: int) -> ChangedRobot:
    """The shipped policy on steps ahead that turn and go aside, so that all joints have to move."""
    robot = ChangedRobot(changes, hanging=False)
    scene, data, policy = robot.scene, robot.data, load_policy(robot.scene.robot)
    side = np.array([Side.LEFT, Side.RIGHT] * steps)[:steps].astype(np.int64)
    start = scene.soles_at(scene.standing_qpos)
    middle, poses = np.zeros(3), []
    for k, one in enumerate(side):
        # Ahead, aside and turned in the frame of the middle between the feet.
        ahead_m, aside_m = 0.12 + 0.06 * (k % 3), 0.06 * math.sin(2.0 * k)
        turn_rad = 0.2 if k < steps / 2 else -0.2
        cos, sin = math.cos(middle[2]), math.sin(middle[2])
        middle += [ahead_m * cos - aside_m * sin, ahead_m * sin + aside_m * cos, turn_rad]
        cos, sin = math.cos(middle[2]), math.sin(middle[2])
        out_m = start[one, 1]
        poses.append([middle[0] - out_m * sin, middle[1] + out_m * cos, 0.0, middle[2]])
    cursor = StepCursor(GaitTicks.of(scene.robot.gait), 1, 16)
    cursor.follow(0, StepSequence.of(start, side, np.array(poses), None), wait_ticks=10)
    previous = np.zeros(12)

    def target() -> np.ndarray:
        nonlocal previous
        observation: Any = observe(
            scene.robot,
            qpos=data.qpos[None],
            qvel=data.qvel[None],
            joint_qpos=scene.joint_qpos,
            joint_qvel=scene.joint_qvel,
            clock=cursor.clock,
            window=cursor.shown_window,
            step_s=cursor.step_s,
        )
        (action,) = policy.act(observation)
        asked = scene.robot.half_sitting_rad + 0.5 * (action + previous)
        previous = action
        return asked

    while not cursor.arrived[0]:
        robot.tick(target)
        cursor.advance()
    assert data.qpos[2] > 0.7, "it fell"
    return robot
