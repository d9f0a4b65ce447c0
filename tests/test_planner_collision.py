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

# So near to touching, check and polygons may disagree: the field is of single precision.
TOLERANCE_M = 2e-6


@pytest.mark.parametrize("share", [0.01, 0.04])
@pytest.mark.parametrize("size_m", [0.02, 0.07, 0.3])
def test_a_rounded_box_is_free_up_to_its_distance_from_cells_and_edge(size_m, share):
    rng = np.random.default_rng([int(1000 * size_m), int(100 * share)])
    cells = (rng.random((40, 50)) < share).astype(np.uint8)
    terrain = terrain_of(OccupancyGrid(cells=cells, resolution_m=size_m), False)
    row, col = np.nonzero(cells)
    squares = shapely.union_all(shapely.box(col, row, col + 1, row + 1))
    width_m, height_m = 50 * size_m, 40 * size_m
    outside = shapely.box(-9, -9, 50, 50).difference(shapely.box(0, 0, width_m, height_m))
    solid = outside.union(affinity.scale(squares, size_m, size_m, origin=(0, 0)))
    shapely.prepare(solid)
    poses = rng.uniform((-0.1, -0.1, -4.0), (width_m + 0.1, height_m + 0.1, 4.0), (1500, 3))
    apart, corners = 0, 0
    for x, y, yaw in poses:
        half_l, half_w = rng.uniform(0.01, min(5 * size_m, 0.4), 2)
        box = shapely.box(-half_l, -half_w, half_l, half_w)
        box = affinity.rotate(box, yaw, origin=(0, 0), use_radians=True)
        box = affinity.translate(box, x, y)
        pose = x, y, math.cos(yaw), math.sin(yaw)
        room_m = float(solid.distance(box))
        assert not box_free(terrain, *pose, (half_l, half_w, room_m + TOLERANCE_M))
        if room_m > TOLERANCE_M:
            assert box_free(terrain, *pose, (half_l, half_w, room_m - TOLERANCE_M))
            apart += 1
            # Nearest at two corners, where a box that is longer and wider by as much would touch.
            grown = half_l + room_m - TOLERANCE_M, half_w + room_m - TOLERANCE_M
            corners += not box_free(terrain, *pose, (*grown, 0.0))
    assert apart > 150
    assert corners > apart / 10


@pytest.mark.parametrize(
    ("col", "row", "is_free"),
    [
        (129, 140, True),  # 9 cm ahead of the box's corner and 9 cm beside it: 12.7 cm off
        (127, 138, False),  # 7 and 7 cm: 9.9 cm
        (130, 110, False),  # 10 cm ahead
        (132, 110, True),  # 12 cm
        (110, 141, False),  # 10 cm beside
        (110, 143, True),  # 12 cm
    ],
)
def test_the_corner_of_a_body_is_round_by_hand(col, row, is_free):
    """A body of 40 x 62 cm, margin 11 cm, in the middle of 2 x 2 m, and one cell of 1 cm."""
    cells = np.zeros((200, 200), np.uint8)
    cells[row, col] = 1
    terrain = terrain_of(OccupancyGrid(cells=cells, resolution_m=0.01), False)
    assert box_free(terrain, 1.0, 1.0, 1.0, 0.0, (0.20, 0.31, 0.11)) == is_free


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
