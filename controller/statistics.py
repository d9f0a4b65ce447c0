"""What a segment of training came to."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from controller.assessment import ModeResult
from controller.curriculum import Stage
from controller.env import Transition


@dataclass
class Tally:
    """Counts over the transitions of a segment."""

    reward: float = 0.0
    steps: int = 0
    ended: int = 0
    fallen: int = 0
    stairs_ended: int = 0
    stairs_fallen: int = 0
    failed: int = 0
    errors: list[np.ndarray] = field(default_factory=list)
    terms: dict[str, float] = field(default_factory=dict)

    def add(self, step: Transition) -> None:
        """Count one control step of all robots."""
        self.reward += float(step.reward.mean())
        self.steps += 1
        self.ended += int((step.terminated | step.truncated).sum())
        self.fallen += int(step.terminated.sum())
        self.stairs_ended += int((step.stairs & (step.terminated | step.truncated)).sum())
        self.stairs_fallen += int((step.stairs & step.terminated).sum())
        self.failed += int(step.failed.sum())
        self.errors.append(step.landing_error_m[step.landed])
        for name, value in step.terms.items():
            self.terms[name] = self.terms.get(name, 0.0) + value

    def summary(self) -> dict[str, float]:
        """Means over the segment."""
        landings = np.concatenate(self.errors) if self.errors else np.zeros(0)
        return {
            "reward": self.reward / max(self.steps, 1),
            "falls_per_episode": self.fallen / max(self.ended, 1),
            "stairs_falls_per_episode": self.stairs_fallen / max(self.stairs_ended, 1),
            "landing_error_m": float(np.median(landings)) if len(landings) else float("nan"),
            "failed_simulations": float(self.failed),
            **{f"term/{name}": value / self.steps for name, value in self.terms.items()},
        }


@dataclass(frozen=True, kw_only=True)
class Report:
    """What a segment gave; passed to the progress display."""

    samples: int
    samples_total: int
    samples_per_s: float
    seconds_left: float
    reward: float
    landing_error_m: float
    falls_per_episode: float
    result: ModeResult
    stage: Stage
    stairs: tuple[ModeResult, ...]
    best: bool
