"""The options of `serve`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from app.options import (
    MapOptions,
    OptionalFile,
    PlannerName,
    Pose,
    PoseOption,
    RobotName,
    text,
    whole_number,
)
from planner.options import PlannerOptions


@dataclass(frozen=True, kw_only=True)
class ServeOptions(MapOptions):
    """Open a web page: the map, and the robot that walks where you click.

    The page is for this machine alone unless --host says more. Ctrl-C ends it.
    """

    map: Annotated[Path, text("FILE")] = Path("maps/room.png")
    """The map: an image with its YAML beside it, or the YAML, such as maps/office.png."""

    start: PoseOption = Pose(0.0, 0.0, 0.0)
    """Where the robot stands at first, such as -1,2,0."""

    robot: RobotName = "jvrc1"
    """Which robot, such as jvrc1."""

    planner: PlannerName = PlannerOptions.name
    """Which planner at first, such as ara; docs/planners.md tells them apart."""

    refine: bool = True
    """Move the steps off the lattice to where they cost less, unless --no-refine is given."""

    policy: OptionalFile = None
    """The policy that walks, such as runs/train/jvrc1.safetensors; none: the robot's own."""

    seed: Annotated[int, whole_number(at_least=0)] = 0
    """Seed of everything random, such as 7."""

    host: Annotated[str, text("ADDRESS")] = "127.0.0.1"
    """Address to serve at, such as 0.0.0.0 for everybody who can reach this machine."""

    port: Annotated[int, whole_number(at_least=0)] = 8080
    """Port to serve at, such as 8080; 0 for any that is free."""
