"""Domain randomization: sensor noise, latency, pushes, model parameters, tread errors.

Every range is (low, high). A `DomainRandomization` says what is drawn; `Disturbances` holds what
was drawn for each of B robots and applies it. All of it scales with the curriculum's level.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planner.robot_model import Interval
from sim.batch import SimBatch

PUSH_TICKS = 4


@dataclass(frozen=True, kw_only=True)
class DomainRandomization:
    """Ranges of everything that is disturbed, drawn per episode unless it says otherwise.

    In a share `quiet_share` of the episodes nothing is sensed wrongly, late or pushed. Noise is
    uniform, drawn anew at every control step, between minus and plus the episode's amplitude.
    Joint speeds are off by `joint_speed_noise_per_s` (rad/s per rad of position noise). Friction,
    masses, centre of mass and gains belong to the simulation and are drawn once per segment of
    training. Tread errors apply in stair episodes, to a share `true_tread_share` not at all.

    Raises:
        ValueError: a range that is none, a share that is none, or latency beyond one step.
    """

    quiet_share: float = 0.4
    joint_noise_deg: Interval = (0.0, 6.5)
    joint_speed_noise_per_s: float = 10.0
    tilt_noise_deg: Interval = (0.0, 1.0)
    angular_speed_noise_rad_s: Interval = (0.0, 0.1)
    latency_share: float = 0.2
    latency_ticks: Interval = (0.0, 1.0)
    push_share: float = 0.25
    push_n_s: Interval = (0.0, 12.0)
    true_tread_share: float = 0.3
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
        """These amplitudes in every episode, and nothing else."""
        return cls(
            quiet_share=0.0,
            joint_noise_deg=(joint_noise_deg, joint_noise_deg),
            tilt_noise_deg=(0.0, 0.0),
            angular_speed_noise_rad_s=(0.0, 0.0),
            latency_share=0.0,
            push_share=0.0,
            true_tread_share=0.0,
            tread_error_m=(tread_error_m, tread_error_m),
            friction_factor=(1.0, 1.0),
            mass_factor=(1.0, 1.0),
            pelvis_com_m=(0.0, 0.0),
            gain_factor=(1.0, 1.0),
        )

    @property
    def varies_models(self) -> bool:
        """Whether any simulation's model is to differ from the robot's own."""
        ranges = (self.friction_factor, self.mass_factor, self.gain_factor)
        return any(r != (1.0, 1.0) for r in ranges) or self.pelvis_com_m != (0.0, 0.0)


def _check_range(name: str, interval: Interval) -> None:
    """Raises ValueError unless it is a range of values that the field can have."""
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
    """What has been drawn for each of B robots. Nothing is drawn at level 0."""

    def __init__(self, config: DomainRandomization, count: int, joints: int):
        self.config = config
        self.joint_noise_rad = np.zeros(count)
        self.tilt_noise_rad = np.zeros(count)
        self.angular_speed_noise_rad_s = np.zeros(count)
        self.latency_ticks = np.zeros(count)
        self._push_n = np.zeros((count, 3))
        self._push_tick = np.full(count, -PUSH_TICKS)
        self._pushing = False
        self._joints = joints

    def draw_episode(
        self,
        rng: np.random.Generator,
        row: int,
        disturbance_level: float,
        *,
        period_s: float,
        ticks: int,
    ) -> None:
        """Draw an episode of `ticks` control steps of `period_s` for robot `row`."""
        config = self.config
        loud = rng.uniform() >= config.quiet_share
        scale = disturbance_level * loud
        self.joint_noise_rad[row] = math.radians(scale * rng.uniform(*config.joint_noise_deg))
        self.tilt_noise_rad[row] = math.radians(scale * rng.uniform(*config.tilt_noise_deg))
        self.angular_speed_noise_rad_s[row] = scale * rng.uniform(*config.angular_speed_noise_rad_s)
        late = loud and rng.uniform() < config.latency_share
        self.latency_ticks[row] = disturbance_level * rng.uniform(*config.latency_ticks) * late
        pushed = loud and rng.uniform() < config.push_share
        angle, push_n_s = rng.uniform(-np.pi, np.pi), rng.uniform(*config.push_n_s)
        size_n = pushed * disturbance_level * push_n_s / (PUSH_TICKS * period_s)
        self._push_n[row] = size_n * math.cos(angle), size_n * math.sin(angle), 0.0
        self._push_tick[row] = rng.integers(ticks)

    def clear(self, row: int) -> None:
        """Robot `row` walks an episode without any of it."""
        for amplitude in (self.joint_noise_rad, self.tilt_noise_rad, self.latency_ticks):
            amplitude[row] = 0.0
        self.angular_speed_noise_rad_s[row] = 0.0
        self._push_n[row] = 0.0

    def draw_tread_error_m(self, rng: np.random.Generator, disturbance_level: float) -> float:
        """By how much the treads of one stair episode may be off."""
        off = rng.uniform() >= self.config.true_tread_share
        return float(disturbance_level * off * rng.uniform(*self.config.tread_error_m))

    def vary_models(
        self, rng: np.random.Generator, sim: SimBatch, disturbance_level: float
    ) -> None:
        """Draw the models of all simulations."""
        config, count = self.config, sim.count

        def factor(interval: Interval) -> np.ndarray:
            return 1.0 + disturbance_level * (rng.uniform(*interval, count) - 1.0)

        sim.variation().set(
            friction=factor(config.friction_factor),
            mass=factor(config.mass_factor),
            gain=factor(config.gain_factor),
            pelvis_com_m=disturbance_level * rng.uniform(*config.pelvis_com_m, (count, 3)),
        )

    def push(self, sim: SimBatch, ticks: np.ndarray) -> None:
        """Push the robots whose episodes are at their push, `ticks` (B,) into the episode."""
        now = (ticks >= self._push_tick) & (ticks < self._push_tick + PUSH_TICKS)
        now &= self._push_n.any(axis=1)
        if now.any() or self._pushing:
            sim.push(self._push_n * now[:, None])
        self._pushing = bool(now.any())

    def sense(self, rng: np.random.Generator, observation: np.ndarray) -> np.ndarray:
        """The observation (B, N) as `observe` gives it, with the noise of the sensors."""
        count, joints = len(observation), self._joints
        noise = rng.uniform(-1, 1, (count, 5 + 2 * joints))
        amplitude = np.concatenate(
            [
                np.repeat(self.tilt_noise_rad[:, None], 2, axis=1),
                np.repeat(self.angular_speed_noise_rad_s[:, None], 3, axis=1),
                np.repeat(self.joint_noise_rad[:, None], joints, axis=1),
                np.repeat(
                    self.config.joint_speed_noise_per_s * self.joint_noise_rad[:, None],
                    joints,
                    axis=1,
                ),
            ],
            axis=1,
        )
        sensed = observation.copy()
        sensed[:, : 5 + 2 * joints] += amplitude * noise
        return sensed
