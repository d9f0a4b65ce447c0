"""How hard the task is, and when it grows: flat ground first, then stairs of growing rise.

Singh et al. 2022, sec. IV-E, train on flat ground until iteration 3000 and let the rise grow
linearly over the next 8000. Here, by default, the rise grows whenever held-out episodes at the
present one succeed.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Stage:
    """How hard episodes are: the highest rise (0: no stairs), and the share of disturbance."""

    rise_m: float = 0.0
    hardness: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Curriculum:
    """When the stage grows.

    With `measured` the stairs come when at least `flat_success` of the held-out flat episodes
    succeed, and each time that at least `stairs_success` of those on stairs do, the rise grows by
    `rise_step_m`. Otherwise they come after `flat_updates` updates of the learner, and the rise
    grows linearly over the next `growth_updates`. The disturbances grow with the rise.
    """

    measured: bool = True
    top_rise_m: float = 0.15
    rise_step_m: float = 0.015
    flat_success: float = 0.95
    stairs_success: float = 0.9
    flat_updates: int = 3000
    growth_updates: int = 8000

    def first(self) -> Stage:
        """The stage that a run begins with."""
        return Stage()

    def after(
        self, stage: Stage, *, updates: int, flat_success: float, stairs_success: float
    ) -> Stage:
        """The next segment's stage, after `updates` updates of the learner.

        `stairs_success` does not count in a stage without stairs.
        """
        if not self.measured:
            share = (updates - self.flat_updates) / self.growth_updates
            return self._at(self.top_rise_m * min(max(share, 0.0), 1.0))
        if flat_success < self.flat_success:
            return stage
        if stage.rise_m > 0 and stairs_success < self.stairs_success:
            return stage
        return self._at(min(stage.rise_m + self.rise_step_m, self.top_rise_m))

    def _at(self, rise_m: float) -> Stage:
        hardness = rise_m / self.top_rise_m if self.top_rise_m > 0 else 1.0
        return Stage(rise_m=rise_m, hardness=hardness)


MEASURED = Curriculum()
PAPER = Curriculum(measured=False, top_rise_m=0.10)
FLAT = Curriculum(measured=False, top_rise_m=0.0)
PRESETS = {"measured": MEASURED, "paper": PAPER, "flat": FLAT}
