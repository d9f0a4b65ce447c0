"""The pictures of the docs that no command draws.

    python -m docs.make.pictures animation --out docs/images/walk.webp
    python -m docs.make.pictures page --out docs/images/page.png [--phone] [--dark] [--follow]
    python -m docs.make.pictures stairs --out stairs.png [--policy NAME.safetensors] [--rise 0.1]

animation: a film of `navigate --video` through a map, quicker and smaller; `--film walk.mp4`
converts a film that is there already. page: the page of `serve` in a real browser, after the robot
has been sent off and taken a few steps; needs Playwright for Python (the extra `test`) and Debian's
chromium, and without a graphics card a minute. stairs: a policy on flights of stairs as in
training, one row per flight; plates show the present and the next step, blue for the left foot.
The flights are held out: training uses other seeds. Animation and stairs need a GL library.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from PIL import Image

from app.output import replacing, write_picture
from app.pictures.film import tile
from controller.curriculum import Stage
from controller.env import TaskConfig
from controller.gym_env import GymTask
from controller.gym_render import WIDTH
from controller.policy import Policy, load_policy
from sim.robots import get_robot

ROOT = Path(__file__).resolve().parents[2]
BROWSER_ARGUMENTS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"]
BROWSER_ARGUMENTS += ["--enable-unsafe-swiftshader", "--disable-background-networking"]
BROWSER_ARGUMENTS += ["--no-first-run"]
PATIENCE_MS = 300_000
# An upright phone, and a window.
PHONE, WINDOW = {"width": 390, "height": 844}, {"width": 1200, "height": 750}
STAIR_MODES = ("stairs_over", "stairs_curved")
MOMENTS = 6
SHOWN_TICKS = 520


def main() -> None:
    """Makes the picture that is asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    kinds = parser.add_subparsers(required=True)

    def kind(name: str, make: Any) -> argparse.ArgumentParser:
        words = kinds.add_parser(name)
        words.set_defaults(make=make)
        words.add_argument("--out", type=Path, required=True, help="the picture to write")
        return words

    words = kind("animation", make_animation)
    words.add_argument("--film", type=Path, help="such as walk.mp4; none: one is made")
    words.add_argument("--map", default="maps/room.png")
    words.add_argument("--goal", default="2,1,1.57")
    words.add_argument("--speed", type=float, default=2.0, help="times real time")
    words.add_argument("--frames-per-s", type=float, default=12.0)
    words.add_argument("--width", type=int, default=640, help="pixels")
    words.add_argument("--quality", type=int, default=60, help="0 to 100")
    words = kind("page", make_page_picture)
    words.add_argument("--map", default="maps/room.png")
    words.add_argument("--goal", default="2,1,90", help="x and y in m, heading in degrees")
    words.add_argument("--steps", type=int, default=6, help="steps before the picture is taken")
    words.add_argument("--phone", action="store_true", help="a phone, held upright")
    words.add_argument("--dark", action="store_true", help="the dark theme")
    words.add_argument("--follow", action="store_true", help="with a camera that follows")
    words = kind("stairs", make_stairs_picture)
    words.add_argument("--robot", default="jvrc1")
    words.add_argument("--policy", type=Path)
    words.add_argument("--rise", type=float, default=0.10)
    words.add_argument("--seed", type=int, default=39)
    options = parser.parse_args()
    options.make(options)


def make_animation(options: argparse.Namespace) -> None:
    """Films a walk if there is no film yet, and writes the animation."""
    with tempfile.TemporaryDirectory() as folder:
        film = options.film or filmed(Path(folder), options.map, options.goal)
        step_s = options.speed / options.frames_per_s
        pictures = [
            Image.fromarray(smaller(picture, options.width)) for picture in frames(film, step_s)
        ]
    # It begins anew when it is over; the last picture stays for a second.
    shown_ms = [round(1000 / options.frames_per_s)] * (len(pictures) - 1) + [1000]
    with replacing(options.out) as temporary:
        pictures[0].save(
            temporary,
            format="WEBP",
            save_all=True,
            append_images=pictures[1:],
            duration=shown_ms,
            loop=0,
            quality=options.quality,
            method=4,
        )
    kilobytes = options.out.stat().st_size / 1000
    print(f"{options.out}: {len(pictures)} frames of {pictures[0].size}, {kilobytes:.0f} kB")


