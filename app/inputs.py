"""What commands share: the options that say which map and robot, and the reading of both."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from app.errors import as_bad_input
from app.options import FileOption, OptionalLength, OptionalPose, choice, text
from controller.policy import PolicyError
from controller.tracking_limits import as_measured
from maps.grid import OccupancyGrid
from maps.map_files import MapError, load_map
from planner.options import HEURISTICS, PLANNERS
from sim.robot import Robot
from sim.robots import get_robot


@dataclass(frozen=True, kw_only=True)
class MapOptions:
    """Which map, and how to read it."""

    map: FileOption
    """The map: an image with its YAML beside it, or the YAML, such as maps/room.png."""

    resolution: OptionalLength = None
    """Metres per pixel, such as 0.05, for an image without a YAML; wins over the YAML's."""

    origin: OptionalPose = None
    """Pose of the map's lower-left corner, such as -4,-3,0; wins over the YAML's."""

    unknown_is_free: bool = False
    """Let the robot step on cells of which the map says neither free nor occupied."""


RobotName = Annotated[str, text("NAME")]
PlannerName = Annotated[str, choice(*PLANNERS)]
HeuristicName = Annotated[str, choice(*HEURISTICS)]


def read_grid(options: MapOptions) -> OccupancyGrid:
    """The map that the options name.

    Raises:
        InputError: It cannot be read.
    """
    with as_bad_input(MapError):
        return load_map(options.map, resolution_m=options.resolution, origin=options.origin)


def find_robot(name: str) -> Robot:
    """The robot of that name.

    Raises:
        InputError: There is none; the message lists those there are.
    """
    with as_bad_input(ValueError):
        return get_robot(name)


def find_follower(name: str, policy: Path | None = None) -> Robot:
    """The robot of that name with the step model that planning uses.

    Step limits and margins are those that the policy, by default the robot's own, was measured to
    keep (`evaluate` stores them beside it), or the robot's file's where nothing was measured.

    Raises:
        InputError: There is no such robot, or what was measured cannot be read.
    """
    robot = find_robot(name)
    with as_bad_input(PolicyError):
        return as_measured(robot, policy)
