"""Reading of map images and their YAML: every rule, and one clear line for everything wrong."""

from __future__ import annotations

import warnings
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from maps.grid import Cell, OccupancyGrid
from maps.make_maps import SILLS, STAIRS, draw, draw_heights
from maps.make_maps import write as write_plan
from maps.map_files import MapError, MapWarning, load_map, yaml_lines

F, O, U = Cell.FREE, Cell.OCCUPIED, Cell.UNKNOWN  # noqa: E741


@pytest.fixture
def write(tmp_path):
    """Writes an image and its YAML and gives the image's path."""

    def _write(picture, suffix=".png", /, **keys):
        path = tmp_path / f"m{suffix}"
        assert cv2.imwrite(str(path), np.asarray(picture))
        document = {
            "image": path.name,
            "resolution": 0.05,
            "origin": [1.0, 2.0, 0.5],
            "negate": 0,
            "occupied_thresh": 0.65,
            "free_thresh": 0.196,
            **keys,
        }
        document = {key: value for key, value in document.items() if value is not None}
        path.with_suffix(".yaml").write_text(yaml.safe_dump(document))
        return path

    return _write


def row_of(path, **options):
    """Cells of the map's top row, left to right."""
    return load_map(path, **options).cells[-1].tolist()


GREYS = np.array([[0, 89, 90, 204, 205, 206, 255]], np.uint8)


@pytest.mark.parametrize("suffix", [".png", ".pgm", ".bmp"])
def test_greys_fall_on_their_side_of_the_thresholds(write, suffix):
    # p(89) = 0.651 and p(90) = 0.647 on either side of 0.65; p(205) = 0.19608 is above 0.196,
    # p(206) = 0.192 below.
    assert row_of(write(GREYS, suffix)) == [O, O, U, U, U, F, F]


def test_a_jpeg_is_read(write):
    path = write(np.full((8, 8), 255, np.uint8), ".jpg")
    assert set(row_of(path)) == {F}


def test_thresholds_are_met_by_equality(write):
    # 51 / 255 is 0.2 and 153 / 255 is 0.6, both exact quotients of the greys 204 and 102.
    path = write([[102, 103, 203, 204]], free_thresh=1 - 204 / 255, occupied_thresh=1 - 102 / 255)
    assert row_of(path) == [O, U, U, F]


def test_negate_swaps_black_and_white(write):
    assert row_of(write([[0, 40, 100, 166, 255]], negate=1)) == [F, F, U, O, O]
    assert row_of(write([[0, 255]], negate=True)) == [F, O]


def test_the_top_row_of_the_image_has_the_largest_y(write):
    grid = load_map(write([[0, 255], [255, 255], [255, 0]], origin=[0, 0, 0]))
    assert grid.cells.tolist() == [[F, O], [F, F], [O, F]]
    np.testing.assert_allclose(grid.cell_to_world((2, 0)), (0.025, 0.125))


def test_origin_and_resolution_are_the_yamls_unless_given(write):
    path = write([[255]])
    assert load_map(path).origin == (1.0, 2.0, 0.5)
    given = load_map(path, resolution_m=0.2, origin=(-1.0, 0.0, 0.0))
    assert (given.resolution_m, given.origin) == (0.2, (-1.0, 0.0, 0.0))


@pytest.mark.parametrize(("mode", "cells"), [("trinary", [F, U, U]), ("scale", [F, U, U])])
def test_what_is_not_opaque_is_unknown(write, mode, cells):
    white = np.full((1, 3, 4), 255, np.uint8)
    white[0, :, 3] = (255, 254, 0)
    assert row_of(write(white, mode=mode)) == cells


def test_raw_reads_the_grey_as_per_cent_and_ignores_alpha_and_negate(write):
    greys = [[0, 19, 20, 64, 65, 100, 101, 255]]
    expected = [F, F, U, U, O, O, U, U]
    assert row_of(write(np.array(greys, np.uint8), mode="raw")) == expected
    assert row_of(write(np.array(greys, np.uint8), mode="raw", negate=1)) == expected
    clear = np.zeros((1, 8, 4), np.uint8)
    clear[0, :, :3] = np.array(greys[0])[:, None]
    assert row_of(write(clear, mode="raw")) == expected


