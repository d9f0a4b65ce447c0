"""The page's state in its address: what a link says, and what opening it does."""

from __future__ import annotations

import http.client
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest

from app.output import InputError
from app.viewer.address import Link, is_same
from app.viewer.html_page import LINK_COOKIE
from app.viewer.obstacles import Box, Obstacle, boxes_of, cells_below, obstacles_of, snapped
from app.viewer.page import Maps, Page, open_page
from benchmarks.page_watcher import Watcher, painted_in_background
from maps.grid import Cell, OccupancyGrid
from tests.scenes import HALL, POLICY, ROBOT, wait_until


def test_a_link_says_the_same_when_it_is_read_again():
    link = Link(
        map="maps/my hall.png", robot="jvrc1", start=(0, 0, -0.0), goal=(2.5, -1.125, math.pi / 2)
    )
    words = str(link)
    assert words == "map=maps/my%20hall.png&robot=jvrc1&start=0,0,0deg&goal=2.5,-1.125,90deg"
    again = Link.read(f"key=secret&{words}")
    assert (again.map, again.robot) == (link.map, link.robot)
    assert is_same(again.start, link.start)
    assert is_same(again.goal, link.goal)
    assert str(again) == words
    assert Link.read("darkMode&websocket=x") == Link()


def test_radians_are_taken_as_on_the_command_line():
    assert Link.read("goal=2,1,1.5").goal == (2, 1, 1.5)


@pytest.mark.parametrize("pose", ["2,1", "2,1,nan", "here", "1e999,0,0"])
def test_what_is_no_pose_is_refused(pose):
    with pytest.raises(InputError, match=r"^goal in the link: .* is not a pose; write X,Y,YAW"):
        Link.read(f"goal={pose}")


def test_poses_are_the_same_but_for_what_an_address_leaves_out():
    assert is_same((1.0004, 2, math.pi), (1, 2, -math.pi))
    assert not is_same((1.01, 2, 0), (1, 2, 0))
    assert not is_same((1, 2, 0.01), (1, 2, 0))
    assert is_same(None, None)
    assert not is_same(None, (0, 0, 0))


def test_waypoints_stand_in_a_link_and_those_passed_are_not_missed():
    text = "via=1,0,0deg;2,0.5,-90deg,stand&goal=3,0,0deg"
    link = Link.read(text)
    assert [point.stands for point in link.via] == [False, True]
    assert link.via[1].pose == pytest.approx((2, 0.5, -math.pi / 2))
    assert str(link) == text
    assert link.leaves(link.via)
    assert link.leaves(link.via[1:])
    assert link.leaves(())
    assert not link.leaves(link.via[:1])
    assert not link.leaves((*link.via, *link.via))
    assert Link().leaves(link.via)
    with pytest.raises(InputError, match="via in the link"):
        Link.read("via=1,0,0deg;nowhere")


@pytest.fixture
def page() -> Iterator[Page]:
    maps = Maps({"hall": Path("hall.yaml"), "office": Path("maps/office.yaml")}, "hall")
    with (
        open_page(HALL, ROBOT, POLICY, title="links", map_name="hall", maps=maps) as page,
        painted_in_background(page),
    ):
        page.text_every_s = 0.0
        page.session.start()
        yield page


def opened(page: Page, query: str, **headers: str) -> str:
    """The cookie about its link that a browser is given which opens the page."""
    connection = http.client.HTTPConnection("127.0.0.1", page.server.get_port(), timeout=60)
    connection.request("GET", f"/?{query}" if query else "/", headers=headers)
    response = connection.getresponse()
    response.read()
    connection.close()
    cookies = response.headers.get_all("Set-Cookie") or []
    (cookie,) = (cookie for cookie in cookies if cookie.startswith(LINK_COOKIE))
    return cookie.partition(";")[0]


def address(watcher: Watcher) -> dict[str, list[str]]:
    """The words that stand in the address of a page."""
    source = watcher.last.get("RunJavascriptMessage", {"source": "kept, ''"})["source"]
    query = source.partition("[...kept, ")[2].partition("]")[0]
    return parse_qs(json.loads(query)) if query else {}


def goal(page: Page) -> Any:
    return page.session.snapshot.requested or page.session.snapshot.goal


def test_a_link_opens_start_and_goal_and_the_address_says_them(page):
    cookie = opened(page, "robot=jvrc1&start=0.5,0.5,90deg&goal=2,1,90deg")
    watcher = Watcher(page.server.url, cookie=cookie)
    wait_until(lambda: goal(page) == pytest.approx((2, 1, math.pi / 2)))
    assert page.session.setup.start == pytest.approx((0.5, 0.5, math.pi / 2))
    wait_until(lambda: address(watcher).get("goal") == ["2,1,90deg"])
    assert address(watcher)["start"] == ["0.5,0.5,90deg"]
    assert address(watcher)["map"] == ["hall"]
    # Whoever opens it again changes nothing: it is so already.
    walk = page.session.snapshot.walk
    query = "&".join(f"{word}={values[0]}" for word, values in address(watcher).items())
    again = Watcher(page.server.url, cookie=opened(page, query))
    wait_until(lambda: address(again) == address(watcher))
    assert page.session.snapshot.walk - walk <= 1
    assert page.session.snapshot.requested in (None, goal(page))
    watcher.close()
    again.close()


def test_a_link_to_another_map_asks_for_it_and_goes_on_there(page):
    watcher = Watcher(page.server.url, cookie=opened(page, "map=office&goal=9,4,0deg"))
    wanted: Any = wait_until(lambda: page.wanted_map)
    assert (wanted.name, wanted.link.goal) == ("office", (9, 4, 0))
    assert page.session.snapshot.goal is None
    watcher.close()


