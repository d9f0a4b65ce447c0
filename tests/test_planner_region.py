"""Goals that are regions: the cheapest end among all poses that are near enough."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from planner.options import PlannerOptions
from planner.plan import PlanStatus, feet_at, pair_pose
from planner.planner import Planner, plan_footsteps
from planner.verify import violations
from tests.planner_floor import CASES, estimated_m, oracle_of, plan_on_lattice, walled
from tests.planner_oracle import Oracle, oracle_node, small_model

# Two or three cells of 0.1 m around the goal, and a heading of an eighth turn to either side.
REACH = (0.25, 0.8)


def within(reach, *, refine=False, **changes):
    reach_m, reach_rad = reach
    return PlannerOptions(
        goal_reach_m=reach_m,
        goal_reach_rad=reach_rad,
        improve_expansions=None,
        refine=refine,
        **changes,
    )


def final_pose(oracle, node):
    """Pair pose x, y, yaw of both feet side by side, one of them at a node."""
    x, y, yaw = oracle.pose(node)
    inward = (node[3] - 0.5) * oracle.model.stance_width_m
    return x - inward * math.sin(yaw), y + inward * math.cos(yaw), yaw


def is_end(oracle, node, reach):
    """Whether a plan may end with the foot of a node and the other one beside it."""
    x, y, yaw = final_pose(oracle, node)
    off_rad = abs(math.remainder(yaw - oracle.goal[2], 2 * math.pi))
    if math.dist((x, y), oracle.goal[:2]) > reach[0] + 1e-9 or off_rad > reach[1] + 1e-9:
        return False
    other = feet_at((x, y, yaw), oracle.model.stance_width_m)[1 - node[3]]
    foot = oracle.model.foot
    free = oracle.box_is_free(other[0], other[1], yaw, foot.length_m, foot.width_m, 0.0)
    return free and oracle.node_is_free(node)


def cheapest(oracle, start, reach):
    """Least cost over all poses of the region, by Dijkstra's search of everything."""
    model = oracle.model
    last_m = model.stance_width_m + model.step_cost_m
    costs = oracle.costs_from(oracle.first_steps(start))
    return min(cost + last_m for node, cost in costs.items() if is_end(oracle, node, reach))


@pytest.mark.parametrize("name", CASES)
def test_the_cheapest_end_is_found_by_every_search(name):
    grid, start, goal = CASES[name]
    model = small_model()
    least_m = cheapest(oracle_of(name), start, REACH)
    exact = plan_on_lattice(grid, model, start=start, goal=goal)
    assert least_m < exact.cost_m - 0.05
    for planner in ("ara", "astar", "backward", "adstar", "rstar"):
        options = within(REACH, name=planner)
        plan = plan_footsteps(grid, model, start=start, goal=goal, options=options)
        assert plan.cost_m == pytest.approx(least_m, abs=1e-5)
        assert plan.epsilon == 1.0
        assert plan.goal == goal
        assert violations(plan, grid, model, goal_reach=REACH) == []


@pytest.mark.parametrize("reach", [(0.15, 0.0), (0.0, 0.8), (0.6, 3.2)])
def test_a_reach_in_metres_and_one_in_radians_each_hold(reach):
    grid, start, goal = CASES["posts"]
    model = small_model()
    plan = plan_footsteps(grid, model, start=start, goal=goal, options=within(reach))
    assert plan.cost_m == pytest.approx(cheapest(oracle_of("posts"), start, reach), abs=1e-5)
    assert violations(plan, grid, model, goal_reach=reach) == []


