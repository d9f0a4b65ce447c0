"""Pictures of plans and walks: what is drawn stands where it belongs, in any frame of the map."""

from __future__ import annotations

import math

import numpy as np
import pytest

from app.output import InputError, write_picture
from app.pictures.canvas import (
    BODY,
    INK,
    LEFT,
    PLANNED,
    RIGHT,
    Canvas,
    body_path,
    draw_plan,
    sole_corners,
)
from app.pictures.plan_pictures import Swatch, plan_picture, walk_picture, with_legend
from maps.grid import Cell, OccupancyGrid
from planner.plan import FootstepPlan, PlanStatus, feet_at
from planner.robot_model import FootShape, Side
from sim.robots import get_robot
from tests.planner_floor import FLOOR, plan_on_lattice, small_plan
from tests.planner_oracle import small_model
from tests.programs import picture_at

MODEL = get_robot("jvrc1").step_model


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
    plan = plan_on_lattice(grid, small_model(), start=(10, 10, 0), goal=(11, 10, 0))
    image = draw_plan(plan, grid, small_model())
    # About 1 m and 1.5 m on each side wide, 0.2 m and the same high.
    assert image.shape[1] / image.shape[0] == pytest.approx(4.0 / 3.2, rel=0.1)


def test_a_failed_plan_and_a_tiny_map_can_be_drawn():
    grid = OccupancyGrid(cells=np.full((1, 3), Cell.UNKNOWN, np.uint8), resolution_m=0.05)
    plan = plan_on_lattice(grid, small_model(), start=(0.1, 0.02, 0), goal=(9, 9, 0))
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


def free_map(origin: tuple[float, float, float] = (-2.0, -1.0, 0.0)) -> OccupancyGrid:
    """A free map of 4 x 2 m."""
    cells = np.full((20, 40), Cell.FREE, np.uint8)
    return OccupancyGrid(cells=cells, resolution_m=0.1, origin=origin)


def plan_of(*poses: tuple[float, float, float, float]) -> FootstepPlan:
    """A plan of these feet, right foot first."""
    return FootstepPlan(
        start_feet_world=feet_at((-1.5, 0.5, 0), MODEL.stance_width_m),
        start=(-1.5, 0.5, 0),
        goal=(1.5, 0.5, 0),
        side=np.array([(number + 1) % 2 for number in range(len(poses))], np.int8),
        pose_world=np.array(poses).reshape(-1, 4),
        robot="jvrc1",
        map="maps/test.png",
    )


def walked_picture(grid, plan, placed_world, body_xy_world) -> np.ndarray:
    return walk_picture(
        grid,
        MODEL,
        plan,
        placed_side=plan.side,
        placed_world=placed_world,
        body_xy_world=np.array(body_xy_world),
    )


def colour_at(picture: np.ndarray, grid: OccupancyGrid, x_m: float, y_m: float) -> np.ndarray:
    """Blue, green, red where the picture shows a point of the world."""
    column, row = Canvas(grid).pixels((x_m, y_m)) // 16
    return picture[row, column].astype(int)


def is_like(shown: np.ndarray, colour: tuple[int, int, int]) -> bool:
    """Whether the shown colour is the colour mixed with a light floor."""
    return np.ptp(shown) > 30 and bool((np.argsort(shown) == np.argsort(colour)).all())


@pytest.mark.parametrize("origin", [(-2.0, -1.0, 0.0), (5.0, -3.0, 0.7), (0.0, 0.0, math.pi)])
def test_feet_are_drawn_where_they_came_down(origin):
    grid = free_map(origin)
    # In the grid's own frame: planned on one line, placed on another below it.
    planned, placed = (
        np.column_stack([grid.grid_to_world([(2.5, y_m), (2.9, y_m)]), [[0, origin[2]]] * 2])
        for y_m in (0.7, 0.3)
    )
    plan = plan_of(*planned)
    picture = walked_picture(grid, plan, placed, np.zeros((0, 2)))
    for number, colour in enumerate((RIGHT, LEFT)):
        assert is_like(colour_at(picture, grid, *placed[number, :2]), colour)
        # A planned foot is an outline: paper in the middle, dark at its front edge.
        assert colour_at(picture, grid, *planned[number, :2]).min() > 200
        box = sole_corners(planned[number], MODEL.foot)
        assert colour_at(picture, grid, *(box[0] + box[3]) / 2).max() < 120


def test_the_path_of_the_body_is_drawn():
    grid = free_map()
    plan = plan_of()
    picture = walked_picture(grid, plan, plan.pose_world, [[0.2, -0.8], [1.8, -0.8]])
    assert tuple(colour_at(picture, grid, 1.2, -0.8)) == BODY
    assert tuple(colour_at(picture, grid, 0.1, -0.8)) != BODY


