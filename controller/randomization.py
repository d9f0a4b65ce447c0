"""What a robot has to put up with: noise, latency, pushes, other masses, treads that are off.

Every range is (low, high). A `Robustness` says what is drawn; `Disturbances` holds what has been
drawn for each of B robots and applies it. All of it scales with the hardness of the curriculum.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planner.robot_model import Interval
from sim.batch import SimBatch

PUSH_TICKS = 4


@dataclass(frozen=True, kw_only=True)
class Robustness:
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
    late_share: float = 0.2
    late_ticks: Interval = (0.0, 1.0)
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
    def exactly(cls, *, joint_noise_deg: float = 0.0, tread_error_m: float = 0.0) -> Robustness:
        """These amplitudes in every episode, and nothing else."""
        return cls(
            quiet_share=0.0,
            joint_noise_deg=(joint_noise_deg, joint_noise_deg),
            tilt_noise_deg=(0.0, 0.0),
            angular_speed_noise_rad_s=(0.0, 0.0),
            late_share=0.0,
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
    if name == "late_ticks" and high > 1:
        raise ValueError(f"{name}: ({low}, {high}) must be at most 1 control step")


class Disturbances:
    """What has been drawn for each of B robots. Nothing is drawn while the hardness is 0."""

    def __init__(self, config: Robustness, count: int, joints: int):
        self.config = config
        self.joint_noise_rad = np.zeros(count)
        self.tilt_noise_rad = np.zeros(count)
        self.angular_speed_noise_rad_s = np.zeros(count)
        self.late_ticks = np.zeros(count)
        self._push_n = np.zeros((count, 3))
        self._push_tick = np.full(count, -PUSH_TICKS)
        self._pushing = False
        self._joints = joints

    def draw_episode(
        self, rng: np.random.Generator, row: int, hardness: float, *, period_s: float, ticks: int
    ) -> None:
        """Draw an episode of `ticks` control steps of `period_s` for robot `row`."""
        config = self.config
        loud = rng.uniform() >= config.quiet_share
        scale = hardness * loud
        self.joint_noise_rad[row] = math.radians(scale * rng.uniform(*config.joint_noise_deg))
        self.tilt_noise_rad[row] = math.radians(scale * rng.uniform(*config.tilt_noise_deg))
        self.angular_speed_noise_rad_s[row] = scale * rng.uniform(*config.angular_speed_noise_rad_s)
        late = loud and rng.uniform() < config.late_share
        self.late_ticks[row] = hardness * rng.uniform(*config.late_ticks) * late
        pushed = loud and rng.uniform() < config.push_share
        angle, push_n_s = rng.uniform(-np.pi, np.pi), rng.uniform(*config.push_n_s)
        size_n = pushed * hardness * push_n_s / (PUSH_TICKS * period_s)
        self._push_n[row] = size_n * math.cos(angle), size_n * math.sin(angle), 0.0
        self._push_tick[row] = rng.integers(ticks)

    def calm(self, row: int) -> None:
        """Robot `row` walks an episode without any of it."""
        for amplitude in (self.joint_noise_rad, self.tilt_noise_rad, self.late_ticks):
            amplitude[row] = 0.0
        self.angular_speed_noise_rad_s[row] = 0.0
        self._push_n[row] = 0.0

    def draw_tread_error_m(self, rng: np.random.Generator, hardness: float) -> float:
        """By how much the treads of one stair episode may be off."""
        off = rng.uniform() >= self.config.true_tread_share
        return float(hardness * off * rng.uniform(*self.config.tread_error_m))

    def vary_models(self, rng: np.random.Generator, sim: SimBatch, hardness: float) -> None:
        """Draw the models of all simulations."""
        config, count = self.config, sim.count

        def factor(interval: Interval) -> np.ndarray:
            return 1.0 + hardness * (rng.uniform(*interval, count) - 1.0)

        sim.variation().set(
            friction=factor(config.friction_factor),
            mass=factor(config.mass_factor),
            gain=factor(config.gain_factor),
            pelvis_com_m=hardness * rng.uniform(*config.pelvis_com_m, (count, 3)),
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
