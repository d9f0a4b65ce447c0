"""Pictures of the page of `serve`, taken in a real browser while the robot walks.

    python -m docs.make.page_picture --out docs/images/page.png [--phone] [--dark] [--follow]

The robot is sent through maps/room.png; the picture is taken after a few steps. Needs Playwright
for Python (the extra `test`) and Debian's chromium; without a graphics card it takes a minute.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright

from app.output import replacing

ROOT = Path(__file__).resolve().parents[2]
ARGUMENTS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"]
ARGUMENTS += ["--enable-unsafe-swiftshader", "--disable-background-networking", "--no-first-run"]
PATIENCE_MS = 300_000
# An upright phone, and a window.
PHONE, WINDOW = {"width": 390, "height": 844}, {"width": 1200, "height": 750}


def main() -> None:
    """Serve, send the robot off, and take the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="such as docs/images/page.png")
    parser.add_argument("--map", default="maps/room.png")
    parser.add_argument("--goal", default="2,1,90", help="x and y in m, heading in degrees")
    parser.add_argument("--steps", type=int, default=6, help="steps before the picture is taken")
    parser.add_argument("--phone", action="store_true", help="a phone, held upright")
    parser.add_argument("--dark", action="store_true", help="the dark theme")
    parser.add_argument("--follow", action="store_true", help="with a camera that follows")
    options = parser.parse_args()
    words = [sys.executable, "main.py", "serve", "--map", options.map, "--port", "0"]
    server = subprocess.Popen(words, cwd=ROOT, stderr=subprocess.PIPE, text=True)
    assert server.stderr is not None
    try:
        told = ""
        while not (found := re.search(r"http://\S+", told)):
            line = server.stderr.readline()
            if not line:
                raise RuntimeError(f"the page is not served: {told}")
            told += line
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(
                executable_path=shutil.which("chromium"), args=ARGUMENTS
            )
            page = browser.new_page(viewport=PHONE if options.phone else WINDOW)
            page.set_default_timeout(PATIENCE_MS)
            page.goto(found[0] + ("/?darkMode" if options.dark else ""))
            walk(page, options.goal, options.steps, follow=options.follow)
            with replacing(options.out) as temporary:
                page.screenshot(path=str(temporary))
            browser.close()
    finally:
        server.terminate()
        server.wait(timeout=30)


def walk(page: Any, goal: str, steps: int, *, follow: bool) -> None:
    """Types the goal in and waits until so many steps are taken."""
    page.get_by_text("Standing").wait_for()
    if follow:
        page.get_by_label("Camera follows").check(force=True)
    for label, number in zip(("x, m", "y, m", "heading, °"), goal.split(","), strict=True):
        page.get_by_label(label, exact=True).fill(number)
    page.get_by_role("button", name="Go", exact=True).click()
    page.wait_for_function(
        f"parseInt((/step (\\d+) of/.exec(document.body.innerText) || [0, 0])[1]) >= {steps}"
    )
    # viser complains of a browser that draws without a graphics card.
    page.add_style_tag(content=".mantine-Notification-root { display: none }")
    page.wait_for_timeout(1000)


if __name__ == "__main__":
    main()
