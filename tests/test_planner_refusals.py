"""What the planner answers where it cannot or may not plan."""

from __future__ import annotations

import math

import numpy as np
import pytest

from maps.grid import Cell
from planner.options import PlannerOptions
from planner.plan import PlanStatus, feet_at
from planner.planner import plan_footsteps
from planner.robot_model import FootShape
from planner.verify import violations
from tests.planner_floor import FLOOR, blocked_at
from tests.planner_oracle import small_model


@pytest.mark.parametrize(
    ("box", "what"),
    [
        # The pose is 2, 1.5 facing +x: the left foot is at 2, 1.6 and the right one at 2, 1.4.
        ((16, 20, 17, 21), "the left foot at 2.00,1.60"),
        ((13, 20, 14, 21), "the right foot at 2.00,1.40"),
        ((16, 21, 17, 22), "the body at 2.00,1.50"),
    ],
)
def test_a_blocked_goal_or_start_names_foot_or_body_and_a_free_pose(box, what):
    grid, model = blocked_at(box), small_model(foot=FootShape(length_m=0.18, width_m=0.1))
    here, there = (2.0, 1.5, 0.0), (0.8, 0.8, 0.0)
    at_goal = plan_footsteps(
        grid, model, start=there, goal=here, options=PlannerOptions(refine=False)
    )
    at_start = plan_footsteps(
        grid, model, start=here, goal=there, options=PlannerOptions(refine=False)
    )
    for plan, status, name in (
        (at_goal, PlanStatus.GOAL_BLOCKED, "goal"),
        (at_start, PlanStatus.START_BLOCKED, "start"),
    ):
        assert plan.status is status
        assert plan.reason.startswith(f"{name}: {what} would touch an obstacle")
        near = [float(v) for v in plan.reason.rsplit(" ", 1)[1].split(",")]
        assert math.dist(near[:2], here[:2]) < 0.5
        assert plan_footsteps(
            grid, model, start=there, goal=near, options=PlannerOptions(refine=False)
        ).found


def test_unknown_ground_blocks_unless_it_is_said_to_be_free():
    cells = np.zeros((30, 40), np.uint8)
    cells[10:20, 18:22] = Cell.UNKNOWN
    grid, model = FLOOR.with_cells(cells), small_model()
    start, goal = (0.8, 0.8, 0.0), (2.0, 1.5, 0.0)
    plan = plan_footsteps(grid, model, start=start, goal=goal, options=PlannerOptions(refine=False))
    assert plan.status is PlanStatus.GOAL_BLOCKED
    brave = PlannerOptions(unknown_is_free=True, refine=False)
    plan = plan_footsteps(grid, model, start=start, goal=goal, options=brave)
    assert plan.found
    assert violations(plan, grid, model, unknown_is_free=True) == []
    assert violations(plan, grid, model)


@pytest.mark.parametrize(("start", "goal"), [((1, 1, 0), (4.2, 1, 0)), ((-0.1, 1, 0), (1, 1, 0))])
def test_poses_off_the_map_are_named(start, goal):
    plan = plan_footsteps(
        FLOOR, small_model(), start=start, goal=goal, options=PlannerOptions(refine=False)
    )
    assert plan.status is PlanStatus.OFF_MAP
    assert "from 0,0 to 4,3" in plan.reason
    assert ("start -0.1,1" if start[0] < 0 else "goal 4.2,1") in plan.reason


def test_a_foot_over_the_maps_edge_is_blocked():
    plan = plan_footsteps(
        FLOOR,
        small_model(),
        start=(1, 1, 0),
        goal=(3.98, 1, 0),
        options=PlannerOptions(refine=False),
    )
    assert plan.status is PlanStatus.GOAL_BLOCKED


def test_a_goal_in_a_closet_is_found_out_without_searching_the_lattice():
    grid = blocked_at((9, 24, 11, 37), (20, 24, 22, 37), (9, 24, 22, 26), (9, 35, 22, 37))
    plan = plan_footsteps(
        grid,
        small_model(),
        start=(1, 1, 0),
        goal=(3.1, 1.55, 0),
        options=PlannerOptions(refine=False),
    )
    assert plan.status is PlanStatus.NO_PATH
    assert plan.expansions == 0
    assert "enclose" in plan.reason


def test_a_robot_too_near_to_a_wall_may_leave_but_not_come():
    # 4 cm between body and wall, less than the margin of 6 cm.
    grid, model = blocked_at((0, 0, 30, 8)), small_model(body_margin_m=0.06)
    near, far = (1.02, 1.5, 0.0), (2.0, 1.5, 0.0)
    assert (
        plan_footsteps(
            grid, model, start=far, goal=near, options=PlannerOptions(refine=False)
        ).status
        is PlanStatus.GOAL_BLOCKED
    )
    assert (
        plan_footsteps(
            grid, model, start=near, goal=far, options=PlannerOptions(refine=False)
        ).status
        is PlanStatus.START_BLOCKED
    )
    feet = feet_at(near, model.stance_width_m)
    plan = plan_footsteps(
        grid, model, start_feet_world=feet, goal=far, options=PlannerOptions(refine=False)
    )
    assert plan.found
    assert violations(plan, grid, model, stood_freely=False) == []


@pytest.mark.parametrize(
    ("query", "message"),
    [
        ({"goal": (1, 1, 0)}, "either start or start_feet_world"),
        ({"goal": (1, math.nan, 0), "start": (1, 1, 0)}, "goal"),
        ({"goal": (1, 1), "start": (1, 1, 0)}, "goal"),
        ({"goal": (1, 1, 0), "start": (math.inf, 1, 0)}, "start"),
        ({"goal": (1, 1, 0), "start_feet_world": np.zeros((2, 3))}, "start_feet_world"),
    ],
)
def test_numbers_that_are_no_pose_are_refused(query, message):
    with pytest.raises(ValueError, match=message):
        plan_footsteps(FLOOR, small_model(), **query)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": "magic"}, "planner 'magic' must be one of ara"),
        ({"epsilon": 0.5}, "epsilon 0.5"),
        ({"epsilon": math.inf}, "epsilon inf"),
        ({"final_epsilon": 0.5}, "at least 1"),
        ({"max_expansions": 0}, "max_expansions 0"),
        ({"time_limit_s": 0.0}, "time_limit_s 0.0"),
        ({"heuristic": "guess"}, "heuristic 'guess' must be one of full, path, steps, euclidean"),
        ({"heuristic": "path", "name": "adstar"}, "for the planners ara, astar, rstar"),
    ],
)
def test_options_that_make_no_sense_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        PlannerOptions(**change)
