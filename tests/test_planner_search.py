"""The search against a slow oracle, its limits, and what it reports."""

from __future__ import annotations

import numpy as np
import pytest

from maps.grid import Cell, OccupancyGrid
from planner.options import PlannerOptions
from planner.plan import PlanStatus
from planner.planner import Planner, plan_footsteps
from planner.verify import violations
from sim.robots import get_robot
from tests.planner_floor import CASES, walled
from tests.planner_oracle import Oracle, small_model


@pytest.mark.parametrize("planner", ["ara", "astar", "backward"])
@pytest.mark.parametrize("name", CASES)
def test_the_cost_is_the_oracles_optimum(name, planner):
    grid, start, goal = CASES[name]
    model = small_model()
    options = PlannerOptions(name=planner, refine=False)
    plan = plan_footsteps(grid, model, start=start, goal=goal, options=options)
    assert plan.found
    assert plan.epsilon == 1.0
    assert plan.cost_m == pytest.approx(Oracle(grid, model, goal).best_cost(start), abs=1e-5)
    assert violations(plan, grid, model) == []


@pytest.mark.parametrize("epsilon", [1.0, 1.5, 3.0, 10.0])
def test_a_first_plan_costs_no_more_than_its_bound_times_the_optimum(epsilon):
    for grid, start, goal in CASES.values():
        model = small_model()
        best = plan_footsteps(
            grid, model, start=start, goal=goal, options=PlannerOptions(refine=False)
        ).cost_m
        options = PlannerOptions(epsilon=epsilon, stop_at_first=True, refine=False)
        plan = plan_footsteps(grid, model, start=start, goal=goal, options=options)
        assert best - 1e-6 <= plan.cost_m <= plan.epsilon * best + 1e-6
        assert violations(plan, grid, model) == []


def test_limits_on_the_search_end_it_and_say_so():
    grid, start, goal = CASES["wall"]
    model = small_model()
    options = PlannerOptions(max_expansions=1, refine=False)
    plan = plan_footsteps(grid, model, start=start, goal=goal, options=options)
    best = plan_footsteps(grid, model, start=start, goal=goal, options=PlannerOptions(refine=False))
    assert plan.status is PlanStatus.TIMED_OUT
    assert "1 expansions" in plan.reason
    bound = float(plan.reason.split("at least ")[1].split(" m")[0])
    assert 1.0 < bound <= best.cost_m + 0.005
    assert len(plan) == 0
    options = PlannerOptions(time_limit_s=1e-6, refine=False)
    plan = plan_footsteps(grid, model, start=start, goal=goal, options=options)
    assert plan.status in (PlanStatus.TIMED_OUT, PlanStatus.FOUND)


def test_a_plan_cut_short_reports_a_bound_that_holds():
    grid, start, goal = CASES["posts"]
    model = small_model(cell_m=0.05, headings=16)
    best = plan_footsteps(grid, model, start=start, goal=goal, options=PlannerOptions(refine=False))
    bounds = set()
    for limit in (40, 200, 1000, best.expansions - 1):
        options = PlannerOptions(max_expansions=limit, epsilon=5.0, refine=False)
        plan = plan_footsteps(grid, model, start=start, goal=goal, options=options)
        if plan.found:
            assert best.cost_m - 1e-6 <= plan.cost_m <= plan.epsilon * best.cost_m + 1e-6
            assert violations(plan, grid, model) == []
            bounds.add(plan.epsilon)
    assert bounds


def test_a_way_far_dearer_than_the_heuristic_thinks_is_still_searched_in_order():
    # Posts 0.8 m apart let the robot through only with its shoulders turned, which the path of the
    # body does not know: keys come to lie far above those that the search began with.
    cells = np.zeros((64, 64), np.uint8)
    for row in range(10, 60, 11):
        for col in range(10, 60, 11):
            cells[row : row + 3, col : col + 3] = Cell.OCCUPIED
    grid = OccupancyGrid(cells=cells, resolution_m=0.1)
    model = get_robot("jvrc1").step_model
    plan = Planner(grid, model, options=PlannerOptions(refine=False)).plan(
        start=(0.55, 0.55, 0.0), goal=(3.9, 3.9, 0.0)
    )
    assert plan.found
    assert len(plan) < 100
    assert plan.cost_m < 50
    assert violations(plan, grid, model) == []


def test_a_planner_kept_gives_the_plans_of_a_fresh_one():
    grid, model = walled(30, 40, ((0, 18, 20, 20),)), small_model()
    planner = Planner(grid, model, options=PlannerOptions(refine=False))
    for goal in ((3, 1, 0), (3, 1, 0), (1, 2.5, 2), (3, 1, 0)):
        kept = planner.plan(start=(1, 1, 0), goal=goal)
        fresh = plan_footsteps(
            grid, model, start=(1, 1, 0), goal=goal, options=PlannerOptions(refine=False)
        )
        np.testing.assert_array_equal(kept.pose_world, fresh.pose_world)
        assert kept.expansions == fresh.expansions


def test_the_record_of_a_search_falls_in_cost_rises_in_bound_and_ends_with_the_plan():
    grid, start, goal = CASES["wall"]
    planner = Planner(
        grid, small_model(), PlannerOptions(record=True, improve_expansions=None, refine=False)
    )
    plan = planner.plan(start=start, goal=goal)
    record = planner.record
    assert record is not None
    assert np.all(np.diff(record.time_s) >= 0)
    assert np.all(np.diff(record.cost_m) <= 0)
    assert np.all(record.lower_bound_m <= plan.cost_m + 1e-9)
    assert record.cost_m[-1] == pytest.approx(plan.cost_m, abs=1e-6)
    assert record.lower_bound_m[-1] == pytest.approx(plan.cost_m / plan.epsilon, abs=1e-5)
    x_m, y_m, states = record.expanded.T
    # States of the quick search that goes first are not in the tree that the record shows.
    assert 0 < states.sum() <= plan.expansions
    assert np.all((x_m > -0.3) & (x_m < 2.7) & (y_m > -0.3) & (y_m < 2.7))


def test_no_record_is_kept_that_nobody_asked_for():
    grid, start, goal = CASES["wall"]
    planner = Planner(grid, small_model(), options=PlannerOptions(refine=False))
    planner.plan(start=start, goal=goal)
    assert planner.record is None
