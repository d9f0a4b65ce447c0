"""What every search of one robot shares, made once per step model."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

from planner.heuristics.facing import Facing, build_facing
from planner.heuristics.goal_table import Endgame, build_endgame
from planner.heuristics.potential import Potential, build_potential
from planner.heuristics.turning import Exits, build_exits
from planner.lattice.steps import StepTable, build_step_table
from planner.robot_model import StepModel


class Tables(NamedTuple):
    """Steps on the lattice, and the parts of the heuristic that know no map."""

    steps: StepTable
    potential: Potential
    endgame: Endgame
    exits: Exits
    facing: Facing


@lru_cache(maxsize=8)
def tables_of(model: StepModel) -> Tables:
    """The tables of a step model; made at the first call, which takes a while."""
    steps = build_step_table(model)
    potential = build_potential(model, steps)
    endgame = build_endgame(model, steps, potential)
    facing = build_facing(potential, endgame)
    return Tables(steps, potential, endgame, build_exits(steps, potential), facing)
