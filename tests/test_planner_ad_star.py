"""Plans from a kept tree: as good as fresh ones after any steps and any changes of the map."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from maps.grid import Cell
from planner.collision import terrain_of
from planner.compiled import slots_of
from planner.heuristics.heuristic import tables_of
from planner.lattice import goal_region
from planner.lattice.lattice import COST_UM, D_NODE, build_lattice, node_free
from planner.lattice.map_change import change_between
from planner.options import PlannerOptions
from planner.plan import PlanStatus, pair_pose
from planner.planner import Planner, plan_footsteps
from planner.robot_model import Side
from planner.search import ad_star_tree
from planner.search.best_first import ROOT
from planner.search.problem import new_tree
from planner.verify import violations
from tests.compiled import from_python
from tests.planner_floor import CASES, first_quick, walled
from tests.planner_oracle import Oracle, small_model

may_end_at = from_python(goal_region.may_end_at)
edge_cost_um = from_python(ad_star_tree.edge_cost_um)

KEPT = PlannerOptions(name="adstar", refine=False)
PROVEN = replace(KEPT, improve_expansions=None)
MODELS = {
    "plain": small_model(),
    "shy": small_model(clearance_m=0.3, clearance_cost_m=0.2, body_margin_m=0.02),
}
# Floors with walls, and start and goal there: a small one, and one on which there is far to go.
FLOORS = {
    "small": (walled(boxes=((0, 11, 12, 12), (17, 5, 18, 9))), (0.55, 0.6, 0.3), (1.8, 1.7, 0.4)),
    "large": (
        walled(56, 60, boxes=((0, 24, 36, 26), (28, 40, 56, 42), (12, 8, 14, 20))),
        (0.55, 0.6, 0.3),
        (5.2, 4.7, 0.4),
    ),
}


def optimum(grid, model, **query):
    """A plan of a fresh search that is proven to be the cheapest."""
    return plan_footsteps(grid, model, options=PlannerOptions(name="astar", refine=False), **query)


def assert_right(plan, best, grid, model):
    """The plan holds on the map, and costs no more than it says."""
    assert plan.found == best.found, (plan.reason, best.reason)
    if plan.found:
        assert violations(plan, grid, model, stood_freely=False) == []
        assert best.cost_m - 2e-6 <= plan.cost_m <= plan.epsilon * best.cost_m + 2e-6


def after_a_step(plan, rng):
    """Feet and next side when the robot has made the plan's first step, off by a little."""
    feet, side = np.array(plan.start_feet_world), Side(int(plan.side[0]))
    feet[side] = plan.pose_world[0] + rng.uniform(-1, 1, 4) * (0.03, 0.03, 0.0, 0.05)
    return feet, side.other


def changed(grid, rng, at, frees):
    """The map with a block put somewhere near a pose or all blocks of a part taken away."""
    cells = np.array(grid.cells)
    if not frees:
        row, col = (np.array(at[1::-1]) / grid.resolution_m + rng.integers(-9, 9, 2)).astype(int)
        row, col = max(row, 0), max(col, 0)
        cells[row : row + rng.integers(1, 4), col : col + rng.integers(1, 4)] = Cell.OCCUPIED
    else:
        row, col = rng.integers(0, 12, 2)
        cells[row : row + 12, col : col + 12] = Cell.FREE
    return grid.with_cells(cells)


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
@pytest.mark.parametrize("options", [KEPT, PROVEN], ids=["kept", "proven"])
@pytest.mark.parametrize(
    ("floor", "seed"),
    [
        ("small", 0),
        ("small", 1),
        pytest.param("small", 2, marks=pytest.mark.slow),
        pytest.param("large", 3, marks=pytest.mark.slow),
    ],
)
def test_after_any_steps_and_changes_the_plan_is_right_and_the_bound_true(
    floor, seed, options, model
):
    rng = np.random.default_rng(seed)
    grid, start, goal = FLOORS[floor]
    planner = Planner(grid, model, options)
    plan = planner.plan(start=start, goal=goal)
    assert plan.found
    feet, side, found = np.array(plan.start_feet_world), None, 0
    for _ in range(12):
        if plan.found and len(plan) > 2 and rng.random() < 0.6:
            feet, side = after_a_step(plan, rng)
        else:
            grid = changed(grid, rng, pair_pose(feet), not plan.found or rng.random() < 0.4)
            planner.take_map(grid)
        query: dict[str, Any] = {"start_feet_world": feet, "first_side": side, "goal": goal}
        plan, best = planner.plan(**query), optimum(grid, model, **query)
        assert_right(plan, best, grid, model)
        if plan.found and options is PROVEN:
            assert plan.cost_m == pytest.approx(best.cost_m, abs=2e-6)
            assert plan.epsilon == 1.0
        found += plan.found
    assert found > 2


