"""The picture of heights beside a map: how it is read, and one clear line for everything wrong."""

from __future__ import annotations

import warnings
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from maps.grid import Cell, OccupancyGrid
from maps.make_maps import SILLS, STAIRS, draw, draw_heights, write
from maps.map_files import MapError, MapWarning, load_map


@pytest.fixture
def write_map(tmp_path):
    """Writes a white map of 3 x 2 cells and, if given, a picture of heights; gives the YAML."""

    def _write(heights=None, suffix=".png", /, **keys):
        cv2.imwrite(str(tmp_path / "m.png"), np.full((2, 3), 255, np.uint8))
        document = {"image": "m.png", "resolution": 0.1, "origin": [1.0, 2.0, 0.0], "negate": 0}
        if heights is not None:
            assert cv2.imwrite(str(tmp_path / f"heights{suffix}"), np.asarray(heights))
            document |= {"elevation": f"heights{suffix}", "elevation_scale": 0.01}
        document |= keys
        document = {key: value for key, value in document.items() if value is not None}
        path = tmp_path / "m.yaml"
        path.write_text(yaml.safe_dump(document))
        return path

    return _write


def heights_of(grid):
    """Heights (H, W) as an array that is there."""
    assert grid.elevation_m is not None
    return np.asarray(grid.elevation_m)


GREYS = np.array([[0, 1, 255], [10, 20, 30]])


@pytest.mark.parametrize("suffix", [".png", ".bmp", ".pgm"])
def test_a_height_is_scale_times_grey_value_with_row_0_at_the_bottom(write_map, suffix):
    grid = load_map(write_map(GREYS.astype(np.uint8), suffix))
    assert heights_of(grid).tolist() == [[0.1, 0.2, 0.3], [0.0, 0.01, 2.55]]
    assert grid.height_m([[1.05, 2.05], [1.25, 2.15], [1.15, 2.05]]).tolist() == [0.1, 2.55, 0.2]


@pytest.mark.parametrize("suffix", [".png", ".pgm"])
def test_pictures_of_16_bits_have_65536_heights(write_map, suffix):
    greys = np.array([[0, 1000, 65535], [1, 2, 3]], np.uint16)
    grid = load_map(write_map(greys, suffix, elevation_scale=0.001, elevation_offset=-5.0))
    assert heights_of(grid).tolist() == [[-4.999, -4.998, -4.997], [-5.0, -4.0, 60.535]]


def test_grey_values_of_a_pgm_are_those_in_the_file(write_map, tmp_path):
    # Its white is 100; the map itself would be brightened to 255, heights must not be.
    path = write_map(GREYS.astype(np.uint8), ".pgm")
    (tmp_path / "heights.pgm").write_bytes(b"P5\n3 2\n100\n" + bytes([0, 1, 100, 10, 20, 30]))
    assert heights_of(load_map(path)).tolist() == [[0.1, 0.2, 0.3], [0.0, 0.01, 1.0]]


def test_colours_count_by_their_luminance(write_map):
    picture = np.repeat(GREYS.astype(np.uint8)[..., None], 3, axis=2)
    assert heights_of(load_map(write_map(picture)))[0].tolist() == [0.1, 0.2, 0.3]


