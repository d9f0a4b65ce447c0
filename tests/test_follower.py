"""What planning knows of its follower: the file beside the weights, and the step model from it."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import cast

import numpy as np
import pytest

from app.options import find_robot_with_limits
from controller.evaluation import step_limits as step_region
from controller.evaluation.step_limits import (
    BodySway,
    LimitTrial,
    StepWalks,
    beyond_box_m,
    cut_back,
    limit_corners,
    search_limits,
    spheres_around,
    step_grid,
)
from controller.policy import Policy, PolicyError, load_policy, save_policy
from controller.tracking_limits import (
    TrackingLimits,
    load_tracking_limits,
    tracking_limits_path,
    tracking_limits_text,
    with_tracking_limits,
)
from planner.lattice.steps import allowed
from planner.robot_model import StepLimits
from sim.robots import get_robot, robot_names
from sim.scene import build_scene

ROBOT = get_robot("jvrc1")
NARROW = StepLimits(x_m=(-0.1, 0.2), y_m=(0.17, 0.31), yaw_rad=(-0.16, 0.2), z_m=(-0.1, 0.05))


@pytest.fixture
def policy_path(tmp_path):
    """A policy of somebody's own, in a folder of its own."""
    path = tmp_path / "own.safetensors"
    save_policy(load_policy(ROBOT), path)
    return path


def measured(path, **changes) -> TrackingLimits:
    about = json.loads(path.with_suffix(".json").read_text())
    values = {
        "robot": "jvrc1",
        "policy_sha256": about["sha256"],
        "limits": NARROW,
        "foot_margin_m": 0.017,
        "body_margin_m": 0.093,
        "evidence": {"episodes": 1000},
    }
    return TrackingLimits(**(values | changes))


def test_measured_limits_and_margins_are_what_planning_uses(policy_path):
    written = measured(policy_path)
    tracking_limits_path(policy_path, ROBOT).write_text(tracking_limits_text(written))
    assert load_tracking_limits(ROBOT, policy_path) == written
    model = find_robot_with_limits("jvrc1", policy_path).step_model
    assert model.limits == NARROW
    assert (model.foot_margin_m, model.body_margin_m) == (0.017, 0.093)
    dropped = set(ROBOT.step_model.steps) - set(model.steps)
    assert (0.3, 0.20, 0.0) in dropped
    assert (0.2, 0.20, 0.0) in model.steps
    assert all(NARROW.contain(step) for step in model.steps)
    # Training goes on with the limits of the robot's file.
    assert (
        find_robot_with_limits("jvrc1", policy_path).training_model.limits == ROBOT.training_limits
    )


def test_without_measurements_or_with_those_of_other_weights_the_robot_stays_as_it_is(policy_path):
    assert with_tracking_limits(ROBOT, policy_path) is ROBOT
    text = tracking_limits_text(measured(policy_path, policy_sha256="0" * 64))
    tracking_limits_path(policy_path, ROBOT).write_text(text)
    assert with_tracking_limits(ROBOT, policy_path) is ROBOT
    assert load_tracking_limits(ROBOT, policy_path.with_name("none.safetensors")) is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"robot": "hrp5p"}, "measured on hrp5p"),
        ({"foot_margin_m": -1.0}, "foot_margin_m -1.0"),
        ({"limits": replace(NARROW, y_m=(0.25, 0.31))}, "does not fit jvrc1"),
    ],
)
def test_measurements_that_cannot_be_used_say_so(policy_path, change, words):
    tracking_limits_path(policy_path, ROBOT).write_text(
        tracking_limits_text(measured(policy_path, **change))
    )
    with pytest.raises(PolicyError, match=words):
        with_tracking_limits(ROBOT, policy_path)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"format": "other/1", "limits": {}}'])
def test_damaged_measurements_say_what_to_do(policy_path, text):
    tracking_limits_path(policy_path, ROBOT).write_text(text)
    with pytest.raises(PolicyError, match="evaluate the policy again"):
        with_tracking_limits(ROBOT, policy_path)


@pytest.mark.parametrize("name", robot_names())
def test_what_ships_beside_a_policy_can_be_planned_with(name):
    model = with_tracking_limits(get_robot(name)).step_model
    assert model.limits.contain((0.0, model.stance_width_m, 0.0))
    assert len(model.steps) >= 5


def trial(limits, success, corner) -> LimitTrial:
    fell = np.zeros(8)
    fell[corner] = 3
    return LimitTrial(limits=limits, success=success, walked=np.full(8, 10), fell=fell)


def test_a_corner_is_cut_where_planning_loses_least():
    """Steps at x -0.1, y 0.2 and 0.3: cutting x low or y high would lose one."""
    steps = ((-0.1, 0.2, 0.0), (0.1, 0.3, 0.0))
    model = replace(ROBOT.step_model, limits=NARROW, steps=steps)
    tight = replace(NARROW, y_m=(0.17, 0.3))
    corners = limit_corners(tight)
    assert corners[0].tolist() == [-0.1, 0.17, -0.16]
    assert corners[3].tolist() == [-0.1, 0.3, 0.2]
    # Of y low (1 of 13 cm) and yaw low (0.03 of 0.36 rad) the first loses the smaller part.
    assert cut_back(tight, 0, model) == replace(tight, y_m=(0.18, 0.3))
    assert cut_back(tight, 3, model) == replace(tight, yaw_rad=(-0.16, 0.17))
    standing = StepLimits(x_m=(0.0, 0.0), y_m=(0.2, 0.2), yaw_rad=(0.0, 0.0))
    only = replace(model, limits=standing, steps=((0.0, 0.2, 0.0),))
    assert cut_back(standing, 5, only) is None


