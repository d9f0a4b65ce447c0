"""A small floor for tests of the planner's parts: empty, with boxes, and a plan over it."""

from __future__ import annotations

import numpy as np

from maps.grid import Cell, OccupancyGrid
from planner.api import plan_footsteps
from planner.plan import FootstepPlan
from tests.planner_oracle import small_model

FLOOR = OccupancyGrid(cells=np.zeros((30, 40), np.uint8), resolution_m=0.1)


def blocked_at(*boxes: tuple[int, int, int, int]) -> OccupancyGrid:
    """The floor with blocked boxes (row0, col0, row1, col1), ends excluded."""
    cells = np.zeros((30, 40), np.uint8)
    for row0, col0, row1, col1 in boxes:
        cells[row0:row1, col0:col1] = Cell.OCCUPIED
    return FLOOR.with_cells(cells)


def small_plan() -> FootstepPlan:
    """A plan over the empty floor, turning."""
    return plan_footsteps(FLOOR, small_model(), start=(1.0, 1.0, 0.2), goal=(2.5, 1.8, 1.0))