def test_a_map_without_heights_is_flat(write_map):
    grid = load_map(write_map())
    assert grid.elevation_m is None
    assert grid.height_m([[1.05, 2.05], [-9.0, 0.0]]).tolist() == [0.0, 0.0]


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"elevation": 3}, "elevation 3 must be the name of a picture of heights"),
        ({"elevation_scale": None}, "key `elevation_scale` is missing: metres per grey value"),
        ({"elevation_scale": 0}, "elevation_scale 0 must be above 0"),
        ({"elevation_scale": -0.1}, "elevation_scale -0.1 must be above 0"),
        ({"elevation_scale": "high"}, "elevation_scale 'high' must be a finite number"),
        ({"elevation_offset": [1]}, "elevation_offset [1] must be a finite number"),
        ({"elevation_scale": 10}, "a height of 2550 m; elevation_scale 10 is in metres per grey"),
        ({"elevation": "none.png"}, "none.png: no such file"),
        ({"elevation": "m.yaml"}, "m.yaml: not an image that can be read"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(write_map, keys, message):
    path = write_map(GREYS.astype(np.uint8), **keys)
    with pytest.raises(MapError) as error:
        load_map(path)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_heights_need_the_size_of_the_map(write_map):
    path = write_map(np.zeros((2, 4), np.uint8))
    with pytest.raises(MapError, match=r"heights.png: 4 x 2 pixels, but the map m.png has 3 x 2"):
        load_map(path)


def test_keys_of_heights_without_a_picture_of_them_are_told_of(write_map):
    with pytest.warns(MapWarning, match="`elevation_scale` means nothing without `elevation`"):
        assert load_map(write_map(elevation_scale=0.1)).elevation_m is None


def test_a_grid_refuses_heights_of_another_shape_or_beyond_all_measure():
    cells = np.zeros((2, 3), np.uint8)
    for bad in (np.zeros((3, 2)), np.full((2, 3), np.nan), np.full((2, 3), 1e4)):
        with pytest.raises(ValueError, match="elevation_m"):
            OccupancyGrid(cells=cells, resolution_m=0.1, elevation_m=bad)


def test_the_heights_of_a_grid_are_its_own_and_follow_new_cells():
    heights = np.full((2, 3), 0.25)
    grid = OccupancyGrid(cells=np.zeros((2, 3), np.uint8), resolution_m=0.1, elevation_m=heights)
    heights[:] = 7.0
    walled = grid.with_cells(np.full((2, 3), Cell.OCCUPIED, np.uint8))
    assert (heights_of(walled) == 0.25).all()
    with pytest.raises(ValueError, match="read-only"):
        heights_of(grid)[0, 0] = 1.0


@pytest.mark.parametrize("plan", [STAIRS, SILLS], ids=lambda plan: plan.name)
def test_maps_with_heights_are_as_drawn(plan, tmp_path):
    write(plan, tmp_path)
    here, name = Path("maps"), plan.name
    for file, picture in ((name, draw(plan)), (f"{name}_height", draw_heights(plan))):
        np.testing.assert_array_equal(cv2.imread(str(here / f"{file}.png"), -1), picture)
    assert (here / f"{name}.yaml").read_text() == (tmp_path / f"{name}.yaml").read_text()


def test_the_sills_are_the_only_way_from_room_to_room():
    grid = load_map("maps/sills.yaml")
    x_m = [1.51, 1.53, 1.57, 1.59, 2.99, 3.01, 3.04, 3.06]
    heights = grid.height_m([(x, 0.0) for x in x_m])
    assert heights.tolist() == [0.0, 0.05, 0.05, 0.0, 0.0, 0.05, 0.05, 0.0]
    # In the doors, 1.3 m wide, and all across the middle room but for the cupboard.
    is_high = heights_of(grid) > 0
    is_sill = is_high & ~grid.blocked()
    for x, width_m in ((1.55, 1.3), (4.55, 1.3), (3.01, 4.1)):
        col = round((x + 2.0) / 0.025)
        assert is_sill[:, col].sum() * 0.025 == pytest.approx(width_m)
        assert (grid.blocked()[:, col] | is_sill[:, col]).all()


def test_the_stairs_map():
    here = Path("maps")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        grid = load_map(here / "stairs.yaml")
    # Six steps of 10 cm, 0.30 m deep, up to a landing of 1.2 m, and six down.
    x_m = [1.99, 2.01, 2.29, 2.31, 3.49, 3.51, 4.69, 4.71, 6.19, 6.21]
    heights = grid.height_m([(x, 0.0) for x in x_m])
    assert heights.tolist() == [0.0, 0.1, 0.1, 0.2, 0.5, 0.6, 0.6, 0.5, 0.1, 0.0]
    # Nothing but the stairs leads from room to room.
    assert (grid.blocked()[:, 170:320].sum(axis=0) == 200 - 96).all()
