"""The page in a real browser: what a person sees, clicks and waits for.

Needs Debian's chromium (or the browser that FOOTFALL_CHROMIUM names) and Playwright for Python;
skipped where one of them is missing.
"""

from __future__ import annotations

import base64
import contextlib
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from app.navigation.report import NavigationReport
from app.viewer.camera import FIELD_OF_VIEW_RAD, overview
from app.viewer.panel import CHOSEN
from app.workers import compile_planner
from planner.options import PlannerOptions
from planner.plan import FootstepPlan
from sim.robots import get_robot
from tests.programs import ROOT, run_python
from tests.scenes import HALL

BROWSER = os.environ.get("FOOTFALL_CHROMIUM") or shutil.which("chromium")
ARGUMENTS = [
    *("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
    "--no-first-run",
]
# The browser draws without a graphics card, and slowly.
PATIENCE_MS = 300_000
CLICKS = 10
# Whether the slider has been at a share of its way for a second.
WAITS_AT = """share => {
    const slider = document.querySelector('[role=slider]'), now = Date.now();
    const [at, most] = ['now', 'max'].map(end => Number(slider.getAttribute('aria-value' + end)));
    if (window.at !== at) [window.at, window.since] = [at, now];
    return Math.abs(at / most - share) < 0.03 && now - window.since > 1000;
}"""
# Files that are dropped on the page: name and content in base64 of each.
DROP = """files => {
    const dataTransfer = new DataTransfer();
    for (const [name, content] of files) {
        const bytes = Uint8Array.from(atob(content), letter => letter.charCodeAt(0));
        dataTransfer.items.add(new File([bytes], name));
    }
    document.body.dispatchEvent(new DragEvent('drop', {dataTransfer, bubbles: true}));
}"""
# A complaint of the viewer's own about its dragging; nothing comes of it.
HARMLESS = "Unable to preventDefault inside passive event listener"

try:
    from playwright.sync_api import Page, sync_playwright
    from playwright.sync_api import TimeoutError as PlaywrightTimeout
except ImportError:
    pytest.skip("no Playwright: pip install playwright", allow_module_level=True)
if BROWSER is None:
    pytest.skip("no browser: apt-get install chromium", allow_module_level=True)


WIDTH_PX, HEIGHT_PX = 900, 600


def pixel_of(x_m: float, y_m: float, z_m: float = 0.0) -> tuple[float, float]:
    """Where a page's first view shows a point of the hall, on its floor or above."""
    sight = overview(HALL, WIDTH_PX / HEIGHT_PX)
    right = np.array([1.0, 0.0, 0.0])
    away_m = np.array([x_m, y_m, z_m]) - sight.position_m
    scale = HEIGHT_PX / 2 / np.tan(FIELD_OF_VIEW_RAD / 2) / (away_m @ sight.forward)
    up = np.cross(right, sight.forward)
    return WIDTH_PX / 2 + scale * (away_m @ right), HEIGHT_PX / 2 - scale * (away_m @ up)


class Visit:
    """A page that is open in the browser, and what it asked for and complained of."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.errors: list[str] = []
        self.hosts: set[str] = set()
        page.set_default_timeout(PATIENCE_MS)
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("console", self._heard)
        page.on("request", lambda request: self._asked(request.url))
        page.on("websocket", lambda socket: self._asked(socket.url))

    def _heard(self, message: Any) -> None:
        if message.type == "error" and HARMLESS not in message.text:
            self.errors.append(message.text)

    def _asked(self, url: str) -> None:
        if not url.startswith(("data:", "blob:")):
            self.hosts.add(re.sub(r"^\w+://([^/:]*).*$", r"\1", url))

    @property
    def told(self) -> str:
        """What the panel says, from the status on."""
        return self.page.inner_text("body")

    def reads(self, pattern: str) -> None:
        """Waits until the page says this; if it never does, the error is what it says instead."""
        try:
            self.page.wait_for_function(f"/{pattern}/.test(document.body.innerText)")
        except PlaywrightTimeout:
            raise AssertionError(f"never read {pattern!r}; at the end:\n{self.told}") from None

    def heading(self, text: str) -> None:
        """Waits until the status begins with this."""
        self.reads(f"(^|\\n)({text})")

    def click_floor(self, x_m: float, y_m: float) -> None:
        """Clicks the floor of the hall there, if the camera is where it was at first."""
        self.page.mouse.click(*pixel_of(x_m, y_m))

    def number(self, pattern: str) -> float:
        """The number in the panel's text."""
        found = re.search(pattern, self.page.inner_text("body"))
        assert found, f"{pattern} is not on the page"
        return float(found[1])


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=BROWSER, args=ARGUMENTS)
        yield browser
        browser.close()


