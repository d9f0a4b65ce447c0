"""Floors for tests of the planner, queries on them, robots, and plans made comparable."""

from __future__ import annotations

import functools
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest

from maps.grid import Cell, OccupancyGrid
from planner.heuristics import heuristic
from planner.heuristics.heuristic import Heuristic
from planner.lattice.lattice import Lattice
from planner.options import PlannerOptions
from planner.plan import FootstepPlan, feet_at, to_frame
from planner.planner import Planner, plan_footsteps
from planner.robot_model import StepLimits, StepModel
from planner.search.problem import Request
from planner.search.reachability import Floods, Verdict
from tests.compiled import from_python
from tests.planner_oracle import Node, Oracle, lattice_node, small_model

estimate = from_python(heuristic.estimate)


def first_quick(values: Iterable[Any]) -> list[Any]:
    """The values as parameters of a test: all but the first are marked slow."""
    first, *others = values
    return [first, *(pytest.param(value, marks=pytest.mark.slow) for value in others)]


def walled(rows=24, cols=24, boxes=(), origin=(0.0, 0.0, 0.0), resolution_m=0.1, treads=()):
    """A floor with blocked boxes (row0, col0, row1, col1), ends excluded.

    Treads are such boxes with a height at the end; without any the floor has no heights.
    """
    cells = np.zeros((rows, cols), np.uint8)
    for row0, col0, row1, col1 in boxes:
        cells[row0:row1, col0:col1] = Cell.OCCUPIED
    heights_m = np.zeros((rows, cols))
    for row0, col0, row1, col1, height_m in treads:
        heights_m[row0:row1, col0:col1] = height_m
    return OccupancyGrid(
        cells=cells,
        resolution_m=resolution_m,
        origin=origin,
        elevation_m=heights_m if treads else None,
    )


FLOOR = walled(30, 40)
LATTICE = PlannerOptions(refine=False)


def plan_on_lattice(grid: OccupancyGrid, model: StepModel, **query: Any) -> FootstepPlan:
    """The plan of the default search, not refined."""
    return plan_footsteps(grid, model, options=LATTICE, **query)


def scatter(rng: np.random.Generator, cells: np.ndarray, count: int, less_than: int) -> None:
    """Sets obstacles down on cells (n, n), with sides of 1 to less_than - 1 of them."""
    for row, col in rng.integers(0, len(cells), (count, 2)):
        height, width = rng.integers(1, less_than), rng.integers(1, less_than)
        cells[row : row + height, col : col + width] = Cell.OCCUPIED


def blocked_at(*boxes: tuple[int, int, int, int]) -> OccupancyGrid:
    """FLOOR with blocked boxes (row0, col0, row1, col1), ends excluded."""
    return walled(30, 40, boxes)


def small_plan() -> FootstepPlan:
    """A plan over the empty floor, turning."""
    return plan_on_lattice(FLOOR, small_model(), start=(1.0, 1.0, 0.2), goal=(2.5, 1.8, 1.0))


# A wall with a way around its upper end.
WALL = ((0, 11, 15, 12),)
CASES = {
    "empty": (walled(), (0.55, 0.6, 0.3), (1.7, 1.5, 2.0)),
    "wall": (walled(boxes=WALL), (0.55, 0.6, 0.3), (1.8, 0.7, -1.2)),
    "posts": (
        walled(boxes=((8, 8, 9, 9), (14, 12, 16, 13), (5, 15, 6, 18))),
        (0.4, 0.4, 1.0),
        (1.9, 1.9, 0.1),
    ),
    "slanted map": (
        walled(boxes=WALL, origin=(-1.0, 2.0, 0.6)),
        (-0.885, 2.806, 0.9),
        (0.09, 3.594, 2.0),
    ),
}


@functools.cache
def oracle_of(name: str) -> Oracle:
    """The oracle of one of the cases for the small robot: it keeps what it has worked out."""
    grid, _, goal = CASES[name]
    return Oracle(grid, small_model(), goal)


@functools.cache
def least_cost_m(name: str) -> float:
    """Least cost of any plan of a case, by the oracle."""
    return oracle_of(name).best_cost(CASES[name][1])


@functools.cache
def least_costs_m(name: str) -> dict[Node, float]:
    """Least cost to the end of a case's plans from every node, by the oracle; more than 500."""
    costs_m = oracle_of(name).costs_to_go(CASES[name][1])
    assert len(costs_m) > 500
    return costs_m


def fine_model(**changes) -> StepModel:
    """The small robot on a finer lattice, which keeps off walls, at a cost within 0.2 m of them."""
    fields = {
        "cell_m": 0.05,
        "headings": 16,
        "foot_margin_m": 0.01,
        "body_margin_m": 0.02,
        "clearance_cost_m": 0.05,
        "clearance_m": 0.2,
        **changes,
    }
    return small_model(**fields)


# Steps of a robot that climbs, and stairs for it.
CLIMBING = StepLimits(x_m=(-0.2, 0.3), y_m=(0.14, 0.4), yaw_rad=(-0.4, 0.8), z_m=(-0.1, 0.1))
STAIRS = ((0, 9, 24, 24, 0.1), (0, 12, 24, 24, 0.2), (0, 15, 24, 24, 0.3))


def repeatable(plan: FootstepPlan) -> str:
    """The plan as text without its times."""
    return plan.to_json().split('"time_to')[0]


def request_of(grid, model, start, goal) -> Request:
    """What a search is asked for this query."""
    planner = Planner(grid, model, LATTICE)
    planner.plan(start=start, goal=goal)
    feet = feet_at(start, model.stance_width_m)
    return Request(
        context=planner.goal_context(goal),
        feet_lattice=to_frame(feet[:, [0, 1, 3]], goal),
        feet_m=np.zeros(2),
        stands=False,
        first_side=None,
    )


def estimated_m(lattice: Lattice, heuristic: Heuristic, node: Node) -> float:
    """What a heuristic says of a node of the oracle's."""
    return estimate(lattice, heuristic, lattice_node(lattice, node)) / 1e6


def floods_meet(lattice: Lattice, oracle: Oracle, start: tuple[float, float, float]) -> bool:
    """Whether the floods from the oracle's first steps and from the goal meet, in small bites."""
    seeds = [lattice_node(lattice, node) for _, node in oracle.first_steps(start)]
    goals = [lattice_node(lattice, (0, 0, 0, side)) for side in (0, 1)]
    floods = Floods(lattice, np.array(seeds, np.int64), np.array(goals))
    while floods.verdict is Verdict.OPEN:
        floods.expand(7)
    return floods.verdict is Verdict.MET
