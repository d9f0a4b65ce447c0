"""What can be chosen about a search."""

from __future__ import annotations

import math
from dataclasses import dataclass

PLANNERS = ("ara",)


@dataclass(frozen=True, kw_only=True)
class PlannerOptions:
    """How to search.

    epsilon, final_epsilon: the heuristic's weight in the first and in the last search; a plan costs
    at most the reported epsilon times the optimum. max_expansions: the rule by which a search ends
    that repeats exactly. time_limit_s: a limit on the clock on top of it; results then depend on
    the machine. stop_at_first: be content with the first plan. unknown_is_free: walk on cells that
    nobody has seen.
    """

    name: str = "ara"
    epsilon: float = 1.2
    final_epsilon: float = 1.0
    max_expansions: int = 3_000_000
    time_limit_s: float | None = None
    stop_at_first: bool = False
    unknown_is_free: bool = False

    def __post_init__(self) -> None:
        if self.name not in PLANNERS:
            raise ValueError(f"planner {self.name!r} must be one of {', '.join(PLANNERS)}")
        if not (math.isfinite(self.epsilon) and self.epsilon >= self.final_epsilon >= 1.0):
            raise ValueError(
                f"epsilon {self.epsilon} must be a finite number, at least "
                f"final_epsilon {self.final_epsilon}, which must be at least 1"
            )
        if self.max_expansions < 1:
            raise ValueError(f"max_expansions {self.max_expansions} must be at least 1")
        if self.time_limit_s is not None and not self.time_limit_s > 0:
            raise ValueError(f"time_limit_s {self.time_limit_s} must be above 0")
