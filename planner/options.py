"""What can be chosen about a search."""

from __future__ import annotations

import math
from dataclasses import dataclass

# These plan by way of a path of the body, which OMPL finds.
SAMPLING_PLANNERS = ("rrtconnect", "rrtstar", "informed-rrtstar", "bitstar", "prmstar", "fmt")
PLANNERS = ("ara", "astar", "backward", "adstar", "rstar", *SAMPLING_PLANNERS)

# Heuristics of the anytime search; FULL is the greatest lower bound, see `heuristics/heuristic.py`.
FULL = "full"
HEURISTICS = (FULL, "path", "steps", "euclidean")
# The others look from the goal to the start, or have no heuristic.
HEURISTIC_PLANNERS = ("ara", "astar", "rstar")


@dataclass(frozen=True, kw_only=True)
class PlannerOptions:
    """How to search.

    epsilon, final_epsilon: the heuristic's weight in the first and in the last search; a plan costs
    at most the reported epsilon times the optimum. improve_expansions: states to expand past the
    first plan in search of a better one, as many for each further tenth that its cost is above the
    bound, and ten times that at most; None goes on until final_epsilon is proven.
    max_expansions: the same for the whole search. Both repeat exactly. time_limit_s: a limit on the
    clock on top of them; results then depend on the machine. stop_at_first: be content with the
    first plan. refine: move the plan's steps off the lattice to lower its cost. unknown_is_free:
    walk on cells that nobody has seen. heuristic: one of `HEURISTICS`. seed: of the planners that
    draw at random. partial: where a limit ends the search without a plan, give the steps that lead
    nearest to the goal. goal_reach_m, goal_reach_rad: how far from the goal, and how far turned,
    plans may end; those of `SAMPLING_PLANNERS` end at the goal itself.
    """

    name: str = "ara"
    epsilon: float = 1.2
    final_epsilon: float = 1.0
    improve_expansions: int | None = 60_000
    max_expansions: int = 3_000_000
    time_limit_s: float | None = None
    stop_at_first: bool = False
    refine: bool = True
    unknown_is_free: bool = False
    record: bool = False
    heuristic: str = FULL
    seed: int = 0
    partial: bool = False
    goal_reach_m: float = 0.0
    goal_reach_rad: float = 0.0

    def __post_init__(self) -> None:
        if self.name not in PLANNERS:
            raise ValueError(f"planner {self.name!r} must be one of {', '.join(PLANNERS)}")
        if self.heuristic not in HEURISTICS:
            raise ValueError(f"heuristic {self.heuristic!r} must be one of {', '.join(HEURISTICS)}")
        if self.heuristic != FULL and self.name not in HEURISTIC_PLANNERS:
            raise ValueError(
                f"heuristic {self.heuristic!r} is for the planners "
                f"{', '.join(HEURISTIC_PLANNERS)}; {self.name} has its own"
            )
        if not (math.isfinite(self.epsilon) and self.epsilon >= self.final_epsilon >= 1.0):
            raise ValueError(
                f"epsilon {self.epsilon} must be a finite number, at least "
                f"final_epsilon {self.final_epsilon}, which must be at least 1"
            )
        if self.improve_expansions is not None and self.improve_expansions < 0:
            raise ValueError(f"improve_expansions {self.improve_expansions} must be at least 0")
        if self.max_expansions < 1:
            raise ValueError(f"max_expansions {self.max_expansions} must be at least 1")
        if self.seed < 0:
            raise ValueError(f"seed {self.seed} must be at least 0")
        for name in ("goal_reach_m", "goal_reach_rad"):
            reach = getattr(self, name)
            if not (math.isfinite(reach) and reach >= 0):
                raise ValueError(f"{name} {reach} must be a finite number of at least 0")
        if self.time_limit_s is not None and not self.time_limit_s > 0:
            raise ValueError(f"time_limit_s {self.time_limit_s} must be above 0")
