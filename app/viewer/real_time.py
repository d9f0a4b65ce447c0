"""How fast simulated time passes against the clock on the wall."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

# What was missed for longer than this is not caught up.
_FORGIVEN_S = 0.5
_MEASURED_OVER_S = 1.0


class Pace:
    """Says when the next tick is due. `factor` is simulated over real time; 0 pauses.

    `factor` may be set from any thread. While `is_idle`, there is nothing to
    hurry for: time passes no faster than on the wall.
    """

    def __init__(self, factor: float = 1.0, clock: Callable[[], float] = time.monotonic) -> None:
        self.factor = factor
        self.is_idle = False
        self.reached = 0.0
        self._clock = clock
        self._due_s = clock()
        self._since_s = clock()
        self._passed_s = 0.0

    @property
    def _factor(self) -> float:
        return min(1.0, self.factor) if self.is_idle else self.factor

    def wait_s(self) -> float:
        """Real time until the next tick is due; infinite while paused."""
        factor = self._factor
        if factor <= 0:
            return math.inf
        return 0.0 if math.isinf(factor) else max(0.0, self._due_s - self._clock())

    def is_due(self) -> bool:
        """Whether to tick now."""
        self._measure()
        return self.wait_s() <= 0.0

    def ticked(self, period_s: float) -> None:
        """Notes that so much simulated time has passed."""
        self._passed_s += period_s
        now_s = self._clock()
        factor = self._factor
        if math.isinf(factor) or factor <= 0:
            self._due_s = now_s
            return
        self._due_s = max(self._due_s + period_s / factor, now_s - _FORGIVEN_S)

    def skip(self) -> None:
        """Notes that there was nothing to tick for: what was missed is not caught up."""
        self._due_s = self._clock()
        self._measure()

    def _measure(self) -> None:
        now_s = self._clock()
        if now_s - self._since_s >= _MEASURED_OVER_S:
            self.reached = self._passed_s / (now_s - self._since_s)
            self._since_s, self._passed_s = now_s, 0.0