@pytest.mark.parametrize("seed", first_quick(range(4)))
def test_over_ground_that_became_free_it_costs_no_more_than_a_new_plan(seed):
    rng = np.random.default_rng(seed)
    model, (free, start, goal) = small_model(), FLOORS["large"]
    quick, cheaper = replace(KEPT, stop_at_first=True), 0
    planner = Planner(free, model, quick)
    for _ in range(4):
        cells = np.array(free.cells)
        for row, col in rng.integers((14, 0), (40, 44), (3, 2)):
            cells[row : row + 3, col : col + 16] = Cell.OCCUPIED
        planner.take_map(free.with_cells(cells))
        shut = planner.plan(start=start, goal=goal)
        planner.take_map(free)
        plan = planner.plan(start=start, goal=goal)
        fresh = plan_footsteps(free, model, start=start, goal=goal, options=quick)
        assert_right(plan, optimum(free, model, start=start, goal=goal), free, model)
        assert plan.cost_m <= fresh.cost_m + 2e-6
        assert plan.epsilon <= quick.epsilon
        cheaper += not shut.found or plan.cost_m < shut.cost_m
    assert cheaper


@pytest.mark.parametrize("seed", range(4))
def test_what_is_kept_of_a_tree_is_what_the_changed_map_allows(seed):
    rng = np.random.default_rng(seed)
    model, goal = MODELS["shy"], (1.8, 1.7, 0.4)
    grid = walled(boxes=((0, 11, 12, 12), (17, 5, 18, 9)))
    planner = Planner(grid, model, PROVEN)
    kept = 0
    for _ in range(5):
        planner.plan(start=(0.55, 0.6, 0.3), goal=goal)
        grid = changed(grid, rng, (0.5, 0.5, 0.0), rng.random() < 0.5)
        planner.take_map(grid)
        context = planner.goal_context(goal)
        tree = context.memory["adstar"].tree
        slots = slots_of(tree.slots, np.arange(context.lattice.nodes))
        cost_um, came_from = tree.cost_um[slots], tree.parent[slots]
        known = np.flatnonzero(cost_um)
        kept += len(known)
        for node in known:
            before = int(came_from[node])
            if before != ROOT:
                step = edge_cost_um(context.lattice, tree, before, int(node))
                assert step > 0
                assert cost_um[node] >= cost_um[before] + step
    assert kept > 500


@pytest.mark.slow
def test_a_kept_plan_is_the_oracles_optimum_when_a_door_shuts_and_opens():
    model = small_model()
    _, start, goal = CASES["wall"]
    # A wall with a way around its upper end, and a door that is open at first.
    shut = walled(boxes=((0, 11, 15, 12),))
    grids = walled(boxes=((0, 11, 4, 12), (10, 11, 15, 12))), shut
    planner = Planner(grids[0], model, PROVEN)
    costs_m = []
    for turn in range(4):
        grid = grids[turn % 2]
        planner.take_map(grid)
        plan = planner.plan(start=start, goal=goal)
        assert violations(plan, grid, model) == []
        assert plan.cost_m == pytest.approx(Oracle(grid, model, goal).best_cost(start), abs=1e-5)
        costs_m.append(plan.cost_m)
    assert costs_m[1] > costs_m[0] + 0.3
    assert costs_m[:2] == costs_m[2:]


@pytest.mark.performance
def test_a_robot_that_walks_its_plan_needs_no_search():
    grid, start, goal = CASES["wall"]
    model, rng = small_model(), np.random.default_rng(1)
    planner = Planner(grid, model, KEPT)
    plan = planner.plan(start=start, goal=goal)
    expansions, replans = 0, 0
    while len(plan) > 2:
        feet, side = after_a_step(plan, rng)
        plan = planner.plan(start_feet_world=feet, first_side=side, goal=goal)
        assert plan.found
        assert plan.epsilon <= KEPT.epsilon
        expansions, replans = expansions + plan.expansions, replans + 1
    assert replans > 5
    assert expansions < 20 * replans


def test_another_goal_begins_anew_and_the_old_one_again():
    grid, start, goal = CASES["wall"]
    model = small_model()
    planner = Planner(grid, model, PROVEN)
    for there in (goal, (0.6, 1.8, 0.0), goal):
        plan = planner.plan(start=start, goal=there)
        assert plan.epsilon == 1.0
        best = optimum(grid, model, start=start, goal=there)
        assert plan.cost_m == pytest.approx(best.cost_m, abs=2e-6)