def test_limits_are_cut_until_walks_succeed():
    """Robots that fall where feet come nearer than 18.5 cm, and nowhere else."""
    asked = []

    def walk(limits):
        asked.append(limits)
        return trial(limits, 1.0 if limits.y_m[0] > 0.185 else 0.5, 0)

    model = replace(ROBOT.training_model, steps=((0.0, 0.2, 0.0), (-0.2, 0.2, -0.2)))
    trials = search_limits(model, model.limits, walk, success=0.99)
    assert [found.limits for found in trials] == asked
    assert trials[-1].limits == replace(model.limits, y_m=(0.19, model.limits.y_m[1]))
    assert len(trials) == 4
    hopeless = search_limits(
        model, model.limits, lambda limits: trial(limits, 0.0, 0), success=0.99
    )
    assert 5 < len(hopeless) <= 31
    assert hopeless[-1].limits.contain((0.0, 0.2, 0.0))


def test_walks_within_limits_begin_on_corners(monkeypatch):
    """Every walk that begins on the corner that is made to fail falls, and is counted there."""
    drawn = {}

    def walk_steps(robot, policy, draw, *, count, **_):
        rng = np.random.default_rng(0)
        for row in range(count):
            drawn[row], counting = draw(rng, 12, row)
            assert counting.all()
        corner = limit_corners(NARROW)[2]
        fell = [np.isclose(drawn[row][:2], corner).all(axis=1).any() for row in range(count)]
        return StepWalks(
            upright=~np.array(fell),
            robot=np.zeros(0, dtype=int),
            error_m=np.zeros(0),
            heading_error_rad=np.zeros(0),
        )

    monkeypatch.setattr(step_region, "walk_steps", walk_steps)
    impossible = limit_corners(NARROW)[7]
    _, found = step_region.walk_within(
        ROBOT,
        cast(Policy, None),  # nobody walks
        NARROW,
        lambda steps: ~np.isclose(steps, impossible).all(axis=1),
        count=200,
        seed=0,
    )
    steps = np.array(list(drawn.values()))
    first = {tuple(step) for step in steps[:, :2].reshape(-1, 3)}
    assert first == {tuple(corner) for corner in limit_corners(NARROW)[:7]}
    assert NARROW.contain(steps).all()
    later = steps[:, 2:].reshape(-1, 3)
    usual = {step for step in ROBOT.step_model.steps if NARROW.contain(step)}
    assert 0.4 < np.mean([tuple(step) in usual for step in later]) < 0.6
    assert np.ptp(later, axis=0) == pytest.approx([0.3, 0.14, 0.36], rel=0.1)
    assert found.worst_corner == 2
    assert found.fell[2] == found.walked[2] > 30
    assert found.walked[7] == 0
    assert 0.7 < found.success < 0.85


def test_the_grid_of_steps_goes_through_stepping_in_place():
    model = ROBOT.training_model
    kinds = step_grid(model.limits, 0.20, lambda steps: allowed(steps, model))
    assert model.limits.contain(kinds).all()
    for step in ((0.0, 0.20, 0.0), (0.35, 0.34, 0.4), (-0.2, 0.2, 0.0)):
        assert np.isclose(kinds, step).all(axis=1).any()


def test_spheres_around_shapes_by_hand():
    model = build_scene(ROBOT, timestep_s=0.001).model
    head = model.geom("head").id
    radius_m, half_m = model.geom_size[head, :2]
    centres, told_m = spheres_around(model, head)
    assert told_m == radius_m
    assert np.unique(centres, axis=0).tolist() == [[0, 0, -half_m], [0, 0, half_m]]
    foot = model.geom("left_foot").id
    centres, told_m = spheres_around(model, foot)
    assert told_m == 0.0
    assert len(np.unique(centres, axis=0)) == 8
    assert np.abs(centres) == pytest.approx(np.tile(model.geom_size[foot], (8, 1)))


def test_distances_beyond_a_box_by_hand():
    points = np.array([[0.5, 0.0], [-0.2, 0.1], [0.2, -0.7], [0.6, 0.8], [-0.6, -0.8]])
    half_m, expected_m = np.array([0.3, 0.4]), [0.2, -0.1, 0.3, 0.5, 0.5]
    assert beyond_box_m(points, np.zeros(3), half_m) == pytest.approx(expected_m)
    # The same, all turned by a quarter and moved.
    turned = np.column_stack([1.0 - points[:, 1], 2.0 + points[:, 0]])
    there = np.array([1.0, 2.0, np.pi / 2])
    assert beyond_box_m(turned, there, half_m) == pytest.approx(expected_m)


def test_reach_is_measured_from_the_nearer_stance():
    scene = build_scene(ROBOT, timestep_s=0.001)
    sway = BodySway(scene, ROBOT.step_model.body)
    feet = scene.soles_at(scene.standing_qpos)
    assert "head" in sway.names
    assert "left_foot" not in sway.names

    def shifted(*by_m: float) -> np.ndarray:
        return np.stack([feet + np.array([x, 0.0, 0.0, 0.0]) for x in by_m])

    standing = sway.beyond_m(scene.standing_qpos, shifted(0, 0))
    assert (standing <= 0.0).all(), "the box holds the robot in half-sitting"
    far = sway.beyond_m(scene.standing_qpos, shifted(-3, -3))
    # Shapes within the box's width are straight ahead of it.
    assert sway.beyond_m(scene.standing_qpos, shifted(-4, -4)) == pytest.approx(far + 1)
    assert sway.beyond_m(scene.standing_qpos, shifted(-4, -3)) == pytest.approx(far)
    # The same, all turned: nothing depends on which way the robot faces.
    turned = scene.qpos_at(np.array([0.5, -0.2, 2.0]))
    at = scene.soles_at(turned)
    assert sway.beyond_m(turned, np.stack([at, at])) == pytest.approx(standing)
