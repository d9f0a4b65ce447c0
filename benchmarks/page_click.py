"""How long from a click on the page to the footprints of the plan: time on the wall and processor.

    python -m benchmarks.page_click [--map maps/room.png] [--goals 25] [--seed 0]

The robot stands at its start; random places of the floor are clicked, as a browser would, where a
plan leads. Wall time is from the message that says "clicked" to the first footprints of the plan
arriving at the page, both over the socket; "planner asked" is that of the planner alone, as the
page tells it. Processor time is that of the two processes meanwhile: the server, with physics and
the page that listens in it, and the planner. Needs no browser; processor time of the planner is
read from /proc (Linux).
"""

from __future__ import annotations

import argparse
import contextlib
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path

import numpy as np

from app.controllers import load_walker
from app.options import MapOptions, read_grid
from app.viewer.page import Page, open_page
from app.viewer.session import Session
from benchmarks.page_watcher import Watcher, painted_in_background, wait
from maps.grid import OccupancyGrid
from planner.options import PlannerOptions

ABOVE_M = 5.0
# So long nothing must come before the next click.
QUIET_S = 0.3
PRINTS = ("/steps/planned_left", "/steps/next_left", "/steps/next_right")
# As `serve` plans unless it is told otherwise.
SERVED = PlannerOptions(refine=True)
HEADER = "goal           click to prints  planner asked  server cpu  planner cpu   (ms)"


def main() -> None:
    """Serve, click, and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--map", type=Path, default=Path("maps/room.png"))
    parser.add_argument("--goals", type=int, default=25)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    grid = read_grid(MapOptions(map=options.map))
    rows: list[tuple[float, ...]] = []
    rng = np.random.default_rng(options.seed)
    x0, y0, x1, y1 = grid.bounds_world()
    with watched_page(grid) as (page, watcher):
        print(HEADER)
        while len(rows) < options.goals:
            x_m, y_m = float(rng.uniform(x0, x1)), float(rng.uniform(y0, y1))
            row = clicked(page.session, watcher, x_m, y_m)
            if row is not None:
                rows.append(row)
                print_row(f"{x_m:6.2f},{y_m:6.2f}", row)
    print_row("median", tuple(np.median(rows, axis=0)))
    print_row("worst", tuple(np.max(rows, axis=0)))


@contextlib.contextmanager
def watched_page(grid: OccupancyGrid) -> Iterator[tuple[Page, Watcher]]:
    """A page that plans as `serve` does, ready for clicks, and one who watches it."""
    robot, policy = load_walker("jvrc1", None)
    with (
        open_page(grid, robot, policy, title="clicks", options=SERVED) as page,
        painted_in_background(page),
    ):
        watcher = Watcher(page.server.url)
        page.session.start()
        # A click waits for a planner that is still loading.
        wait(lambda: page.visitors == 1 and not page.session.snapshot.loading)
        yield page, watcher
        watcher.close()


def clicked(
    session: Session,
    watcher: Watcher,
    x_m: float,
    y_m: float,
    meanwhile: AbstractContextManager[None] | None = None,
) -> tuple[float, ...] | None:
    """Milliseconds, in the order of HEADER; None if that goal is refused.

    The robot is put back to its start first. `meanwhile` is entered for what is measured alone,
    from the click to the footprints.
    """
    session.reset()
    wait(lambda: session.snapshot.status == "standing" and session.snapshot.notice is None)
    wait(lambda: is_quiet(watcher))
    began, before = (time.monotonic(), time.process_time(), planner_s(session)), footprints(watcher)
    with meanwhile or contextlib.nullcontext():
        watcher.click("/map/slab", (x_m, y_m, ABOVE_M), (0.0, 0.0, -1.0))
        wait(lambda: footprints(watcher) > before or session.snapshot.notice is not None)
    if session.snapshot.notice is not None:
        return None
    ended = time.monotonic(), time.process_time(), planner_s(session)
    wall_s, server_cpu_s, planner_cpu_s = (b - a for a, b in zip(began, ended, strict=True))
    answer_s = session.snapshot.answer_s
    assert answer_s is not None
    return 1000 * wall_s, 1000 * answer_s, 1000 * server_cpu_s, 1000 * planner_cpu_s


def footprints(watcher: Watcher) -> int:
    """How often the page was told of footprints."""
    return sum(watcher.heard_of[name] for name in PRINTS)


def is_quiet(watcher: Watcher) -> bool:
    """Whether no footprints come for a while."""
    before = footprints(watcher)
    time.sleep(QUIET_S)
    return footprints(watcher) == before


def planner_s(session: Session) -> float:
    """Processor time of the planner so far."""
    nanoseconds = Path(f"/proc/{session.planner_pid}/schedstat").read_text().split()[0]
    return int(nanoseconds) / 1e9


def print_row(name: str, row: tuple[float, ...]) -> None:
    """Prints milliseconds below the header."""
    wall, answer, server, planner = row
    print(f"{name:13s} {wall:16.0f} {answer:14.0f} {server:11.0f} {planner:12.0f}", flush=True)


if __name__ == "__main__":
    main()
