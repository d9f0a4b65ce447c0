"""Which search answers to which name: one call for all, a request in and a result out."""

from __future__ import annotations

from collections.abc import Callable

from planner.options import SAMPLING_PLANNERS, PlannerOptions
from planner.search.ad_star import plan_adstar
from planner.search.ara import plan_ara, plan_astar, plan_backward
from planner.search.problem import Request, Result
from planner.search.r_star import plan_rstar

# Takes the request, the options and the time.perf_counter() of the request's arrival.
Backend = Callable[[Request, PlannerOptions, float], Result]


def backend(name: str) -> Backend:
    """The search of that name, one of `PLANNERS`. What a search loads is loaded here."""
    if name in SAMPLING_PLANNERS:
        from planner.sampling.sampling_planner import plan_by_sampling

        return plan_by_sampling
    return {
        "ara": plan_ara,
        "astar": plan_astar,
        "backward": plan_backward,
        "adstar": plan_adstar,
        "rstar": plan_rstar,
    }[name]
