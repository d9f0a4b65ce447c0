"""Collision checks and the verifier of plans, against polygons."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from shapely import affinity

from maps.grid import OccupancyGrid
from planner.collision import box_free, point_clearance, terrain_of
from planner.plan import PlanStatus
from planner.verify import violations
from tests.planner_floor import FLOOR, blocked_at, small_plan
from tests.planner_oracle import small_model


def test_box_checks_agree_with_polygons_exactly():
    rng = np.random.default_rng(2)
    cells = (rng.random((40, 50)) < 0.04).astype(np.uint8)
    grid = OccupancyGrid(cells=cells, resolution_m=0.07)
    terrain = terrain_of(grid, False)
    row, col = np.nonzero(cells)
    squares = shapely.union_all(shapely.box(col, row, col + 1, row + 1))
    blocked = affinity.scale(squares, 0.07, 0.07, origin=(0, 0))
    shapely.prepare(blocked)
    floor = shapely.box(0, 0, 3.5, 2.8)
    hits = 0
    for x, y, yaw in rng.uniform((-0.1, -0.1, -4.0), (3.6, 2.9, 4.0), (3000, 3)):
        half_l, half_w = rng.uniform(0.01, 0.4, 2)
        box = shapely.box(-half_l, -half_w, half_l, half_w)
        box = affinity.rotate(box, yaw, origin=(0, 0), use_radians=True)
        box = affinity.translate(box, x, y)
        is_free = floor.covers(box) and not blocked.intersects(box)
        said = box_free(terrain, x, y, math.cos(yaw), math.sin(yaw), half_l, half_w)
        assert said == is_free
        hits += not is_free
    assert 500 < hits < 2900


def test_point_clearance_is_a_lower_bound():
    rng = np.random.default_rng(4)
    cells = (rng.random((20, 20)) < 0.02).astype(np.uint8)
    terrain = terrain_of(OccupancyGrid(cells=cells, resolution_m=0.1), False)
    row, col = np.nonzero(cells)
    blocked = shapely.union_all(shapely.box(col * 0.1, row * 0.1, col * 0.1 + 0.1, row * 0.1 + 0.1))
    outside = shapely.box(-9, -9, 9, 9).difference(shapely.box(0, 0, 2, 2))
    solid = blocked.union(outside)
    points = rng.uniform(-0.2, 2.2, (400, 2))
    told = np.array([point_clearance(terrain, x, y) for x, y in points])
    true_m = shapely.distance(solid, shapely.points(points))
    assert np.all(told <= true_m + 1e-6)
    assert told.max() > 0.3


@pytest.fixture(scope="module")
def plan():
    return small_plan()


def test_the_verifier_finds_every_kind_of_wrong(plan):
    model = small_model()
    assert violations(plan, FLOOR, model) == []

    def wrongs(**changes):
        return " ".join(violations(replace(plan, **changes), FLOOR, model))

    def moved(step, by):
        poses = np.array(plan.pose_world)
        poses[step] += by
        return wrongs(pose_world=poses)

    same = np.array(plan.side)
    same[1] = same[0]
    onto = plan.pose_world[2] - plan.pose_world[3]
    assert "is outside" in moved(2, (0.3, 0, 0, 0))
    assert "twice in a row" in wrongs(side=same)
    assert "not the goal's" in moved(-1, (1e-6, 0, 0, 0))
    assert "apart" in moved(3, (*onto[:2], 0, 0))
    assert "is not 0 on a flat floor" in moved(1, (0, 0, 0.1, 0))
    assert "not found" in wrongs(status=PlanStatus.NO_PATH)


@pytest.mark.parametrize(
    ("cell_of", "what"), [(0, "the foot hits"), (1, "the body on both feet hits")]
)
def test_the_verifier_finds_what_feet_and_body_hit(plan, cell_of, what):
    i = len(plan) // 2
    middle = (plan.pose_world[i] + plan.pose_world[i - 1]) / 2
    point = (plan.pose_world[i] if cell_of == 0 else middle)[:2]
    row, col = FLOOR.world_to_cell(point)
    assert what in " ".join(
        violations(plan, blocked_at((row, col, row + 1, col + 1)), small_model())
    )
