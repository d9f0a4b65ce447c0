"""The command `serve`: a web page with a live robot."""

from __future__ import annotations

import re
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from app.controllers import ControllerOption, load_controlled
from app.options import (
    FileOption,
    OptionalFile,
    PlanningOptions,
    Pose,
    PoseOption,
    read_grid,
    text,
    whole_number,
)
from app.output import InputError, ProgressBar, say
from app.ros.recording import SessionRecorder, require_recordable, session_recording
from maps.grid import OccupancyGrid
from maps.map_files import COMES_ALONG
from sim.robot import Robot

if TYPE_CHECKING:
    from app.viewer.page import Page
    from controller.walker import Controller


# So long what is sent to a page last is on its way.
_LAST_WORDS_S = 0.3


def parse_hosts(words: str) -> tuple[str, ...]:
    """Reads names of hosts with commas between; raises ValueError where one can be none."""
    names = tuple(words.lower().split(","))
    if not all(re.fullmatch(r"[\w.:\[\]-]+", name) for name in names):
        raise ValueError(f"{words!r} is not names of hosts; write NAME,..., such as robot.local")
    return names


@dataclass(frozen=True, kw_only=True)
class ServeOptions(PlanningOptions):
    """Open a web page: the map, and the robot that walks where you click.

    The page is for this machine alone unless --host says more. Ctrl-C ends it.
    """

    controller: ControllerOption = "policy"
    """Who walks: the trained policy, or a controller by a model, such as lipm (docs/lipm.md)."""

    map: FileOption = Path("maps/room.png")
    """The map: an image with its YAML beside it, or the YAML, such as maps/office.png."""

    start: PoseOption = Pose(0.0, 0.0, 0.0)
    """Where the robot stands at first, such as -1,2,0."""

    host: Annotated[str, text("ADDRESS")] = "127.0.0.1"
    """Address to serve at, such as 0.0.0.0 for everybody who can reach this machine."""

    allow_host: Annotated[tuple[str, ...], text("NAME,...", parse_hosts)] = ()
    """Further names under which the page is asked for, such as that of a proxy, robot.local."""

    port: Annotated[int, whole_number(at_least=0, metavar="PORT")] = 8080
    """Port to serve at, such as 8080; 0 for any that is free."""

    record: OptionalFile = None
    """Also write what the robot does as an MCAP file, whole after Ctrl-C, such as walk.mcap."""


def run(options: ServeOptions) -> int:
    """Carries the command out: serves until Ctrl-C, one map after another."""
    require_recordable(options.record, None)
    with session_recording(options.record) as recorder:
        return _serve(options, recorder)


def _serve(options: ServeOptions, recorder: SessionRecorder | None) -> int:
    from app.viewer.map_chooser import maps_that_come_along
    from app.viewer.page import Maps, open_page

    grid = read_grid(options)

    robot, policy = load_controlled(options, options.controller, "normal")
    first = robot.option

    def load(name: str) -> tuple[Robot, Controller]:
        chosen = replace(options, robot=name, policy=options.policy if name == first else None)
        return load_controlled(chosen, options.controller, "normal")

    _check_start(options, grid, robot)
    maps = maps_that_come_along()
    name = _name_of(options.map, maps)
    start: Pose | tuple[float, float, float] = options.start
    port, access, link = options.port, None, None
    while True:
        with open_page(
            grid,
            robot,
            policy,
            title=f"Footfall: {name}",
            map_name=name,
            host=options.host,
            names=options.allow_host,
            access=access,
            port=port,
            start=start,
            options=options.planner_options(),
            seed=options.seed,
            load=load,
            robots=(first,),
            maps=Maps({name: options.map} | maps, name),
        ) as page:
            if recorder is not None:
                page.session.on_tick = recorder.ticked
            page.session.start()
            if link is not None:
                page.follow(link)
            if access is None:
                say(f"open {page.server.url} in a browser; Ctrl-C ends it")
            port, access = page.server.get_port(), page.server.access
            _run_until_loaded(page)
            page.run(is_over=lambda: page.wanted_map is not None)
            # Its pages shall hear that the map that they sent is here.
            page.server.flush()
            time.sleep(_LAST_WORDS_S)
            assert page.wanted_map is not None
            name, grid, start, link = page.wanted_map
            robot, policy = page.session.setup.robot, page.session.setup.policy


def _run_until_loaded(page: Page) -> None:
    """Runs the page, and tells what it waits for on the terminal too."""
    began_s = time.monotonic()
    with ProgressBar("planner", None) as bar:

        def is_loaded() -> bool:
            if page.session.failure is not None:
                raise page.session.failure
            loading = page.session.snapshot.loading
            bar.update(time.monotonic() - began_s, loading)
            return not loading or page.wanted_map is not None

        page.run(is_over=is_loaded)


def _name_of(path: Path, maps: dict[str, Path]) -> str:
    """The name of a map that comes along, or else the path."""
    place = (path if path.exists() else COMES_ALONG.parent / path).resolve().with_suffix("")
    along = (name for name, file in maps.items() if file.with_suffix("") == place)
    return next(along, str(path))


def _check_start(options: ServeOptions, grid: OccupancyGrid, robot: Robot) -> None:
    from planner.collision import terrain_of
    from planner.endpoints import suggestion, what_blocks
    from planner.plan import feet_at

    wanted = "--start {:g},{:g},{:g}".format(*options.start)
    if not grid.contains(options.start[:2]):
        raise InputError(f"{wanted} is off the map")
    model, terrain = robot.step_model, terrain_of(grid, options.planner_options().unknown_is_free)
    blocked = what_blocks(grid, terrain, model, feet_at(options.start, model.stance_width_m))
    if blocked:
        raise InputError(f"{wanted}: {blocked}{suggestion(grid, terrain, model, options.start)}")