def test_colours_count_by_luminance(write):
    # Pure green is light (0.587), pure blue dark (0.114): p 0.41 and 0.89.
    colours = np.array([[[0, 255, 0], [255, 0, 0], [255, 255, 255]]], np.uint8)
    assert row_of(write(colours)) == [U, O, F]


def test_sixteen_bits_count_like_eight(write):
    assert row_of(write(np.array([[0, 205 * 257, 65535]], np.uint16))) == [O, U, F]


def test_a_pgm_with_its_own_white_is_scaled(write):
    path = write([[255]], ".pgm")
    path.write_bytes(b"P5\n# a comment\n3 1\n100\n" + bytes([0, 50, 100]))
    assert row_of(path) == [O, U, F]


def test_the_yaml_itself_is_a_map(write):
    path = write([[255, 0]])
    assert row_of(path.with_suffix(".yaml")) == [F, O]


def test_an_image_with_resolution_needs_no_yaml(write):
    path = write([[255, 0]])
    path.with_suffix(".yaml").unlink()
    grid = load_map(path, resolution_m=0.1)
    assert (grid.cells.tolist(), grid.resolution_m, grid.origin) == ([[F, O]], 0.1, (0, 0, 0))


def test_without_yaml_the_error_shows_four_lines_that_work(write):
    path = write([[255, 0]])
    path.with_suffix(".yaml").unlink()
    with pytest.raises(MapError) as error:
        load_map(path)
    first, *lines = str(error.value).splitlines()
    assert "--resolution" in first
    assert "m.yaml" in first
    assert lines == yaml_lines("m.png").splitlines()
    assert len(lines) == 4
    path.with_suffix(".yaml").write_text("\n".join(lines))
    assert load_map(path).cells.tolist() == [[F, O]]


def test_unknown_grey_read_as_free_is_warned_of_with_the_count(write):
    image = np.array([[205, 205, 205, 255]], np.uint8)
    with pytest.warns(MapWarning, match="reads 3 pixels"):
        assert row_of(write(image, free_thresh=0.25)) == [F, F, F, F]


def test_nothing_is_warned_of_where_205_stays_unknown(write):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # 0.196 itself is below p(205) = 50 / 255 = 0.19608.
        assert row_of(write([[205, 255]], free_thresh=0.196)) == [U, F]
        assert row_of(write([[204, 255]], free_thresh=0.197)) == [U, F]


def test_a_map_without_free_cells_and_a_strange_key_are_warned_of(write):
    with pytest.warns(MapWarning, match="no free cell"):
        load_map(write([[0, 205]]))
    with pytest.warns(MapWarning, match="free_tresh"):
        load_map(write([[0, 255]], free_tresh=0.1))


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"resolution": 0}, "resolution 0 must be above 0"),
        ({"resolution": -0.05}, "resolution -0.05"),
        ({"resolution": "wide"}, "resolution 'wide' must be a finite number"),
        ({"resolution": True}, "resolution True must be a finite number"),
        ({"resolution": float("nan")}, "resolution nan"),
        ({"resolution": None}, "key `resolution` is missing"),
        ({"image": None}, "key `image` is missing"),
        ({"origin": None}, "key `origin` is missing"),
        ({"origin": [0, 0]}, r"origin \[0, 0\] must be three numbers"),
        ({"origin": [0, "a", 0]}, "origin 'a'"),
        ({"negate": 2}, "negate 2 must be 0, 1"),
        ({"negate": None}, "key `negate` is missing"),
        ({"mode": "binary"}, "mode 'binary' must be one of trinary, scale, raw"),
        ({"free_thresh": 0.7}, "0 <= free_thresh < occupied_thresh <= 1"),
        ({"occupied_thresh": 65}, "occupied_thresh 65"),
        ({"occupied_thresh": [1]}, r"occupied_thresh \[1\]"),
        ({"image": 3}, "image 3 must be the name of a picture"),
    ],
)
def test_a_wrong_key_is_named_with_its_value(write, keys, message):
    with pytest.raises(MapError, match=message) as error:
        load_map(write([[255]], **keys))
    assert len(str(error.value).splitlines()) == 1


