"""The estimates by which a first plan is found soon, and how soon that is."""

import numpy as np

from maps.grid import OccupancyGrid
from planner.heuristics.heuristic import tables_of
from planner.heuristics.turning import SECTORS
from planner.options import PlannerOptions
from planner.plan import PlanStatus
from planner.planner import Planner
from planner.verify import violations
from sim.robots import get_robot
from tests.planner_floor import blocked_at, walled

MODEL = get_robot("jvrc1").step_model
HALL = OccupancyGrid(cells=np.zeros((90, 90), np.uint8), resolution_m=0.1)


def test_to_go_off_the_way_one_faces_costs_least_and_more_the_farther_one_must_turn():
    depart_um = tables_of(MODEL).facing.depart_um.reshape(MODEL.headings, 2, SECTORS).min(axis=1)
    for heading in range(0, MODEL.headings, 4):
        ahead = heading * SECTORS // MODEL.headings
        # The heading lies on the border of two sectors.
        turned = np.roll(depart_um[heading], -ahead)
        assert min(turned[0], turned[-1]) == turned.min()
        assert turned[0] < turned[2] < turned[4] <= turned[7] * 1.001


def test_to_arrive_facing_the_goal_pose_costs_nothing_and_from_before_it_a_turn():
    arrive_um = tables_of(MODEL).facing.arrive_um
    middle = len(arrive_um) // 2
    behind, before = arrive_um[middle, middle - 80], arrive_um[middle, middle + 80]
    assert 0 <= behind < 150_000  # what is left of a step
    assert before > 300_000


def test_a_first_plan_on_an_empty_floor_takes_few_expansions():
    rng = np.random.default_rng(5)
    options = PlannerOptions(epsilon=2.0, stop_at_first=True, refine=False)
    expansions = []
    for _ in range(12):
        start, goal = rng.uniform((1, 1, -np.pi), (8, 8, np.pi), (2, 3))
        plan = Planner(HALL, MODEL, options).plan(start=start, goal=goal)
        assert plan.found
        assert not violations(plan, HALL, MODEL)
        expansions.append(plan.expansions)
    assert np.median(expansions) < 200


def test_where_no_path_of_the_body_leads_the_first_search_takes_no_expansions():
    grid = blocked_at((0, 19, 30, 21))
    plan = Planner(grid, MODEL, options=PlannerOptions(refine=False)).plan(
        start=(0.8, 1.5, 0.0), goal=(3.2, 1.5, 0.0)
    )
    assert plan.status is PlanStatus.NO_PATH
    assert plan.expansions == 0


def test_a_gap_that_the_path_fits_through_and_the_body_does_not_is_left_aside_at_once():
    # The gap of 20 cm is open to the path of the bound; the way round is a metre and a half longer.
    grid = walled(80, 80, ((38, 0, 42, 39), (38, 41, 42, 70)))
    options = PlannerOptions(stop_at_first=True, refine=False)
    plan = Planner(grid, MODEL, options).plan(start=(4.0, 2.0, 1.57), goal=(4.0, 6.0, 1.57))
    assert plan.found
    assert not violations(plan, grid, MODEL)
    assert plan.expansions < 400
    assert plan.pose_world[:, 0].max() > 6.8
