"""The options of `trials`, apart from what carries it out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from app.options import (
    FolderOption,
    MapOptions,
    OptionalFile,
    PlannerName,
    RobotName,
    number,
    whole_number,
)
from planner.options import PlannerOptions


@dataclass(frozen=True, kw_only=True)
class TrialsOptions(MapOptions):
    """Walk between many random pairs of free poses on a map, and print how it went.

    Start and goal are drawn from all poses at which the robot can stand; the same seed gives
    the same pairs and walks, whatever the number of workers.
    """

    count: Annotated[int, whole_number(at_least=1)] = 100
    """How many pairs, such as 100."""

    apart: Annotated[float, number(at_least=0.0)] = 1.5
    """Least distance in metres between start and goal, such as 1.5."""

    robot: RobotName = "jvrc1"
    """Which robot, such as jvrc1."""

    planner: PlannerName = PlannerOptions.name
    """Which planner, such as ara; docs/planners.md tells them apart."""

    refine: bool = True
    """Move the steps off the lattice to where they cost less, unless --no-refine is given."""

    policy: OptionalFile = None
    """The policy that walks, such as runs/train/jvrc1.safetensors; none: the robot's own."""

    seed: Annotated[int, whole_number(at_least=0)] = 0
    """Seed of the pairs and of the walks, such as 7."""

    workers: Annotated[int, whole_number(at_least=0)] = 0
    """Processes that walk, such as 2; 0 for all cores."""

    out: FolderOption = Path("runs/trials")
    """Folder for trials.json, such as runs/trials; made when missing."""

    json: bool = False
    """Print trials.json on standard output, and nothing else there."""
