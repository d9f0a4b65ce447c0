"""Domain randomization: sensor noise, latency, pushes, model parameters, tread errors.

Every range is (low, high). `DomainRandomization` holds the ranges; `Disturbances` holds the values
drawn for each of B robots and applies them. All scale with the level, 0 to 1, of the curriculum.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from controller.gait import CONTROL_PERIOD_S
from controller.observation import rotate_xy
from controller.recovery import moved_within
from controller.walker import Walker
from planner.robot_model import Interval, Side
from sim.simulation import Simulation

PUSH_TICKS = 4


@dataclass(frozen=True, kw_only=True)
class DomainRandomization:
    """Ranges of the disturbances, drawn once per episode unless stated otherwise.

    A share `undisturbed_share` of the episodes has no noise, latency, push or moved step. Of the
    steps of the others a share `moved_share` moves on level ground, somewhere in the first half of
    its swing, by up to `moved_m` each along x and outward within the step limits, as the recovery
    from a push may move one. A push gives the robot's mass a speed of `push_m_s`; for `recovery_s`
    after it the steps on level ground change by the law of `controller/recovery.py`, as they do in
    `navigate`. Noise is uniform, drawn at every control step, between minus and plus the episode's
    amplitude; the amplitude for joint speeds is `joint_speed_noise_per_s` (rad/s per rad) times
    that of joint positions. Friction, masses, centre of mass and gains are drawn once per segment
    of training. Tread errors apply in stair episodes except a share
    `exact_tread_share`.

    Raises:
        ValueError: an invalid range or share, or latency beyond one control step.
    """

    undisturbed_share: float = 0.4
    joint_noise_deg: Interval = (0.0, 6.5)
    joint_speed_noise_per_s: float = 10.0
    tilt_noise_deg: Interval = (0.0, 1.0)
    angular_speed_noise_rad_s: Interval = (0.0, 0.1)
    latency_share: float = 0.2
    latency_ticks: Interval = (0.0, 1.0)
    push_share: float = 0.35
    push_m_s: Interval = (0.0, 0.35)
    recovery_s: float = 2.0
    moved_share: float = 0.2
    moved_m: float = 0.1
    exact_tread_share: float = 0.3
    tread_error_m: Interval = (0.0, 0.055)
    friction_factor: Interval = (0.7, 1.2)
    mass_factor: Interval = (0.94, 1.06)
    pelvis_com_m: Interval = (-0.015, 0.015)
    gain_factor: Interval = (0.9, 1.1)

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, tuple):
                _check_range(name, value)
            elif not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{name} {value} must be a finite number of 0 or more")
            elif name.endswith("_share") and value > 1:
                raise ValueError(f"{name} {value} must be from 0 to 1")

    @classmethod
    def exactly(
        cls, *, joint_noise_deg: float = 0.0, tread_error_m: float = 0.0
    ) -> DomainRandomization:
        """These amplitudes in every episode, and no other disturbance."""
        return cls(
            undisturbed_share=0.0,
            joint_noise_deg=(joint_noise_deg, joint_noise_deg),
            tilt_noise_deg=(0.0, 0.0),
            angular_speed_noise_rad_s=(0.0, 0.0),
            latency_share=0.0,
            push_share=0.0,
            moved_share=0.0,
            exact_tread_share=0.0,
            tread_error_m=(tread_error_m, tread_error_m),
            friction_factor=(1.0, 1.0),
            mass_factor=(1.0, 1.0),
            pelvis_com_m=(0.0, 0.0),
            gain_factor=(1.0, 1.0),
        )

    @property
    def varies_models(self) -> bool:
        """Whether any model parameter is randomized."""
        ranges = (self.friction_factor, self.mass_factor, self.gain_factor)
        return any(r != (1.0, 1.0) for r in ranges) or self.pelvis_com_m != (0.0, 0.0)


def _check_range(name: str, interval: Interval) -> None:
    """Raises ValueError unless the range is valid for the field."""
    low, high = interval
    if not (math.isfinite(low) and math.isfinite(high) and low <= high):
        raise ValueError(f"{name}: ({low}, {high}) must be finite, low <= high")
    if name.endswith("_factor") and low <= 0:
        raise ValueError(f"{name}: ({low}, {high}) must be above 0")
    if not name.endswith("_factor") and name != "pelvis_com_m" and low < 0:
        raise ValueError(f"{name}: ({low}, {high}) must be 0 or more")
    if name == "latency_ticks" and high > 1:
        raise ValueError(f"{name}: ({low}, {high}) must be at most 1 control step")


class Disturbances:
    """The disturbances drawn for each of B robots; all zero at first."""

    def __init__(self, config: DomainRandomization, count: int, joints: int, mass_kg: float):
        self.config = config
        self.joint_noise_rad = np.zeros(count)
        self.tilt_noise_rad = np.zeros(count)
        self.angular_speed_noise_rad_s = np.zeros(count)
        self.latency_ticks = np.zeros(count)
        self.moves_steps = np.zeros(count, dtype=bool)
        self._push_n = np.zeros((count, 3))
        self._push_tick = np.full(count, -PUSH_TICKS)
        self._pushing = False
        self._joints, self._mass_kg = joints, mass_kg

    def draw_episode(self, rng: np.random.Generator, row: int, level: float, *, ticks: int) -> None:
        """Draw the disturbances of robot `row` for an episode of `ticks` control steps."""
        config = self.config
        loud = rng.uniform() >= config.undisturbed_share
        scale = level * loud
        self.moves_steps[row] = scale > 0
        self.joint_noise_rad[row] = math.radians(scale * rng.uniform(*config.joint_noise_deg))
        self.tilt_noise_rad[row] = math.radians(scale * rng.uniform(*config.tilt_noise_deg))
        self.angular_speed_noise_rad_s[row] = scale * rng.uniform(*config.angular_speed_noise_rad_s)
        late = loud and rng.uniform() < config.latency_share
        self.latency_ticks[row] = level * rng.uniform(*config.latency_ticks) * late
        pushed = loud and rng.uniform() < config.push_share
        angle, push_m_s = rng.uniform(-np.pi, np.pi), rng.uniform(*config.push_m_s)
        size_n = pushed * level * push_m_s * self._mass_kg / (PUSH_TICKS * CONTROL_PERIOD_S)
        self._push_n[row] = size_n * math.cos(angle), size_n * math.sin(angle), 0.0
        self._push_tick[row] = rng.integers(ticks)

    def clear(self, row: int) -> None:
        """Remove the disturbances of robot `row`."""
        for noise in (self.joint_noise_rad, self.tilt_noise_rad, self.angular_speed_noise_rad_s):
            noise[row] = 0.0
        self.latency_ticks[row] = 0.0
        self.moves_steps[row] = False
        self._push_n[row] = 0.0

    def draw_tread_error_m(self, rng: np.random.Generator, level: float) -> float:
        """Amplitude of the tread errors of one stair episode."""
        off = rng.uniform() >= self.config.exact_tread_share
        return float(level * off * rng.uniform(*self.config.tread_error_m))

    def randomize_models(self, rng: np.random.Generator, sim: Simulation, level: float) -> None:
        """Draw the model parameters of all simulations."""
        config, count = self.config, sim.count

        def factor(interval: Interval) -> np.ndarray:
            return 1.0 + level * (rng.uniform(*interval, count) - 1.0)

        sim.variation().set(
            friction=factor(config.friction_factor),
            mass=factor(config.mass_factor),
            gain=factor(config.gain_factor),
            pelvis_com_m=level * rng.uniform(*config.pelvis_com_m, (count, 3)),
        )

    def push(self, sim: Simulation, ticks: np.ndarray) -> None:
        """Apply the pushes that are due, `ticks` (B,) control steps into the episodes."""
        now = (ticks >= self._push_tick) & (ticks < self._push_tick + PUSH_TICKS)
        now &= self._push_n.any(axis=1)
        if now.any() or self._pushing:
            sim.push(self._push_n * now[:, None])
        self._pushing = bool(now.any())

    def pushed(self, ticks: np.ndarray) -> np.ndarray:
        """Robots (B,) that recover from a push, `ticks` (B,) control steps into the episodes."""
        since = ticks - self._push_tick
        recovering = (since >= 0) & (since < round(self.config.recovery_s / CONTROL_PERIOD_S))
        return np.asarray(recovering & self._push_n.any(axis=1))

    def move_steps(
        self, rng: np.random.Generator, walker: Walker, level: float, rows: np.ndarray
    ) -> None:
        """Move the present step, and with it all later ones, of some of the robots `rows` (n,)."""
        cursor, limits = walker.cursor, walker.robot.training_model.limits
        half_ticks = cursor.ticks.swing // 2
        due = self.moves_steps & cursor.swinging & (cursor.tick > 0) & (cursor.tick <= half_ticks)
        due &= rng.uniform(size=len(due)) * half_ticks < self.config.moved_share
        rows = rows[due[rows]]
        if not len(rows):
            return
        feet, side = cursor.foot_targets[rows], cursor.side[rows]
        which, outward = np.arange(len(rows)), np.where(side == Side.LEFT, 1.0, -1.0)
        support, swing = feet[which, 1 - side], feet[which, side]
        step = rotate_xy(swing - support, -support[:, 3])[:, :2]
        step[:, 1] *= outward
        drawn = level * self.config.moved_m * rng.uniform(-1, 1, (len(rows), 2))
        change = moved_within(limits, step, drawn)
        change[:, 1] *= outward
        cursor.shift(rows, rotate_xy(change, support[:, 3]))

    def sense(self, rng: np.random.Generator, observation: np.ndarray) -> np.ndarray:
        """The unscaled observation (B, N) with sensor noise on its first fields.

        These are roll and pitch, the pelvis's angular velocity, joint positions and joint speeds.
        """
        joint_rad = self.joint_noise_rad
        joint_rad_s = self.config.joint_speed_noise_per_s * joint_rad
        amplitudes = self.tilt_noise_rad, self.angular_speed_noise_rad_s, joint_rad, joint_rad_s
        widths = 2, 3, self._joints, self._joints
        amplitude = np.repeat(np.stack(amplitudes, axis=1), widths, axis=1)
        sensed = observation.copy()
        sensed[:, : sum(widths)] += amplitude * rng.uniform(-1, 1, amplitude.shape)
        return sensed
