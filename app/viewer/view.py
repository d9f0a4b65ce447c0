"""A run of `navigate` on the page: walked in real time, watched, and open until Ctrl-C."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from app.commands.navigate_options import NavigateOptions
from app.navigation.navigator import Navigator
from app.output import say
from app.viewer.page import opened
from controller.policy import Policy
from maps.grid import OccupancyGrid
from sim.robot import Robot


@contextlib.contextmanager
def viewed(
    options: NavigateOptions, grid: OccupancyGrid, robot: Robot, policy: Policy
) -> Iterator[Navigator]:
    """Gives the walk when it is over; on leaving, the page goes on until Ctrl-C."""
    with opened(
        grid,
        robot,
        policy,
        title=f"Footfall: {options.map}",
        start=options.start,
        goal=options.goal,
        options=options.search,
        seed=options.seed,
    ) as page:
        session = page.session
        say(f"open {page.server.url} in a browser to watch; the walk begins when it is open")
        page.wait_for_visitor()
        session.start()
        page.run(is_over=lambda: session.ended is not None)
        assert session.ended is not None
        yield session.ended
        say("the page stays open; Ctrl-C ends it")
        with contextlib.suppress(KeyboardInterrupt):
            page.run()
