"""Plans by way of poses."""

from __future__ import annotations

import numpy as np
import pytest

from maps.grid import Cell, OccupancyGrid
from planner.options import PlannerOptions
from planner.plan import PlanStatus, feet_at
from planner.planner import Planner, plan_through
from planner.verify import violations
from tests.planner_oracle import small_model

START, VIA, GOAL = (0.5, 0.5, 0.0), (1.5, 0.6, 1.0), (0.8, 1.8, 2.5)


def floor(boxes=()):
    cells = np.zeros((24, 24), np.uint8)
    for row0, col0, row1, col1 in boxes:
        cells[row0:row1, col0:col1] = Cell.OCCUPIED
    return OccupancyGrid(cells=cells, resolution_m=0.1)


def test_the_robot_stands_at_every_pose_and_steps_alternate():
    grid, model = floor(), small_model()
    plan = plan_through(
        Planner(grid, model, options=PlannerOptions(refine=False)), start=START, poses=[VIA, GOAL]
    )
    assert plan.found
    assert plan.goal == GOAL
    assert np.all(np.diff(plan.side) != 0)
    assert violations(plan, grid, model) == []
    stood = [
        set(plan.side[k : k + 2]) == {0, 1}
        and np.allclose(
            plan.pose_world[k : k + 2], feet_at(VIA, model.stance_width_m)[plan.side[k : k + 2]]
        )
        for k in range(len(plan) - 1)
    ]
    assert sum(stood) == 1


def test_the_cost_is_that_of_the_legs():
    grid, model = floor(), small_model()
    planner = Planner(grid, model, options=PlannerOptions(refine=False))
    first = planner.plan(goal=VIA, start=START)
    plan = plan_through(planner, start=START, poses=[VIA, GOAL])
    rest = plan_through(
        Planner(grid, model, options=PlannerOptions(refine=False)), start=START, poses=[VIA]
    )
    assert rest.cost_m == first.cost_m
    assert plan.cost_m > first.cost_m
    assert np.array_equal(plan.pose_world[: len(first)], first.pose_world)


def test_a_leg_without_a_way_is_named():
    grid, model = floor(boxes=((13, 0, 14, 24),)), small_model()
    plan = plan_through(
        Planner(grid, model, options=PlannerOptions(refine=False)),
        start=START,
        poses=[VIA, (0.8, 1.95, 2.5)],
    )
    assert plan.status is PlanStatus.NO_PATH
    assert plan.reason.startswith("leg 2 of 2: ")
    assert len(plan) == 0


def test_no_pose_is_an_error():
    with pytest.raises(ValueError, match="poses is empty"):
        plan_through(
            Planner(floor(), small_model(), options=PlannerOptions(refine=False)),
            start=START,
            poses=[],
        )
