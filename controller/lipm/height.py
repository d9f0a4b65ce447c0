"""The height of the centre of mass over the coming steps: as low as the legs need to reach.

It wishes to be at its walking height over the feet that stand. On stairs and in wide steps one of
the legs would be stretched there, and a leg near to straight can no longer follow. So it sinks
before that, as softly as it can: a linear model predictive controller chooses its jerk, as the
pattern's does on the floor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import daqp
import numpy as np

from controller.lipm.pattern import (
    OPTIMAL,
    SAMPLE_S,
    SAMPLES,
    SOFT,
    SOFT_OPTIMAL,
    Phase,
    StageFailed,
    integrated,
    phase_at,
    triple_integrator,
)
from controller.lipm.whole_body import LegReach

# Weights of squared jerk and of squared distance from the wish.
JERK_WEIGHT, HEIGHT_WEIGHT = 1.0, 5e4


@dataclass(kw_only=True)
class HeightGenerator:
    """Height, its rate and the rate of that, of a centre of mass that walks at `height_m`."""

    height_m: float
    reach: LegReach
    state: np.ndarray = field(default_factory=lambda: np.zeros(3))
    _jerk: float = 0.0

    def __post_init__(self) -> None:
        free, forced = integrated()
        self._free, self._forced = free[:, 0], np.ascontiguousarray(forced[:, 0])
        self._cost = JERK_WEIGHT * np.eye(SAMPLES)
        self._cost += HEIGHT_WEIGHT * self._forced.T @ self._forced

    def solve(self, com: np.ndarray, phases: Sequence[Phase]) -> None:
        """Choose the jerk for the centre of mass (SAMPLES, 2) over these support phases.

        Raises:
            StageFailed: there is none.
        """
        wish, most = np.empty(SAMPLES), np.empty(SAMPLES)
        for k in range(SAMPLES):
            phase = phase_at(phases, SAMPLE_S * (k + 1))
            wish[k] = phase.soles[:, 2].mean() + self.height_m
            standing = np.flatnonzero(phase.standing)
            most[k] = min(self.reach.most_com_z_m(com[k], phase.feet, int(s)) for s in standing)
        free = self._free @ self.state
        jerk, _, flag, _ = daqp.solve(
            self._cost,
            HEIGHT_WEIGHT * self._forced.T @ (free - np.minimum(wish, most)),
            self._forced,
            most - free,
            np.full(SAMPLES, -1e30),
            np.full(SAMPLES, SOFT, np.int32),
        )
        if flag not in (OPTIMAL, SOFT_OPTIMAL) or not np.isfinite(jerk[0]):
            raise StageFailed("the height of the body has no solution")
        self._jerk = float(jerk[0])

    def advance(self, time_s: float) -> None:
        """Go on for a time."""
        free, forced = triple_integrator(time_s)
        self.state = free @ self.state + forced * self._jerk
