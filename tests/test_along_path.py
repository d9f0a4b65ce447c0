"""Footsteps along a path, against an oracle that knows only single steps, and over gaps."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest

from maps.grid import Cell, OccupancyGrid
from planner.collision import box_free, terrain_of
from planner.lattice.footsteps import Stance, cost_of
from planner.lattice.lattice import build_lattice
from planner.lattice.steps import allowed, build_step_table, step_cost_um
from planner.options import PlannerOptions
from planner.plan import feet_at, relative_step
from planner.planner import plan_footsteps
from planner.robot_model import Side
from planner.sampling import sampling_planner as sampling
from planner.sampling.footsteps_along_path import PathFootsteps, resample
from planner.sampling.ompl_paths import SampledPath, outline_of
from planner.sampling.path_headings import choose_headings, turning_rate, walking_rate
from planner.sampling.sampling_planner import (
    corridor_along,
    into_frame,
    out_of_frame,
    window_around,
)
from planner.verify import violations
from tests.planner_oracle import small_model


def floor(boxes=(), side=48, resolution_m=0.05):
    cells = np.zeros((side, side), np.uint8)
    for row0, col0, row1, col1 in boxes:
        cells[row0:row1, col0:col1] = Cell.OCCUPIED
    return OccupancyGrid(cells=cells, resolution_m=resolution_m)


def standing(pose, model, first_side=None):
    feet = feet_at(pose, model.stance_width_m)[:, [0, 1, 3]]
    return Stance(
        feet=feet,
        feet_m=np.zeros(2),
        first_side=first_side,
        pair_margin_m=model.body_margin_m,
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


def test_a_strand_ends_where_something_stands_in_the_way():
    model = small_model()
    grid = floor(boxes=((20, 30, 28, 32),))
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
    grid, model = floor(boxes=(post,)), small_model(cell_m=0.05, headings=16)
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
    terrain = terrain_of(floor(boxes=boxes), False)
    line = np.array([[0.9, 0.9], [1.5, 1.4]])
    window = window_around(terrain, line, 0.5)
    corridor = corridor_along(terrain, line, 0.3)
    free = np.zeros(3, int)
    for x, y, yaw in rng.uniform((0.9, 0.9, -3), (1.5, 1.4, 3), (400, 3)):
        cos, sin = math.cos(yaw), math.sin(yaw)
        here = [
            box_free(part, x - corner[0], y - corner[1], cos, sin, 0.1, 0.05)
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
    there = into_frame(poses, frame)
    np.testing.assert_allclose(out_of_frame(there, frame), poses, atol=1e-12)
    np.testing.assert_allclose(into_frame(frame[None], frame), np.zeros((1, 3)), atol=1e-12)
