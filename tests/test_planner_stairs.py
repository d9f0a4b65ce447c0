"""Robots on the map of stairs: feet well inside the treads, checks and pictures of heights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.pictures.canvas import draw_plan
from maps.map_files import load_map
from planner.options import PlannerOptions
from planner.plan import PlanStatus
from planner.planner import plan_footsteps
from planner.verify import violations
from sim.robots import get_robot
from tests.planner_treads import LIMITS

STAIRS_MAP = load_map("maps/stairs.yaml")


@pytest.mark.parametrize(
    ("start", "goal", "z_m"),
    [
        ((0.0, 0.0, 0.0), (8.0, 0.0, 0.0), 0.0),
        ((8.5, -1.2, 2.0), (-0.6, 1.1, -1.3), 0.0),
        ((0.3, 0.9, 1.0), (4.1, 0.1, 1.57), 0.6),
        ((4.1, 0.0, 0.0), (8.3, 1.0, -2.0), 0.0),
    ],
)
@pytest.mark.parametrize("name", ["jvrc1", "hrp5p"])
def test_stairs_are_walked_with_feet_well_inside_the_treads(name, start, goal, z_m):
    model = get_robot(name).step_model
    plan = plan_footsteps(
        STAIRS_MAP, model, start=start, goal=goal, options=PlannerOptions(refine=False)
    )
    assert plan.found
    assert violations(plan, STAIRS_MAP, model) == []
    assert (plan.pose_world[-2:, 2] == z_m).all()
    assert np.ptp(plan.pose_world[:, 2]) >= 0.5
    rises = np.abs(np.diff(plan.pose_world[:, 2]))
    assert rises.max() == pytest.approx(0.1)
    # Corners of the soles keep off the edges at x = 2.0, 2.3 ... 3.5 and 4.7 ... 6.2.
    edges_m = np.concatenate([2.0 + 0.3 * np.arange(6), 4.7 + 0.3 * np.arange(6)])
    x, half_l, half_w = plan.pose_world[:, 0], model.foot.length_m / 2, model.foot.width_m / 2
    yaw = plan.pose_world[:, 3]
    reach = np.abs(np.cos(yaw)) * half_l + np.abs(np.sin(yaw)) * half_w
    gaps = np.abs(x[:, None] - edges_m) - reach[:, None]
    assert gaps.min() >= model.level_margin_m - 1e-6


def test_a_robot_that_does_not_climb_is_told_so():
    model = replace(get_robot("jvrc1").step_model, limits=replace(LIMITS, z_m=(-0.01, 0.01)))
    model = replace(model, steps=((0.3, 0.2, 0.0), (0.0, 0.2, 0.0), (0.0, 0.2, 0.3)))
    plan = plan_footsteps(
        STAIRS_MAP, model, start=(0, 0, 0), goal=(8, 0, 0), options=PlannerOptions(refine=False)
    )
    assert plan.status is PlanStatus.NO_PATH
    assert plan.reason.endswith("steps go from -0.01 to 0.01 m")


def test_the_independent_check_finds_wrong_heights():
    model = get_robot("jvrc1").step_model
    plan = plan_footsteps(
        STAIRS_MAP, model, start=(0, 0, 0), goal=(4.1, 0, 0), options=PlannerOptions(refine=False)
    )
    poses = plan.pose_world.copy()
    poses[-5, 2] += 0.01
    lines = violations(replace(plan, pose_world=poses), STAIRS_MAP, model)
    assert any("is not the height of the ground" in line for line in lines)
    assert any("rise 0.1100 is outside" in line for line in lines)
    poses = plan.pose_world.copy()
    poses[-5, 0] += 0.06
    assert any(
        "is not level" in line
        for line in violations(replace(plan, pose_world=poses), STAIRS_MAP, model)
    )
    flat = replace(STAIRS_MAP, elevation_m=None)
    assert any("flat floor" in line for line in violations(plan, flat, model))


def test_the_picture_shades_the_floor_by_its_height():
    model = get_robot("jvrc1").step_model
    plan = plan_footsteps(
        STAIRS_MAP, model, start=(0, 0, 0), goal=(0.5, 0, 0), options=PlannerOptions(refine=False)
    )
    image = draw_plan(plan, STAIRS_MAP, model)
    scale = image.shape[1] / STAIRS_MAP.size_m[0]

    def shade(x_m):
        return int(image[round((2.5 - 0.55) * scale), round((x_m + 2.0) * scale)].sum())

    shades = [shade(1.85 + 0.3 * i) for i in range(7)]
    assert all(np.diff(shades) < 0)
    assert shade(-1.15) == shades[0]
