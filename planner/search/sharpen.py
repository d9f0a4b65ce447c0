"""A search goes on with the bound of `rounded.py`, once it is worth what that takes to make."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from planner.heuristics.rounded_plans import rounded_steps
from planner.heuristics.rounded_spread import rounded_costs
from planner.heuristics.wavefront import NOWHERE_UM
from planner.search.problem import Request
from planner.search.search_task import Task, heuristic_toward_start

_SPACING_M = 0.03  # at least


def sharpened(
    request: Request, task: Task, limit_um: int, go_on: Callable[[], bool]
) -> Task | None:
    """A search from the start with a sharper bound, good for plans that cost less than limit_um.

    None where the grid would be too large, or as soon as go_on says so.
    """
    space, tables = task.space, request.toward.tables
    # Most steps are whole cells, and what is a whole number of the grid's as well is not rounded.
    spacing_m = math.ceil(_SPACING_M / space.cell_m - 1e-9) * space.cell_m
    behind = heuristic_toward_start(request, task.roots, task.root_um)
    start_um = np.where(
        behind.cost_um > 0, behind.cost_um - 1 + int(behind.potential_um.min()), NOWHERE_UM
    )
    steps = rounded_steps(request.model, tables.steps, tables.potential, spacing_m)
    rounded = rounded_costs(
        space, request.model, steps, spacing_m, request.toward.ends, start_um, limit_um, go_on
    )
    if rounded is None:
        return None
    # The bound by the rim of a circle adds nothing to this one: all is within the circle.
    everywhere = space.cols + space.rows
    heuristic = task.heuristic._replace(rounded=rounded, radius_cells=everywhere)
    return replace(task, heuristic=heuristic)