@pytest.mark.parametrize("name", ["ara", "astar", "backward", "adstar"])
def test_every_search_plans_over_a_changed_map_as_over_a_new_one(name):
    grid, start, goal = CASES["wall"]
    model, options = small_model(), PlannerOptions(name=name, improve_expansions=None, refine=False)
    planner = Planner(walled(), model, options)
    for floor in (walled(), grid, walled(boxes=((14, 0, 15, 24),)), walled(30, 30)):
        planner.take_map(floor)
        plan = planner.plan(start=start, goal=goal)
        fresh = plan_footsteps(floor, model, start=start, goal=goal, options=options)
        assert (plan.status, plan.epsilon) == (fresh.status, fresh.epsilon)
        assert plan.cost_m == pytest.approx(fresh.cost_m, abs=2e-6)


def test_a_goal_that_is_blocked_for_a_while_is_planned_to_again():
    grid, start, goal = CASES["empty"]
    model = small_model()
    planner = Planner(grid, model, PROVEN)
    before = planner.plan(start=start, goal=goal)
    row, col = int(goal[1] / 0.1), int(goal[0] / 0.1)
    planner.take_map(walled(boxes=((row, col, row + 1, col + 1),)))
    assert planner.plan(start=start, goal=goal).status is PlanStatus.GOAL_BLOCKED
    planner.take_map(grid)
    assert planner.plan(start=start, goal=goal).cost_m == before.cost_m


GOAL = (1.3, 1.2, 0.4)


def steps_over(grid, model, nodes):
    """Costs (n, K) of the steps from nodes (n,) and whether a plan may end there (n,).

    Of a lattice made for this map; below 0 where a step is not allowed.
    """
    lattice = build_lattice(grid, terrain_of(grid, False), model, tables_of(model).steps, GOAL)
    tree = new_tree(lattice, is_backward=False)
    rows = 2 * lattice.headings
    costs_um = np.full((len(nodes), lattice.steps.shape[1]), -1, np.int64)
    for i, node in enumerate(nodes):
        if not node_free(lattice, node):
            continue
        for k in np.flatnonzero(lattice.steps[node % rows, :, COST_UM]):
            to = int(node + lattice.steps[node % rows, k, D_NODE])
            costs_um[i, k] = edge_cost_um(lattice, tree, int(node), to)
    return costs_um, np.array([may_end_at(lattice, node) for node in nodes])


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
@pytest.mark.parametrize("resolution_m", [0.1, 0.05])
def test_only_steps_with_feet_near_to_a_change_see_it(resolution_m, model):
    rng = np.random.default_rng(7)
    scale = round(0.1 / resolution_m)
    grid = walled(26 * scale, 26 * scale, origin=(0.3, -0.2, 0.5), resolution_m=resolution_m)
    cells = np.array(grid.cells)
    cells[5:7, 8:9] = Cell.OCCUPIED
    before = grid.with_cells(cells)
    row, col = rng.integers(9, 14, 2) * scale
    cells[5:7, 8:9] = Cell.FREE
    cells[row, col] = Cell.OCCUPIED
    after = grid.with_cells(cells)
    lattice = build_lattice(before, terrain_of(before, False), model, tables_of(model).steps, GOAL)
    rows = 2 * lattice.headings
    # One node of eleven away from the rim, which all headings and sides are among.
    up, across = np.meshgrid(np.arange(6, lattice.rows - 6), np.arange(6, lattice.cols - 6))
    nodes = ((up * lattice.cols + across).reshape(-1, 1) * rows + np.arange(rows)).reshape(-1)[::11]
    old_um, old_ends = steps_over(before, model, nodes)
    new_um, new_ends = steps_over(after, model, nodes)
    change = change_between(lattice, terrain_of(before, False), terrain_of(after, False))
    assert change is not None
    here = nodes // rows
    there = (nodes[:, None] + lattice.steps[nodes % rows, :, D_NODE]) // rows
    dearer = (old_um >= 0) & ((new_um < 0) | (new_um > old_um))
    cheaper = (new_um >= 0) & ((old_um < 0) | (old_um > new_um))
    for steps, found in ((dearer, change.shut), (cheaper, change.freed)):
        assert steps.sum() > 20
        assert np.isin(np.broadcast_to(here[:, None], steps.shape)[steps], found).all()
        assert np.isin(there[steps], found).all()
    lost = old_ends & ~new_ends
    assert lost.any()
    assert np.isin(here[lost], change.shut).all()
    # It is not all that is called near.
    assert len(change.shut) + len(change.freed) < 0.5 * lattice.cols * lattice.rows
