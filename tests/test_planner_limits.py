"""When a search ends without a plan or early: refusals, proofs that there is no way, limits."""

from __future__ import annotations

import math

import numpy as np
import pytest

from maps.grid import Cell, OccupancyGrid
from planner.options import PlannerOptions
from planner.plan import PlanStatus, feet_at
from planner.planner import Planner, plan_footsteps
from planner.robot_model import BodyShape, FootShape
from planner.search import ara_star, first_plan
from planner.search.shut_passages import ShutPassages
from planner.verify import violations
from tests.planner_floor import (
    FLOOR,
    LATTICE,
    blocked_at,
    first_quick,
    floods_meet,
    plan_on_lattice,
    scatter,
    walled,
)
from tests.planner_oracle import Oracle, small_model

# A body that is longer than wide fits by its width, as the 2D search sees it, where it cannot turn.
LONG = small_model(body=BodyShape(length_m=0.9, width_m=0.36))


def random_floor(seed):
    rng = np.random.default_rng(seed)
    cells = np.zeros((24, 24), np.uint8)
    scatter(rng, cells, 8, 7)
    return OccupancyGrid(cells=cells, resolution_m=0.1), rng


def bent_corridor():
    """A room, and a corridor 0.5 m wide out of it that turns a corner."""
    cells = np.full((30, 30), Cell.OCCUPIED, np.uint8)
    cells[2:16, 2:14] = Cell.FREE
    cells[6:11, 14:25] = Cell.FREE
    cells[6:28, 20:25] = Cell.FREE
    return OccupancyGrid(cells=cells, resolution_m=0.1)


BLOCKED = PlanStatus.START_BLOCKED, PlanStatus.GOAL_BLOCKED
BENT, IN_ROOM, ROUND_CORNER = bent_corridor(), (0.8, 0.8, 0.0), (2.25, 2.1, math.pi / 2)


@pytest.fixture
def impatient(monkeypatch):
    """The floods take their turn from the first state on, in small bites; passages do not help."""
    monkeypatch.setattr(first_plan, "shut_passages", lambda request: ShutPassages())
    monkeypatch.setattr(ara_star, "is_shut", lambda request: False)
    for name, value in (("FLOOD_AFTER", 1), ("SEARCH_TURN", 5), ("FLOOD_TURN", 50)):
        monkeypatch.setattr(ara_star, name, value)


@pytest.mark.slow
@pytest.mark.parametrize("seed", first_quick(range(6)))
def test_the_floods_meet_just_where_the_oracle_finds_a_way(seed):
    grid, rng = random_floor(seed)
    model = small_model(body=BodyShape(length_m=0.6, width_m=0.36))
    compared = 0
    while compared < 4:
        start, goal = rng.uniform((0.3, 0.3, -3.1), (2.1, 2.1, 3.1), (2, 3))
        planner = Planner(grid, model, LATTICE)
        if planner.plan(start=start, goal=goal).status in BLOCKED:
            continue
        oracle = Oracle(grid, model, goal)
        if not any(oracle.first_steps(start)):
            continue
        is_reachable = math.isfinite(oracle.best_cost(start))
        assert floods_meet(planner.goal_context(goal).lattice, oracle, start) == is_reachable
        compared += 1


@pytest.mark.parametrize("seed", first_quick(range(4)))
def test_no_goal_is_given_up_that_can_be_reached(seed, impatient):
    grid, rng = random_floor(seed)
    for _ in range(6):
        start, goal = rng.uniform((0.3, 0.3, -3.1), (2.1, 2.1, 3.1), (2, 3))
        plan = plan_on_lattice(grid, LONG, start=start, goal=goal)
        if plan.status in (PlanStatus.FOUND, PlanStatus.NO_PATH):
            reachable = math.isfinite(Oracle(grid, LONG, goal).best_cost(start))
            assert plan.found == reachable


@pytest.mark.parametrize(
    ("start", "goal", "side"),
    [(IN_ROOM, ROUND_CORNER, "outside to the goal"), (ROUND_CORNER, IN_ROOM, "out from the start")],
)
def test_a_corner_too_tight_to_turn_is_found_out_from_its_smaller_side(
    start, goal, side, impatient
):
    plan = plan_on_lattice(BENT, LONG, start=start, goal=goal)
    assert plan.status is PlanStatus.NO_PATH
    assert side in plan.reason
    # A short body of the same width gets round the corner.
    assert plan_on_lattice(BENT, small_model(), start=start, goal=goal).found


def test_the_floods_cost_no_expansions_once_they_know(impatient, monkeypatch):
    quick = plan_on_lattice(BENT, LONG, start=IN_ROOM, goal=ROUND_CORNER)
    monkeypatch.setattr(ara_star, "FLOOD_AFTER", 10**9)
    slow = plan_on_lattice(BENT, LONG, start=IN_ROOM, goal=ROUND_CORNER)
    assert slow.status is quick.status is PlanStatus.NO_PATH
    assert quick.expansions < slow.expansions / 2


