"""The goal that holds: what is clicked and where, what the fields and the arrows say of it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from app.viewer.page import Page, open_page, painted_in_background
from app.viewer.panel import SPEEDS
from app.viewer.pointer import Tool
from app.viewer.robot_scene import robot_meshes_of
from benchmarks.page_watcher import Watcher
from controller.policy import POLICY_FOLDER, load_policy
from maps.grid import OccupancyGrid
from sim.robots import get_robot
from sim.scene import build_scene

ROBOT = get_robot("jvrc1")
POLICY = load_policy(ROBOT, POLICY_FOLDER / "jvrc1.safetensors")
# A hall of 8 by 6 m with a wall from x = 3 m.
CELLS = np.zeros((120, 160), np.uint8)
CELLS[:, 100:104] = 1
HALL = OccupancyGrid(cells=CELLS, resolution_m=0.05, origin=(-2, -3, 0))
WAIT_LIMIT_S = 120.0


@pytest.fixture
def page() -> Iterator[Page]:
    with open_page(HALL, ROBOT, POLICY, title="goals") as page, painted_in_background(page):
        page.text_every_s = 0.0
        page.session.start()
        yield page


@pytest.fixture
def watcher(page: Page) -> Iterator[Watcher]:
    watcher = Watcher(page.server.url)
    until(lambda: page.visitors == 1)
    yield watcher
    watcher.close()


def until(wanted: Callable[[], Any]) -> None:
    until_s = time.monotonic() + WAIT_LIMIT_S
    while not wanted():
        assert time.monotonic() < until_s, "waited in vain"
        time.sleep(0.01)


def look_down(watcher: Watcher, x_m: float, y_m: float) -> None:
    watcher.click("/map/slab", (x_m, y_m, 5.0), (0.0, 0.0, -1.0))


def seen(page: Page, name: str) -> Any:
    """The place x, y of an arrow; None where it is hidden."""
    arrow: Any = page.server.scene._handle_from_node_name[name]
    return tuple(arrow.position[:2]) if arrow.visible else None


def fields(page: Page) -> Any:
    return page.panel.goal.pose


def test_fields_and_arrow_follow_a_click_that_begins_one_walk(page, watcher):
    look_down(watcher, 1.0, 0.5)
    until(lambda: fields(page)[:2] == pytest.approx((1.0, 0.5)))
    assert math.degrees(fields(page)[2]) == pytest.approx(math.degrees(math.atan2(0.5, 1)), abs=2)
    until(lambda: seen(page, "/goal") == pytest.approx((1.0, 0.5)))
    until(lambda: seen(page, "/requested") is None)
    # The server tells the page's fields; they tell nobody.
    assert watcher.heard["GuiUpdateMessage"] > 0
    assert page.session.snapshot.walk == 2


def test_where_no_goal_was_before_the_refused_one_can_be_corrected(page, watcher):
    page.session.go_to((2.0, 2.95, 0.0))
    until(lambda: seen(page, "/refused") == pytest.approx((2.0, 2.95)))
    until(lambda: fields(page)[:2] == pytest.approx((2.0, 2.95)))
    assert seen(page, "/goal") is None
    assert seen(page, "/alternative")[1] < 2.95


def test_a_refused_goal_leaves_the_one_that_holds(page, watcher):
    page.session.clock.factor = SPEEDS["Pause"]
    look_down(watcher, 1.0, 0.5)
    until(lambda: seen(page, "/goal") == pytest.approx((1.0, 0.5)))
    # Upon the wall.
    look_down(watcher, 3.1, 0.0)
    until(lambda: seen(page, "/refused") == pytest.approx((3.1, 0.0)))
    assert page.server.scene._handle_from_node_name["/refused"].position[2] > 1.0
    until(lambda: fields(page)[:2] == pytest.approx((1.0, 0.5)))
    assert seen(page, "/goal") == pytest.approx((1.0, 0.5))
    assert seen(page, "/requested") is None
    assert seen(page, "/alternative")[0] < 3.0
    page.panel.take_offer()
    until(lambda: seen(page, "/goal")[0] > 1.5)
    until(lambda: (seen(page, "/refused"), seen(page, "/alternative")) == (None, None))
    until(lambda: fields(page)[:2] == pytest.approx(seen(page, "/goal"), abs=1e-3))


def test_a_stopped_robot_has_no_goal(page, watcher):
    look_down(watcher, 1.0, 0.5)
    until(lambda: seen(page, "/goal") is not None)
    page.session.stop()
    until(lambda: seen(page, "/goal") is None)


def test_the_start_that_is_refused_is_not_shown_as_the_start(page, watcher):
    page.panel.use_tool(Tool.ROBOT)
    look_down(watcher, 1.0, 1.0)
    until(lambda: page.panel.start.pose[:2] == pytest.approx((1.0, 1.0)))
    look_down(watcher, 3.1, 1.0)
    until(lambda: seen(page, "/refused") == pytest.approx((3.1, 1.0)))
    time.sleep(0.2)
    assert page.panel.start.pose[:2] == pytest.approx((1.0, 1.0))


def test_the_robot_is_no_glass(page, watcher):
    """A ray through its chest that comes down 1.6 m behind it means the robot."""
    stood = page.session.snapshot.qpos[:2]
    watcher.click("/map/slab", (-1.6, 0.0, 1.6), (1.6, 0.0, -0.8))
    until(lambda: page.session.snapshot.goal or page.session.snapshot.requested)
    now = page.session.snapshot
    assert (now.goal or now.requested)[:2] == pytest.approx(stood, abs=0.05)
    page.panel.use_tool(Tool.BOX)
    watcher.click("/map/slab", (-1.6, 0.0, 1.6), (1.6, 0.0, -0.8))
    until(lambda: "that is the robot" in page.panel.notice.content)


def test_how_far_a_ray_comes_before_it_meets_the_robot():
    meshes = robot_meshes_of(ROBOT)
    qpos = build_scene(ROBOT, timestep_s=0.001).standing_qpos.copy()
    qpos[:2] = 1.0, 2.0
    height_m = 5.0 - meshes.hit_distance_m(qpos, (1.0, 2.0, 5.0), (0, 0, -2))
    assert 1.3 < height_m < 1.8
    assert meshes.hit_distance_m(qpos, (2.0, 2.0, 5.0), (0, 0, -1)) == math.inf
    # From the side at the height of the pelvis.
    assert 1.8 < meshes.hit_distance_m(qpos, (3.0, 2.0, float(qpos[2])), (-1, 0, 0)) < 2.0


def test_boxes_are_moved_with_their_own_tool_alone(page, watcher):
    page.obstacle_editor.add((1.0, -1.0), (0.4, 0.4))
    box: Any = page.server.scene._handle_from_node_name["/map/box_0"]
    assert not box._impl.drag_cb
    page.panel.use_tool(Tool.BOX)
    assert len(box._impl.drag_cb) == 1
    page.obstacle_editor.add((1.0, -2.0), (0.4, 0.4))
    other: Any = page.server.scene._handle_from_node_name["/map/box_1"]
    assert len(other._impl.drag_cb) == 1
    page.panel.use_tool(Tool.GOAL)
    assert not box._impl.drag_cb
    assert not other._impl.drag_cb
    # It can be clicked with each of them.
    assert box._impl.click_cb
