"""Another map for the page: chosen, or sent, and what is said of one that cannot be read."""

from __future__ import annotations

import contextlib
import gzip
import http.client
import re
import tempfile
from typing import Any

import cv2
import numpy as np
import pytest
from viser import UploadedFile

from app.navigation.planner_process import World, somewhere_to_stand
from app.viewer.map_chooser import MapInbox, maps_that_come_along
from app.viewer.page import Maps, Page, open_page
from controller.policy import load_policy
from maps.grid import Cell, OccupancyGrid
from maps.map_files import MapError, load_map
from planner.collision import terrain_of
from planner.endpoints import what_blocks
from planner.options import PlannerOptions
from planner.plan import feet_at
from sim.robots import get_robot
from tests.programs import ROOT

ROBOT = get_robot("jvrc1")
FLOOR = np.full((60, 80), 254, np.uint8)
YAML = "image: {}\nresolution: 0.1\norigin: [1, 2, 0]\nnegate: 0\n"


@pytest.fixture
def inbox():
    with contextlib.closing(MapInbox()) as box:
        yield box


def picture(pixels: Any = FLOOR, form: str = ".png") -> bytes:
    return bytes(cv2.imencode(form, np.asarray(pixels))[1])


def sent(inbox: MapInbox, name: str, content: bytes | str) -> OccupancyGrid | str:
    data = content if isinstance(content, bytes) else content.encode()
    return inbox.take(UploadedFile(name, data), resolution_m=0.05, origin=(-1.0, -2.0, 0.0))


def test_an_image_takes_the_numbers_that_were_typed(inbox):
    grid = sent(inbox, "floor.png", picture())
    assert isinstance(grid, OccupancyGrid)
    assert (grid.shape, grid.resolution_m, grid.origin) == ((60, 80), 0.05, (-1.0, -2.0, 0.0))


def test_a_yaml_waits_for_all_pictures_that_it_names(inbox):
    yaml = YAML.format("floor.pgm") + "elevation: height.png\nelevation_scale: 0.001\n"
    assert sent(inbox, "any.yaml", yaml) == "any.yaml is here: now send floor.pgm and height.png"
    assert sent(inbox, "height.png", picture(FLOOR // 2)) == (
        "any.yaml is here: now send floor.pgm"
    )
    grid = sent(inbox, "floor.pgm", picture(form=".pgm"))
    assert isinstance(grid, OccupancyGrid)
    assert (grid.resolution_m, grid.origin) == (0.1, (1.0, 2.0, 0.0))
    assert grid.elevation_m is not None
    # The next map has nothing to do with it.
    plain = sent(inbox, "other.png", picture())
    assert isinstance(plain, OccupancyGrid)
    assert plain.resolution_m == 0.05


@pytest.mark.parametrize("named", ["/etc/hostname", "../room.png", "~/room.png", "a/b.png"])
@pytest.mark.parametrize("key", ["image", "elevation"])
def test_a_yaml_reads_nothing_that_was_not_sent(inbox, named, key):
    image = named if key == "image" else "m.png"
    text = YAML.format(image)
    text += f"elevation: {named}\nelevation_scale: 1\n" if key == "elevation" else ""
    with pytest.raises(MapError, match="name the image without its folder"):
        sent(inbox, "m.yaml", text)
    grid = sent(inbox, "m.png", picture())  # nor through an image of the same name
    assert isinstance(grid, OccupancyGrid)
    assert grid.resolution_m == 0.05
    assert grid.elevation_m is None


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("a.txt", b"", "send an image"),
        ("a.png", b"no picture", "not an image"),
        ("a.png", picture()[:50], "cut off"),
        ("a.yaml", "image: [", "not valid YAML"),
        ("a.yaml", "image: a.png\n", "`resolution` is missing"),
        ("", picture(), "send an image"),
        ("..", picture(), "send an image"),
        ("x" * 300 + ".png", picture(), "cannot be kept"),
        ("a\0.png", picture(), "cannot be kept"),
    ],
)
def test_what_is_no_map_is_said_in_words(inbox, name, content, told):
    with pytest.raises(MapError, match=told):
        sent(inbox, name, content)


