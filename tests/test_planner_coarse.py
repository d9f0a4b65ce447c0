"""Plans of a lattice of fine cells that come from one of coarse cells."""

from dataclasses import replace

import numpy as np

from planner.options import PlannerOptions
from planner.planner import Planner
from planner.search.ara_star import coarse_model, nodes_on_fine
from planner.verify import violations
from sim.robots import get_robot
from tests.planner_floor import blocked_at

MODEL = get_robot("jvrc1").step_model
FINE = replace(MODEL, cell_m=0.025)
GRID = blocked_at((10, 16, 22, 24))
START, GOAL = (0.8, 2.0, 0.0), (3.2, 2.1, 0.6)


def test_only_fine_cells_have_a_coarse_lattice_and_its_cells_hold_whole_numbers_of_theirs():
    assert coarse_model(MODEL) is None
    for cell_m, times in ((0.01, 5), (0.02, 2), (0.025, 2), (0.005, 10)):
        coarse = coarse_model(replace(MODEL, cell_m=cell_m))
        assert coarse is not None
        assert coarse.cell_m == times * cell_m


def test_a_node_of_the_coarse_lattice_is_the_same_foot_on_the_fine_one():
    planner = Planner(GRID, FINE, PlannerOptions(refine=False))
    fine = planner.goal_context(GOAL)
    assert fine.coarse is not None
    coarse = fine.coarse.lattice
    rows = 2 * coarse.headings
    nodes = np.arange(coarse.nodes)
    inside = np.abs(nodes // rows % coarse.cols - coarse.origin_col) < 10
    inside &= np.abs(nodes // rows // coarse.cols - coarse.origin_row) < 10
    nodes = np.random.default_rng(0).choice(nodes[inside], 200)
    for node, moved in zip(nodes, nodes_on_fine(coarse, fine.lattice, nodes), strict=True):
        poses = []
        for lattice, number in ((coarse, node), (fine.lattice, moved)):
            row, cell = number % (2 * lattice.headings), number // (2 * lattice.headings)
            x_m = (cell % lattice.cols - lattice.origin_col) * lattice.cell_m
            y_m = (cell // lattice.cols - lattice.origin_row) * lattice.cell_m
            poses.append((row, round(x_m, 9), round(y_m, 9)))
        assert poses[0] == poses[1]


def test_a_plan_from_the_coarse_lattice_is_right_and_its_bound_holds_on_the_fine_one():
    first = Planner(GRID, FINE, PlannerOptions(stop_at_first=True, refine=False)).plan(
        start=START, goal=GOAL
    )
    best = Planner(GRID, FINE, PlannerOptions(improve_expansions=None, refine=False)).plan(
        start=START, goal=GOAL
    )
    exact = Planner(GRID, FINE, PlannerOptions(name="astar", refine=False)).plan(
        start=START, goal=GOAL
    )
    for plan in (first, best, exact):
        assert plan.found
        assert not violations(plan, GRID, FINE)
    assert best.epsilon == exact.epsilon == 1.0
    assert best.cost_m <= exact.cost_m + 1e-9
    assert first.cost_m <= first.epsilon * exact.cost_m + 1e-9


def test_the_coarse_lattice_follows_a_change_of_the_map():
    planner = Planner(GRID, FINE, PlannerOptions(stop_at_first=True, refine=False))
    assert planner.plan(start=START, goal=GOAL).found
    changed = blocked_at((10, 16, 22, 24), (17, 23, 17, 30))
    planner.take_map(changed)
    plan = planner.plan(start=START, goal=GOAL)
    assert not plan.found or not violations(plan, changed, FINE)
    anew = Planner(changed, FINE, planner.options).plan(start=START, goal=GOAL)
    assert np.array_equal(plan.pose_world, anew.pose_world)
