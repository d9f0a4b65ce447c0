"""The parts of refinement by numbers: costs, slopes, distances, gaps, the banded system."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from shapely import affinity

from maps.grid import OccupancyGrid
from planner.collision import terrain_of
from planner.lattice.steps import feet_apart
from planner.planner import Planner
from planner.refinement import constraints, cost, interior_point
from planner.refinement.constraints import DIRECTIONS, new_workspace
from planner.refinement.cost import foot_height_um, plan_cost_um
from tests.compiled import from_python
from tests.planner_floor import LATTICE
from tests.planner_oracle import small_model
from tests.planner_refinement import FLOOR, problem_of, random_floor, shy_model

add_block = from_python(constraints.add_block)
distances_to_blocked = from_python(constraints.distances_to_blocked)
evaluate_constraints = from_python(constraints.evaluate_constraints)
add_step_cost = from_python(cost.add_step_cost)
gap_axis = from_python(cost.gap_axis)
step_between = from_python(cost.step_between)
add = from_python(cost.add)
solve_banded = from_python(interior_point.solve_banded)


def test_the_cost_of_a_chain_is_that_of_the_search():
    grid, rng = random_floor(2)
    model = shy_model(clearance_cost_m=0.0)
    compared = 0
    while compared < 4:
        start, goal = rng.uniform((0.2, 0.2, -3.1), (2.8, 2.8, 3.1), (2, 3))
        planner = Planner(grid, model, LATTICE)
        plan = planner.plan(start=start, goal=goal)
        if not plan.found or not len(plan):
            continue
        problem, poses, outward = problem_of(planner, plan)
        assert plan_cost_um(problem, poses, outward) == pytest.approx(plan.cost_m * 1e6, abs=2)
        # A foot in a wall, or a step too far, is no path.
        poses[1, 0] += 1.0
        assert plan_cost_um(problem, poses, outward) == -1
        compared += 1


def test_slopes_of_rules_and_costs_are_those_of_differences():
    grid, rng = random_floor(4)
    pentagon = ((-0.2, 0.1), (0.3, 0.1), (0.3, 0.2), (0.1, 0.4), (-0.2, 0.4))
    limits = replace(small_model().limits, reach_m=pentagon)
    model = shy_model(clearance_cost_m=0.0, limits=limits)
    planner = Planner(grid, model, LATTICE)
    plan = planner.plan(start=(0.4, 0.5, 0.2), goal=(2.5, 2.4, 1.0))
    assert plan.found
    problem, path, first = problem_of(planner, plan)
    lattice = problem.lattice
    seen = 0
    for _ in range(10):
        poses = path + rng.uniform(-0.02, 0.02, path.shape)
        i = int(rng.integers(1, len(poses) - 3))
        outward = first * (-1) ** i
        workspace = new_workspace(lattice, len(poses) - 1, len(problem.reach))
        evaluate_constraints(problem, workspace, poses, first)
        value, gradient, active = (
            workspace.value[i].copy(),
            workspace.gradient[i].copy(),
            workspace.active[i].copy(),
        )
        workspace.block[:] = 0.0
        add_step_cost(problem.weights, i, workspace.step, workspace.along, workspace.block)
        for k in range(6):
            nudged = poses.copy()
            nudged[i + k // 3, k % 3] += 1e-7
            evaluate_constraints(problem, workspace, nudged, first)
            same = active & workspace.active[i]
            rate = (workspace.value[i] - value)[same] / 1e-7
            np.testing.assert_allclose(rate, gradient[same, k], atol=2e-5)
            seen += int(same.sum())
            # The last column of the block is minus the gradient of the cost.
            costs = []
            for sign in (1, -1):
                nudged = poses.copy()
                nudged[i + k // 3, k % 3] += sign * 1e-5
                x, y, yaw = step_between(nudged[i], nudged[i + 1], outward)
                costs.append(math.hypot(x, y) + smooth(0.05, yaw) + smooth(0.2, y - 0.2))
                costs[-1] += 0.5 * (smooth(0.2, x) - 0.2 * x)
            by_pose = (costs[0] - costs[1]) / 2e-5
            assert workspace.block[k, 6] == pytest.approx(-by_pose, abs=1e-4)
    assert seen > 300


def smooth(rate, value):
    return rate * math.sqrt(value * value + 1e-6)


def test_room_around_a_box_is_right_by_polygons():
    grid, rng = random_floor(6)
    terrain = terrain_of(grid, False)
    row, col = np.nonzero(grid.blocked())
    walls = shapely.union_all(
        shapely.box(col * 0.05, row * 0.05, (col + 1) * 0.05, (row + 1) * 0.05)
    )
    distances = np.zeros((DIRECTIONS, 4))
    touched = 0
    for _ in range(300):
        x, y, yaw = rng.uniform((0.4, 0.4, -3.2), (2.6, 2.6, 3.2))
        radius_m = rng.uniform(0.0, 0.1)
        rounded = 0.15, 0.08, radius_m
        near = distances_to_blocked(terrain, x, y, yaw, rounded, 0.1, distances)
        box = affinity.rotate(
            shapely.box(-0.15, -0.08, 0.15, 0.08), yaw, origin=(0, 0), use_radians=True
        )
        distance_m = affinity.translate(box, x, y).distance(walls) - radius_m
        if not near:
            assert distance_m > 0.1
            continue
        least = distances[:, 0].min()
        if distance_m == -radius_m:  # the box itself overlaps a cell
            assert least < distance_m
            continue
        assert least == pytest.approx(min(distance_m, 0.1), abs=1.1e-5)
        touched += least < 0.1
    assert touched > 50


def test_the_gap_between_feet_is_that_of_the_lattice():
    model = small_model(foot_gap_m=0.02)
    rng = np.random.default_rng(0)
    half_l, half_w = model.foot.length_m / 2 + 0.01, model.foot.width_m / 2 + 0.01
    steps = rng.uniform((-0.3, 0.0, -1.0), (0.3, 0.3, 1.0), (400, 3))
    gaps = [gap_axis(x, y, yaw, half_l, half_w)[0] for x, y, yaw in steps]
    assert (np.array(gaps) >= 0).tolist() == feet_apart(steps, model.foot, 0.02).tolist()


def test_the_banded_system_is_solved_as_a_dense_one():
    planner = Planner(FLOOR, small_model(), LATTICE)
    plan = planner.plan(start=(0.4, 0.5, 0.2), goal=(2.5, 2.4, 1.0))
    rng = np.random.default_rng(1)
    workspace = new_workspace(planner.goal_context(plan.goal).lattice, len(plan), 0)
    size = len(workspace.right)
    dense, right = np.eye(size), np.zeros(size)
    workspace.matrix[:, 0] = 1.0
    for i in range(len(workspace.value)):
        along = rng.normal(size=6)
        workspace.block[:] = 0.0
        add(workspace.block, 2.0, along, 3.0)
        add_block(workspace.block, i, workspace.matrix, workspace.right)
        whole = np.zeros(size + 6)
        whole[3 * i : 3 * i + 6] = along
        whole = whole[3 : size + 3]
        dense += 2.0 * np.outer(whole, whole)
        right += 3.0 * whole
    assert solve_banded(workspace.matrix, workspace.right)
    np.testing.assert_allclose(workspace.right, np.linalg.solve(dense, right), rtol=1e-9, atol=1e-9)


def test_height_under_a_foot_is_that_of_its_tread_or_none():
    heights = np.zeros((20, 20))
    heights[:, 10:] = 0.1
    grid = OccupancyGrid(cells=np.zeros((20, 20), np.uint8), resolution_m=0.1, elevation_m=heights)
    planner = Planner(grid, small_model(), LATTICE)
    lattice = planner.goal_context((0.5, 1.2, 0.0)).lattice
    # The foot is 0.2 m long and wants 0.02 m of level ground around it; the edge is at x = 1.
    assert foot_height_um(lattice, np.array([0.87, 1.0, 0.0])) == 0
    assert foot_height_um(lattice, np.array([1.13, 1.0, 0.0])) == 100_000
    assert foot_height_um(lattice, np.array([0.93, 1.0, 0.0])) < -1_000_000
    assert foot_height_um(lattice, np.array([0.93, 1.0, math.pi / 2])) < -1_000_000
    assert foot_height_um(lattice, np.array([0.92, 1.0, math.pi / 2])) == 0
