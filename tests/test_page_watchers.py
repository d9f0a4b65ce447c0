"""Several pages at one robot: none harms another, and none makes the server grow."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from app.navigation.live_navigator import Notice
from app.viewer.camera import overview
from app.viewer.page import Page, open_page
from app.viewer.snapshot import Snapshot
from benchmarks.page_watcher import Watcher, painted_in_background
from planner.plan import FootstepPlan
from tests.scenes import HALL, POLICY, ROBOT, wait_until


class Served:
    """A page that is served; after `live` its robot lives and a thread draws what happens."""

    def __init__(self) -> None:
        self._stack = contextlib.ExitStack()
        self.page = self._stack.enter_context(open_page(HALL, ROBOT, POLICY, title="test"))
        self.server, self.session = self.page.server, self.page.session
        self.session.clock.factor = math.inf

    def live(self) -> None:
        """Lets the robot live and the page be drawn."""
        self.session.start()
        self._stack.enter_context(painted_in_background(self.page))

    def close(self) -> None:
        self._stack.close()

    @property
    def kept(self) -> tuple[int, int, int]:
        """Messages kept for who comes later, nodes of the scene, controls of the panel."""
        buffer = self.server.broadcast
        nodes, controls = (
            self.server.scene._handle_from_node_name,
            self.server.gui._gui_input_handle_from_uuid,
        )
        return len(buffer.message_from_id), len(nodes), len(controls)


@pytest.fixture
def served() -> Iterator[Served]:
    served = Served()
    yield served
    served.close()


@pytest.mark.parametrize("parting", ["close", "vanish", "sleep"])
def test_a_page_that_goes_or_sleeps_on_the_way_harms_neither_robot_nor_others(served, parting):
    served.live()
    stays = Watcher(served.server.url)
    goes = Watcher(served.server.url, is_lazy=parting == "sleep")
    wait_until(lambda: served.page.visitors == 2, "two pages are open")
    served.session.go_to((2.0, 0.0, 0.0))
    wait_until(lambda: len(served.session.snapshot.placed_side) >= 2, "two steps")
    if parting != "sleep":
        getattr(goes, parting)()
        wait_until(lambda: served.page.visitors == 1, "one page is gone")
    before = stays.heard["SetPositionMessage"]
    wait_until(lambda: served.session.snapshot.status == "reached", "the robot is there")
    wait_until(lambda: stays.heard["SetPositionMessage"] > before, "the other page sees it walk")
    stays.close()
    goes.vanish()
    wait_until(lambda: served.page.visitors == 0, "nobody is left")


def test_the_camera_follows_on_the_page_that_wants_it_alone(served):
    served.live()
    follows, stays = Watcher(served.server.url), Watcher(served.server.url)
    wait_until(lambda: served.page.visitors == 2, "two pages are open")
    kind = "SetCameraPositionMessage"
    wait_until(lambda: follows.heard[kind] and stays.heard[kind], "both look at the map")
    time.sleep(0.2)
    before = stays.heard[kind]
    served.page.cameras.toggle(min(served.server.get_clients()))
    served.session.go_to((2.0, 0.0, 0.0))
    wait_until(lambda: served.session.snapshot.status == "reached", "the robot is there")
    first, second = follows.heard[kind], stays.heard[kind]
    assert sorted((first > before + 5, second > before + 5)) == [False, True]
    assert min(first, second) == before
    follows.close()
    stays.close()


def test_a_phone_that_is_turned_sees_the_map_anew(served):
    served.live()
    phone = Watcher(served.server.url, width_px=390, height_px=844)

    def sees_the_map() -> bool:
        told = phone.last.get("SetCameraPositionMessage", {"position": (0, 0, 0)})
        wanted_m = overview(HALL, phone.shape_px[0] / phone.shape_px[1]).position_m
        return np.allclose(told["position"], wanted_m, atol=1e-3)

    wait_until(sees_the_map, "it sees the map above the panel")
    phone.shape_px = 844, 390
    phone.say_camera((0.0, -5.0, 5.0), (0.0, 0.0, 0.0))
    wait_until(sees_the_map, "it sees the map beside the panel")
    phone.close()


@pytest.mark.slow
def test_a_page_that_begins_where_all_do_is_aimed_again(served):
    """Whether a slow browser hears first where pages begin or where it is to look from is open."""
    served.live()
    page = Watcher(served.server.url, width_px=600, height_px=600)
    kind, wanted_m = "SetCameraPositionMessage", overview(HALL, 1.0).position_m
    # One says where all pages begin, made for another shape of window, the other aims this page.
    wait_until(lambda: page.heard[kind] == 2, "it has heard both")
    begin = overview(HALL, 1.5)
    page.say_camera(begin.position_m.tolist(), begin.look_at_m.tolist())
    wait_until(lambda: page.heard[kind] > 2, "it is aimed again")
    assert page.last[kind]["position"] == pytest.approx(wanted_m, abs=1e-3)
    # Whoever looks elsewhere is let alone.
    before = page.heard[kind]
    page.say_camera((1.0, -4.0, 4.0), (0.0, 0.0, 0.0))
    time.sleep(1.5)
    assert page.heard[kind] == before
    page.close()


def shown_walk(page: Page, start: Snapshot, frames: int, rng: np.random.Generator) -> None:
    """Draws so many moments of made-up walks, with everything changing all the time."""
    count = 40
    side = np.arange(count, dtype=np.int8) % 2
    for frame in range(frames):
        pose = np.column_stack([rng.uniform(-1, 3, (count, 2)), np.zeros((count, 2))])
        plan = FootstepPlan(
            start_feet_world=pose[:2],
            start=(0, 0, 0),
            goal=(1, 0, 0),
            side=side,
            pose_world=pose,
        )
        qpos = start.qpos.copy()
        qpos[:2] = pose[0, :2]
        done = frame % count
        page.show(
            replace(
                start,
                qpos=qpos,
                time_s=frame / 30,
                goal=tuple(pose[-1, :3]),
                plan=plan,
                done=done,
                placed_side=side[:done],
                placed_world=pose[:done],
                foot_error_m=np.abs(pose[:done, 0]) / 100,
                path_world=pose[:done, :2],
                replans=frame,
                answer_s=frame / 1000,
                notice=Notice(text=f"notice {frame}", alternative=(0, 0, 0)) if frame % 3 else None,
            )
        )


def test_an_hour_of_news_is_kept_in_the_room_of_a_minute(served):
    served.page.text_every_s = served.page.plot_every_s = 0.0
    rng = np.random.default_rng(0)
    shown_walk(served.page, served.session.snapshot, 100, rng)
    before = served.kept
    assert min(before) > 10
    shown_walk(served.page, served.session.snapshot, 500, rng)
    assert served.kept == before


def test_threads_that_write_at_once_meet_no_change_of_who_waits(served):
    """viser's own events, set from other threads, break in about one of 100,000 writes."""
    watchers = [Watcher(served.server.url) for _ in range(3)]
    wait_until(lambda: served.page.visitors == 3, "three pages are open")
    buffer = served.server.broadcast
    events = [buffer.message_event]
    events += [
        client._websock_connection.get_message_buffer().message_event
        for client in served.server.get_clients().values()
    ]
    assert len(events) == 4
    for event in events:
        event.clear()
        event.set()
        assert not event.is_set()
    before = [watcher.heard["SetPositionMessage"] for watcher in watchers]
    shown_walk(served.page, served.session.snapshot, 10, np.random.default_rng(0))
    wait_until(
        lambda: all(
            watcher.heard["SetPositionMessage"] > count
            for watcher, count in zip(watchers, before, strict=True)
        ),
        "all see the robot move",
    )
    for watcher in watchers:
        watcher.close()


