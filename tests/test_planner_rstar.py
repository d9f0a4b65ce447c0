"""R*: plans by way of random sub-goals, and the full search where these lead nowhere."""

from __future__ import annotations

import numpy as np
import pytest

from planner.options import PlannerOptions
from planner.plan import PlanStatus
from planner.planner import plan_footsteps
from planner.robot_model import StepModel
from planner.verify import violations
from tests.planner_floor import CASES, repeatable, walled
from tests.planner_oracle import Oracle, small_model


def rstar(**changes):
    return PlannerOptions(name="rstar", refine=False, **changes)


@pytest.mark.parametrize("first", [True, False])
@pytest.mark.parametrize("name", CASES)
def test_plans_are_right_and_their_bound_holds(name, first):
    grid, start, goal = CASES[name]
    model = small_model()
    best_m = Oracle(grid, model, goal).best_cost(start)
    plan = plan_footsteps(grid, model, start=start, goal=goal, options=rstar(stop_at_first=first))
    assert plan.found
    assert violations(plan, grid, model) == []
    assert best_m - 1e-5 <= plan.cost_m <= plan.epsilon * best_m + 1e-5
    if not first:
        assert plan.epsilon == 1.0
        assert plan.cost_m == pytest.approx(best_m, abs=1e-5)


def hall() -> tuple:
    """A hall of 12 m by 8 m with posts and a wall across it that has one door."""
    boxes = [(0, 60, 50, 62), (62, 60, 80, 62)]
    boxes += [(row, col, row + 2, col + 2) for row in range(8, 80, 16) for col in (20, 40, 80, 100)]
    return walled(80, 120, tuple(boxes)), (1.0, 1.0, 0.5), (11.0, 1.2, -2.0)


def test_sub_goals_lead_through_a_hall_and_the_seed_decides_which():
    grid, start, goal = hall()
    model = small_model()
    texts = {}
    for seed in (0, 1, 2):
        options = rstar(stop_at_first=True, seed=seed)
        plan = plan_footsteps(grid, model, start=start, goal=goal, options=options)
        assert plan.found
        assert 1.0 < plan.epsilon < 4.0
        assert violations(plan, grid, model) == []
        again = plan_footsteps(grid, model, start=start, goal=goal, options=options)
        assert repeatable(again) == repeatable(plan)
        texts[seed] = repeatable(plan)
    assert len(set(texts.values())) > 1


@pytest.mark.parametrize("seed", range(12))
def test_there_is_a_plan_wherever_the_full_search_finds_one(seed):
    rng = np.random.default_rng(seed)
    corners = rng.integers(0, 28, (9, 2))
    sizes = rng.integers(1, 8, (9, 2))
    boxes = np.hstack([corners, corners + sizes])
    grid, model = walled(32, 32, tuple(map(tuple, boxes))), small_model()
    start, goal = rng.uniform((0.3, 0.3, -3), (2.9, 2.9, 3), (2, 3))
    best = plan_footsteps(
        grid, model, start=start, goal=goal, options=PlannerOptions(name="astar", refine=False)
    )
    plan = plan_footsteps(
        grid, model, start=start, goal=goal, options=rstar(stop_at_first=True, seed=seed)
    )
    assert plan.status is best.status
    if plan.found:
        assert violations(plan, grid, model) == []
        assert best.cost_m - 1e-6 <= plan.cost_m <= plan.epsilon * best.cost_m + 1e-6


def test_what_is_shut_in_has_no_plan():
    model: StepModel = small_model()
    grid = walled(24, 24, ((0, 12, 24, 13),))
    plan = plan_footsteps(grid, model, start=(0.6, 1.2, 0.0), goal=(1.8, 1.2, 0.0), options=rstar())
    assert plan.status is PlanStatus.NO_PATH


def test_a_region_may_be_the_goal():
    grid, start, goal = CASES["wall"]
    reach = (0.25, 0.8)
    options = rstar(goal_reach_m=reach[0], goal_reach_rad=reach[1], stop_at_first=True)
    plan = plan_footsteps(grid, small_model(), start=start, goal=goal, options=options)
    assert violations(plan, grid, small_model(), goal_reach=reach) == []
    full = PlannerOptions(
        goal_reach_m=reach[0], goal_reach_rad=reach[1], improve_expansions=None, refine=False
    )
    best = plan_footsteps(grid, small_model(), start=start, goal=goal, options=full)
    assert best.cost_m - 1e-6 <= plan.cost_m <= plan.epsilon * best.cost_m + 1e-6