@pytest.fixture
def visit(browser: Any) -> Iterator[Visit]:
    page = browser.new_page(viewport={"width": WIDTH_PX, "height": HEIGHT_PX})
    yield Visit(page)
    page.close()


@pytest.fixture(scope="module")
def hall(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The image of the hall, with its YAML beside it."""
    folder = tmp_path_factory.mktemp("hall")
    cv2.imwrite(str(folder / "hall.png"), np.full(HALL.shape, 255, np.uint8))
    (folder / "hall.yaml").write_text(
        "image: hall.png\nresolution: 0.05\norigin: [-2, -3, 0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    return folder / "hall.png"


@pytest.fixture(scope="module")
def address(hall: Path) -> Iterator[str]:
    """Where `serve` says that its page is."""
    # The page opens at once; a click waits for a planner that is compiled first.
    compile_planner(get_robot("jvrc1").step_model, PlannerOptions())
    words = [sys.executable, "main.py", "serve", "--map", str(hall), "--port", "0"]
    server = subprocess.Popen(words, cwd=ROOT, stderr=subprocess.PIPE, text=True)
    assert server.stderr is not None
    told = ""
    try:
        while not (found := re.search(r"http://127\.0\.0\.1:\d+", told)):
            line = server.stderr.readline()
            assert line, told
            told += line
        yield found[0]
    finally:
        server.terminate()
        server.wait(timeout=30)


@pytest.mark.slow
def test_a_goal_is_clicked_and_reached_round_a_box_that_comes_up(visit, address):
    page = visit.page
    page.goto(address)
    visit.heading("Standing")
    # A browser that draws without a graphics card clicks late: the robot must not be there before.
    page.get_by_role("button", name="Slow", exact=True).click()
    visit.reads(f"{CHOSEN}Slow")
    visit.click_floor(4.0, 0.5)
    visit.heading("Planning|Walking")
    visit.heading("Walking")
    assert visit.number(r"plan after (\d+) ms") > 0
    assert visit.number(r"step \d+ of (\d+)") > 8

    page.get_by_role("button", name="Pause", exact=True).click()
    visit.reads(f"{CHOSEN}Pause")
    page.get_by_role("button", name="Box", exact=True).click()
    visit.reads("click the floor to set a box down")
    visit.click_floor(2.8, 0.35)
    page.get_by_role("button", name="Fastest").click()
    visit.reads(r"[1-9]\d* replans")
    visit.reads("Reached|Collided|Fell|Stopped")
    assert visit.errors == []
    assert visit.hosts == {"127.0.0.1"}


@pytest.mark.slow
def test_what_is_impossible_is_told_and_a_pose_offered(visit, address):
    page = visit.page
    page.goto(address)
    page.get_by_role("button", name="Reset", exact=True).click()
    visit.heading("Standing")
    page.get_by_label("x, m", exact=True).fill("1")
    page.get_by_label("y, m", exact=True).fill("2.9")
    page.get_by_role("button", name="Go", exact=True).click()
    page.get_by_text("no plan: goal:").wait_for()
    page.get_by_role("button", name="Go to the nearest free pose").click()
    visit.heading("Walking")
    assert visit.errors == []


@pytest.mark.slow
def test_plan_picture_report_and_replay_are_saved(visit, address):
    page = visit.page
    page.goto(address)
    page.get_by_role("button", name="Reset", exact=True).click()
    visit.heading("Standing")
    page.get_by_text("Save", exact=True).first.click()
    page.get_by_role("button", name="report.json", exact=True).click()
    visit.reads("There is none before the end of the walk")
    page.get_by_label("x, m", exact=True).fill("0.4")
    page.get_by_label("y, m", exact=True).fill("0.1")
    page.get_by_role("button", name=re.compile("Fastest")).click()
    page.get_by_role("button", name="Go", exact=True).click()
    visit.heading("Reached")
    documents = {}
    for name in ("plan.json", "report.json", "path.png", "walk.html"):
        with page.expect_download() as coming:
            page.get_by_role("button", name=name, exact=True).click()
        assert coming.value.suggested_filename == name
        documents[name] = Path(coming.value.path()).read_bytes()
    assert FootstepPlan.from_json(documents["plan.json"].decode()).goal[:2] == (0.4, 0.1)
    assert NavigationReport.from_json(documents["report.json"].decode()).outcome == "reached"
    assert (
        cv2.imdecode(np.frombuffer(documents["path.png"], np.uint8), cv2.IMREAD_COLOR) is not None
    )
    assert b"Footfall: JVRC-1 on" in documents["walk.html"]


@pytest.mark.slow
def test_the_address_opens_the_same_on_a_dark_phone(visit, address):
    page = visit.page
    page.goto(f"{address}/?darkMode&start=0,0,0&goal=1,0.5,90deg")
    visit.heading("Walking|Reached")
    page.wait_for_function("/goal=1,0.5,90deg/.test(location.search)")
    assert "darkMode" not in page.url
    page.wait_for_function("document.documentElement.dataset.mantineColorScheme === 'dark'")
    page.set_viewport_size({"width": 390, "height": 844})
    sheet = page.locator("[style*='max-height: 60%']").first
    sheet.wait_for()
    box = sheet.bounding_box()
    assert box is not None
    assert box["height"] <= 844 / 3 + 1
    assert box["width"] == 390
    page.get_by_role("button", name="Undo", exact=True).click()
    page.wait_for_function("!/goal=1,0.5/.test(location.search)")
    assert visit.errors == []


@pytest.mark.slow
def test_light_is_even_and_shadows_are_soft(visit, address):
    """On a box that the address puts there, as seen from where a page begins."""
    page = visit.page
    page.goto(f"{address}/?start=-1,-2,0deg&boxes=2,0,1,1")
    page.wait_for_function("/boxes=2,0,1,1(&|$)/.test(location.search)")
    visit.heading("Standing")

    def brightness() -> dict[str, float]:
        picture = cv2.imdecode(np.frombuffer(page.screenshot(), np.uint8), cv2.IMREAD_GRAYSCALE)
        assert picture is not None
        seen = {
            "top": (2.0, 0.0, 1.0),
            "side": (2.0, -0.5, 0.5),
            "floor": (3.3, -0.3, 0.0),
            "shadow": (2.72, 0.6, 0.0),
        }
        at = {name: np.rint(pixel_of(*point)).astype(int) for name, point in seen.items()}
        return {
            name: float(np.median(picture[v - 2 : v + 3, u - 2 : u + 3]))
            for name, (u, v) in at.items()
        }

    # The scene fades in.
    before: dict[str, float] = {}
    now = brightness()
    while now != before:
        page.wait_for_timeout(2000)
        before, now = now, brightness()
    assert 0.6 < now["side"] / now["top"] < 0.95
    assert 0.75 < now["shadow"] / now["floor"] < 0.98
    page.goto(f"{address}/?boxes=none")
    page.wait_for_function("/boxes=none/.test(location.search)")
    assert visit.errors == []


@pytest.mark.slow
def test_maps_are_chosen_and_sent_and_the_page_stays_open(visit, address, tmp_path):
    """The last of those that share the server: it leaves the hall."""
    page = visit.page
    page.goto(address)
    visit.heading("\\w")
    page.get_by_text("Map", exact=True).first.click()
    (tmp_path / "broken.png").write_bytes(b"nothing")
    page.locator("input[type=file]").set_input_files(tmp_path / "broken.png")
    visit.reads("not an image that can be read")
    page.locator("input[value$='hall.png']").first.click()
    page.get_by_role("option", name="office", exact=True).click()
    visit.reads("Footfall: office")
    visit.heading("Standing")
    floor = np.full((100, 120), 254, np.uint8)
    assert cv2.imwrite(str(tmp_path / "mine.png"), floor)
    page.get_by_text("Map", exact=True).first.click()
    page.locator("input[type=file]").set_input_files(tmp_path / "mine.png")
    visit.reads("Footfall: mine.png")
    visit.heading("Standing")
    # The page that stayed open has the title of the map, and nothing is still being sent.
    page.wait_for_function("document.title === 'Footfall: mine.png'")
    visit.reads("^(?![^]*Uploading )")
    content = base64.b64encode(cv2.imencode(".png", floor)[1].tobytes()).decode()
    yaml = base64.b64encode(b"image: dropped.png\nresolution: 0.1\norigin: [-3, -3, 0]\n").decode()
    page.evaluate(DROP, [["dropped.png", content], ["dropped.yaml", yaml]])
    page.wait_for_function("document.title === 'Footfall: dropped.png'")
    visit.heading("Standing")


@pytest.fixture(scope="module")
def walked(hall: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a walk in the hall, with its replay."""
    folder = tmp_path_factory.mktemp("walked")
    words = ["main.py", "navigate", "--map", hall, "--goal", "0.6,0,0"]
    run_python(*words, "--out", folder, "--html", folder / "walk.html")
    return folder


@pytest.mark.slow
def test_a_replay_fits_a_dark_phone(browser, walked):
    """All of the map is in the window, floor and card are dark."""
    page = browser.new_page(viewport={"width": 390, "height": 844}, color_scheme="dark")
    visit = Visit(page)
    page.goto((walked / "walk.html").as_uri())
    page.locator("#walk-step").wait_for(state="attached")
    page.wait_for_function("document.documentElement.dataset.mantineColorScheme === 'dark'")
    page.add_style_tag(content=".mantine-Notification-root, #walk { display: none }")

    def picture() -> np.ndarray:
        seen = cv2.imdecode(np.frombuffer(page.screenshot(), np.uint8), cv2.IMREAD_GRAYSCALE)
        assert seen is not None
        return seen[:780].astype(int)  # the player's bar is below

    # The scene fades in, again whenever so short a walk begins anew: it is to wait.
    page.keyboard.press("Space")
    before, bright = 0, 1
    while bright < 10_000 or bright > 1.02 * before:
        page.wait_for_timeout(2000)
        seen = picture()
        is_map = seen > seen[0, 0] + 20
        before, bright = bright, int(np.count_nonzero(is_map))
    assert not is_map[:, :8].any()
    assert not is_map[:, -8:].any()
    columns = np.flatnonzero(is_map.any(axis=0))
    assert columns[-1] - columns[0] > 250
    assert np.median(seen[is_map]) < 128
    page.add_style_tag(content="#walk { display: block !important }")
    red = page.evaluate(
        "Number(/\\d+/.exec(getComputedStyle(document.querySelector('#walk')).backgroundColor))"
    )
    assert red < 64
    assert visit.errors == []
    page.close()


@pytest.mark.slow
def test_a_replay_opens_from_disk_and_plays(visit, walked):
    visit.page.goto((walked / "walk.html").as_uri())
    shown = visit.page.locator("input[type=text], input[inputmode]").first
    shown.wait_for()
    visit.page.wait_for_function(
        "[...document.querySelectorAll('input')].some(input => parseFloat(input.value) > 0.5)"
    )
    # The slider: a click near its end goes there, and the walk waits.
    sequence = visit.page.locator(".mantine-Slider-trackContainer").first
    for _ in range(CLICKS):
        # A browser that is short of time may still be laying the panel out: then the click misses.
        box = sequence.bounding_box()
        assert box is not None
        visit.page.mouse.click(box["x"] + 0.9 * box["width"], box["y"] + box["height"] / 2)
        with contextlib.suppress(PlaywrightTimeout):
            visit.page.wait_for_function(WAITS_AT, arg=0.9, timeout=PATIENCE_MS / CLICKS)
            break
    else:
        pytest.fail("the slider never stayed where it was clicked")
    # The walk is over there: the panel tells all steps and how it ended.
    steps = str(len(json.loads((walked / "plan.json").read_text())["steps"]))
    visit.page.wait_for_function(
        "steps => document.querySelector('#walk-step').innerText.split(/\\s+/)[0] == steps",
        arg=steps,
    )
    assert visit.page.inner_text("#walk-step").split()[2] == steps
    assert visit.page.inner_text("#walk-outcome").startswith("reached, ")
    assert visit.page.inner_text("#walk-error").endswith(" cm")
    assert visit.errors == []
    assert visit.hosts <= {""}
