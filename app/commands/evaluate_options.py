"""The options of `evaluate`, apart from what carries it out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from app.options import FolderOption, OptionalFile, OptionalFolder, RobotName, some_of, whole_number

SECTION_NAMES = ("modes", "stairs", "gait", "push", "energy", "long", "limits")


@dataclass(frozen=True, kw_only=True)
class EvaluateOptions:
    """Measure how well a policy walks, and write one report with figures.

    Sections: falls and foot errors of every mode (modes), stairs with noise on treads and joints
    (stairs), joint loads, ground force and contact (gait), push recovery (push), speed and cost of
    transport (energy), a minute of mixed walking (long), and the steps and margins that planning
    may count on (limits); what the last finds is stored beside the policy, where plans find it.
    The folder gets report.md, evaluation.json and the figures. What is done is kept when the run
    is cut off: the same command goes on from there.
    """

    out: FolderOption
    """Folder of the report, such as runs/evaluate; made when missing."""

    robot: RobotName = "jvrc1"
    """Which robot, such as jvrc1."""

    policy: OptionalFile = None
    """The policy to measure, such as runs/train/jvrc1.safetensors; none: the robot's own."""

    sections: Annotated[tuple[str, ...], some_of(*SECTION_NAMES)] = SECTION_NAMES
    """What to measure, such as modes,stairs."""

    episodes: Annotated[int, whole_number(at_least=1)] = 1000
    """Episodes of each mode, such as 1000; where there are many cases, a share of it for each."""

    seed: Annotated[int, whole_number(at_least=0)] = 1
    """Seed of the episodes, such as 1; training never uses the same ones."""

    workers: Annotated[int, whole_number(at_least=0)] = 0
    """Threads for the physics, such as 2; 0 for all cores. The result does not depend on it."""

    beside: OptionalFolder = None
    """Report of another policy of the robot, to show beside this one, such as runs/other."""

    json: bool = False
    """Print evaluation.json on standard output, and nothing else there."""
