"""The picture of a plan: what is drawn stands where it belongs, whatever the map's frame."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from app.errors import InputError
from app.map_canvas import FREE, OCCUPIED, UNKNOWN, MapCanvas, Swatch
from app.output import write_picture
from app.path_picture import BODY, FOOT_COLOURS, GOAL, foot_boxes, path_picture, write_path_picture
from maps.grid import Cell, OccupancyGrid
from planner.model import FootShape, Side
from planner.plan import FootstepPlan, PlanStatus, feet_at
from sim.robots import get_robot

MODEL = get_robot("jvrc1").step_model


def grid_of(origin: tuple[float, float, float] = (-2.0, -1.0, 0.0)) -> OccupancyGrid:
    """A free map of 4 x 2 m with its lower-left quarter occupied, its upper right unknown."""
    cells = np.full((20, 40), Cell.FREE, np.uint8)
    cells[:10, :20] = Cell.OCCUPIED
    cells[10:, 20:] = Cell.UNKNOWN
    return OccupancyGrid(cells=cells, resolution_m=0.1, origin=origin)


def plan_of(*poses: tuple[float, float, float, float]) -> FootstepPlan:
    """A plan of these feet, right foot first."""
    return FootstepPlan(
        start_feet_world=feet_at((-1.5, 0.5, 0), MODEL.stance_width_m),
        start=(-1.5, 0.5, 0),
        goal=(1.5, -0.5, 0),
        side=np.array([(number + 1) % 2 for number in range(len(poses))], np.int8),
        pose_world=np.array(poses).reshape(-1, 4),
        robot="jvrc1",
        map="maps/test.png",
    )


def pixel(picture: np.ndarray, grid: OccupancyGrid, x_m: float, y_m: float) -> np.ndarray:
    """The pixel that shows a point of the world; the long side of the map has 1280."""
    across_m, up_m = grid.world_to_grid((x_m, y_m))
    px_per_m = 1280 / grid.size_m[0]
    return picture[int(grid.size_m[1] * px_per_m - up_m * px_per_m), int(across_m * px_per_m)]


@pytest.mark.parametrize("origin", [(-2.0, -1.0, 0.0), (5.0, -3.0, 0.7), (0.0, 0.0, math.pi)])
def test_cells_are_where_the_map_says(origin):
    grid = grid_of(origin)
    picture = MapCanvas(grid).finished("", [])
    for across_m, up_m, colour in ((1, 0.5, OCCUPIED), (3, 0.5, FREE), (3, 1.5, UNKNOWN)):
        x_m, y_m = grid.grid_to_world((across_m, up_m))
        assert tuple(pixel(picture, grid, x_m, y_m)) == colour


def test_placed_feet_are_filled_and_planned_ones_are_outlines():
    grid = grid_of()
    plan = plan_of((0.5, -0.3, 0, 0.0), (0.9, -0.3, 0, 0.0))
    placed_world = np.array([[0.5, -0.7, 0, 0.0], [0.9, -0.7, 0, 0.0]])
    alone = path_picture(grid, MODEL, plan)
    walked = path_picture(grid, MODEL, plan, placed_side=plan.side, placed_world=placed_world)
    for x_m, side in ((0.5, Side.RIGHT), (0.9, Side.LEFT)):
        colour = np.array(FOOT_COLOURS[side])
        strongest = colour.argmax()
        for picture, y_m, filled in (
            *((alone, -0.3, True), (alone, -0.7, False)),
            *((walked, -0.3, False), (walked, -0.7, True)),
        ):
            shown = pixel(picture, grid, x_m, y_m)
            assert (tuple(shown) != FREE) is filled
            assert not filled or shown.argmax() == strongest
        # The border of the planned foot: its front edge is half a foot ahead.
        assert tuple(pixel(walked, grid, x_m + MODEL.foot.length_m / 2, -0.3)) != FREE


def test_the_path_of_the_body_is_drawn():
    grid = grid_of()
    body_xy_world = np.array([[0.2, -0.8], [1.8, -0.8]])
    picture = path_picture(grid, MODEL, plan_of(), body_xy_world=body_xy_world)
    assert tuple(pixel(picture, grid, 1.0, -0.8)) == BODY


def test_the_goal_points_along_its_heading():
    grid = grid_of()
    picture = path_picture(grid, MODEL, plan_of())
    assert tuple(pixel(picture, grid, 1.5 + 0.25, -0.5)) == GOAL
    assert tuple(pixel(picture, grid, 1.5 - 0.25, -0.5)) == FREE


def test_corners_of_a_turned_foot():
    foot = FootShape(length_m=0.2, width_m=0.1)
    (corners,) = foot_boxes(np.array([[1.0, 2.0, 0.0, math.pi / 2]]), foot)
    expected = {(0.95, 2.1), (0.95, 1.9), (1.05, 1.9), (1.05, 2.1)}
    assert {(round(x, 9), round(y, 9)) for x, y in corners} == expected


def test_a_goal_far_off_the_map_does_no_harm():
    plan = FootstepPlan(
        start_feet_world=feet_at((0, 0, 0), 0.2),
        start=(0, 0, 0),
        goal=(1e12, -1e300, 0),
        status=PlanStatus.OFF_MAP,
        reason="goal 1e+12,-1e+300 is off the map " * 9,
    )
    with np.errstate(over="ignore"):
        picture = path_picture(grid_of(), MODEL, plan)
    assert picture.shape[1] == 1280


@pytest.mark.parametrize("shape", [(1, 1), (3, 5000), (4000, 30)])
def test_no_map_is_too_small_or_too_large(shape):
    grid = OccupancyGrid(cells=np.zeros(shape, np.uint8), resolution_m=0.05)
    swatches = [Swatch(colour=GOAL, text="an entry of the legend")] * 7
    height, width = MapCanvas(grid).finished("title", swatches).shape[:2]
    assert 640 <= width <= 3000
    assert 50 <= height <= 3200


def test_it_is_written_as_a_png(tmp_path):
    write_path_picture(tmp_path / "path.png", grid_of(), MODEL, plan_of())
    picture = cv2.imread(str(tmp_path / "path.png"))
    assert picture is not None
    # OpenCV reads blue, green, red.
    assert tuple(pixel(picture, grid_of(), -1, -0.5))[::-1] == OCCUPIED


def test_an_ending_that_is_no_image_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"must end in \.png"):
        write_picture(tmp_path / "path.txt", np.zeros((2, 2, 3), np.uint8))
    assert list(tmp_path.iterdir()) == []
