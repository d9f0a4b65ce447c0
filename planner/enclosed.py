"""Whether floods of the lattice prove that no steps lead from the start to the goal."""

from __future__ import annotations

from planner.flood import Verdict, new_flood, spread
from planner.request import Request, first_nodes

_NODES = 1 << 17  # of each flood


def how_enclosed(request: Request) -> str:
    """What encloses the start or the goal, in words; empty where that is not proven."""
    space = request.space
    flood = new_flood(space, first_nodes(request)[0], request.toward.goal_nodes)
    flood, verdict = spread(space, flood, _NODES)
    poses = int(flood.ends[1] + flood.ends[3])
    if verdict is Verdict.GOAL_ENCLOSED:
        return f"obstacles leave no steps from outside to the goal ({poses} poses tried)"
    if verdict is Verdict.START_ENCLOSED:
        return f"obstacles leave no steps out from the start ({poses} poses tried)"
    return ""
