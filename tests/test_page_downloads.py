"""The files that the page gives about its walk, and light and dark pages."""

from __future__ import annotations

import http.client
import math
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
import pytest

from app.navigation.report import NavigationReport
from app.viewer.html_page import DARK_COOKIE
from app.viewer.page import Page, open_page
from app.viewer.scene import DARK
from benchmarks.page_watcher import Watcher, painted_in_background
from planner.plan import FootstepPlan
from tests.scenes import HALL, POLICY, ROBOT, wait_until

NAMES = ("plan.json", "path.png", "report.json", "walk.html")


@pytest.fixture
def page() -> Iterator[Page]:
    with (
        open_page(HALL, ROBOT, POLICY, title="files", map_name="hall") as page,
        painted_in_background(page),
    ):
        page.session.clock.factor = math.inf
        page.session.start()
        yield page


def test_each_file_is_there_as_soon_as_it_can_be(page):
    content = page.panel.downloads.content
    assert [content(name) for name in NAMES] == [None] * 4
    page.session.clock.factor = 0.0
    page.session.go_to((0.6, 0.0, 0.0))
    wait_until(
        lambda: page.session.snapshot.plan is not None and not page.session.snapshot.requested
    )
    assert [content(name) is None for name in NAMES] == [False, False, True, True]
    page.session.clock.factor = math.inf
    wait_until(lambda: page.session.snapshot.status == "reached")
    files = [content(name) for name in NAMES]
    plan_json, path_png, report_json, walk_html = (file or b"" for file in files)
    plan = FootstepPlan.from_json(plan_json.decode())
    assert (plan.robot, plan.map, plan.goal) == ("jvrc1", "hall", (0.6, 0.0, 0.0))
    report = NavigationReport.from_json(report_json.decode())
    assert (report.outcome, report.map) == ("reached", "hall")
    picture = cv2.imdecode(np.frombuffer(path_png, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    assert picture.std() > 1
    title = f"<title>Footfall: {ROBOT.title} on hall</title>"
    assert walk_html.decode().count(title) == 1
    assert '"outcome": "reached' in walk_html.decode()


def node(watcher: Watcher, name: str) -> dict[str, Any]:
    return watcher.last_of.get(("SceneNodeUpdateMessage", name), {}).get("updates", {})


def test_a_page_that_was_dark_opens_dark_with_its_map(page):
    light = Watcher(page.server.url)
    dark = Watcher(page.server.url, cookie=f"{DARK_COOKIE}=1")
    wait_until(lambda: node(dark, "/map/lines"))
    assert tuple(node(dark, "/map/floor")["color"]) == DARK.floor
    assert tuple(node(dark, "/map/lines")["cell_color"]) == DARK.line
    assert dark.last["ThemeConfigurationMessage"]["dark_mode"]
    assert not light.last["ThemeConfigurationMessage"]["dark_mode"]
    assert node(light, "/map/floor") == {}
    # Nothing is coloured that is not on this map: the hall has no walls.
    assert node(dark, "/map/walls") == {}
    light.close()
    dark.close()


def test_the_page_has_its_title_and_the_sheet_for_phones_once(page):
    connection = http.client.HTTPConnection("127.0.0.1", page.server.get_port(), timeout=60)
    connection.request("GET", "/")
    body = connection.getresponse().read().decode()
    connection.close()
    assert body.count("<title>files</title>") == 1
    assert body.count("max-height: 33% !important") == 1
    assert body.index("max-height: 33%") < body.index("<body")
