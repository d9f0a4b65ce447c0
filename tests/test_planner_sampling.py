"""Plans by OMPL: whole plans, footsteps along a path against an oracle, headings, windows."""

from __future__ import annotations

import functools
import math
import subprocess
import sys

import numpy as np
import pytest

from maps.grid import Cell
from maps.map_files import load_map
from planner.collision import box_free, terrain_of
from planner.lattice.lattice import build_lattice
from planner.lattice.steps import allowed, build_step_table, step_cost_um
from planner.options import SAMPLING_PLANNERS, PlannerOptions
from planner.plan import PlanStatus, feet_at, from_frame, relative_step, to_frame
from planner.planner import Planner, plan_footsteps
from planner.robot_model import Side
from planner.sampling import sampling_planner as sampling
from planner.sampling.footsteps_along_path import PathFootsteps, Stance, cost_of, resample
from planner.sampling.ompl_paths import SampledPath, outline_of
from planner.sampling.path_headings import choose_headings, turning_rate, walking_rate
from planner.sampling.sampling_planner import corridor_along, window_around
from planner.verify import violations
from sim.robots import get_robot
from tests.planner_floor import CASES, fine_model, least_cost_m, repeatable, scatter, walled
from tests.planner_oracle import small_model

# On a map that is turned and shifted, so that no frame passes for another.
GRID, START, GOAL = CASES["slanted map"]


@pytest.mark.parametrize("name", SAMPLING_PLANNERS)
def test_each_finds_a_plan_round_a_wall_that_is_right_and_repeats(name):
    model, best_m = small_model(), least_cost_m("slanted map")
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
    texts = set()
    for seed in range(3):
        options = PlannerOptions(name="rrtconnect", stop_at_first=True, seed=seed, refine=False)
        plan = plan_footsteps(GRID, small_model(), start=START, goal=GOAL, options=options)
        texts.add(repeatable(plan))
    assert len(texts) > 1


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
    scatter(rng, cells, 5, 9)
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
    assert found > 2


@pytest.mark.parametrize("name", SAMPLING_PLANNERS)
def test_a_wall_all_across_is_proven_to_leave_no_way(name):
    grid = walled(boxes=((0, 11, 24, 12),))
    planner = Planner(grid, small_model(), PlannerOptions(name=name, refine=False))
    plan = planner.plan(start=(0.6, 1.2, 0.0), goal=(1.8, 1.2, 0.0))
    assert plan.status is PlanStatus.NO_PATH
    assert "no way for a body" in plan.reason


@pytest.mark.parametrize("name", SAMPLING_PLANNERS)
def test_a_planner_that_gives_up_says_so_and_claims_no_more(name):
    # One iteration finds no way around this wall, though there is one.
    options = PlannerOptions(name=name, max_expansions=1, refine=False)
    plan = plan_footsteps(GRID, small_model(), start=START, goal=GOAL, options=options)
    assert plan.status is PlanStatus.TIMED_OUT
    assert f"{name} found no path of the body within" in plan.reason
    assert (len(plan), plan.epsilon) == (0, math.inf)


def test_stairs_are_climbed():
    grid, model = load_map("maps/stairs.yaml"), get_robot("jvrc1").step_model
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


def floor(*boxes):
    return walled(48, 48, boxes, resolution_m=0.05)


def standing(pose, model, first_side=None):
    feet = feet_at(pose, model.stance_width_m)[:, [0, 1, 3]]
    return Stance(
        feet=feet, feet_m=np.zeros(2), first_side=first_side, pair_margin_m=model.body_margin_m
    )


def cheapest_cost_um(path, model, first_side):
    """Least cost of steps beside the points of a path, by trying every sequence of them."""
    feet = [feet_at(pose, model.stance_width_m) for pose in path]
    last = len(path) - 1

    def cost(support, swing, side):
        step = relative_step(support, swing, side)
        return int(step_cost_um(step, model)) if bool(allowed(step, model)) else None

    @functools.cache
    def rest(point, side, both):
        """From a foot of one side at a point; whether the other one stands there too."""
        if both and point == last:
            return 0
        options = []
        for to in range(point if not both else point + 1, last + 1):
            step = cost(feet[point][side], feet[to][side.other], side.other)
            if step is not None:
                options.append(step + rest(to, side.other, to == point))
        return min(options, default=10**12)

    best = 10**12
    for side in Side if first_side is None else (first_side,):
        for to in range(last + 1):
            step = cost(feet[0][side.other], feet[to][side], side)
            if step is not None:
                best = min(best, step + rest(to, side, False))
    return best


@pytest.mark.parametrize("first_side", [None, *Side])
@pytest.mark.parametrize("turn_rad", [0.0, 0.9, -1.6])
def test_no_steps_along_a_path_are_cheaper(turn_rad, first_side):
    model = small_model()
    terrain = terrain_of(floor(), False)
    lattice = build_lattice(floor(), terrain, model, build_step_table(model), (1.5, 1.2, 0.0))
    share = np.linspace(0, 1, 19)
    path = np.column_stack([0.8 + 0.7 * share, 1.2 + 0.2 * share**2, turn_rad * share])
    stance = standing(path[0], model, first_side)
    steps = PathFootsteps(lattice, model, path, stance).to_end()
    assert steps is not None
    assert cost_of(lattice, model, stance, steps) == cheapest_cost_um(path, model, first_side)
    if first_side is not None:
        assert steps.side[0] == first_side
    for side, pose in zip(steps.side[-2:], steps.pose[-2:], strict=True):
        np.testing.assert_allclose(pose, feet_at(path[-1], 0.2)[side][[0, 1, 3]], atol=1e-12)


