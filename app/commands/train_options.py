"""The options of `train`, apart from what carries it out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from app.options import (
    FolderOption,
    OptionalFolder,
    OptionalLength,
    RobotName,
    choice,
    whole_number,
)


@dataclass(frozen=True, kw_only=True)
class TrainOptions:
    """Train the step follower from nothing, with PPO in many simulations at once.

    The folder gets a checkpoint after every segment, a TensorBoard log, and the best policy so
    far. A run that was stopped, however it was, goes on with --resume to the same result. Some
    episodes walk plans of the planner: without --corpus the folder gets a corpus of its own, made
    as `dataset --count 1000 --seed 0` makes it.
    """

    out: FolderOption
    """Folder of the run, such as runs/train."""

    robot: RobotName = "jvrc1"
    """Which robot, such as jvrc1."""

    samples: Annotated[int, whole_number(at_least=1)] = 20_000_000
    """Control steps of single robots to train on, such as 20000000."""

    seed: Annotated[int, whole_number(at_least=0)] = 0
    """Seed of the run, such as 0."""

    reward: Annotated[str, choice("precise", "paper")] = "precise"
    """Which reward: the paper's, or the more precise one, such as precise."""

    curriculum: Annotated[str, choice("measured", "paper", "flat")] = "measured"
    """When stairs come: with success, on the paper's schedule, or never, such as measured."""

    rise: OptionalLength = None
    """Highest rise of the stairs to train on in metres, such as 0.15; none: all the robot can."""

    corpus: OptionalFolder = None
    """Corpus of `dataset` to train on, such as runs/corpus; none: makes one in DIR/corpus."""

    workers: Annotated[int, whole_number(at_least=0)] = 0
    """Threads for the physics, such as 2; 0 for all cores. The result does not depend on it."""

    resume: bool = False
    """Go on with the run in the folder."""
