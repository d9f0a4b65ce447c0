"""A polygon of where the swing foot may land: what it holds, and that every plan obeys it."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, replace

import numpy as np
import pytest
import shapely

from controller.step_sequences import MODES, clip_to_limits, draw_sequence
from controller.tracking_limits import TrackingLimits, limits_from, planning_model
from planner.corpus.check import from_document
from planner.options import PlannerOptions
from planner.planner import Planner, plan_footsteps
from planner.refinement.cost import NOT_ALLOWED, plan_cost_um
from planner.robot_model import StepLimits, StepModel
from planner.verify import violations
from tests.planner_floor import plan_on_lattice, walled
from tests.planner_oracle import Oracle, small_model
from tests.planner_refinement import problem_of, random_floor, steps_of

BOX = {"x_m": (-0.2, 0.3), "y_m": (0.1, 0.4), "yaw_rad": (-0.4, 0.8)}
# The box without its corner of steps that are long and wide, and without that of wide ones back.
CUT = ((-0.2, 0.1), (0.3, 0.1), (0.3, 0.2), (0.1, 0.4), (0.0, 0.4), (-0.2, 0.25))


def limits(reach_m=(), **changes):
    return StepLimits(**{**BOX, **changes}, reach_m=reach_m)


def with_polygon(model):
    return replace(model, limits=replace(model.limits, reach_m=CUT))


def beyond_m(steps):
    """How far (N,) steps (N, 3) lie outside the polygon."""
    return shapely.distance(shapely.Polygon(CUT), shapely.points(steps[:, :2]))


def test_a_step_lies_in_the_polygon_and_in_the_intervals():
    # A right triangle; its long edge is x + y = 0.3, so a point (t, t) beyond lies (t - 0.15) * √2
    # off it.
    triangle = limits(((0.0, 0.0), (0.3, 0.0), (0.0, 0.3)))
    steps = {
        (0.0, 0.1, 0.0): True,
        (0.1, 0.1, 0.0): True,
        (0.0, 0.3, 0.0): True,  # a vertex
        (0.15, 0.15, 0.0): True,  # on the edge
        (0.2, 0.101, 0.0): False,
        (-0.001, 0.2, 0.0): False,  # inside the intervals
        (0.2, 0.05, 0.0): False,  # inside the polygon
        (0.1, 0.1, 0.9): False,
    }
    assert triangle.contain(list(steps)).tolist() == list(steps.values())
    assert limits().contain((0.2, 0.101, 0.0))
    assert triangle.contain(np.zeros((2, 5, 3))).shape == (2, 5)
    just = 0.15 + 1e-3 / math.sqrt(2)
    for off, inside in ((-1e-7, True), (1e-7, False)):
        assert triangle.contain((just + off, just + off, 0.0), tolerance=1e-3) == inside


def test_half_planes_are_unit_normals_and_distances():
    planes = limits(((0.0, 0.0), (0.3, 0.0), (0.0, 0.3))).half_planes
    half = math.sqrt(0.5)
    expected = [(0.0, -1.0, 0.0), (half, half, 0.3 * half), (-1.0, 0.0, 0.0)]
    np.testing.assert_allclose(planes, expected, atol=1e-12)
    assert limits().half_planes.shape == (0, 3)


def test_how_far_a_straight_step_goes():
    cut = limits(CUT)
    assert cut.most_x_m(0.2) == pytest.approx(0.3)
    assert cut.most_x_m(0.3) == pytest.approx(0.2)
    assert cut.most_x_m(0.3, backward=True) == pytest.approx(-0.4 / 3)
    assert (limits().most_x_m(0.3), limits().most_x_m(0.3, backward=True)) == (0.3, -0.2)


@pytest.mark.parametrize(
    ("vertices", "words"),
    [
        (((0.0, 0.1), (0.3, 0.1)), "2 vertices, must have at least 3"),
        (((0.0, 0.1), (0.3, 0.1), (0.0, math.nan)), "two finite numbers"),
        (((0.0, 0.1), (0.3, 0.1), (0.0, 0.1, 0.2)), "two finite numbers"),
        ((0.0, 0.1, 0.3), "two finite numbers"),
        (((0.0, 0.1), (0.0, 0.3), (0.3, 0.1)), "clockwise, must be counter-clockwise"),
        (((0.0, 0.1), (0.1, 0.2), (0.2, 0.3)), "has no area"),
        (((0.0, 0.1), (0.3, 0.1), (0.3, 0.1), (0.0, 0.3)), "a vertex twice"),
        (((0.0, 0.1), (0.3, 0.1), (0.05, 0.15), (0.0, 0.4)), "must be convex"),
        # A star of five points turns left at each of them.
        (
            tuple(
                (0.3 * math.cos(4 * k * math.pi / 5), 0.3 * math.sin(4 * k * math.pi / 5))
                for k in range(5)
            ),
            "must be convex",
        ),
    ],
)
def test_polygons_that_are_none_are_refused(vertices, words):
    with pytest.raises(ValueError, match=words) as refused:
        limits(vertices)
    assert "reach_m" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_steps_and_stance_must_lie_in_the_polygon():
    model = small_model()
    with pytest.raises(ValueError, match=r"step \(0.3, 0.2, 0.0\) lies outside the step limits"):
        replace(model, limits=limits(((-0.2, 0.1), (0.29, 0.1), (0.0, 0.4), (-0.2, 0.4))))
    aside = limits(((0.05, 0.1), (0.3, 0.1), (0.3, 0.4), (0.05, 0.4)))
    with pytest.raises(ValueError, match="must allow the step"):
        replace(model, limits=aside, steps=((0.3, 0.2, 0.0),))


@pytest.mark.parametrize(
    ("name", "refine"),
    [(name, False) for name in ("ara", "astar", "backward", "adstar", "rstar", "rrtconnect")]
    + [("ara", True), ("rrtconnect", True)],
)
def test_no_step_of_any_plan_leaves_the_polygon(name, refine):
    """Starts are off the lattice, so first steps are of all kinds: without it some are outside."""
    box = small_model(cell_m=0.05, headings=16)
    cut, options = with_polygon(box), PlannerOptions(name=name, refine=refine)
    free, kept = [], []
    for seed in (0, 2, 4):
        grid, rng = random_floor(seed)
        for _ in range(5):
            start, goal = rng.uniform((0.4, 0.4, -3.1), (2.6, 2.6, 3.1), (2, 3))
            query = {"start": start, "goal": goal, "options": options}
            plan = plan_footsteps(grid, cut, **query)
            if plan.found and len(plan):
                assert violations(plan, grid, cut) == []
                assert cut.limits.contain(steps_of(plan), 1e-9).all()
                kept.append(beyond_m(steps_of(plan)).max())
                free.append(beyond_m(steps_of(plan_footsteps(grid, box, **query))).max())
    assert len(kept) >= 5
    assert max(kept) < 1e-8
    assert max(free) > 0.01


def test_refined_steps_go_to_the_edge_of_the_polygon():
    """Diagonal walks, which want to be long and wide at once."""
    model = with_polygon(small_model(cell_m=0.05, headings=16))
    plans = [
        plan_footsteps(
            walled(30, 40),
            model,
            start=(0.5, 0.5, 0.0),
            goal=(2.5, 2.0, 0.0),
            options=PlannerOptions(refine=refine),
        )
        for refine in (False, True)
    ]
    assert plans[1].cost_m < plans[0].cost_m
    planes = model.limits.half_planes
    steps = steps_of(plans[1])
    slanted = [k for k, plane in enumerate(planes) if abs(plane[0]) > 0.1 and abs(plane[1]) > 0.1]
    room_m = planes[slanted, 2] - steps[:, :2] @ planes[slanted, :2].T
    assert -1e-9 <= room_m.min() < 1e-3


def test_the_independent_check_tells_of_a_step_outside():
    box = small_model(cell_m=0.05, headings=16)
    grid = walled(30, 40)
    plan = plan_footsteps(
        grid, box, start=(0.5, 0.5, 0.0), goal=(2.5, 2.0, 0.0), options=PlannerOptions(refine=True)
    )
    assert violations(plan, grid, box) == []
    wrong = violations(plan, grid, with_polygon(box))
    outside = np.flatnonzero(beyond_m(steps_of(plan)) > 1e-6)
    assert len(outside) > 0
    assert [line.split(":")[0] for line in wrong] == [f"step {i}" for i in outside]
    assert all("outside the polygon" in line for line in wrong)


def test_a_chain_with_a_step_outside_is_not_allowed():
    box = small_model(cell_m=0.05, headings=16)
    grid, start, goal = walled(30, 40), (0.5, 0.5, 0.0), (2.5, 2.0, 0.0)
    planner = Planner(grid, with_polygon(box), PlannerOptions(refine=False))
    plans = (
        planner.plan(start=start, goal=goal),
        plan_on_lattice(grid, box, start=start, goal=goal),
    )
    costs_um = []
    for plan in plans:
        rules, poses, outward = problem_of(planner, plan)
        costs_um.append(plan_cost_um(rules, poses, outward))
    assert costs_um[0] == pytest.approx(plans[0].cost_m * 1e6, abs=2)
    assert beyond_m(steps_of(plans[1])).max() > 1e-3
    assert costs_um[1] == NOT_ALLOWED


@pytest.mark.slow
def test_the_cheapest_plan_is_that_of_the_oracle():
    model = with_polygon(small_model())
    grid, start = walled(24, 24, ((4, 10, 8, 12),)), (0.6, 0.6, 0.0)
    compared, dearer = 0, 0
    for angle in (0.2, 0.5, 0.8, 1.1):
        goal = (0.6 + 1.3 * math.cos(angle), 0.6 + 1.3 * math.sin(angle), 0.3)
        best_m = Oracle(grid, model, goal).best_cost(start)
        options = PlannerOptions(epsilon=1.0, refine=False)
        plan = plan_footsteps(grid, model, start=start, goal=goal, options=options)
        assert plan.found == math.isfinite(best_m)
        if plan.found:
            assert plan.cost_m == pytest.approx(best_m, abs=1e-5)
            compared += 1
            box = plan_footsteps(grid, small_model(), start=start, goal=goal, options=options)
            dearer += plan.cost_m > box.cost_m + 1e-6
    assert compared >= 2
    assert dearer >= 1


def test_a_walk_from_feet_as_they_stand_begins_within_the_polygon():
    model = with_polygon(small_model(cell_m=0.05, headings=16))
    feet = np.array([[1.0, 1.13, 0.0, 0.1], [1.1, 0.9, 0.0, -0.15]])
    first = []
    for angle in np.arange(8) * math.pi / 4:
        goal = (1.5 + 0.9 * math.cos(angle), 1.4 + 0.9 * math.sin(angle), angle)
        plan = plan_on_lattice(walled(30, 40), model, start_feet_world=feet, goal=goal)
        if plan.found:
            first.append(steps_of(plan)[0])
    assert len(first) >= 4
    assert beyond_m(np.array(first)).max() < 1e-8


def test_steps_drawn_for_training_stay_within_the_polygon():
    model = with_polygon(small_model())
    feet = np.array([[0.0, 0.1, 0.0, 0.0], [0.0, -0.1, 0.0, 0.0]])
    free = []
    for mode in MODES:
        for seed in range(10):
            tracks = [
                draw_sequence(np.random.default_rng(seed), of, feet, mode=mode)
                for of in (model, small_model())
            ]
            steps, without = (steps_of_track(track) for track in tracks)
            assert model.limits.contain(steps, 1e-9).all()
            free.append(beyond_m(without).max())
    assert max(free) > 0.01


def steps_of_track(track):
    """Steps (N, 3) of a track, worked out by complex numbers."""
    steps = []
    before_world, pose_world = track.pose_world[1:-1], track.pose_world[2:]
    for before, pose, side in zip(before_world, pose_world, track.side[2:], strict=True):
        out = 1 - 2 * int(side)
        away = complex(*(pose - before)[:2]) * complex(math.cos(before[3]), -math.sin(before[3]))
        turn = math.remainder(pose[3] - before[3], 2 * math.pi)
        steps.append((away.real, out * away.imag, out * turn))
    return np.array(steps)


def test_steps_are_drawn_in_toward_the_stance():
    steps = np.array([[0.3, 0.4, 0.5], [0.2, 0.2, -0.9], [0.5, 0.2, 0.0]])
    # From (0, 0.2) toward (0.3, 0.4) the edge x + y = 0.5 is met after 0.6 of the way.
    expected = [[0.18, 0.32, 0.5], [0.2, 0.2, -0.4], [0.3, 0.2, 0.0]]
    np.testing.assert_allclose(clip_to_limits(steps, limits(CUT), 0.2), expected, atol=1e-12)
    assert clip_to_limits(steps, limits(), 0.2)[0].tolist() == [0.3, 0.4, 0.5]


def test_a_corpus_says_the_polygon_of_its_robot():
    model = with_polygon(small_model())
    document = json.loads(json.dumps(asdict(model)))
    assert from_document(StepModel, document) == model


def test_the_polygon_outlives_measured_limits():
    model = with_polygon(small_model())
    narrow = {"x_m": [-0.1, 0.25], "y_m": [0.14, 0.35], "yaw_rad": [-0.3, 0.8]}

    def measured(found):
        return TrackingLimits(
            robot="small", policy_sha256="", limits=found, foot_margin_m=0.0, body_margin_m=0.0
        )

    plain = planning_model(model, measured(limits_from(narrow)))
    assert plain.limits == limits(CUT, **{name: tuple(ends) for name, ends in narrow.items()})
    # One that was measured holds for a robot whose file has none.
    kept = limits_from({**narrow, "reach_m": [list(vertex) for vertex in CUT]})
    assert planning_model(small_model(), measured(kept)).limits == plain.limits
