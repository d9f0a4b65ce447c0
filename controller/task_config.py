"""What the walking task trains on, as one value."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from controller.randomization import Robustness
from controller.rewards import PRECISE

EPISODE_TICKS = 400


@dataclass(frozen=True, kw_only=True)
class TaskConfig:
    """What is trained on.

    `stairs_share` of the episodes are on stairs once the curriculum has come to them. Where
    `exact_rise` is set, all their rises are the stage's own, else they are drawn up to it.
    `planned_share` of the flat episodes walk steps of the planner's corpus, if there is one.

    Raises:
        ValueError: a share, length or noise that no episode can have.
    """

    timestep_s: float = 0.005
    episode_ticks: int = EPISODE_TICKS
    joint_noise_rad: float = 0.02
    joint_speed_noise_rad_s: float = 0.2
    wait_ticks: int = 20
    stairs_share: float = 0.38
    planned_share: float = 0.35
    exact_rise: bool = False
    robustness: Robustness = field(default_factory=Robustness)
    reward: Mapping[str, float] = field(default_factory=lambda: dict(PRECISE))

    def __post_init__(self) -> None:
        for name in ("stairs_share", "planned_share"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} {getattr(self, name)} must be from 0 to 1")
        for name in ("joint_noise_rad", "joint_speed_noise_rad_s", "wait_ticks"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{name} {value} must be a finite number of 0 or more")
        if self.episode_ticks < 1:
            raise ValueError(f"episode_ticks {self.episode_ticks} must be at least 1")
