"""How bodies touch in Drake; this file loads nothing of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

# How Drake's discrete solver treats friction and damping of contact: docs/engines.md.
APPROXIMATIONS = ("sap", "similar", "lagged", "tamsi")


class EngineError(ValueError):
    """An engine is not installed, or cannot hold a scene; the message says what would be right."""


@dataclass(frozen=True, kw_only=True)
class ContactModel:
    """How bodies touch in Drake, and the duration of its physics steps.

    `modulus_pa` is how the pressure under a sole grows with its depth over half its thickness.
    Approximation `sap` damps contacts by `relaxation_s`, the others by Hunt and Crossley's
    `dissipation_s_m`. `friction` None is that of the scene. Below `stiction_m_s` friction grows
    with speed, but for `sap`, which has a law of its own.

    Raises:
        ValueError: an unknown approximation, or a value out of range.
    """

    approximation: str = "sap"
    modulus_pa: float = 1e6
    relaxation_s: float = 0.02
    dissipation_s_m: float = 50.0
    friction: float | None = None
    stiction_m_s: float = 1e-4
    timestep_s: float = 0.001

    def __post_init__(self) -> None:
        if self.approximation not in APPROXIMATIONS:
            raise ValueError(f"{self.approximation!r} is not one of {', '.join(APPROXIMATIONS)}")
        for name, value in vars(self).items():
            if isinstance(value, float) and not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{name} {value} must be a finite number of 0 or more")
        for name in ("modulus_pa", "stiction_m_s", "timestep_s"):
            if not getattr(self, name):
                raise ValueError(f"{name} must be above 0")
