"""The grid's frames, obstacle rectangles, the distance field and the project's own maps."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from maps.boxes import merge_rectangles, obstacle_boxes, plates_of, terraces_of
from maps.grid import Cell, OccupancyGrid, distance_field
from maps.make_maps import OFFICE, ROOM, SILLS, STAIRS, write
from maps.map_files import load_map

MAPS = Path(__file__).parents[1] / "maps"


def test_a_turned_grid_puts_a_cell_where_a_hand_drawing_does():
    # Origin 2, 3 turned by a quarter: the grid's x runs along the world's y.
    grid = OccupancyGrid(
        cells=np.zeros((4, 6), np.uint8), resolution_m=0.5, origin=(2.0, 3.0, math.pi / 2)
    )
    np.testing.assert_allclose(grid.cell_to_world((0, 0)), (1.75, 3.25))
    np.testing.assert_allclose(grid.cell_to_world((1, 3)), (1.25, 4.75))
    assert grid.world_to_cell((1.2, 4.8)).tolist() == [1, 3]
    np.testing.assert_allclose(grid.bounds_world(), (0.0, 3.0, 2.0, 6.0))
    assert grid.contains([[1.0, 5.9], [2.1, 4.0]]).tolist() == [True, False]


def test_cells_and_world_are_inverse_on_a_slanted_grid():
    grid = OccupancyGrid(
        cells=np.zeros((7, 5), np.uint8), resolution_m=0.1, origin=(-3.0, 1.5, 0.7)
    )
    cells = np.moveaxis(np.indices((7, 5)), 0, -1)
    np.testing.assert_array_equal(grid.world_to_cell(grid.cell_to_world(cells)), cells)
    points = np.random.default_rng(0).uniform(-5, 5, (50, 2))
    np.testing.assert_allclose(grid.grid_to_world(grid.world_to_grid(points)), points)


def test_unknown_blocks_unless_told_otherwise():
    grid = OccupancyGrid(
        cells=np.array([[Cell.FREE, Cell.OCCUPIED, Cell.UNKNOWN]], np.uint8), resolution_m=1.0
    )
    assert grid.blocked().tolist() == [[False, True, True]]
    assert grid.blocked(unknown_is_free=True).tolist() == [[False, True, False]]


def test_a_grid_keeps_its_own_cells():
    cells = np.zeros((2, 2), np.uint8)
    grid = OccupancyGrid(cells=cells, resolution_m=1.0)
    cells[0, 0] = Cell.OCCUPIED
    assert not grid.blocked().any()
    with pytest.raises(ValueError, match="read-only"):
        grid.cells[0, 0] = 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"resolution_m": 0.0}, "resolution_m 0.0"),
        ({"resolution_m": math.nan}, "resolution_m nan"),
        ({"cells": np.zeros((0, 3), np.uint8)}, r"cells \(0, 3\)"),
        ({"cells": np.full((2, 2), 3, np.uint8)}, "cell value 3"),
        ({"origin": (0.0, math.inf, 0.0)}, "origin"),
    ],
)
def test_a_grid_that_makes_no_sense_is_refused(change, message):
    fields = {"cells": np.zeros((2, 2), np.uint8), "resolution_m": 1.0, **change}
    with pytest.raises(ValueError, match=message):
        OccupancyGrid(**fields)


@pytest.mark.parametrize("seed", range(6))
def test_rectangles_tile_the_blocked_cells_exactly(seed):
    rng = np.random.default_rng(seed)
    blocked = cv2.resize(rng.random((9, 12)), (40, 31), interpolation=cv2.INTER_NEAREST) < 0.5
    blocked ^= rng.random(blocked.shape) < 0.03
    count = np.zeros(blocked.shape, int)
    rectangles = merge_rectangles(blocked)
    for row0, col0, row1, col1 in rectangles:
        assert row1 > row0
        assert col1 > col0
        count[row0:row1, col0:col1] += 1
    np.testing.assert_array_equal(count, blocked.astype(int))
    assert 0 < len(rectangles) < blocked.sum() / 2


def test_a_cross_becomes_three_boxes_and_nothing_becomes_none():
    cross = np.zeros((5, 7), bool)
    cross[2, :] = True
    cross[:, 3] = True
    assert len(merge_rectangles(cross)) == 3
    assert merge_rectangles(np.zeros((3, 3), bool)).shape == (0, 4)


def test_a_box_of_cells_has_its_place_in_metres():
    blocked = np.zeros((4, 10), bool)
    blocked[1:3, 4:9] = True
    np.testing.assert_allclose(obstacle_boxes(blocked, 0.2), [[1.3, 0.4, 0.5, 0.2]])


def test_distances_never_exceed_the_true_ones_and_are_tight():
    rng = np.random.default_rng(3)
    blocked = rng.random((23, 31)) < 0.02
    size = 0.1
    field = distance_field(blocked, size)
    wall = np.ones((25, 33), bool)
    wall[1:-1, 1:-1] = blocked
    rows, cols = np.nonzero(wall)
    compared = 0
    for row, col in np.ndindex(blocked.shape):
        # To the nearest point of each blocked square, the rim of outside cells included.
        dx = np.maximum(np.abs(cols - 1 - col) - 0.5, 0.0)
        dy = np.maximum(np.abs(rows - 1 - row) - 0.5, 0.0)
        true_m = 0.0 if blocked[row, col] else size * np.hypot(dx, dy).min()
        assert field[row, col] <= true_m + 1e-6
        assert field[row, col] >= true_m - 0.25 * size
        compared += 1
    assert compared == 23 * 31


@pytest.mark.parametrize("plan", [ROOM, OFFICE, STAIRS, SILLS], ids=lambda plan: plan.name)
def test_the_committed_maps_are_the_drawn_ones(plan, tmp_path):
    write(plan, tmp_path)
    drawn = sorted(tmp_path.iterdir())
    assert len(drawn) == (2 if plan in (ROOM, OFFICE) else 3)
    for path in drawn:
        if path.suffix == ".yaml":
            assert (MAPS / path.name).read_text() == path.read_text()
        else:
            committed, new = (cv2.imread(str(p), -1) for p in (MAPS / path.name, path))
            np.testing.assert_array_equal(committed, new)
    x0, y0, x1, y1 = plan.bounds
    np.testing.assert_allclose(
        load_map(MAPS / f"{plan.name}.yaml").bounds_world(), (x0, y0, x1, y1)
    )


def test_the_room_blocks_the_straight_way_but_neither_end():
    grid = load_map(MAPS / "room.yaml")
    line = np.linspace((0.0, 0.0), (2.0, 1.0), 200)
    row, col = grid.world_to_cell(line).T
    assert grid.blocked()[row, col].any()
    clear_m = distance_field(grid.blocked(), grid.resolution_m)
    for end in ((0.0, 0.0), (2.0, 1.0)):
        row, col = grid.world_to_cell(end)
        assert clear_m[row, col] > 0.7


def test_the_room_has_a_passage_of_nine_tenths_of_a_metre():
    grid = load_map(MAPS / "room.yaml")
    # Between the bookcases, along the line x = 1.
    y = np.arange(-2.4, 3.4, 0.025) + 0.0125
    row, col = grid.world_to_cell(np.column_stack([np.full(len(y), 1.0125), y])).T
    free = ~grid.blocked()[row, col]
    upper = y[free & (y > 1.5)]
    assert upper.max() - upper.min() + 0.025 == pytest.approx(0.9)


def test_the_distance_field_is_exact_to_the_bit():
    # Whole squares by brute force: a transform whose last bits change from call to call fails.
    rng = np.random.default_rng(3)
    for _ in range(3):
        blocked = rng.random((37, 52)) < 0.02
        padded = np.pad(blocked, 1, constant_values=True)
        row, col = np.nonzero(padded)
        place = np.indices(padded.shape)[..., None]
        squares = ((place[0] - row) ** 2 + (place[1] - col) ** 2).min(axis=-1)
        cells = np.sqrt(squares[1:-1, 1:-1].astype(np.float32))
        nearest = np.maximum(cells - np.float32(np.sqrt(0.5) + 1e-4), np.float32(0.5))
        expected = np.where(blocked, np.float32(0.0), nearest * np.float32(0.05))
        np.testing.assert_array_equal(distance_field(blocked, 0.05), expected)


# Floor and walls as boxes of equal height: they cover what they should, and nothing twice.


def height_at(boxes, x, y):
    """Heights of the boxes (n, 5) that hold a point."""
    inside = np.all(np.abs(boxes[:, :2] - (x, y)) < boxes[:, 2:4], axis=1)
    return boxes[inside, 4].tolist()


@pytest.mark.parametrize("seed", range(5))
def test_boxes_cover_every_cell_once_at_its_height(seed):
    rng = np.random.default_rng(seed)
    cells = np.where(rng.random((12, 17)) < 0.2, Cell.OCCUPIED, Cell.FREE).astype(np.uint8)
    heights = rng.choice([-0.2, 0.0, 0.1, 0.3], (12, 17))
    heights[0, 0], cells[0, 0] = -0.2, Cell.FREE
    grid = OccupancyGrid(cells=cells, resolution_m=0.1, elevation_m=heights)
    terraces = terraces_of(grid, grid.blocked())
    assert terraces.lowest_m == -0.2
    compared = 0
    for row, col in np.ndindex(12, 17):
        x, y = 0.1 * col + 0.05, 0.1 * row + 0.05
        ground, wall = height_at(terraces.ground, x, y), height_at(terraces.walls, x, y)
        if grid.blocked()[row, col]:
            assert (len(ground), len(wall)) == (0, 1)
            assert wall[0] >= heights[row, col]
        elif heights[row, col] == -0.2:
            assert (ground, wall) == ([], [])
        else:
            assert (ground, wall) == ([pytest.approx(heights[row, col])], [])
        compared += 1
    assert compared == 12 * 17
    plates = plates_of(grid, grid.blocked())
    assert len(plates) > 0
    for row, col in np.argwhere(grid.blocked()):
        at = height_at(plates, 0.1 * col + 0.05, 0.1 * row + 0.05)
        assert at == [pytest.approx(heights[row, col])]


def test_a_flat_map_has_walls_on_the_floor_and_no_ground():
    grid = load_map("maps/room.yaml")
    terraces = terraces_of(grid, grid.blocked())
    assert terraces.ground.shape == (0, 5)
    assert terraces.lowest_m == 0
    expected = obstacle_boxes(grid.blocked(), grid.resolution_m)
    np.testing.assert_array_equal(terraces.walls[:, :4], expected)
    assert not terraces.walls[:, 4].any()


def test_walls_rise_from_the_higher_floor_beside_them():
    # A wall in a hollow, 0.3 m from a platform and 0.8 m from another: nobody steps over it.
    cells = np.zeros((20, 30), np.uint8)
    cells[:, 12:14] = Cell.OCCUPIED
    heights = np.zeros((20, 30))
    heights[:, :9], heights[:, 22:] = 1.5, 3.0
    grid = OccupancyGrid(cells=cells, resolution_m=0.1, elevation_m=heights)
    walls = terraces_of(grid, grid.blocked()).walls
    assert len(walls) == 1
    assert walls[0, 4] == 1.5


def test_the_stairs_are_few_boxes():
    grid = load_map("maps/stairs.yaml")
    terraces = terraces_of(grid, grid.blocked())
    assert len(terraces.ground) == 11
    assert sorted(set(np.round(terraces.ground[:, 4], 3))) == [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
    assert len(terraces.walls) < 60


def test_ground_without_a_free_cell_lies_at_zero():
    cells = np.full((2, 2), Cell.OCCUPIED, np.uint8)
    grid = OccupancyGrid(cells=cells, resolution_m=0.1, elevation_m=np.full((2, 2), 0.5))
    terraces = terraces_of(grid, grid.blocked())
    assert (len(terraces.ground), terraces.lowest_m) == (0, 0.0)
