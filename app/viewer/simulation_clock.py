"""Real-time pacing of a simulation."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

# Simulated time that is behind real time by more than this is not caught up.
_FORGIVEN_S = 0.5
_MEASURED_OVER_S = 1.0


class SimulationClock:
    """Real-time pacing: when the next tick is due. `factor` is simulated over real time; 0 pauses.

    It may be set from any thread. While `is_idle`, time passes no faster than on the wall.
    """

    def __init__(
        self, factor: float = 1.0, monotonic: Callable[[], float] = time.monotonic
    ) -> None:
        self.factor = factor
        self.is_idle = False
        self.reached = 0.0
        self._monotonic = monotonic
        self._due_s = monotonic()
        self._since_s = monotonic()
        self._passed_s = 0.0

    @property
    def _factor(self) -> float:
        return min(1.0, self.factor) if self.is_idle else self.factor

    def wait_s(self) -> float:
        """Real time until the next tick is due; infinite while paused."""
        factor = self._factor
        if factor <= 0:
            return math.inf
        return 0.0 if math.isinf(factor) else max(0.0, self._due_s - self._monotonic())

    def is_due(self) -> bool:
        """Whether to tick now."""
        self._measure()
        return self.wait_s() <= 0.0

    def ticked(self, period_s: float) -> None:
        """Notes that so much simulated time has passed."""
        self._passed_s += period_s
        now_s = self._monotonic()
        factor = self._factor
        if math.isinf(factor) or factor <= 0:
            self._due_s = now_s
            return
        self._due_s = max(self._due_s + period_s / factor, now_s - _FORGIVEN_S)

    def skip(self) -> None:
        """Notes that there was nothing to tick for: what was missed is not caught up."""
        self._due_s = self._monotonic()
        self._measure()

    def _measure(self) -> None:
        now_s = self._monotonic()
        if now_s - self._since_s >= _MEASURED_OVER_S:
            self.reached = self._passed_s / (now_s - self._since_s)
            self._since_s, self._passed_s = now_s, 0.0
