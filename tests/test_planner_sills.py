"""What is low is stepped over: the map says so by its heights, and what it calls a wall is one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from shapely import affinity

from maps.grid import Cell, OccupancyGrid
from maps.map_files import load_map
from planner.options import PlannerOptions
from planner.plan import PlanStatus
from planner.planner import plan_footsteps
from planner.verify import violations
from sim.robots import get_robot

SILLS_MAP = load_map("maps/sills.yaml")
MODEL = get_robot("jvrc1").step_model
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


def bars_between(start, goal):
    low, high = sorted((start[0], goal[0]))
    return [(x0, x1) for x0, x1 in BARS_M if low < x0 < high]


@pytest.mark.parametrize("refine", [False, True])
@pytest.mark.parametrize(("start", "goal"), WAYS)
def test_sills_are_stepped_over_and_never_on(start, goal, refine):
    options = PlannerOptions(refine=refine)
    plan = plan_footsteps(SILLS_MAP, MODEL, start=start, goal=goal, options=options)
    assert plan.found
    assert violations(plan, SILLS_MAP, MODEL) == []
    assert (plan.pose_world[:, 2] == 0.0).all()
    soles = [sole_of(pose) for pose in plan.pose_world]
    crossed = bars_between(start, goal)
    assert crossed
    for x0, x1 in crossed:
        bar = shapely.box(x0, -2.0, x1, 3.0)
        assert min(sole.distance(bar) for sole in soles) >= MODEL.level_margin_m - 1e-6
        sides = {sole.centroid.x > x1 for sole in soles}
        assert sides == {True, False}


def test_sills_higher_than_the_foot_swings_are_in_the_way():
    low = replace(MODEL, swing_clear_m=0.049)
    plan = plan_footsteps(
        SILLS_MAP, low, start=(0, 0, 0), goal=(2.3, 0, 0), options=PlannerOptions(refine=False)
    )
    assert plan.status is PlanStatus.NO_PATH


def test_the_same_bars_as_obstacles_shut_the_doors():
    cells = np.array(SILLS_MAP.cells)
    for x0, x1 in BARS_M:
        cols = slice(round((x0 + 2.0) / 0.025), round((x1 + 2.0) / 0.025))
        cells[:, cols] = Cell.OCCUPIED
    walls = OccupancyGrid(cells=cells, resolution_m=0.025, origin=SILLS_MAP.origin)
    plan = plan_footsteps(
        walls, MODEL, start=(0, 0, 0), goal=(6, 2, 0), options=PlannerOptions(refine=False)
    )
    assert plan.status is PlanStatus.NO_PATH


@pytest.mark.parametrize("name", ["astar", "backward", "adstar", "rstar", "rrtconnect"])
def test_every_planner_finds_the_way_over_a_bar_that_is_the_only_one(name):
    # The fault of humanoid_navigation's default heuristic, which takes such a bar for a wall.
    plan = plan_footsteps(
        SILLS_MAP,
        MODEL,
        start=(2.2, 0, 0),
        goal=(3.8, 0.4, 0),
        options=PlannerOptions(name=name, refine=False),
    )
    assert plan.found
    assert violations(plan, SILLS_MAP, MODEL) == []
