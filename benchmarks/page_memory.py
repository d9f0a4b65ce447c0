"""Whether a page that is left open grows: memory of a served robot over thousands of updates.

    python -m benchmarks.page_memory [--rounds 60] [--updates 2000]

Several pages watch one robot that walks as fast as it goes. In each round it gets a goal, a box is
put down and taken away on its way, so that it plans anew, a page opens and another one vanishes
without a word, and the scene is drawn --updates times (2,000 are a minute at 30 frames a second).
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
from pathlib import Path

from app.inputs import MapOptions, read_grid
from app.page.page import Page
from app.page.server import PageServer, open_server
from app.page.session import Session
from app.page.view import load_robot
from benchmarks.page_watcher import Watcher
from planner.options import PlannerOptions

GOALS = ((2.0, 1.0, 1.57), (0.0, 0.0, 3.1))
PATIENCE_S = 300.0
ROWS = 12
OPENINGS = 5


def main() -> None:
    """Serve, walk, and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--map", type=Path, default=Path("maps/room.png"))
    parser.add_argument("--rounds", type=int, default=60)
    parser.add_argument("--updates", type=int, default=2000)
    parser.add_argument("--watchers", type=int, default=3)
    options = parser.parse_args()
    robot, policy = load_robot("jvrc1")
    server = open_server(title="memory")
    session = Session(read_grid(MapOptions(map=options.map)), robot, policy)
    session.pace.factor = math.inf
    page = Page(
        server,
        session,
        robot,
        robots=(robot.name,),
        load=lambda _name: (robot, policy),
        options=PlannerOptions(),
    )
    # Words and plots at each frame, not four times a second: an hour of them, too.
    page.text_every_s = page.plot_every_s = 0.0
    session.start()
    watchers = [Watcher(server.url) for _ in range(options.watchers)]
    print(
        "round  drawn   replans  server MB  planner MB  messages  ever were  nodes  threads  pages"
        "  opening ms"
    )
    drawn = replans = 0
    try:
        for number in range(options.rounds + 1):
            if number % max(1, options.rounds // ROWS) == 0:
                report(number, drawn, replans, server, session, page)
            passing = Watcher(server.url)
            drawn += options.updates
            replans += walk(session, page, number, options.updates)
            passing.vanish()
    finally:
        for watcher in watchers:
            watcher.close()
        session.close()
        server.stop()


def walk(session: Session, page: Page, number: int, updates: int) -> int:
    """One round; returns how often the robot planned anew."""
    wait(page, lambda: session.snapshot.status in ("standing", "reached"))
    before = session.snapshot.walk
    session.go_to(GOALS[number % 2])
    wait(page, lambda: session.snapshot.walk > before and len(session.snapshot.placed_side) > 0)
    page.toybox.add((-1.0, -1.0), (0.2, 0.2))
    wait(page, lambda: session.snapshot.replans > 0 or session.snapshot.status != "walking")
    page.toybox.clear()
    for _ in range(updates):
        page.show(session.snapshot)
    wait(page, lambda: session.snapshot.status != "walking")
    ended = session.snapshot
    if ended.status != "reached":
        session.reset()
        wait(page, lambda: session.snapshot.walk > ended.walk)
    return ended.replans


def wait(page: Page, wanted: Callable[[], bool]) -> None:
    """Draws until something is so."""
    until_s = time.monotonic() + PATIENCE_S
    while not wanted():
        if time.monotonic() > until_s:
            snapshot = page.session.snapshot
            raise TimeoutError(f"the robot is {snapshot.status}, {snapshot.notice}")
        page.show(page.session.snapshot)
        time.sleep(0.005)


def report(
    number: int, drawn: int, replans: int, server: PageServer, session: Session, page: Page
) -> None:
    """Prints a row of what is held."""
    gc.collect()
    opening_ms = 1000 * statistics.median(opening_s(server) for _ in range(OPENINGS))
    buffer = server._websock_server._broadcast_buffer
    nodes = len(server.scene._handle_from_node_name)
    planner = session.planner_pid
    planner_mb = 0.0 if planner is None else megabytes(str(planner))
    print(
        f"{number:5d} {drawn:6d} {replans:9d} {megabytes('self'):10.1f} "
        f"{planner_mb:11.1f} {len(buffer.message_from_id):9d} "
        f"{buffer.message_counter:10d} {nodes:6d} {threading.active_count():8d} "
        f"{page.visitors:6d} {opening_ms:11.0f}",
        flush=True,
    )


def opening_s(server: PageServer) -> float:
    """Processor time until one more page has all that is to be seen, while nothing is drawn."""
    began_s = time.process_time()
    watcher = Watcher(server.url)
    until_s = time.monotonic() + PATIENCE_S
    while not watcher.heard["ReplayDoneMessage"]:
        if time.monotonic() > until_s:
            raise TimeoutError("a page that opens is not told all")
        time.sleep(0.001)
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
