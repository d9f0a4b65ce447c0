"""What proves, without a plan and without a full search, that no steps lead to the goal."""

from __future__ import annotations

from planner.search.first_plan import is_cut_off
from planner.search.problem import Request, first_nodes, no_first_step, no_way
from planner.search.reachability import Verdict, new_flood, spread

_NODES = 1 << 17  # that each flood goes on from
_BEGIN = "the goal cannot be reached: "


def is_shut(request: Request) -> str:
    """Why there is no way as the search of the body's path knows it; empty if that is unknown."""
    nodes, _ = first_nodes(request)
    if not len(nodes):
        return no_first_step(request).reason
    return no_way().reason if is_cut_off(request, nodes) else ""


def how_enclosed(request: Request) -> str:
    """What floods of the lattice prove to enclose the start or the goal; empty if unknown."""
    space = request.space
    flood = new_flood(space, first_nodes(request)[0], request.toward.ends)
    flood, verdict = spread(space, flood, _NODES)
    poses = int(flood.ends[1] + flood.ends[3])
    if verdict is Verdict.GOAL_ENCLOSED:
        return f"{_BEGIN}obstacles leave no steps from outside to the goal ({poses} poses tried)"
    if verdict is Verdict.START_ENCLOSED:
        return f"{_BEGIN}obstacles leave no steps out from the start ({poses} poses tried)"
    return ""
