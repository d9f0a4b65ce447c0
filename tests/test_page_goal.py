"""The goal that holds: what is clicked and where, what the fields and the arrows say of it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from app.viewer.page import Page, open_page
from app.viewer.panel import SPEEDS
from app.viewer.pointer import Tool
from app.viewer.scene import robot_meshes_of
from benchmarks.page_watcher import Watcher, painted_in_background
from sim.scene import build_scene
from tests.scenes import HALL, POLICY, ROBOT, wait_until

# The hall with a wall from x = 3 m.
CELLS = np.zeros(HALL.shape, np.uint8)
CELLS[:, 100:104] = 1
WALLED = HALL.with_cells(CELLS)


@pytest.fixture
def page() -> Iterator[Page]:
    with open_page(WALLED, ROBOT, POLICY, title="goals") as page, painted_in_background(page):
        page.text_every_s = 0.0
        page.session.start()
        yield page


@pytest.fixture
def watcher(page: Page) -> Iterator[Watcher]:
    watcher = Watcher(page.server.url)
    wait_until(lambda: page.visitors == 1)
    yield watcher
    watcher.close()


def look_down(watcher: Watcher, x_m: float, y_m: float) -> None:
    watcher.click("/map/slab", (x_m, y_m, 5.0), (0.0, 0.0, -1.0))


def node(page: Page, name: str) -> Any:
    return page.server.scene.get_handle_by_name(name)


def seen(page: Page, name: str) -> Any:
    """The place x, y of an arrow; None where it is hidden."""
    arrow = node(page, name)
    return tuple(arrow.position[:2]) if arrow.visible else None


def fields(page: Page) -> Any:
    return page.panel.goal.pose


def test_fields_and_arrow_follow_a_click_that_begins_one_walk(page, watcher):
    look_down(watcher, 1.0, 0.5)
    wait_until(lambda: fields(page)[:2] == pytest.approx((1.0, 0.5)))
    # The fields are set one after another.
    wait_until(lambda: fields(page)[2] == pytest.approx(math.atan2(0.5, 1), abs=0.035))
    wait_until(lambda: seen(page, "/goal") == pytest.approx((1.0, 0.5)))
    wait_until(lambda: seen(page, "/requested") is None)
    # The server tells the page's fields; they tell nobody.
    assert watcher.heard["GuiUpdateMessage"] > 0
    assert page.session.snapshot.walk == 2


def test_where_no_goal_was_before_the_refused_one_can_be_corrected(page, watcher):
    page.session.go_to((2.0, 2.95, 0.0))
    wait_until(lambda: seen(page, "/refused") == pytest.approx((2.0, 2.95)))
    wait_until(lambda: fields(page)[:2] == pytest.approx((2.0, 2.95)))
    assert seen(page, "/goal") is None
    assert seen(page, "/alternative")[1] < 2.95


def test_a_refused_goal_can_be_corrected_and_leaves_the_one_that_holds(page, watcher):
    page.session.clock.factor = SPEEDS["Pause"]
    look_down(watcher, 1.0, 0.5)
    wait_until(lambda: seen(page, "/goal") == pytest.approx((1.0, 0.5)))
    # Upon the wall.
    look_down(watcher, 3.1, 0.0)
    wait_until(lambda: seen(page, "/refused") == pytest.approx((3.1, 0.0)))
    assert node(page, "/refused").position[2] > 1.0
    wait_until(lambda: fields(page)[:2] == pytest.approx((3.1, 0.0)))
    assert seen(page, "/goal") == pytest.approx((1.0, 0.5))
    assert seen(page, "/requested") is None
    assert seen(page, "/alternative")[0] < 3.0
    # The fields show the goal while it is planned for; the offer comes with the refusal.
    wait_until(lambda: page.panel.notice.visible)
    # The word upon the wall goes up, that beside the wall down: neither covers the other.
    assert node(page, "/refused/word").anchor == "bottom-center"
    assert node(page, "/alternative/word").anchor == "top-center"
    page.panel.take_offer()
    wait_until(lambda: seen(page, "/goal")[0] > 1.5)
    wait_until(lambda: (seen(page, "/refused"), seen(page, "/alternative")) == (None, None))
    wait_until(lambda: fields(page)[:2] == pytest.approx(seen(page, "/goal"), abs=1e-3))


def test_a_stopped_robot_has_no_goal(page, watcher):
    look_down(watcher, 1.0, 0.5)
    wait_until(lambda: seen(page, "/goal") is not None)
    page.session.stop()
    wait_until(lambda: seen(page, "/goal") is None)


def test_the_start_that_is_refused_is_left_to_be_corrected(page, watcher):
    page.panel.use_tool(Tool.ROBOT)
    look_down(watcher, 1.0, 1.0)
    wait_until(lambda: page.panel.start.pose[:2] == pytest.approx((1.0, 1.0)))
    look_down(watcher, 3.1, 1.0)
    wait_until(lambda: seen(page, "/refused") == pytest.approx((3.1, 1.0)))
    wait_until(lambda: page.panel.start.pose[:2] == pytest.approx((3.1, 1.0)))
    assert page.session.snapshot.start[:2] == pytest.approx((1.0, 1.0))


def test_the_robot_is_no_glass(page, watcher):
    """A ray through its chest that comes down 1.6 m behind it means the robot."""
    stood = page.session.snapshot.qpos[:2]
    watcher.click("/map/slab", (-1.6, 0.0, 1.6), (1.6, 0.0, -0.8))
    wait_until(lambda: page.session.snapshot.goal or page.session.snapshot.requested)
    now = page.session.snapshot
    assert (now.goal or now.requested)[:2] == pytest.approx(stood, abs=0.05)
    page.panel.use_tool(Tool.BOX)
    watcher.click("/map/slab", (-1.6, 0.0, 1.6), (1.6, 0.0, -0.8))
    wait_until(lambda: "that is the robot" in page.panel.notice.content)


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
    """It can be clicked with each of them."""

    def bindings(what: str, box: int) -> Any:
        kind = f"SetSceneNode{what}BindingsMessage"
        return watcher.last_of.get((kind, f"/map/box_{box}"), {}).get("bindings")

    page.obstacle_editor.add((1.0, -1.0), (0.4, 0.4))
    wait_until(lambda: bindings("Click", 0))
    assert not bindings("Drag", 0)
    page.panel.use_tool(Tool.BOX)
    wait_until(lambda: bindings("Drag", 0))
    page.obstacle_editor.add((1.0, -2.0), (0.4, 0.4))
    wait_until(lambda: bindings("Drag", 1))
    page.panel.use_tool(Tool.GOAL)
    wait_until(lambda: bindings("Drag", 0) == bindings("Drag", 1) == [])
    assert bindings("Click", 0)
    assert bindings("Click", 1)