@pytest.mark.parametrize(
    ("query", "told"),
    [
        ("map=attic", "the map attic of the link is not here"),
        ("robot=r2d2", "the robot r2d2 of the link is not here"),
        ("goal=2,1", "goal in the link: '2,1' is not a pose"),
    ],
)
def test_what_a_link_asks_in_vain_is_told(page, query, told):
    watcher = Watcher(page.server.url, cookie=opened(page, query))
    wait_until(lambda: told in page.panel.notice.content)
    assert goal(page) is None
    watcher.close()


def test_links_on_other_sites_are_asked_about_and_pictures_open_none(page):
    site = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Dest": "document"}
    watcher = Watcher(page.server.url, cookie=opened(page, "goal=2,1,0deg", **site))
    wait_until(lambda: watcher.heard["GuiModalMessage"])
    picture = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Dest": "image"}
    assert opened(page, "goal=2,1,0deg", **picture) == f"{LINK_COOKIE}="
    forged = Watcher(page.server.url, cookie=f"{LINK_COOKIE}=goal%3D2,1,0deg")
    wait_until(lambda: page.visitors == 2)
    wait_until(lambda: address(forged))
    assert goal(page) is None
    watcher.close()
    forged.close()


def test_a_link_is_followed_once(page):
    cookie = opened(page, "goal=2,1,0deg")
    first = Watcher(page.server.url, cookie=cookie)
    wait_until(lambda: goal(page))
    page.session.stop()
    page.session.reset()
    wait_until(lambda: goal(page) is None)
    # A page that loses its socket opens another one, with the same cookie.
    second = Watcher(page.server.url, cookie=cookie)
    wait_until(lambda: address(second))
    assert goal(page) is None
    assert urlsplit(page.server.url).query == ""
    first.close()
    second.close()


def test_boxes_stand_in_a_link_and_cover_the_same_cells_when_it_is_read_again():
    # Cells of a third of a decimetre on a map that is turned: nothing comes out even.
    grid = OccupancyGrid(
        cells=np.zeros((90, 120), np.uint8), resolution_m=0.1 / 3, origin=(-1.3, 0.7, 0.4)
    )
    draw = np.random.default_rng(4)
    for _ in range(200):
        x_m, y_m, size_x_m, size_y_m = draw.uniform((-0.5, -0.5, 0.05, 0.05), (4.5, 3.5, 2, 2))
        asked = Obstacle(number=0, x_m=x_m, y_m=y_m, size_x_m=size_x_m, size_y_m=size_y_m)
        box = snapped(asked, grid)
        link = Link(boxes=boxes_of([box], grid))
        again = Link.read(str(link)).boxes
        assert again is not None
        (found,) = obstacles_of(again, grid)
        assert cells_below(found, grid) == cells_below(box, grid)
    assert str(Link(boxes=(Box(2, 1, 0.4, 0.25),))) == "boxes=2,1,0.4,0.25"
    assert str(Link(boxes=())) == "boxes=none"
    assert Link.read("boxes=none").boxes == ()
    assert Link.read("goal=1,2,0").boxes is None


@pytest.mark.parametrize(
    "text", ["1,2,0.4", "1,2,0,0.4", "1,2,nan,1", "1e300,0,1,1", "0,0,1,inf", "here", "1,2,1,1;"]
)
def test_what_is_no_box_is_refused(text):
    with pytest.raises(InputError, match=r"^box in the link: .* such as 2,1,0.4,0.4$"):
        Link.read(f"boxes={text}")
    with pytest.raises(InputError, match="51 boxes in the link: 50 are as many as can be"):
        Link.read("boxes=" + ";".join(["1,2,0.4,0.4"] * 51))


def test_a_link_sets_boxes_and_the_address_says_them(page):
    page.obstacle_editor.add((-1.0, 1.0), (0.4, 0.4))
    wait_until(lambda: page.session.snapshot.obstacles)
    watcher = Watcher(page.server.url, cookie=opened(page, "boxes=1,1,0.4,0.2;3,0,0.3,0.3"))
    wait_until(lambda: address(watcher).get("boxes") == ["1,1,0.4,0.2;3,0,0.3,0.3"])
    wait_until(lambda: len(page.session.snapshot.obstacles) == 2)
    assert page.session.setup.grid.cells.sum() == (8 * 4 + 6 * 6) * Cell.OCCUPIED
    drawn = [node for kind, node in watcher.last_of if kind == "BoxMessage" and "box_" in node]
    assert sorted(drawn) == ["/map/box_0", "/map/box_1"]
    # One that leaves them open changes none of them, and one that names none takes them away.
    other = Watcher(page.server.url, cookie=opened(page, "goal=2,1,0deg"))
    wait_until(lambda: goal(page))
    assert len(page.session.snapshot.obstacles) == 2
    page.session.undo()
    wait_until(lambda: goal(page) is None)
    last = Watcher(page.server.url, cookie=opened(page, "boxes=none"))
    wait_until(lambda: page.session.snapshot.obstacles == ())
    page.session.undo()
    wait_until(lambda: len(page.session.snapshot.obstacles) == 2)
    for one in (watcher, other, last):
        one.close()


def test_a_box_of_a_link_does_not_come_down_on_the_robot(page):
    """It is put elsewhere by the same link, where another box of it would stand."""
    query = "start=1,1,0deg&boxes=0,0,0.4,0.4;1,1,0.4,0.4"
    watcher = Watcher(page.server.url, cookie=opened(page, query))
    wait_until(lambda: "no box can stand on the robot" in page.panel.notice.content)
    wait_until(lambda: address(watcher).get("boxes") == ["0,0,0.4,0.4"])
    assert page.session.setup.start == pytest.approx((1, 1, 0))
    assert page.session.snapshot.status == "standing"
    watcher.close()
