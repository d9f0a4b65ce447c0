"""What planning knows of its follower: the file beside the weights, and the step model from it."""

from __future__ import annotations

import itertools
import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from app.inputs import find_follower
from controller.follower import (
    Measured,
    as_measured,
    load_measured,
    measured_path,
    planning_model,
    to_text,
)
from controller.policy import PolicyError, load_policy, save_policy
from controller.step_region import anywhere_within, candidate_limits, kinds_over
from controller.sway import Reach, half_extent
from planner.lattice import allowed
from planner.model import StepLimits
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


def measured(path, **changes) -> Measured:
    about = json.loads(path.with_suffix(".json").read_text())
    values = {
        "robot": "jvrc1",
        "policy_sha256": about["sha256"],
        "limits": NARROW,
        "foot_margin_m": 0.017,
        "body_margin_m": 0.093,
        "evidence": {"episodes": 1000},
    }
    return Measured(**(values | changes))


def test_measured_limits_and_margins_are_what_planning_uses(policy_path):
    written = measured(policy_path)
    measured_path(policy_path, ROBOT).write_text(to_text(written))
    assert load_measured(ROBOT, policy_path) == written
    model = find_follower("jvrc1", policy_path).step_model
    assert model.limits == NARROW
    assert (model.foot_margin_m, model.body_margin_m) == (0.017, 0.093)
    dropped = set(ROBOT.step_model.steps) - set(model.steps)
    assert (0.3, 0.20, 0.0) in dropped
    assert (0.2, 0.20, 0.0) in model.steps
    assert all(NARROW.contain(step) for step in model.steps)
    # Training goes on with the limits of the robot's file.
    assert find_follower("jvrc1", policy_path).training_model.limits == ROBOT.training_limits


def test_without_measurements_or_with_those_of_other_weights_the_robot_stays_as_it_is(policy_path):
    assert as_measured(ROBOT, policy_path) is ROBOT
    text = to_text(measured(policy_path, policy_sha256="0" * 64))
    measured_path(policy_path, ROBOT).write_text(text)
    assert as_measured(ROBOT, policy_path) is ROBOT
    assert load_measured(ROBOT, policy_path.with_name("none.safetensors")) is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"robot": "hrp5p"}, "measured on hrp5p"),
        ({"foot_margin_m": -1.0}, "foot_margin_m -1.0"),
        ({"limits": replace(NARROW, y_m=(0.25, 0.31))}, "does not fit jvrc1"),
    ],
)
def test_measurements_that_cannot_be_used_say_so(policy_path, change, words):
    measured_path(policy_path, ROBOT).write_text(to_text(measured(policy_path, **change)))
    with pytest.raises(PolicyError, match=words):
        as_measured(ROBOT, policy_path)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"format": "other/1", "limits": {}}'])
def test_damaged_measurements_say_what_to_do(policy_path, text):
    measured_path(policy_path, ROBOT).write_text(text)
    with pytest.raises(PolicyError, match="evaluate the policy again"):
        as_measured(ROBOT, policy_path)


@pytest.mark.parametrize("name", robot_names())
def test_what_ships_beside_a_policy_can_be_planned_with(name):
    model = as_measured(get_robot(name)).step_model
    assert model.limits.contain((0.0, model.stance_width_m, 0.0))
    assert len(model.steps) >= 5


@pytest.mark.parametrize("name", robot_names())
def test_candidates_go_from_what_is_trained_inwards(name):
    robot = get_robot(name)
    tried = candidate_limits(robot)
    trained, stated = robot.training_model.limits, robot.step_model.limits
    assert asdict(tried[0])["x_m"] == trained.x_m
    assert replace(stated, z_m=tried[0].z_m) in tried
    corners = [[(x, y, yaw) for x in c.x_m for y in c.y_m for yaw in c.yaw_rad] for c in tried]
    for outer, inner in zip(tried, corners[1:], strict=False):
        assert outer.contain(inner).all()
    for limits in tried:
        assert limits.contain((0.0, robot.step_model.stance_width_m, 0.0))
        planning_model(
            robot.step_model,
            Measured(
                robot=name,
                policy_sha256="",
                limits=limits,
                foot_margin_m=0.0,
                body_margin_m=0.0,
            ),
        )


def test_drawn_steps_begin_on_corners_and_stay_within():
    rng = np.random.default_rng(0)
    usual = [(0.1, 0.2, 0.0), (0.2, 0.2, 0.0)]
    corners = list(itertools.product(NARROW.x_m, NARROW.y_m, NARROW.yaw_rad))

    def not_the_last(steps: np.ndarray) -> np.ndarray:
        return np.asarray(~np.isclose(steps, corners[-1]).all(axis=1))

    draw = anywhere_within(NARROW, usual, not_the_last)
    walks = [draw(rng, 12, row) for row in range(60)]
    steps = np.array([relative for relative, _ in walks])
    assert all(counting.all() for _, counting in walks)
    assert NARROW.contain(steps).all()
    first = {tuple(step) for step in steps[:, :2].reshape(-1, 3)}
    assert first == set(corners[:-1])
    later = steps[:, 2:].reshape(-1, 3)
    share = np.mean([tuple(step) in usual for step in later])
    assert 0.4 < share < 0.6
    assert np.ptp(later, axis=0) == pytest.approx([0.3, 0.14, 0.36], rel=0.1)


def test_the_grid_of_steps_goes_through_stepping_in_place():
    model = ROBOT.training_model
    kinds = kinds_over(model.limits, 0.20, lambda steps: allowed(steps, model))
    assert model.limits.contain(kinds).all()
    for step in ((0.0, 0.20, 0.0), (0.35, 0.34, 0.4), (-0.2, 0.2, 0.0)):
        assert np.isclose(kinds, step).all(axis=1).any()


def test_extents_of_shapes_by_hand():
    scene = build_scene(ROBOT, timestep_s=0.001)
    model = scene.model
    head = model.geom("head").id
    radius, half = model.geom_size[head, :2]
    along_and_across = np.array([[0.0, 1.0], [0.0, 0.0], [1.0, 0.0]])
    assert half_extent(model, head, along_and_across) == pytest.approx([radius + half, radius])
    foot = model.geom("left_foot").id
    size = model.geom_size[foot]
    diagonal = np.array([[0.6], [0.8], [0.0]])
    assert half_extent(model, foot, diagonal) == pytest.approx([0.6 * size[0] + 0.8 * size[1]])


def test_reach_is_measured_from_the_nearer_stance():
    scene = build_scene(ROBOT, timestep_s=0.001)
    reach = Reach(scene, ROBOT.step_model.body)
    feet = scene.soles_at(scene.standing_qpos)
    assert "head" in reach.names
    assert "left_foot" not in reach.names

    def shifted(*by_m: float) -> np.ndarray:
        return np.stack([feet + np.array([x, 0.0, 0.0, 0.0]) for x in by_m])

    standing = reach.beyond_m(scene.standing_qpos, shifted(0, 0))
    assert (standing <= 0.0).all(), "the box holds the robot in half-sitting"
    far = reach.beyond_m(scene.standing_qpos, shifted(-3, -3))
    assert reach.beyond_m(scene.standing_qpos, shifted(-4, -4)) == pytest.approx(far + 1)
    assert reach.beyond_m(scene.standing_qpos, shifted(-4, -3)) == pytest.approx(far)
    # The same, all turned: nothing depends on which way the robot faces.
    turned = scene.qpos_at(np.array([0.5, -0.2, 2.0]))
    at = scene.soles_at(turned)
    assert reach.beyond_m(turned, np.stack([at, at])) == pytest.approx(standing)
