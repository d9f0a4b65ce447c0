"""Whether a page that is left open grows: memory of a served robot over hours of walking.

    python -m benchmarks.page_memory [--rounds 60] [--updates 2000]
    python -m benchmarks.page_memory --minutes 60

Several pages watch one robot. In each round it gets a goal, a box is put down and taken away on
its way, so that it plans anew, and a page opens and another one vanishes without a word. The robot
walks as fast as it goes and the scene is drawn --updates times a round (2,000 are a minute at 30
frames a second); with --minutes it walks in real time instead, drawn as `serve` draws it, for so
long.

Prints what is held after every few rounds, how many messages there ever were, and the processor
time that the opening of a page takes: the median of a few, all threads of the server and of the
page that opens. Needs no browser; memory is read from /proc (Linux).
"""

from __future__ import annotations

import argparse
import gc
import math
import statistics
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from app.controllers import load_walker
from app.options import MapOptions, read_grid
from app.viewer.page import Page, open_page
from benchmarks.page_watcher import Watcher, painted_in_background, wait

GOALS = ((2.0, 1.0, 1.57), (0.0, 0.0, 3.1))
ROWS = 12
OPENINGS = 5
# A robot that stands is simulated for two seconds, and drawn; then it is measured.
REST_S = 2.5
HEADER = (
    "minute  round  frames  replans  server MB  planner MB  messages  ever were  nodes  threads"
    "  pages  opening ms"
)


def main() -> None:
    """Serve, walk, and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--map", type=Path, default=Path("maps/room.png"))
    parser.add_argument("--rounds", type=int, default=60)
    parser.add_argument("--updates", type=int, default=2000)
    parser.add_argument("--watchers", type=int, default=3)
    parser.add_argument("--minutes", type=float, help="walk in real time for so long")
    options = parser.parse_args()
    grid = read_grid(MapOptions(map=options.map))
    robot, policy = load_walker("jvrc1")
    with ExitStack() as stack:
        page = stack.enter_context(open_page(grid, robot, policy, title="memory"))
        walks = Walks(page, options.updates if options.minutes is None else None)
        if options.minutes is not None:
            stack.enter_context(painted_in_background(page))
        page.session.start()
        for _ in range(options.watchers):
            stack.callback(Watcher(page.server.url).close)
        print(HEADER, flush=True)
        rows, number = 0, 0
        while True:
            done = number / max(1, options.rounds)
            if options.minutes is not None:
                done = walks.minutes / options.minutes
            if done * ROWS >= rows:
                rows += 1
                if options.minutes is not None:
                    time.sleep(REST_S)
                report(number, walks)
            if done >= 1.0:
                return
            passing = Watcher(page.server.url)
            walks.walk(number)
            passing.vanish()
            number += 1


class Walks:
    """Walks to and fro on a page, round by round; counts the minutes, frames and new plans.

    With `updates` the robot walks as fast as it goes, and all that `serve` draws now and then is
    drawn at each frame, so often in each round; without it walks in real time, drawn by another.
    """

    def __init__(self, page: Page, updates: int | None) -> None:
        self.page = page
        self.frames = self.replans = 0
        self._updates = updates
        self._began_s = time.monotonic()
        # Every drawing counts, whichever thread does it.
        self._show, page.show = page.show, self._count  # type: ignore[method-assign]
        if updates is not None:
            page.text_every_s = page.plot_every_s = 0.0
            page.session.clock.factor = math.inf

    @property
    def minutes(self) -> float:
        """On the wall, since the beginning."""
        return (time.monotonic() - self._began_s) / 60

    def _count(self, *args: object) -> None:
        self._show(*args)  # type: ignore[arg-type]
        self.frames += 1

    def walk(self, number: int) -> None:
        """One round: a goal, a box on the way there, and on."""
        page, session = self.page, self.page.session
        self._wait(lambda: session.snapshot.status in ("standing", "reached"))
        before = session.snapshot.walk
        session.go_to(GOALS[number % 2])
        self._wait(lambda: session.snapshot.walk > before and len(session.snapshot.placed_side) > 0)
        page.obstacle_editor.add((-1.0, -1.0), (0.2, 0.2))
        self._wait(lambda: session.snapshot.replans > 0 or session.snapshot.status != "walking")
        page.obstacle_editor.clear()
        for _ in range(self._updates or 0):
            page.show(session.snapshot)
        self._wait(lambda: session.snapshot.status != "walking")
        ended = session.snapshot
        if ended.status != "reached":
            session.reset()
            self._wait(lambda: session.snapshot.walk > ended.walk)
        self.replans += ended.replans

    def _wait(self, wanted: Callable[[], bool]) -> None:
        """Lets time pass until something is so."""
        wait(wanted, self._pass_time)

    def _pass_time(self) -> None:
        if self._updates is not None:
            self.page.show(self.page.session.snapshot)
        time.sleep(0.05 if self._updates is None else 0.005)


def report(number: int, walks: Walks) -> None:
    """Prints a row of what is held."""
    page = walks.page
    gc.collect()
    opening_ms = 1000 * statistics.median(opening_s(page) for _ in range(OPENINGS))
    buffer = page.server.broadcast
    nodes = len(page.server.scene._handle_from_node_name)
    planner = page.session.planner_pid
    planner_mb = 0.0 if planner is None else megabytes(str(planner))
    print(
        f"{walks.minutes:6.1f} {number:6d} {walks.frames:7d} {walks.replans:8d} "
        f"{megabytes('self'):10.1f} {planner_mb:11.1f} {len(buffer.message_from_id):9d} "
        f"{buffer.message_counter:10d} {nodes:6d} {threading.active_count():8d} "
        f"{page.visitors:6d} {opening_ms:11.0f}",
        flush=True,
    )


def opening_s(page: Page) -> float:
    """Processor time until one more page has all that is to be seen, while nothing is drawn."""
    began_s = time.process_time()
    watcher = Watcher(page.server.url)
    wait(lambda: watcher.heard["ReplayDoneMessage"] > 0)
    took_s = time.process_time() - began_s
    watcher.close()
    return took_s


def megabytes(process: str) -> float:
    """Resident memory of a process."""
    for line in Path(f"/proc/{process}/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024
    return 0.0


if __name__ == "__main__":
    main()
