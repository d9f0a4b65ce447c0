"""Whether floods of the lattice prove that no steps lead from the start to the goal."""

from __future__ import annotations

import numpy as np

from planner.ara import Request
from planner.connect import first_steps
from planner.flood import Verdict, new_flood, spread
from planner.lattice import MICRO
from planner.model import Side

_NODES = 1 << 17  # of each flood


def how_enclosed(request: Request) -> str:
    """What encloses the start or the goal, in words; empty where that is not proven."""
    space, model = request.space, request.model
    margin_m = 0.0 if request.stands else model.body_margin_m
    sides = Side if request.first_side is None else (request.first_side,)
    seeds = [
        first_steps(
            space,
            model,
            request.feet_lattice[side.other],
            side,
            margin_m,
            round(float(request.feet_m[side.other]) * MICRO),
        )[0]
        for side in sides
    ]
    goal = (space.origin_row * space.cols + space.origin_col) * space.headings * 2
    flood = new_flood(space, np.concatenate(seeds), np.array([goal, goal + 1]))
    flood, verdict = spread(space, flood, _NODES)
    poses = int(flood.ends[1] + flood.ends[3])
    if verdict is Verdict.GOAL_ENCLOSED:
        return f"obstacles leave no steps from outside to the goal ({poses} poses tried)"
    if verdict is Verdict.START_ENCLOSED:
        return f"obstacles leave no steps out from the start ({poses} poses tried)"
    return ""