def test_footsteps_along_a_path_end_where_something_stands_in_the_way():
    model = small_model()
    grid = floor((20, 30, 28, 32))
    terrain = terrain_of(grid, False)
    lattice = build_lattice(grid, terrain, model, build_step_table(model), (2.0, 1.2, 0.0))
    path = resample(np.array([[0.6, 1.2, 0.0], [2.0, 1.2, 0.0]]))
    along = PathFootsteps(lattice, model, path, standing(path[0], model))
    assert along.to_end() is None
    # The body, 0.36 m long, comes as far as 0.18 m before the obstacle at 1.5 m.
    assert path[along.end, 0] == pytest.approx(1.3, abs=0.03)
    point, lead = along.to_point(along.end)
    assert point == along.end
    assert max(lead.pose[-2:, 0]) == pytest.approx(path[along.end, 0])


@pytest.mark.parametrize("first", [True, False])
@pytest.mark.parametrize("post", [(22, 22, 24, 24), (10, 22, 30, 24), (0, 20, 34, 22)])
def test_the_lattice_leads_round_what_a_path_runs_into(monkeypatch, post, first):
    grid, model = floor(post), small_model(cell_m=0.05, headings=16)
    start, goal = (0.5, 1.2, 0.0), (1.9, 1.2, 0.0)

    def straight_through(name, query, limits, seed):
        return SampledPath(corners=np.array([query.start, query.goal]), iterations=1)

    monkeypatch.setattr(sampling, "find_path", straight_through)
    options = PlannerOptions(name="rrtconnect", stop_at_first=first, refine=False)
    plan = plan_footsteps(grid, model, start=start, goal=goal, options=options)
    assert plan.found
    assert violations(plan, grid, model) == []


def test_points_of_a_path_are_near_each_other_and_turn_the_shorter_way():
    path = resample(np.array([[0.0, 0.0, 3.0], [0.1, 0.0, 3.0], [0.1, 0.0, -3.0]]))
    # 0.1 m in strides of 0.025 m, then 2 pi - 6 = 0.283 rad in turns of 0.05 rad.
    assert len(path) == 1 + 4 + 6
    np.testing.assert_allclose(path[4], [0.1, 0.0, 3.0])
    np.testing.assert_allclose(np.diff(path[4:, 2]), 0.283185 / 6, atol=1e-6)


def test_what_walking_costs_by_hand():
    # Nine tenths of the limits x -0.2..0.3, y 0.14..0.4, yaw -0.4..0.8. To the side the stance
    # opens and closes by 0.234 m around 0.14 + 0.117 m.
    rates = walking_rate(small_model(), np.array([0.0, math.pi, math.pi / 2, -math.pi / 2]))
    ahead = (math.hypot(0.27, 0.2) + 0.1) / 0.27
    back = (math.hypot(0.18, 0.2) + 0.1) / 0.18
    aside = (0.374 + 0.1 + 0.14 + 0.1) / 0.234
    np.testing.assert_allclose(rates, [ahead, back, aside, aside], rtol=1e-4)
    assert turning_rate(small_model()) == pytest.approx(2 * 0.3 / (0.9 * 1.2))


def test_the_body_faces_the_way_where_there_is_room():
    model = small_model()
    terrain = terrain_of(floor(), False)
    # Sideways all the way, as a sampling planner may find it.
    corners = np.array([[0.4, 1.2, 1.5], [1.2, 1.2, 1.6], [2.0, 1.2, 1.5]])
    poses = choose_headings(terrain, outline_of(model), model, corners)
    np.testing.assert_array_equal(poses[[0, -1]], corners[[0, -1]])
    middle = poses[(poses[:, 0] > 0.9) & (poses[:, 0] < 1.5), 2]
    assert len(middle) > 5
    assert np.abs(np.angle(np.exp(1j * middle))).max() < 0.3


def test_a_window_is_a_part_of_the_map_and_a_corridor_a_part_of_a_window():
    rng = np.random.default_rng(2)
    boxes = [(r, c, r + 2, c + 2) for r, c in rng.integers(0, 44, (12, 2))]
    terrain = terrain_of(floor(*boxes), False)
    line = np.array([[0.9, 0.9], [1.5, 1.4]])
    window = window_around(terrain, line, 0.5)
    corridor = corridor_along(terrain, line, 0.3)
    free = np.zeros(3, int)
    for x, y, yaw in rng.uniform((0.9, 0.9, -3), (1.5, 1.4, 3), (400, 3)):
        cos, sin = math.cos(yaw), math.sin(yaw)
        here = [
            box_free(part, x - corner[0], y - corner[1], cos, sin, (0.08, 0.03, 0.02))
            for part, corner in (
                (terrain, (0.0, 0.0)),
                (window.terrain, window.corner_m),
                (corridor.terrain, corridor.corner_m),
            )
        ]
        assert here[0] == here[1]
        assert here[0] or not here[2]
        free += here
    assert free[0] > free[2] > 50


def test_frames_there_and_back():
    rng = np.random.default_rng(0)
    poses, frame = rng.uniform(-3, 3, (20, 3)), np.array([1.0, -2.0, 2.5])
    there = to_frame(poses, frame)
    np.testing.assert_allclose(from_frame(there, frame), poses, atol=1e-12)
    np.testing.assert_allclose(to_frame(frame[None], frame), np.zeros((1, 3)), atol=1e-12)
