"""Plans on uneven floors: stairs with feet well inside the treads, and sills to step over."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from shapely import affinity

from app.pictures.canvas import draw_plan
from maps.map_files import load_map
from planner.endpoints import Footing
from planner.options import PlannerOptions
from planner.planner import Planner, plan_footsteps
from planner.verify import violations
from sim.robots import get_robot
from tests.planner_floor import plan_on_lattice

STAIRS_MAP = load_map("maps/stairs.yaml")
MODEL = get_robot("jvrc1").step_model


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
    plan = plan_on_lattice(STAIRS_MAP, model, start=start, goal=goal)
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


def test_the_independent_check_finds_wrong_heights():
    plan = plan_on_lattice(STAIRS_MAP, MODEL, start=(0, 0, 0), goal=(4.1, 0, 0))

    def wrongs(moved_m, grid=STAIRS_MAP):
        poses = plan.pose_world.copy()
        poses[-5, :3] += moved_m
        return "\n".join(violations(replace(plan, pose_world=poses), grid, MODEL))

    lifted = wrongs((0, 0, 0.01))
    assert "is not the height of the ground" in lifted
    assert "rise 0.1100 is outside" in lifted
    assert "is not level" in wrongs((0.06, 0, 0))
    assert "flat floor" in wrongs((0, 0, 0), replace(STAIRS_MAP, elevation_m=None))


def test_the_picture_shades_the_floor_by_its_height():
    plan = plan_on_lattice(STAIRS_MAP, MODEL, start=(0, 0, 0), goal=(0.5, 0, 0))
    image = draw_plan(plan, STAIRS_MAP, MODEL)
    scale = image.shape[1] / STAIRS_MAP.size_m[0]

    def shade(x_m):
        return int(image[round((2.5 - 0.55) * scale), round((x_m + 2.0) * scale)].sum())

    shades = [shade(1.85 + 0.3 * i) for i in range(7)]
    assert all(np.diff(shades) < 0)
    assert shade(-1.15) == shades[0]


SILLS_MAP = load_map("maps/sills.yaml")
WAYS = [
    ((0, 0, 0), (6, 2, 0)),
    ((5.5, 0.5, 2.5), (-1.0, -1.0, -1.57)),
    ((2.2, 0, 3.1), (3.8, 0, 0)),
]
# x from and to, over all of y that is not blocked.
BARS_M = ((1.525, 1.575), (3.0, 3.05), (4.525, 4.575))


def sole_of(pose):
    """The sole of a foot pose (4,) in the world."""
    foot = MODEL.foot
    box = shapely.box(-foot.length_m / 2, -foot.width_m / 2, foot.length_m / 2, foot.width_m / 2)
    box = affinity.rotate(box, pose[3], origin=(0, 0), use_radians=True)
    return affinity.translate(box, pose[0], pose[1])


@pytest.mark.parametrize("refine", [False, True])
@pytest.mark.parametrize(("start", "goal"), WAYS)
def test_sills_are_stepped_over_and_never_on(start, goal, refine):
    options = PlannerOptions(refine=refine)
    plan = plan_footsteps(SILLS_MAP, MODEL, start=start, goal=goal, options=options)
    assert plan.found
    assert violations(plan, SILLS_MAP, MODEL) == []
    assert (plan.pose_world[:, 2] == 0.0).all()
    soles = [sole_of(pose) for pose in plan.pose_world]
    low, high = sorted((start[0], goal[0]))
    crossed = [(x0, x1) for x0, x1 in BARS_M if low < x0 < high]
    assert crossed
    for x0, x1 in crossed:
        bar = shapely.box(x0, -2.0, x1, 3.0)
        assert min(sole.distance(bar) for sole in soles) >= MODEL.level_margin_m - 1e-6
        sides = {sole.centroid.x > x1 for sole in soles}
        assert sides == {True, False}
    over_z_m = Footing(SILLS_MAP, MODEL, False).swing_over_z_m(plan)
    feet = plan.start_feet_world.copy()
    for side, pose, top_m in zip(plan.side, plan.pose_world, over_z_m, strict=True):
        xs = sorted((feet[side][0], pose[0]))
        is_over = any(xs[0] < x0 and x1 < xs[1] for x0, x1 in BARS_M)
        assert top_m == (pytest.approx(0.05) if is_over else -np.inf)
        feet[side] = pose


def test_steps_on_stairs_swing_over_nothing_but_their_own_ground():
    plan = plan_footsteps(STAIRS_MAP, MODEL, start=(0, 0, 0), goal=(7, 0, 0))
    assert plan.found
    assert np.ptp(plan.pose_world[:, 2]) > 0.5
    assert (Footing(STAIRS_MAP, MODEL, False).swing_over_z_m(plan) == -np.inf).all()


@pytest.mark.parametrize("name", ["astar", "backward", "adstar", "rstar", "rrtconnect"])
def test_every_planner_finds_the_way_over_a_bar_that_is_the_only_one(name):
    # The fault of humanoid_navigation's default heuristic, which takes such a bar for a wall.
    planner = Planner(SILLS_MAP, MODEL, PlannerOptions(name=name, refine=False))
    plan = planner.plan(start=(2.2, 0, 0), goal=(3.8, 0.4, 0))
    assert plan.found
    assert violations(plan, SILLS_MAP, MODEL) == []
