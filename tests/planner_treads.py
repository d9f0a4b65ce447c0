"""Floors with treads, kerbs and trenches, queries on them, and a small robot that climbs."""

from __future__ import annotations

import numpy as np

from maps.grid import Cell, OccupancyGrid
from planner.robot_model import StepLimits
from tests.planner_oracle import small_model

LIMITS = StepLimits(x_m=(-0.2, 0.3), y_m=(0.14, 0.4), yaw_rad=(-0.4, 0.8), z_m=(-0.1, 0.1))
CLIMBER = small_model(limits=LIMITS, level_margin_m=0.0)


def floor(*treads, rows=24, cols=24, boxes=(), origin=(0.0, 0.0, 0.0), resolution_m=0.1):
    """A floor at 0 with treads (row0, col0, row1, col1, height) and blocked boxes."""
    heights = np.zeros((rows, cols))
    for row0, col0, row1, col1, height in treads:
        heights[row0:row1, col0:col1] = height
    cells = np.zeros((rows, cols), np.uint8)
    for row0, col0, row1, col1 in boxes:
        cells[row0:row1, col0:col1] = Cell.OCCUPIED
    return OccupancyGrid(cells=cells, resolution_m=resolution_m, origin=origin, elevation_m=heights)


STAIRS = ((0, 9, 24, 24, 0.1), (0, 12, 24, 24, 0.2), (0, 15, 24, 24, 0.3))
CLIFF = ((0, 11, 24, 24, 0.2), (15, 8, 24, 11, 0.1))
KERB = ((0, 11, 15, 12, 0.08),)
CASES = {
    "stairs": (floor(*STAIRS), (0.45, 1.13, 0.1), (1.93, 1.22, 0.0)),
    "stairs that no foot fits": (floor(*STAIRS), (0.45, 1.13, 0.1), (1.95, 1.22, 0.4)),
    "down": (floor(*STAIRS), (1.95, 1.22, 2.9), (0.45, 1.13, 3.0)),
    "slanted stairs": (
        floor(*STAIRS, origin=(-1.0, 2.0, 0.6)),
        (-1.28, 3.17, 0.7),
        (-0.09, 4.09, 0.8),
    ),
    "a cliff with a step beside it": (floor(*CLIFF), (0.5, 0.6, 0.3), (1.75, 0.7, 0.0)),
    "a kerb to go around": (floor(*KERB), (0.52, 0.6, 0.3), (1.83, 0.71, -0.3)),
    "a trench": (
        floor((0, 24, 48, 25, -0.4), rows=48, cols=48, resolution_m=0.05),
        (0.52, 1.1, 0.0),
        (1.86, 1.2, 0.0),
    ),
    "walls on the treads": (
        floor(*STAIRS, boxes=((0, 10, 7, 14),)),
        (0.45, 0.6, 0.1),
        (1.93, 0.82, 0.0),
    ),
}
