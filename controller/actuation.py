"""Servos as they are on a robot: late, with encoders that are off, play, and motors that tire.

What the model cannot hold happens here, at every physics step: see `sim/hardware.py` for the rest.
"""

from __future__ import annotations

import math

import numpy as np

from sim.hardware import HardwareErrors
from sim.simulation import Simulation


class ImperfectServos:
    """The servos of B robots; the same seed and commands give the same steps.

    `encoder_offset_rad` (B, J) is by how much each encoder reads too much.
    """

    def __init__(self, sim: Simulation, errors: HardwareErrors, *, seed: int):
        robot, joints = sim.scene.robot, sim.scene.robot.joints
        self._errors = errors
        self._rng = np.random.default_rng(seed)
        sign = self._rng.choice([-1.0, 1.0], (sim.count, len(joints)))
        self.encoder_offset_rad = errors.encoder_rad * sign
        self._kp = errors.gain * np.array([joint.kp for joint in joints])
        self._kd = errors.gain * np.array([joint.kd for joint in joints])
        self._limit_nm = np.array([joint.torque_limit_nm for joint in joints])
        self._speed_rad_s = np.array([joint.speed_limit_rad_s for joint in joints])
        longest_s = errors.delay_s + errors.jitter_s
        self._period_s = sim.substeps * sim.scene.model.opt.timestep
        depth = 1 + math.ceil(longest_s / self._period_s - 1e-9)
        # Commands (B, J), the newest first, and how late each takes effect (B,).
        rest = np.tile(robot.half_sitting_rad, (sim.count, 1))
        self._sent = [(rest, np.zeros(sim.count)) for _ in range(depth)]

    def step(self, sim: Simulation, command_rad: np.ndarray) -> None:
        """Advance by one control period after the joint targets (B, J) have been sent."""
        errors = self._errors
        late_s = errors.delay_s + errors.jitter_s * self._rng.uniform(size=sim.count)
        self._sent = [(np.array(command_rad), late_s), *self._sent[:-1]]
        part, timestep_s = -1, sim.scene.model.opt.timestep

        def targets_rad(_sensors: np.ndarray) -> np.ndarray:
            nonlocal part
            part += 1
            return self._effective(sim, self._in_force(part * timestep_s))

        sim.step_in_parts(sim.substeps, targets_rad)

    def _in_force(self, since_s: float) -> np.ndarray:
        """The commands (B, J) that have come through, so long after the newest was sent."""
        command = self._sent[-1][0].copy()
        for age in range(len(self._sent) - 1, -1, -1):
            sent, late_s = self._sent[age]
            through = since_s + age * self._period_s >= late_s - 1e-9
            command[through] = sent[through]
        return command

    def _effective(self, sim: Simulation, command_rad: np.ndarray) -> np.ndarray:
        """Targets (B, J) with which a perfect servo gives the torque that this one would."""
        errors = self._errors
        joint_rad = sim.qpos[:, sim.scene.joint_qpos]
        missing = command_rad - self.encoder_offset_rad - joint_rad
        if errors.backlash_rad:
            play = errors.backlash_rad / 2
            missing = np.sign(missing) * np.maximum(np.abs(missing) - play, 0.0)
        if not errors.no_load:
            return joint_rad + missing
        rate = sim.qvel[:, sim.scene.joint_qvel]
        torque = self._kp * missing - self._kd * rate
        left = np.maximum(1.0 - np.abs(rate) / (errors.no_load * self._speed_rad_s), 0.0)
        drives = torque * rate > 0
        most_nm = np.where(drives, self._limit_nm * left, self._limit_nm)
        torque = np.clip(torque, -most_nm, most_nm)
        return np.asarray(joint_rad + (torque + self._kd * rate) / self._kp)
