"""The command `serve`: a web page with a live robot."""

from __future__ import annotations

from app.errors import InputError, as_bad_input
from app.inputs import find_follower, read_grid
from app.page.offers import place_to_stand
from app.page.page import Page
from app.page.server import open_server
from app.page.session import Session
from app.page.view import load_robot
from app.progress import say
from app.serve_options import ServeOptions
from controller.policy import Policy, PolicyError, load_policy
from maps.grid import OccupancyGrid
from planner.options import PlannerOptions
from sim.robot import Robot
from sim.robots import robot_names


def run(options: ServeOptions) -> int:
    """Carries the command out: serves until Ctrl-C."""
    grid = read_grid(options)

    def load(name: str) -> tuple[Robot, Policy]:
        if options.policy is None or name != options.robot:
            return load_robot(name)
        robot = find_follower(name, options.policy)
        with as_bad_input(PolicyError):
            return robot, load_policy(robot, options.policy)

    robot, policy = load(options.robot)
    _check_start(options, grid, robot)
    plan_options = PlannerOptions(
        name=options.planner,
        refine=options.refine,
        unknown_is_free=options.unknown_is_free,
        seed=options.seed,
    )
    server = open_server(host=options.host, port=options.port, title=f"Footfall: {options.map}")
    session = Session(
        grid, robot, policy, start=options.start, options=plan_options, seed=options.seed
    )
    try:
        page = Page(
            server,
            session,
            robot,
            robots=robot_names(),
            load=load,
            options=plan_options,
        )
        session.start()
        say(f"open {server.url} in a browser; Ctrl-C ends it")
        page.run()
    finally:
        session.close()
        server.stop()
    return 0


def _check_start(options: ServeOptions, grid: OccupancyGrid, robot: Robot) -> None:
    wanted = "--start {:g},{:g},{:g}".format(*options.start)
    if not grid.contains(options.start[:2]):
        raise InputError(f"{wanted} is off the map")
    stand = place_to_stand(grid, robot.step_model, options.unknown_is_free, options.start)
    if stand.blocked:
        near = "none within 2 m" if stand.offer is None else "{:g},{:g},{:g}".format(*stand.offer)
        raise InputError(f"{wanted}: {stand.blocked}; the nearest free pose is {near}")
