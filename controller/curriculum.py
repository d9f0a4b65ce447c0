"""Curriculum: flat ground first, then stairs of growing rise.

Singh et al. 2022, sec. IV-E, train on flat ground until iteration 3000 and let the rise grow
linearly over the next 8000. Here, by default, the rise grows whenever the policy succeeds in
held-out episodes at the present rise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Stage:
    """Highest rise of the stairs (0: no stairs) and level of domain randomization, 0 to 1."""

    rise_m: float = 0.0
    disturbance_level: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Curriculum:
    """When the stage grows.

    With `measured` the stairs come when at least `flat_success` of the held-out flat episodes
    succeed, and each time that at least `stairs_success` of those on stairs do, the rise grows by
    `rise_step_m`. Otherwise they come after `flat_updates` updates of the learner, and the rise
    grows linearly over the next `growth_updates`. The disturbances grow with the rise; where there
    are no stairs (`top_rise_m` 0) they come all at once, or grow over those updates.

    Raises:
        ValueError: an invalid length, share or count.
    """

    measured: bool = True
    top_rise_m: float = 0.15
    rise_step_m: float = 0.015
    flat_success: float = 0.95
    stairs_success: float = 0.9
    flat_updates: int = 3000
    growth_updates: int = 8000

    def __post_init__(self) -> None:
        if not (math.isfinite(self.top_rise_m) and self.top_rise_m >= 0):
            raise ValueError(f"top_rise_m {self.top_rise_m} must be a finite number of 0 or more")
        if not self.rise_step_m > 0:
            raise ValueError(f"rise_step_m {self.rise_step_m} must be above 0, or nothing grows")
        for name in ("flat_success", "stairs_success"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} {getattr(self, name)} must be from 0 to 1")
        if self.flat_updates < 0 or self.growth_updates < 1:
            raise ValueError(
                f"flat_updates {self.flat_updates} must be at least 0, "
                f"growth_updates {self.growth_updates} at least 1"
            )

    def first(self) -> Stage:
        """The first stage of a run."""
        return Stage()

    def after(
        self, stage: Stage, *, updates: int, flat_success: float, stairs_success: float
    ) -> Stage:
        """The next segment's stage, after `updates` updates of the learner.

        `stairs_success` is ignored in a stage without stairs.
        """
        if not self.measured:
            share = min(max((updates - self.flat_updates) / self.growth_updates, 0.0), 1.0)
            return Stage(rise_m=self.top_rise_m * share, disturbance_level=share)
        if flat_success < self.flat_success:
            return stage
        if stage.rise_m > 0 and stairs_success < self.stairs_success:
            return stage
        if self.top_rise_m == 0:
            return Stage(disturbance_level=1.0)
        rise_m = min(stage.rise_m + self.rise_step_m, self.top_rise_m)
        return Stage(rise_m=rise_m, disturbance_level=rise_m / self.top_rise_m)


MEASURED = Curriculum()
PAPER = Curriculum(measured=False, top_rise_m=0.10)
FLAT = Curriculum(top_rise_m=0.0)
PRESETS = {"measured": MEASURED, "paper": PAPER, "flat": FLAT}
