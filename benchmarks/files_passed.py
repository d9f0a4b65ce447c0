"""Files of this repository that one plan passes through, with the calls to each.

    python -m benchmarks.files_passed [--map maps/room.png] [--goal 2,1,1.57]
    python -m benchmarks.files_passed --click

The command `plan` runs twice and the second run is counted. With --click a page is served and a
click on its floor is counted, from the click to the footprints of the plan: all threads of the
server, and the planner, which answers the same question a second time in this process. A file
counts if Python called one of its functions; what compiled functions call among them does not show.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import multiprocessing
import sys
import threading
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

from app.commands.plan import PlanOptions
from app.commands.plan import run as plan
from app.navigation.planner_process import Answer, Asked, Query, World, answer_questions
from app.options import MapOptions, read_grid
from benchmarks.page_click import SERVED, clicked, watched_page
from planner.plan import Pose, feet_at
from sim.robots import get_robot

ROOT = Path(__file__).resolve().parent.parent


class FileCounter:
    """Counts calls by file of the repository, benchmarks apart, while it is on.

    Make it before the threads that are to be counted.
    """

    def __init__(self) -> None:
        self.calls: Counter[str] = Counter()
        self._is_on = False
        threading.setprofile(self._note)
        sys.setprofile(self._note)

    @contextlib.contextmanager
    def on(self) -> Iterator[None]:
        """Counts while the context is open."""
        self._is_on = True
        yield
        self._is_on = False

    def _note(self, frame: FrameType, event: str, _: Any) -> None:
        path = frame.f_code.co_filename
        if self._is_on and event == "call" and path.startswith(f"{ROOT}/"):
            name = path.removeprefix(f"{ROOT}/")
            if not name.startswith("benchmarks/"):
                self.calls[name] += 1


def count_plan(counter: FileCounter, grid_file: Path, goal: Pose) -> None:
    """Counts the second run of the command `plan`."""
    options = PlanOptions(map=grid_file, goal=goal)
    with contextlib.redirect_stdout(io.StringIO()):
        plan(options)
        with counter.on():
            plan(options)


def count_click(counter: FileCounter, grid_file: Path, goal: Pose) -> None:
    """Counts a click on the floor of the page, and its plan by the planner of the page."""
    grid = read_grid(MapOptions(map=grid_file))
    with watched_page(grid) as (page, watcher):
        clicked(page.session, watcher, *goal[:2])
        clicked(page.session, watcher, *goal[:2], meanwhile=counter.on())
    model = get_robot("jvrc1").step_model
    ours, theirs = multiprocessing.Pipe()
    threading.Thread(target=answer_questions, args=(theirs,), daemon=True).start()
    ours.send(World(grid=grid, model=model, options=SERVED))
    feet = feet_at((0.0, 0.0, 0.0), model.stance_width_m)
    for number, is_counted in enumerate((False, True)):
        asked = Asked(goal=goal, start_feet_world=feet, first_side=None)
        query = Query(number=number, asked=asked, once=True)
        with counter.on() if is_counted else contextlib.nullcontext():
            ours.send(query)
            while not isinstance(ours.recv(), Answer):
                pass
    ours.close()


def main() -> None:
    """Counts and prints, the file with most calls first."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--click", action="store_true")
    parser.add_argument("--map", type=Path, default=Path("maps/room.png"))
    parser.add_argument("--goal", default="2,1,1.57")
    arguments = parser.parse_args()
    x_m, y_m, yaw_rad = (float(v) for v in arguments.goal.split(","))
    counter = FileCounter()
    count = count_click if arguments.click else count_plan
    count(counter, arguments.map, (x_m, y_m, yaw_rad))
    for name, calls in counter.calls.most_common():
        print(f"{calls:8d} {name}")
    print(f"{len(counter.calls):8d} files")


if __name__ == "__main__":
    main()
