"""A run of `navigate` on the page: walked in real time, watched, and open until Ctrl-C."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from app.errors import as_bad_input
from app.inputs import find_follower
from app.navigate_options import NavigateOptions
from app.navigator import Navigator
from app.page.page import Page
from app.page.server import open_server
from app.page.session import Session
from app.progress import say
from controller.policy import POLICY_FOLDER, Policy, PolicyError, load_policy
from maps.grid import OccupancyGrid
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
def viewed(
    options: NavigateOptions, grid: OccupancyGrid, robot: Robot, policy: Policy
) -> Iterator[Navigator]:
    """Gives the walk when it is over; on leaving, the page goes on until Ctrl-C."""
    server = open_server(title=f"Footfall: {options.map}")
    session = Session(
        grid,
        robot,
        policy,
        start=options.start,
        goal=options.goal,
        options=options.search,
        seed=options.seed,
    )
    try:
        page = Page(
            server, session, robot, robots=robot_names(), load=load_robot, options=options.search
        )
        say(f"open {server.url} in a browser to watch; the walk begins when it is open")
        page.wait_for_visitor()
        session.start()
        page.run(is_over=lambda: session.ended is not None)
        assert session.ended is not None
        yield session.ended
        say("the page stays open; Ctrl-C ends it")
        with contextlib.suppress(KeyboardInterrupt):
            page.run()
    finally:
        session.close()
        server.stop()