def test_a_resolution_on_the_command_line_is_checked_too(write):
    with pytest.raises(MapError, match="resolution 0 must be above 0"):
        load_map(write([[255]]), resolution_m=0.0)


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("m.png", b"", "not an image"),
        ("m.png", b"hello", "not an image"),
        ("m.png", b"\x89PNG\r\n\x1a\n", "cut off"),
        ("m.jpg", b"\xff\xd8\xff\xe0 half", "cut off"),
    ],
)
def test_what_is_no_image_is_refused(tmp_path, name, data, message):
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(MapError, match=message) as error:
        load_map(path, resolution_m=0.05)
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize("text", ["- 1\n- 2", "", "a: [1", "\x00"])
def test_what_is_no_yaml_of_a_map_is_refused(tmp_path, text):
    path = tmp_path / "m.yaml"
    path.write_text(text)
    with pytest.raises(MapError, match=r"m\.yaml") as error:
        load_map(path)
    assert len(str(error.value).splitlines()) == 1


def test_files_that_are_not_there_are_named(tmp_path, write):
    with pytest.raises(MapError, match=r"nowhere\.png: no such file"):
        load_map(tmp_path / "nowhere.png")
    with pytest.raises(MapError, match="not a file"):
        load_map(tmp_path)
    path = write([[255]], image="other.png")
    with pytest.raises(MapError, match=r"other\.png: no such file"):
        load_map(path.with_suffix(".yaml"))


# The elevation image: how it is read, and one clear line for everything wrong.


@pytest.fixture
def write_map(write, tmp_path):
    """Writes a white map of 3 x 2 cells and, if given, a picture of heights; gives its path."""

    def _write(heights=None, suffix=".png", /, **keys):
        if heights is not None:
            assert cv2.imwrite(str(tmp_path / f"heights{suffix}"), np.asarray(heights))
            keys = {"elevation": f"heights{suffix}", "elevation_scale": 0.01, **keys}
        white = np.full((2, 3), 255, np.uint8)
        return write(white, resolution=0.1, origin=[1.0, 2.0, 0.0], **keys)

    return _write


def heights_of(grid):
    """Heights (H, W) as an array that is there."""
    assert grid.elevation_m is not None
    return np.asarray(grid.elevation_m)


HEIGHT_GREYS = np.array([[0, 1, 255], [10, 20, 30]])


@pytest.mark.parametrize("suffix", [".png", ".bmp", ".pgm"])
def test_a_height_is_scale_times_grey_value_with_row_0_at_the_bottom(write_map, suffix):
    grid = load_map(write_map(HEIGHT_GREYS.astype(np.uint8), suffix))
    assert heights_of(grid).tolist() == [[0.1, 0.2, 0.3], [0.0, 0.01, 2.55]]
    assert grid.height_m([[1.05, 2.05], [1.25, 2.15], [1.15, 2.05]]).tolist() == [0.1, 2.55, 0.2]


@pytest.mark.parametrize("suffix", [".png", ".pgm"])
def test_pictures_of_16_bits_have_65536_heights(write_map, suffix):
    greys = np.array([[0, 1000, 65535], [1, 2, 3]], np.uint16)
    grid = load_map(write_map(greys, suffix, elevation_scale=0.001, elevation_offset=-5.0))
    assert heights_of(grid).tolist() == [[-4.999, -4.998, -4.997], [-5.0, -4.0, 60.535]]


def test_grey_values_of_a_pgm_are_those_in_the_file(write_map, tmp_path):
    # Its white is 100; the map itself would be brightened to 255, heights must not be.
    path = write_map(HEIGHT_GREYS.astype(np.uint8), ".pgm")
    (tmp_path / "heights.pgm").write_bytes(b"P5\n3 2\n100\n" + bytes([0, 1, 100, 10, 20, 30]))
    assert heights_of(load_map(path)).tolist() == [[0.1, 0.2, 0.3], [0.0, 0.01, 1.0]]


def test_colours_count_by_their_luminance(write_map):
    picture = np.repeat(HEIGHT_GREYS.astype(np.uint8)[..., None], 3, axis=2)
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
    path = write_map(HEIGHT_GREYS.astype(np.uint8), **keys)
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
    write_plan(plan, tmp_path)
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
