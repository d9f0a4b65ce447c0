"""Reading of map images and their YAML: every rule, and one clear line for everything wrong."""

from __future__ import annotations

import contextlib
import functools
import warnings
from pathlib import Path

import cv2
import numpy as np
import pytest

from maps.grid import Cell, OccupancyGrid
from maps.map_files import MapError, MapWarning, load_map, yaml_lines
from tests.programs import write_map

F, O, U = Cell.FREE, Cell.OCCUPIED, Cell.UNKNOWN  # noqa: E741


@pytest.fixture
def write(tmp_path):
    """Writes an image and its YAML and gives the image's path."""
    return functools.partial(write_map, tmp_path)


def row_of(path, **options):
    """Cells of the map's top row, left to right."""
    return load_map(path, **options).cells[-1].tolist()


GREYS = np.array([[0, 89, 90, 204, 205, 206, 255]], np.uint8)


COLOURS = np.array([[[0, 255, 0], [255, 0, 0], [255, 255, 255]]], np.uint8)
PER_CENT = np.array([[0, 19, 20, 64, 65, 100, 101, 255]], np.uint8)
READ_AS_PER_CENT = [F, F, U, U, O, O, U, U]


def not_opaque(greys, alpha):
    """A picture (1, N, 4)."""
    picture = np.repeat(np.array([greys], np.uint8)[..., None], 4, axis=2)
    picture[..., 3] = alpha
    return picture


@pytest.mark.parametrize(
    ("picture", "keys", "cells"),
    [
        # p(89) = 0.651 and p(90) = 0.647 on either side of 0.65; p(205) = 0.19608 is above 0.196,
        # p(206) = 0.192 below.
        (GREYS, {}, [O, O, U, U, U, F, F]),
        (GREYS, {"suffix": ".pgm"}, [O, O, U, U, U, F, F]),
        (GREYS, {"suffix": ".bmp"}, [O, O, U, U, U, F, F]),
        (np.full((8, 8), 255, np.uint8), {"suffix": ".jpg"}, [F] * 8),
        # Thresholds are met by equality: 51 / 255 is 0.2 and 153 / 255 is 0.6, both exact quotients
        # of the greys 204 and 102.
        (
            [[102, 103, 203, 204]],
            {"free_thresh": 1 - 204 / 255, "occupied_thresh": 1 - 102 / 255},
            [O, U, U, F],
        ),
        ([[0, 40, 100, 166, 255]], {"negate": 1}, [F, F, U, O, O]),
        ([[0, 255]], {"negate": True}, [F, O]),
        # What is not opaque is unknown.
        (not_opaque([255] * 3, (255, 254, 0)), {"mode": "trinary"}, [F, U, U]),
        (not_opaque([255] * 3, (255, 254, 0)), {"mode": "scale"}, [F, U, U]),
        # Raw reads the grey as per cent and ignores alpha and negate.
        (PER_CENT, {"mode": "raw"}, READ_AS_PER_CENT),
        (PER_CENT, {"mode": "raw", "negate": 1}, READ_AS_PER_CENT),
        (not_opaque(PER_CENT[0], 0), {"mode": "raw"}, READ_AS_PER_CENT),
        # Pure green is light (0.587), pure blue dark (0.114): p 0.41 and 0.89.
        (COLOURS, {}, [U, O, F]),
        (np.array([[0, 205 * 257, 65535]], np.uint16), {}, [O, U, F]),
    ],
)
def test_a_picture_reads_as_cells(write, picture, keys, cells):
    assert row_of(write(picture, **keys)) == cells


def test_the_top_row_of_the_image_has_the_largest_y(write):
    grid = load_map(write([[0, 255], [255, 255], [255, 0]]))
    assert grid.cells.tolist() == [[F, O], [F, F], [O, F]]
    np.testing.assert_allclose(grid.cell_to_world((2, 0)), (0.025, 0.125))


def test_origin_and_resolution_are_the_yamls_unless_given(write):
    path = write([[255]], origin=[1.0, 2.0, 0.5])
    assert load_map(path).origin == (1.0, 2.0, 0.5)
    given = load_map(path, resolution_m=0.2, origin=(-1.0, 0.0, 0.0))
    assert (given.resolution_m, given.origin) == (0.2, (-1.0, 0.0, 0.0))


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
        ({"resolution": 1e7}, r"resolution 1e\+07 must be at most 100 \(metres per pixel\)"),
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