def test_the_check_of_the_end_sees_feet_that_are_too_far_or_turned_too_far():
    grid, start, goal = CASES["empty"]
    model = small_model()
    plan = plan_footsteps(grid, model, start=start, goal=goal, options=within(REACH))
    off = pair_pose(plan.pose_world[-2:]) - goal
    far_m, far_rad = math.hypot(*off[:2]), abs(math.remainder(off[2], 2 * math.pi))
    assert 0.05 < far_m <= REACH[0]
    assert violations(plan, grid, model)
    assert violations(plan, grid, model, goal_reach=(far_m - 0.01, REACH[1]))
    assert violations(plan, grid, model, goal_reach=(REACH[0], far_rad - 0.01))
    assert not violations(plan, grid, model, goal_reach=(far_m, far_rad))


@pytest.mark.parametrize("name", CASES)
def test_the_heuristic_toward_a_region_is_admissible_and_consistent(name):
    grid, start, goal = CASES[name]
    model = small_model()
    context = Planner(grid, model, within(REACH)).goal_context(goal)
    lattice, heuristic, oracle = context.lattice, context.heuristic, oracle_of(name)
    ends = {oracle_node(lattice, int(node)) for node in context.ends}
    known = oracle.costs_from(oracle.first_steps(start))
    at_most_m = {node: estimated_m(lattice, heuristic, node) for node in known}
    assert {node for node in known if is_end(oracle, node, REACH)} <= ends
    last_m = model.stance_width_m + model.step_cost_m
    met = 0
    for node in known:
        if node in ends:
            assert at_most_m[node] <= last_m + 1e-5
            met += 1
        for cost, to in oracle.edges(node):
            assert at_most_m[node] <= cost + at_most_m[to] + 1e-5
    assert met > 10


def test_a_goal_that_is_blocked_gives_way_to_the_nearest_that_is_not():
    model, start = small_model(), (0.55, 0.6, 0.3)
    # The goal itself is in a wall of one cell, with room on this side of it.
    grid, goal = walled(boxes=((0, 17, 24, 18),)), (1.65, 1.2, 0.0)
    asked: dict[str, Any] = {"start": start, "goal": goal}
    assert plan_footsteps(grid, model, **asked).status is PlanStatus.GOAL_BLOCKED
    reach = (0.45, 0.0)
    least_m = cheapest(Oracle(grid, model, goal), start, reach)
    for planner in ("ara", "adstar"):
        plan = plan_footsteps(grid, model, options=within(reach, name=planner), **asked)
        assert plan.found
        assert violations(plan, grid, model, goal_reach=reach) == []
        assert plan.cost_m == pytest.approx(least_m, abs=1e-5)
    near = plan_footsteps(grid, model, options=within((0.15, 0.0)), **asked)
    assert near.status is PlanStatus.GOAL_BLOCKED


def test_whoever_stands_in_the_region_need_not_move():
    grid, start, _ = CASES["empty"]
    goal = (start[0] + 0.1, start[1], start[2])
    model = small_model()
    assert len(plan_footsteps(grid, model, start=start, goal=goal, options=within(REACH))) == 0
    options = replace(within(REACH), goal_reach_m=0.05)
    assert len(plan_footsteps(grid, model, start=start, goal=goal, options=options)) > 0


@pytest.mark.slow
def test_replanning_keeps_to_the_region():
    grid, start, goal = CASES["wall"]
    model, rng = small_model(), np.random.default_rng(2)
    planner = Planner(grid, model, within(REACH, name="adstar"))
    plan = planner.plan(start=start, goal=goal)
    feet, count = np.array(plan.start_feet_world), 0
    while len(plan) > 2:
        side = int(plan.side[0])
        feet[side] = plan.pose_world[0] + rng.uniform(-1, 1, 4) * (0.03, 0.03, 0.0, 0.05)
        asked: dict[str, Any] = {"start_feet_world": feet, "goal": goal}
        plan = planner.plan(**asked)
        fresh = plan_footsteps(grid, model, options=within(REACH, name="astar"), **asked)
        assert plan.cost_m == pytest.approx(fresh.cost_m, abs=2e-6)
        assert violations(plan, grid, model, stood_freely=False, goal_reach=REACH) == []
        count += 1
    assert count > 4
