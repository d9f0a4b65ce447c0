"""Plans by way of a path of the body from OMPL."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from maps.grid import Cell
from maps.map_files import load_map
from planner.lattice.steps import step_cost_um
from planner.options import SAMPLING_PLANNERS, PlannerOptions
from planner.plan import PlanStatus, relative_step
from planner.planner import Planner, plan_footsteps
from planner.robot_model import Side
from planner.verify import violations
from sim.robots import get_robot
from tests.planner_floor import fine_model, repeatable, walled
from tests.planner_oracle import Oracle, small_model

STAIRS = Path(__file__).resolve().parent.parent / "maps" / "stairs.yaml"


# A wall with a way around its upper end, on a map that is turned and shifted, so that no frame
# passes for another.
GRID = walled(boxes=((0, 11, 15, 12),), origin=(-1.0, 2.0, 0.6))
START, GOAL = (-0.885, 2.806, 0.9), (0.09, 3.594, 2.0)


@pytest.fixture(scope="module")
def best_m():
    """Least cost of any plan on the lattice from start to goal."""
    return Oracle(GRID, small_model(), GOAL).best_cost(START)


@pytest.mark.parametrize("name", SAMPLING_PLANNERS)
def test_each_finds_a_plan_round_a_wall_that_is_right_and_repeats(name, best_m):
    model = small_model()
    plans = {}
    for first in (True, False):
        options = PlannerOptions(name=name, stop_at_first=first, refine=False)
        plan = plan_footsteps(GRID, model, start=START, goal=GOAL, options=options)
        assert plan.found
        assert (plan.planner, plan.epsilon) == (name, math.inf)
        assert 0 < plan.time_to_first_s <= plan.time_s
        assert violations(plan, GRID, model) == []
        # Not bound to the lattice, so it may even cost less than the best plan there.
        assert 0.6 * best_m < plan.cost_m < 3 * best_m
        again = plan_footsteps(GRID, model, start=START, goal=GOAL, options=options)
        assert repeatable(again) == repeatable(plan)
        plans[first] = plan
    assert plans[False].cost_m <= plans[True].cost_m


def test_another_seed_gives_another_plan():
    model = small_model()
    plans = {
        repeatable(
            plan_footsteps(
                GRID,
                model,
                start=START,
                goal=GOAL,
                options=PlannerOptions(
                    name="rrtconnect", stop_at_first=True, seed=seed, refine=False
                ),
            )
        )
        for seed in range(3)
    }
    assert len(plans) > 1


def test_the_cost_is_that_of_the_steps():
    model = small_model()
    options = PlannerOptions(name="rrtconnect", stop_at_first=True, refine=False)
    plan = plan_footsteps(GRID, model, start=START, goal=GOAL, options=options)
    support = plan.start_feet_world[1 - plan.side[0]]
    total_m = 0.0
    for side, pose in zip(plan.side, plan.pose_world, strict=True):
        step = relative_step(support, pose, Side(int(side)))
        total_m += int(step_cost_um(step, model)) / 1e6
        support = pose
    assert plan.cost_m == pytest.approx(total_m, abs=1e-4)


@pytest.mark.parametrize("seed", range(6))
def test_plans_among_random_obstacles_are_right(seed):
    rng = np.random.default_rng(seed)
    grid = walled(60, 60, resolution_m=0.05)
    cells = np.array(grid.cells)
    for row, col in rng.integers(0, 60, (5, 2)):
        height, width = rng.integers(1, 9, 2)
        cells[row : row + height, col : col + width] = Cell.OCCUPIED
    cells[:, 50:] = Cell.UNKNOWN
    grid = grid.with_cells(cells)
    model = fine_model()
    name = SAMPLING_PLANNERS[seed]
    found = 0
    for unknown_is_free in (False, True):
        options = PlannerOptions(
            name=name, seed=seed, unknown_is_free=unknown_is_free, refine=False
        )
        for start, goal in rng.uniform((0.2, 0.2, -3.1), (2.8, 2.8, 3.1), (5, 2, 3)):
            plan = plan_footsteps(grid, model, start=start, goal=goal, options=options)
            assert plan.found or plan.reason
            if plan.found:
                found += 1
                assert violations(plan, grid, model, unknown_is_free=unknown_is_free) == []
    assert found


def test_planning_goes_on_from_feet_anywhere():
    model = small_model()
    planner = Planner(GRID, model, PlannerOptions(name="rrtconnect", refine=False))
    plan = planner.plan(start=START, goal=GOAL)
    feet = np.array(plan.start_feet_world)
    rng = np.random.default_rng(5)
    steps = list(zip(plan.side, plan.pose_world, strict=True))[:-2]
    assert len(steps) > 5
    for side, pose in steps:
        # The robot steps, and misses by a little.
        feet[side] = pose + rng.uniform(-1, 1, 4) * (0.03, 0.03, 0.0, 0.05)
        rest = planner.plan(start_feet_world=feet, goal=GOAL, first_side=Side(int(side)).other)
        assert rest.found
        assert rest.side[0] != side
        assert violations(rest, GRID, model, stood_freely=False) == []


def test_a_robot_that_stands_too_near_to_a_wall_gets_away():
    grid = walled(boxes=((0, 8, 24, 9),))
    model = small_model(body_margin_m=0.1)
    # The body's side is 2 cm from the wall, where the margin wants 10.
    feet = np.array([[1.1, 1.3, 0.0, 0.0], [1.1, 1.1, 0.0, 0.0]])
    options = PlannerOptions(name="rrtconnect", refine=False)
    plan = plan_footsteps(grid, model, start_feet_world=feet, goal=(1.8, 1.2, 0.5), options=options)
    assert plan.found
    assert violations(plan, grid, model, stood_freely=False) == []


@pytest.mark.parametrize("name", SAMPLING_PLANNERS)
def test_a_wall_all_across_is_proven_to_leave_no_way(name):
    grid = walled(boxes=((0, 11, 24, 12),))
    plan = plan_footsteps(
        grid,
        small_model(),
        start=(0.6, 1.2, 0.0),
        goal=(1.8, 1.2, 0.0),
        options=PlannerOptions(name=name, refine=False),
    )
    assert plan.status is PlanStatus.NO_PATH
    assert "enclose" in plan.reason


@pytest.mark.parametrize("name", SAMPLING_PLANNERS)
def test_a_planner_that_gives_up_says_so_and_claims_no_more(name):
    # One iteration finds no way around this wall, though there is one.
    options = PlannerOptions(name=name, max_expansions=1, refine=False)
    plan = plan_footsteps(GRID, small_model(), start=START, goal=GOAL, options=options)
    assert plan.status is PlanStatus.TIMED_OUT
    assert f"{name} found no path of the body within" in plan.reason
    assert (len(plan), plan.epsilon) == (0, math.inf)


def test_stairs_are_climbed():
    grid, model = load_map(STAIRS), get_robot("jvrc1").step_model
    options = PlannerOptions(name="rrtconnect", stop_at_first=True, refine=False)
    plan = plan_footsteps(grid, model, start=(0.0, 0.0, 0.0), goal=(8.0, 0.0, 0.0), options=options)
    assert plan.found, plan.reason
    assert plan.pose_world[:, 2].max() == pytest.approx(0.6)
    assert violations(plan, grid, model) == []


def test_a_search_by_ara_does_not_load_ompl():
    code = (
        "import sys, app.commands.plan, planner.planner, planner.planner as b; b.backend('ara');"
        "assert 'ompl' not in sys.modules;"
        "b.backend('fmt'); assert 'ompl' in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=300)