def test_improving_stops_after_so_many_states_for_the_gap_with_a_bound_that_holds():
    grid = walled(40, 40, ((0, 18, 30, 20),))
    model = small_model(cell_m=0.05, headings=16, clearance_m=0.3, clearance_cost_m=0.3)
    start, goal = (0.8, 0.8, 0.0), (3.2, 0.8, 1.0)

    def plan(**options):
        found = plan_footsteps(
            grid,
            model,
            start=start,
            goal=goal,
            options=PlannerOptions(epsilon=5.0, refine=False, **options),
        )
        assert violations(found, grid, model) == []
        return found

    first = plan(stop_at_first=True)
    best = plan(improve_expansions=None)
    assert best.epsilon == 1.0
    spent = best.expansions - first.expansions
    assert spent > 100
    costs = []
    for limit in (0, spent // 30, spent // 10, 2 * spent):
        bounded = plan(improve_expansions=limit)
        # Ten times that while the gap is 1 or more, which the first plan's is not far from.
        times = max(1.0, min(10.0, 10 * (first.epsilon - 1)))
        assert bounded.expansions <= first.expansions + times * limit
        # What is left of the gap when it stops does not deserve more.
        if 0 < limit < spent:
            assert bounded.expansions >= 10 * (bounded.epsilon - 1) * limit
        assert best.cost_m - 1e-6 <= bounded.cost_m <= first.cost_m + 1e-6
        assert bounded.cost_m <= bounded.epsilon * best.cost_m + 1e-6
        costs.append(bounded.cost_m)
    assert costs == sorted(costs, reverse=True)
    assert costs[-1] == pytest.approx(best.cost_m)
    # Past the first plan the bound is worked out anew, from the states that are open then.
    assert first.epsilon < 5.0


def test_a_robot_on_its_feet_keeps_its_margin():
    # A wall along x = 0.8 m; the body, 0.36 m wide and long, with a margin of 6 cm.
    grid, model = blocked_at((0, 0, 30, 8)), small_model(body_margin_m=0.06)
    for x_m in (1.05, 1.08):
        feet = feet_at((x_m, 0.8, math.pi / 2), model.stance_width_m)
        plan = plan_on_lattice(grid, model, start_feet_world=feet, goal=(1.3, 2.2, math.pi / 2))
        assert plan.found
        assert violations(plan, grid, model) == []


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
    at_goal = plan_on_lattice(grid, model, start=there, goal=here)
    at_start = plan_on_lattice(grid, model, start=here, goal=there)
    for plan, status, name in (
        (at_goal, PlanStatus.GOAL_BLOCKED, "goal"),
        (at_start, PlanStatus.START_BLOCKED, "start"),
    ):
        assert plan.status is status
        assert plan.reason.startswith(f"{name}: {what} would touch an obstacle")
        near = [float(v) for v in plan.reason.rsplit(" ", 1)[1].split(",")]
        assert math.dist(near[:2], here[:2]) < 0.5
        assert plan_on_lattice(grid, model, start=there, goal=near).found


def test_unknown_ground_blocks_unless_it_is_said_to_be_free():
    cells = np.zeros((30, 40), np.uint8)
    cells[10:20, 18:22] = Cell.UNKNOWN
    grid, model = FLOOR.with_cells(cells), small_model()
    start, goal = (0.8, 0.8, 0.0), (2.0, 1.5, 0.0)
    plan = plan_on_lattice(grid, model, start=start, goal=goal)
    assert plan.status is PlanStatus.GOAL_BLOCKED
    brave = PlannerOptions(unknown_is_free=True, refine=False)
    plan = plan_footsteps(grid, model, start=start, goal=goal, options=brave)
    assert plan.found
    assert violations(plan, grid, model, unknown_is_free=True) == []
    assert violations(plan, grid, model)


@pytest.mark.parametrize(("start", "goal"), [((1, 1, 0), (4.2, 1, 0)), ((-0.1, 1, 0), (1, 1, 0))])
def test_poses_off_the_map_are_named(start, goal):
    plan = plan_on_lattice(FLOOR, small_model(), start=start, goal=goal)
    assert plan.status is PlanStatus.OFF_MAP
    assert "from 0,0 to 4,3" in plan.reason
    assert ("start -0.1,1" if start[0] < 0 else "goal 4.2,1") in plan.reason


def test_a_foot_over_the_maps_edge_is_blocked():
    plan = plan_on_lattice(FLOOR, small_model(), start=(1, 1, 0), goal=(3.98, 1, 0))
    assert plan.status is PlanStatus.GOAL_BLOCKED


def test_a_goal_in_a_closet_is_found_out_without_searching_the_lattice():
    grid = blocked_at((9, 24, 11, 37), (20, 24, 22, 37), (9, 24, 22, 26), (9, 35, 22, 37))
    plan = plan_on_lattice(grid, small_model(), start=(1, 1, 0), goal=(3.1, 1.55, 0))
    assert plan.status is PlanStatus.NO_PATH
    assert plan.expansions == 0
    assert "no way for a body" in plan.reason


@pytest.mark.parametrize("name", ["ara", "rrtconnect"])
def test_a_robot_too_near_to_a_wall_may_leave_but_not_come(name):
    # 4 cm between body and wall, less than the margin of 6 cm.
    grid, model = blocked_at((0, 0, 30, 8)), small_model(body_margin_m=0.06)
    near, far = (1.02, 1.5, 0.0), (2.0, 1.5, 0.0)
    planner = Planner(grid, model, PlannerOptions(name=name, refine=False))
    assert planner.plan(start=far, goal=near).status is PlanStatus.GOAL_BLOCKED
    assert planner.plan(start=near, goal=far).status is PlanStatus.START_BLOCKED
    plan = planner.plan(start_feet_world=feet_at(near, model.stance_width_m), goal=far)
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
        ({"improve_expansions": -1}, "improve_expansions -1"),
        ({"time_limit_s": 0.0}, "time_limit_s 0.0"),
        ({"goal_reach_m": -0.1}, "goal_reach_m -0.1"),
        ({"goal_reach_m": math.nan}, "goal_reach_m nan"),
        ({"goal_reach_rad": math.inf}, "goal_reach_rad inf"),
        ({"heuristic": "guess"}, "heuristic 'guess' must be one of full, path, steps, euclidean"),
        ({"heuristic": "path", "name": "adstar"}, "for the planners ara, astar, rstar"),
    ],
)
def test_options_that_make_no_sense_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        PlannerOptions(**change)
