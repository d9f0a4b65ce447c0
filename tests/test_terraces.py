"""Floor and walls as boxes of equal height: they cover what they should, and nothing twice."""

from __future__ import annotations

import numpy as np
import pytest

from maps.grid import Cell, OccupancyGrid
from maps.map_files import load_map
from maps.obstacles import obstacle_boxes
from maps.terraces import plates_of, terraces_of


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
