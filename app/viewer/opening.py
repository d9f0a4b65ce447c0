"""Puts a page together: server, robot and planner, and what is shown of them."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator, Sequence

from app.errors import as_bad_input
from app.inputs import find_follower
from app.viewer.page import Page
from app.viewer.server import LOCAL, open_server
from app.viewer.session import Session
from controller.policy import POLICY_FOLDER, Policy, PolicyError, load_policy
from maps.grid import OccupancyGrid
from planner.options import PlannerOptions
from sim.robot import Robot
from sim.robots import robot_names


def load_robot(name: str) -> tuple[Robot, Policy]:
    """A robot and its own policy.

    Raises:
        InputError: There is no such robot, or nobody has taught it to walk.
    """
    robot = find_follower(name)
    with as_bad_input(PolicyError):
        return robot, load_policy(robot, POLICY_FOLDER / f"{name}.safetensors")


@contextlib.contextmanager
def opened(
    grid: OccupancyGrid,
    robot: Robot,
    policy: Policy,
    *,
    title: str,
    host: str = LOCAL,
    port: int = 0,
    start: Sequence[float] = (0.0, 0.0, 0.0),
    goal: Sequence[float] | None = None,
    options: PlannerOptions | None = None,
    seed: int = 0,
    load: Callable[[str], tuple[Robot, Policy]] = load_robot,
) -> Iterator[Page]:
    """A page about one robot on one map; on leaving, robot, planner and server end.

    Neither the robot lives nor is the page drawn until somebody says so: `page.session.start()`,
    `page.run()`. `load` gives the robots among which the page lets choose.

    Raises:
        InputError: The address cannot be had.
    """
    with contextlib.ExitStack() as stack:
        server = open_server(host=host, port=port, title=title)
        stack.callback(server.stop)
        session = Session(grid, robot, policy, start=start, goal=goal, options=options, seed=seed)
        stack.callback(session.close)
        yield Page(server, session, robots=robot_names(), load=load)


@contextlib.contextmanager
def drawn(page: Page) -> Iterator[None]:
    """Lets a thread of its own draw the page meanwhile."""
    ends = threading.Event()
    painter = threading.Thread(target=lambda: page.run(ends.is_set), name="painter")
    painter.start()
    try:
        yield
    finally:
        ends.set()
        painter.join()
