"""The options of `dataset` and `dataset check`, apart from what carries them out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from app.options import (
    FolderArgument,
    FolderOption,
    OptionalFile,
    OptionalInterval,
    OptionalLength,
    OptionalPose,
    RobotName,
    choice,
    text,
    whole_number,
)
from planner.options import PLANNERS, PlannerOptions

FORMATS = ("npz", "lhw")


@dataclass(frozen=True, kw_only=True)
class DatasetOptions:
    """Plan footsteps to many random goals: a corpus to train on.

    Without a map every plan begins at 0,0,0 on an empty floor and ends up to 2 m ahead, up to 1 m
    aside, turned by up to a quarter. The folder gets plans.npz, manifest.json and two pictures,
    plans.png and steps.png. The same seed gives the same plans whatever the number of workers.
    `dataset check DIR` checks every step of a corpus by independent geometry.
    """

    out: FolderOption
    """Folder of the corpus, such as runs/corpus; made when missing."""

    count: Annotated[int, whole_number(at_least=1)] = 1000
    """How many plans, such as 1000."""

    robot: RobotName = "jvrc1"
    """Whose footsteps, such as jvrc1."""

    seed: Annotated[int, whole_number(at_least=0)] = 0
    """Seed of all that is drawn, such as 7."""

    goal_x: OptionalInterval = None
    """Range of the goals' x in metres, such as 0,4; none: 0,2, or the whole map."""

    goal_y: OptionalInterval = None
    """Range of the goals' y in metres, such as -2,2; none: -1,1, or the whole map."""

    goal_yaw: OptionalInterval = None
    """Range of the goals' yaw, such as -3.14,3.14; none: a quarter turn, on a map any heading."""

    start: OptionalPose = None
    """Where every plan starts, such as 0,0,0; none: 0,0,0, on a map anywhere."""

    obstacles: Annotated[int, whole_number(at_least=0)] = 0
    """Boxes of random size and place for each plan anew, such as 5."""

    map: OptionalFile = None
    """Draw start and goal on this map, such as maps/room.png."""

    resolution: OptionalLength = None
    """Metres per pixel, such as 0.05, for a map image without a YAML; wins over the YAML's."""

    origin: OptionalPose = None
    """Pose of the map's lower-left corner, such as -4,-3,0; wins over the YAML's."""

    unknown_is_free: bool = False
    """Let the robot step on cells of which the map says neither free nor occupied."""

    planner: Annotated[str, choice(*PLANNERS)] = PlannerOptions.name
    """Which search, such as ara."""

    refine: bool = False
    """Move the steps of each plan off the lattice to where they cost less."""

    workers: Annotated[int, whole_number(at_least=0)] = 0
    """Processes that plan, such as 2; 0 for all cores."""

    format: Annotated[str, choice(*FORMATS)] = "npz"
    """The default npz alone, or such as lhw: also plans.txt, which the paper's own code reads."""

    json: bool = False
    """Print manifest.json on standard output, and nothing else there."""


@dataclass(frozen=True, kw_only=True)
class DatasetCheckOptions:
    """Check every step of every plan of a corpus by independent, exact geometry.

    Feet alternate, steps are within the limits, feet keep their gap, feet and body are off every
    obstacle, the last two feet are those of the goal. The exit code is 2 if any plan fails.
    """

    folder: FolderArgument
    """Folder of the corpus, such as runs/corpus."""

    robot: Annotated[str | None, text("NAME")] = None
    """Check against this robot as it is now, such as jvrc1; none: as the manifest tells."""

    workers: Annotated[int, whole_number(at_least=0)] = 0
    """Processes that check, such as 2; 0 for all cores."""

    json: bool = False
    """Print what was found as a document on standard output, and nothing else there."""