def test_boxes_and_pages_that_come_and_go_leave_nothing_behind(served):
    def come_and_go() -> None:
        watcher = Watcher(served.server.url)
        wait_until(lambda: served.page.visitors == 1, "the page is open")
        for place in range(5):
            served.page.obstacle_editor.add((1.0 + place / 2, 1.0), (0.3, 0.3))
        served.page.obstacle_editor.clear()
        watcher.vanish()
        wait_until(lambda: served.page.visitors == 0, "the page is gone")

    come_and_go()
    before = served.kept
    for _ in range(5):
        come_and_go()
    assert served.kept == before
    assert served.server._websock_server._client_state_from_id == {}


def test_a_page_opens_as_quickly_after_ages_as_at_first(served):
    """A trillion messages ago: whoever looked for each of them would never be done."""
    buffer = served.server.broadcast
    shown_walk(served.page, served.session.snapshot, 3, np.random.default_rng(0))
    buffer.message_counter += 10**12
    shown_walk(served.page, served.session.snapshot, 2, np.random.default_rng(1))
    watcher = Watcher(served.server.url)
    wait_until(lambda: watcher.heard["ReplayDoneMessage"], "all that was there has been sent")
    assert watcher.heard["SetPositionMessage"] > 10
    assert sum(watcher.heard[kind] for kind in watcher.heard if kind.endswith("MeshMessage")) > 10
    assert len(watcher.heard_of) > 20
    before = watcher.heard["SetPositionMessage"]
    shown_walk(served.page, served.session.snapshot, 2, np.random.default_rng(2))
    wait_until(lambda: watcher.heard["SetPositionMessage"] > before, "news comes after that")
    watcher.close()


@pytest.mark.slow
def test_a_robot_that_rests_sends_nothing(served):
    served.session.clock.factor = 1.0
    served.live()
    watcher = Watcher(served.server.url)

    def is_quiet() -> bool:
        before = watcher.heard.total()
        time.sleep(1.5)
        return watcher.heard.total() == before

    wait_until(is_quiet, "there is nothing to tell")
    before = watcher.heard["SetPositionMessage"]
    assert before > 10
    served.session.go_to((1.0, 0.0, 0.0))
    wait_until(lambda: watcher.heard["SetPositionMessage"] > before, "it sees the robot walk")
    watcher.close()
