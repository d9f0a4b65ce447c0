"""Pictures of plans."""

from __future__ import annotations

import math
import re

import cv2
import numpy as np
import pytest

from app.pictures.canvas import LEFT, RIGHT, Canvas, body_path, draw_plan, write_picture
from maps.grid import Cell, OccupancyGrid
from planner.options import PlannerOptions
from planner.plan import PlanStatus
from planner.planner import plan_footsteps
from planner.robot_model import Side
from tests.planner_floor import FLOOR, small_plan
from tests.planner_oracle import small_model


@pytest.fixture(scope="module")
def plan():
    return small_plan()


def test_a_picture_shows_feet_where_they_are(plan):
    model = small_model()
    image = draw_plan(plan, FLOOR, model)
    height, width = image.shape[:2]
    assert width / height == pytest.approx(4 / 3, abs=0.01)
    scale = width / 4.0
    for side, pose in list(zip(plan.side, plan.pose_world, strict=True))[:-2]:
        # The toe mark is drawn in the foot's own colour, half a foot ahead of its centre.
        x_m, y_m = pose[0] + 0.06 * math.cos(pose[3]), pose[1] + 0.06 * math.sin(pose[3])
        colour = image[round(height - y_m * scale), round(x_m * scale)].astype(int)
        expected = LEFT if side == Side.LEFT else RIGHT
        assert np.abs(colour - expected).max() < 40


def test_a_large_map_is_cropped_to_the_plan():
    grid = OccupancyGrid(cells=np.zeros((200, 400), np.uint8), resolution_m=0.1)
    plan = plan_footsteps(
        grid,
        small_model(),
        start=(10, 10, 0),
        goal=(11, 10, 0),
        options=PlannerOptions(refine=False),
    )
    image = draw_plan(plan, grid, small_model())
    # About 1 m and 1.5 m on each side wide, 0.2 m and the same high.
    assert image.shape[1] / image.shape[0] == pytest.approx(4.0 / 3.2, rel=0.1)


def test_a_failed_plan_and_a_tiny_map_can_be_drawn():
    grid = OccupancyGrid(cells=np.full((1, 3), Cell.UNKNOWN, np.uint8), resolution_m=0.05)
    plan = plan_footsteps(
        grid,
        small_model(),
        start=(0.1, 0.02, 0),
        goal=(9, 9, 0),
        options=PlannerOptions(refine=False),
    )
    assert plan.status is PlanStatus.OFF_MAP
    assert draw_plan(plan, grid, small_model()).ndim == 3


def test_the_body_path_joins_start_and_goal(plan):
    path = body_path(plan)
    assert len(path) == len(plan) + 1
    np.testing.assert_allclose(path[0], plan.start, atol=1e-9)
    np.testing.assert_allclose(path[-1], plan.goal, atol=1e-9)


def test_a_canvas_and_its_map_agree_on_pixels():
    grid = OccupancyGrid(cells=np.zeros((20, 30), np.uint8), resolution_m=0.1, origin=(5, -2, 0.4))
    canvas = Canvas(grid)
    cells = np.array([[0, 0], [19, 29], [7, 11]])
    pixels = canvas.pixels(grid.cell_to_world(cells)) / 16
    size = canvas.image.shape[0] / 20
    np.testing.assert_allclose(pixels[:, 0], (cells[:, 1] + 0.5) * size - 0.5, atol=0.1)
    np.testing.assert_allclose(pixels[:, 1], (19.5 - cells[:, 0]) * size - 0.5, atol=0.1)


def test_pictures_are_written_or_refused_in_one_line(tmp_path, plan):
    image = draw_plan(plan, FLOOR, small_model())
    write_picture(image, str(tmp_path / "plan.png"))
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "plan.png")), image)
    for bad in (tmp_path / "none" / "plan.png", tmp_path / "plan.what"):
        with pytest.raises(OSError, match=re.escape(str(bad))):
            write_picture(image, str(bad))