def test_corners_of_a_turned_foot():
    foot = FootShape(length_m=0.2, width_m=0.1)
    corners = sole_corners((1.0, 2.0, 0.0, math.pi / 2), foot)
    expected = {(0.95, 2.1), (0.95, 1.9), (1.05, 1.9), (1.05, 2.1)}
    assert {(round(x, 9), round(y, 9)) for x, y in corners} == expected


def test_a_large_map_is_cut_to_the_surroundings_of_the_walk():
    cells = np.zeros((400, 2000), np.uint8)
    grid = OccupancyGrid(cells=cells, resolution_m=0.05, origin=(-50.0, -10.0, 0.0))
    plan = plan_of()
    body_xy_world = [[-1.5, 0.5], [0.0, 1.5], [1.5, 0.5]]
    picture = walked_picture(grid, plan, plan.pose_world, body_xy_world)
    # 3 m of walk with 1.5 m on either side, at 240 pixels per metre.
    assert picture.shape[1] == 6 * 240
    assert 4 * 240 < picture.shape[0] < 4 * 240 + 140


def test_names_of_start_and_goal_cover_nothing_that_is_drawn():
    canvas, bare = Canvas(free_map()), Canvas(free_map())
    start, goal = (-1.0, 0.0, 0.0), (1.0, 0.0, 0.0)
    # Behind both, where their names would stand else, and above.
    for x_m in (-1.4, 0.6):
        canvas.line([[x_m, -1.0], [x_m, 1.0]], BODY, 0.02)
    canvas.line([[-2.0, 0.3], [2.0, 0.3]], BODY, 0.02)
    lines = (canvas.image == BODY).all(axis=2)
    for picture in (canvas, bare):
        picture.ends(start, goal)
    assert (canvas.image[lines] == BODY).all()
    # The names are there: without the lines they stand elsewhere.
    assert (canvas.image != bare.image)[~lines].any()


@pytest.mark.parametrize("yaw_rad", [0.0, math.pi / 2])
def test_the_scale_bar_is_as_long_as_it_says(yaw_rad):
    """1 m of 240 pixels does not fit beside the axes, half a metre does."""
    grid = free_map((-2.0, -1.0, yaw_rad))
    canvas = Canvas(grid)
    assert canvas.px_per_m == 240
    whole = with_legend(canvas.image, "", [], canvas=canvas)
    band = whole[canvas.image.shape[0] :]
    # Without the axes, to the right of it.
    dark = (band == INK).all(axis=2)[:, : band.shape[1] - 110]
    assert dark.sum(axis=1).max() == pytest.approx(0.5 * 240, abs=4)


@pytest.mark.filterwarnings("ignore:.*encountered in:RuntimeWarning")
@pytest.mark.parametrize("far_m", [50.0, 1e12, 1e300])
def test_a_goal_off_the_map_does_no_harm(far_m):
    plan = FootstepPlan(
        start_feet_world=feet_at((0, 0, 0), 0.2),
        start=(0, 0, 0),
        goal=(far_m, -far_m, 0),
        status=PlanStatus.OFF_MAP,
        reason=f"goal {far_m:g},{-far_m:g} is off the map " * 9,
    )
    assert plan_picture(free_map(), MODEL, plan).shape[1] == 960


def test_the_legend_breaks_into_rows_and_widens_narrow_pictures():
    swatches = [Swatch(colour=PLANNED, text="an entry of the legend")] * 7
    picture = np.zeros((10, 20, 3), np.uint8)
    whole = with_legend(picture, "title " * 30, swatches)
    assert whole.shape[1] == 640
    np.testing.assert_array_equal(whole[:10, :20], 0)
    assert (whole[:10, 20:] == 255).all()
    # Three lines of title, and four rows: of entries of 248 pixels, two fit into one.
    assert whole.shape[0] == 10 + (3 + 4) * 26 + 12


def test_a_strip_of_text_for_no_title_at_all():
    assert with_legend(np.zeros((10, 700, 3), np.uint8), "", []).shape == (10 + 26 + 12, 700, 3)


def test_an_ending_that_is_no_image_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"must end in \.png"):
        write_picture(tmp_path / "path.txt", np.zeros((2, 2, 3), np.uint8))
    assert list(tmp_path.iterdir()) == []


def test_pictures_are_written_blue_green_red(tmp_path):
    write_picture(tmp_path / "a.png", np.full((2, 2, 3), (1, 2, 3), np.uint8))
    assert tuple(picture_at(tmp_path / "a.png")[0, 0]) == (1, 2, 3)
