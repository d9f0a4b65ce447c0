"""Plans by way of a path of the body from OMPL."""

from __future__ import annotations

import math
import subprocess
import sys

import numpy as np
import pytest

from maps.grid import Cell, OccupancyGrid
from planner.api import plan_footsteps
from planner.options import SAMPLING_PLANNERS, PlannerOptions
from planner.plan import PlanStatus
from planner.verify import violations
from tests.planner_oracle import Oracle, small_model


def walled(rows=24, cols=24, boxes=(), origin=(0.0, 0.0, 0.0), resolution_m=0.1):
    """A free floor with blocked boxes (row0, col0, row1, col1), ends excluded."""
    cells = np.zeros((rows, cols), np.uint8)
    for row0, col0, row1, col1 in boxes:
        cells[row0:row1, col0:col1] = Cell.OCCUPIED
    return OccupancyGrid(cells=cells, resolution_m=resolution_m, origin=origin)


WALL = ((0, 11, 15, 12),)
# A map that is turned and shifted, so that no frame passes for another.
SLANTED = walled(boxes=WALL, origin=(-1.0, 2.0, 0.6)), (-0.885, 2.806, 0.9), (0.09, 3.594, 2.0)


@pytest.mark.parametrize("name", SAMPLING_PLANNERS)
def test_each_finds_a_plan_round_a_wall_that_is_right_and_repeats(name):
    grid, start, goal = SLANTED
    model = small_model()
    best_m = Oracle(grid, model, goal).best_cost(start)
    for first in (True, False):
        options = PlannerOptions(name=name, stop_at_first=first)
        plan = plan_footsteps(grid, model, start=start, goal=goal, options=options)
        assert plan.found
        assert (plan.planner, plan.epsilon) == (name, math.inf)
        assert violations(plan, grid, model) == []
        # Not bound to the lattice, so it may even cost less than the best plan there.
        assert 0.7 * best_m < plan.cost_m < 3 * best_m
        again = plan_footsteps(grid, model, start=start, goal=goal, options=options)
        assert again.to_json().split('"time_to')[0] == plan.to_json().split('"time_to')[0]


def test_the_lattice_makes_no_plan_dearer():
    grid, start, goal = SLANTED
    model = small_model()
    costs = [
        plan_footsteps(
            grid,
            model,
            start=start,
            goal=goal,
            options=PlannerOptions(name="rrtconnect", stop_at_first=first, seed=seed),
        ).cost_m
        for seed in range(4)
        for first in (True, False)
    ]
    assert all(better <= first for first, better in zip(costs[::2], costs[1::2], strict=True))


@pytest.mark.parametrize("name", ["rrtconnect", "prmstar", "fmt"])
def test_a_wall_all_across_is_proven_to_leave_no_way(name):
    grid = walled(boxes=((0, 11, 24, 12),))
    options = PlannerOptions(name=name)
    plan = plan_footsteps(
        grid, small_model(), start=(0.6, 1.2, 0.0), goal=(1.8, 1.2, 0.0), options=options
    )
    assert plan.status is PlanStatus.NO_PATH
    assert "enclose" in plan.reason


def test_importing_and_planning_with_ara_does_not_load_ompl():
    code = (
        "import sys, app.plan, planner.api, planner.backends as b; b.backend('ara');"
        "assert 'ompl' not in sys.modules;"
        "b.backend('fmt'); assert 'ompl' in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)