@pytest.mark.parametrize("suffix", [".pgm", ".bmp", ".png", ".jpg"])
def test_a_picture_that_is_cut_off_is_said_to_be_and_no_library_speaks(write, suffix, capfd):
    path = write(np.random.default_rng(0).integers(0, 256, (40, 60), np.uint8), suffix)
    data, kind = path.read_bytes(), "JPEG" if suffix == ".jpg" else suffix[1:].upper()
    for length in (len(data) * 3 // 4, len(data) - 2):
        path.write_bytes(data[:length])
        with pytest.raises(MapError, match=f"the {kind} is cut off"):
            load_map(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp"])
def test_libraries_do_not_speak_of_damage_themselves(write, suffix, capfd):
    path = write(np.random.default_rng(0).integers(0, 256, (40, 60), np.uint8), suffix)
    data, rng = bytearray(path.read_bytes()), np.random.default_rng(1)
    for at in rng.integers(8, len(data) - 20, 40).tolist():
        damaged = data.copy()
        damaged[at] ^= 0xFF
        path.write_bytes(damaged)
        with contextlib.suppress(MapError):
            load_map(path)
    assert capfd.readouterr() == ("", "")


def test_a_picture_that_is_a_little_transparent_everywhere_is_told_of(write):
    picture = not_opaque([0, 255, 255], 254)
    with pytest.warns(MapWarning, match="transparent at least .alpha below 255."):
        load_map(write(picture))
    picture[..., -1] = [254, 255, 254]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert row_of(write(picture)) == [U, F, U]


def test_a_tab_after_a_colon_is_a_space(write):
    path = write(GREYS)
    beside = path.with_suffix(".yaml")
    beside.write_text(beside.read_text().replace(": ", ":\t"))
    assert row_of(path) == [O, O, U, U, U, F, F]


def test_a_key_that_is_there_twice_is_named_with_its_line(write):
    beside = write(GREYS).with_suffix(".yaml")
    beside.write_text("negate: 1\n" + beside.read_text())
    line = 1 + beside.read_text().splitlines().index("negate: 0")
    with pytest.raises(MapError, match=f"line {line}: .*key `negate` is there twice"):
        load_map(beside)


def test_a_tilde_is_the_home_folder(write, tmp_path, monkeypatch):
    path = write(GREYS)
    (tmp_path / "home" / "maps").mkdir(parents=True)
    path.rename(tmp_path / "home" / "maps" / "a.png")
    beside = path.with_suffix(".yaml")
    beside.write_text(beside.read_text().replace("m.png", "~/maps/a.png"))
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert load_map(beside).shape == (1, 7)


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
def write_heights(write, tmp_path):
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
def test_a_height_is_scale_times_grey_value_with_row_0_at_the_bottom(write_heights, suffix):
    grid = load_map(write_heights(HEIGHT_GREYS.astype(np.uint8), suffix))
    assert heights_of(grid).tolist() == [[0.1, 0.2, 0.3], [0.0, 0.01, 2.55]]
    assert grid.height_m([[1.05, 2.05], [1.25, 2.15], [1.15, 2.05]]).tolist() == [0.1, 2.55, 0.2]


@pytest.mark.parametrize("suffix", [".png", ".pgm"])
def test_pictures_of_16_bits_have_65536_heights(write_heights, suffix):
    greys = np.array([[0, 1000, 65535], [1, 2, 3]], np.uint16)
    grid = load_map(write_heights(greys, suffix, elevation_scale=0.001, elevation_offset=-5.0))
    assert heights_of(grid).tolist() == [[-4.999, -4.998, -4.997], [-5.0, -4.0, 60.535]]


def test_grey_values_of_a_pgm_are_those_in_the_file(write_heights, tmp_path):
    # Its white is 100; the map itself would be brightened to 255, heights must not be.
    path = write_heights(HEIGHT_GREYS.astype(np.uint8), ".pgm")
    (tmp_path / "heights.pgm").write_bytes(b"P5\n3 2\n100\n" + bytes([0, 1, 100, 10, 20, 30]))
    assert heights_of(load_map(path)).tolist() == [[0.1, 0.2, 0.3], [0.0, 0.01, 1.0]]


def test_colours_count_by_their_luminance(write_heights):
    picture = np.repeat(HEIGHT_GREYS.astype(np.uint8)[..., None], 3, axis=2)
    assert heights_of(load_map(write_heights(picture)))[0].tolist() == [0.1, 0.2, 0.3]


def test_a_map_without_heights_is_flat(write_heights):
    grid = load_map(write_heights())
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
def test_what_is_wrong_is_said_in_one_line(write_heights, keys, message):
    path = write_heights(HEIGHT_GREYS.astype(np.uint8), **keys)
    with pytest.raises(MapError) as error:
        load_map(path)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_heights_need_the_size_of_the_map(write_heights):
    path = write_heights(np.zeros((2, 4), np.uint8))
    with pytest.raises(MapError, match=r"heights.png: 4 x 2 pixels, but the map m.png has 3 x 2"):
        load_map(path)


def test_keys_of_heights_without_a_picture_of_them_are_told_of(write_heights):
    with pytest.warns(MapWarning, match="`elevation_scale` means nothing without `elevation`"):
        assert load_map(write_heights(elevation_scale=0.1)).elevation_m is None


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
