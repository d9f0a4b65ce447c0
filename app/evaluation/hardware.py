"""How far robot and ground may differ from the model: the cases, their table and their figure."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from sim.hardware import HardwareErrors
from sim.robot import Robot


@dataclass(frozen=True, kw_only=True)
class HardwareKind:
    """One thing that differs, the values that are tried, and the errors that a value stands for."""

    unit: str
    values: tuple[float, ...]
    errors: Callable[[float, Robot], HardwareErrors]


def _all_at_once(share: float, robot: Robot) -> HardwareErrors:
    return HardwareErrors(
        delay_s=0.015 * share, gain=1.0 - 0.15 * share, encoder_rad=math.radians(share)
    )


def _by_mass(value: float, robot: Robot) -> float:
    """The value for a robot of 100 kg, by the robot's mass."""
    return value * robot.mass_kg / 100


HARDWARE: Mapping[str, HardwareKind] = {
    "servo gains": HardwareKind(
        unit="times the model's",
        values=(0.7, 0.8, 0.9, 1.1, 1.2, 1.3),
        errors=lambda value, _: HardwareErrors(gain=value),
    ),
    "delay": HardwareKind(
        unit="ms",
        values=(5.0, 10.0, 15.0, 20.0, 25.0),
        errors=lambda value, _: HardwareErrors(delay_s=value / 1000),
    ),
    "jitter": HardwareKind(
        unit="ms beside a delay of 5 ms",
        values=(5.0, 10.0, 15.0, 20.0),
        errors=lambda value, _: HardwareErrors(delay_s=0.005, jitter_s=value / 1000),
    ),
    "encoder offset": HardwareKind(
        unit="degrees",
        values=(0.5, 1.0, 1.5, 2.0, 3.0),
        errors=lambda value, _: HardwareErrors(encoder_rad=math.radians(value)),
    ),
    "backlash": HardwareKind(
        unit="degrees",
        values=(0.5, 1.0, 2.0, 3.0),
        errors=lambda value, _: HardwareErrors(backlash_rad=math.radians(value)),
    ),
    "torque falls to 0": HardwareKind(
        unit="times the speed limit",
        values=(1.0, 0.75, 0.5, 0.25),
        errors=lambda value, _: HardwareErrors(no_load=value),
    ),
    "dry friction": HardwareKind(
        unit="N m for each 100 kg of robot",
        values=(1.0, 2.0, 4.0, 8.0, 16.0),
        errors=lambda value, robot: HardwareErrors(friction_nm=_by_mass(value, robot)),
    ),
    "joint damping": HardwareKind(
        unit="N m s for each 100 kg of robot",
        values=(1.0, 2.0, 4.0, 8.0, 16.0),
        errors=lambda value, robot: HardwareErrors(damping_nms=_by_mass(value, robot)),
    ),
    "load carried": HardwareKind(
        unit="kg, 10 cm ahead and 20 above the pelvis",
        values=(1.0, 2.0, 3.0, 5.0, 8.0),
        errors=lambda value, _: HardwareErrors(payload_kg=value),
    ),
    "grip": HardwareKind(
        unit="times the model's friction",
        values=(0.5, 0.25, 0.15, 0.1, 0.05),
        errors=lambda value, _: HardwareErrors(grip=value),
    ),
    "softness": HardwareKind(
        unit="times as slow a contact",
        values=(2.0, 3.0, 4.0, 6.0),
        errors=lambda value, _: HardwareErrors(softness=value),
    ),
    "all at once": HardwareKind(
        unit="times 15 ms of delay, 15 % weaker gains, encoders 1 degree off",
        values=(0.5, 1.0, 1.5),
        errors=_all_at_once,
    ),
}