def filmed(folder: Path, map_file: str, goal: str) -> Path:
    """A film of the walk, by the command of everybody."""
    film = folder / "walk.mp4"
    words = [sys.executable, "main.py", "navigate", "--map", map_file, "--goal", goal]
    words += ["--out", str(folder), "--video", str(film), "--video-size", "960x540"]
    subprocess.run(words, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
    return film


def frames(film: Path, step_s: float) -> Iterator[np.ndarray]:
    """Every picture (height, width, 3), red green blue, that is this much later than the last."""
    due_s = 0.0
    with av.open(str(film)) as container:
        for frame in container.decode(video=0):
            if frame.time is not None and frame.time >= due_s - 1e-6:
                due_s += step_s
                yield frame.to_ndarray(format="rgb24")


def smaller(picture: np.ndarray, width: int) -> np.ndarray:
    """The picture at this width, its proportions kept."""
    height = round(picture.shape[0] * width / picture.shape[1])
    return cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)


def make_page_picture(options: argparse.Namespace) -> None:
    """Serves a page, sends the robot off, and takes the picture."""
    from playwright.sync_api import sync_playwright

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
                executable_path=shutil.which("chromium"), args=BROWSER_ARGUMENTS
            )
            page = browser.new_page(viewport=PHONE if options.phone else WINDOW)
            page.set_default_timeout(PATIENCE_MS)
            page.goto(found[0] + ("/?darkMode" if options.dark else ""))
            send_robot(page, options.goal, options.steps, follow=options.follow)
            with replacing(options.out) as temporary:
                page.screenshot(path=str(temporary))
            browser.close()
    finally:
        server.terminate()
        server.wait(timeout=30)


def send_robot(page: Any, goal: str, steps: int, *, follow: bool) -> None:
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
    # A browser that draws without a graphics card lags behind a robot that walks on.
    page.get_by_role("button", name="Pause", exact=True).click()
    page.get_by_text("Walking").first.scroll_into_view_if_needed()
    # viser complains of such a browser.
    page.add_style_tag(content=".mantine-Notification-root { display: none }")
    page.wait_for_timeout(5000)


def make_stairs_picture(options: argparse.Namespace) -> None:
    """Walks the flights and writes the picture."""
    policy = load_policy(get_robot(options.robot), options.policy)
    pictures = [
        picture
        for mode in STAIR_MODES
        for picture in moments(options.robot, policy, mode, options.rise, options.seed)
    ]
    write_picture(options.out, tile(pictures, MOMENTS)[:, :, ::-1])


def moments(robot: str, policy: Policy, mode: str, rise_m: float, seed: int) -> list[np.ndarray]:
    """Moments of one walk, evenly spread, each half as large as its rendering, red green blue."""
    task = GymTask(
        robot,
        mode=mode,
        config=TaskConfig(exact_rise=True, episode_ticks=SHOWN_TICKS + 2),
        stage=Stage(rise_m=rise_m),
        render_mode="rgb_array",
    )
    task.restart(np.random.SeedSequence([20_000 + seed]))
    shown = set(np.linspace(60, SHOWN_TICKS, MOMENTS).astype(int))
    pictures, observation = [], task.observe()
    for tick in range(SHOWN_TICKS + 1):
        if tick in shown:
            # Half size, as the renderer does not smooth edges.
            pictures.append(smaller(task.pictures()[0], WIDTH // 2))
        step = task.step(policy.act(task.unscaled(observation)))
        if step.terminated.any():
            raise RuntimeError(f"the robot fell at tick {tick} of {mode}, seed {seed}")
        observation = step.observation
    task.close()
    return pictures


if __name__ == "__main__":
    main()
