"""The options of `evaluate`, apart from what carries it out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from app.inputs import RobotName
from app.options import FolderOption, OptionalFile, whole_number


@dataclass(frozen=True, kw_only=True)
class EvaluateOptions:
    """Measure how well a policy walks: falls and foot errors of every walking mode.

    Each mode is walked in held-out episodes of 10 s with physics at 1 kHz, as in navigation, by
    the policy without exploration noise. The folder gets evaluation.json, report.md and
    errors.png; the modes done so far are kept when the run is cut off.
    """

    out: FolderOption
    """Folder of the report, such as runs/evaluate; made when missing."""

    robot: RobotName = "jvrc1"
    """Which robot, such as jvrc1."""

    policy: OptionalFile = None
    """The policy to measure, such as runs/train/jvrc1.safetensors; none: the robot's own."""

    episodes: Annotated[int, whole_number(at_least=1)] = 1000
    """Episodes of each mode, such as 1000."""

    seed: Annotated[int, whole_number(at_least=0)] = 1
    """Seed of the episodes, such as 1; training never uses the same ones."""

    workers: Annotated[int, whole_number(at_least=0)] = 0
    """Threads for the physics, such as 2; 0 for all cores. The result does not depend on it."""

    json: bool = False
    """Print evaluation.json on standard output, and nothing else there."""