def test_names_with_folders_stay_in_the_inbox(inbox, tmp_path):
    assert isinstance(sent(inbox, f"../../{tmp_path}/floor.png", picture()), OccupancyGrid)
    assert isinstance(sent(inbox, "C:\\maps\\floor.png", picture()), OccupancyGrid)
    assert list(tmp_path.iterdir()) == []


def test_what_was_sent_goes_with_the_inbox(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    box = MapInbox()
    sent(box, "floor.png", picture())
    assert [path.name for path in tmp_path.rglob("*.png")] == ["floor.png"]
    box.close()
    assert list(tmp_path.iterdir()) == []


def world(grid: OccupancyGrid) -> World:
    return World(grid=grid, model=ROBOT.step_model, options=PlannerOptions())


def test_there_is_somewhere_to_stand_on_every_map_with_room():
    maps = {name: load_map(file) for name, file in maps_that_come_along().items()}
    assert set(maps) == {"office", "room", "sills", "stairs"}
    far = OccupancyGrid(cells=np.zeros((60, 60), np.uint8), resolution_m=0.05, origin=(50, -80, 1))
    for grid in (*maps.values(), far):
        pose = somewhere_to_stand(world(grid))
        assert pose is not None
        feet = feet_at(pose, ROBOT.step_model.stance_width_m)
        assert not what_blocks(grid, terrain_of(grid, False), ROBOT.step_model, feet)
    full = OccupancyGrid(cells=np.full((40, 40), Cell.OCCUPIED, np.uint8), resolution_m=0.05)
    assert somewhere_to_stand(world(full)) is None


@pytest.fixture(scope="module")
def page():
    maps = Maps(maps_that_come_along(), "room")
    grid = load_map(ROOT / "maps" / "room.png")
    opened = open_page(grid, ROBOT, load_policy(ROBOT), title="Footfall: a & b", maps=maps)
    with opened as page:
        yield page


def said(page: Page) -> str:
    """What the page says to whoever watches, without its sign."""
    page.text_every_s = 0.0
    page.show(page.session.snapshot)
    return str(re.sub(r"<[^>]*>", "", page.panel.notice.content)).removeprefix("⚠️ ")


def test_a_map_that_is_chosen_is_what_comes_next(page):
    page.map_chooser.choose("office")
    name, grid, start, _link = page.wanted_map
    assert name == "office"
    assert grid.shape == load_map(ROOT / "maps" / "office.png").shape
    assert start == (0.0, 0.0, 0.0)
    page.wanted_map = None
    page.map_chooser.choose("what was sent before")
    assert page.wanted_map is None


def test_a_map_that_is_sent_and_one_that_cannot_be_used(page):
    page.map_chooser.take(UploadedFile("broken.png", b"\x89PNG"))
    # By the name that was sent, without the folder where it is kept.
    assert said(page).startswith("map image broken.png: ")
    assert "cut off" in said(page)
    page.map_chooser.take(UploadedFile("full.png", picture(np.zeros((30, 30), np.uint8))))
    assert said(page) == "full.png: the robot can stand nowhere on this map"
    assert page.wanted_map is None
    page.map_chooser.take(UploadedFile("floor.png", picture()))
    assert page.wanted_map is not None
    assert page.wanted_map[0] == "floor.png"
    page.wanted_map = None


@pytest.mark.parametrize("encoding", ["gzip", "identity"])
def test_the_tab_is_named_for_the_map(page, encoding):
    connection = http.client.HTTPConnection("127.0.0.1", page.server.get_port(), timeout=60)
    connection.request("GET", "/", headers={"Accept-Encoding": encoding})
    response = connection.getresponse()
    body = response.read()
    text = gzip.decompress(body) if encoding == "gzip" else body
    assert int(str(response.getheader("Content-Length"))) == len(body)
    assert b"<title>Footfall: a &amp; b</title>" in text
