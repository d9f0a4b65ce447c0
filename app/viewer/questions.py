"""What robot and planner tell each other across the pipe between their processes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from maps.grid import OccupancyGrid
from planner.options import PlannerOptions
from planner.plan import FootstepPlan, Pose
from planner.robot_model import Side, StepModel


@dataclass(frozen=True, kw_only=True)
class Query:
    """What is asked: from both feet (2, 4) to a pair pose; `number` tells answers apart.

    once: there is one answer, the plan that the world's options make as they stand.
    """

    number: int
    goal: Pose
    start_feet_world: np.ndarray
    first_side: Side | None
    once: bool


@dataclass(frozen=True, kw_only=True)
class Answer:
    """A plan for the query of that number; after the first may come one better one.

    `offer` is a pose near by that would do when the goal of the query does not.
    """

    number: int
    plan: FootstepPlan
    offer: Pose | None = None
    is_last: bool = True


@dataclass(frozen=True, kw_only=True)
class Ready:
    """Says that all is loaded, and compiled if it had to be: a question is answered at once."""


@dataclass(frozen=True, kw_only=True)
class World:
    """What is planned over."""

    grid: OccupancyGrid
    model: StepModel
    options: PlannerOptions
