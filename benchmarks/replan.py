"""Planning again while walking: `python -m benchmarks.replan FOLDER`, on the queries of a folder.

FOLDER is as for `benchmarks.planner`. The robot plans once, takes the plan's first step, which
lands off by about a centimetre, plans again from where its feet are, and so on to the goal. With
--blocks the map changes as well: every so many steps a block of 0.3 m falls on the plan, 1.5 m
ahead, and the one before it is taken away; the robot learns of it with its next plan. Times are CPU
time of this one thread, the renewed distance field included; compiling, the tables of the robot and
the first plan come before. Every plan is checked by exact polygons.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from benchmarks.planner import ROBOT, queries_by_map
from maps.grid import Cell, OccupancyGrid
from planner.options import PlannerOptions
from planner.plan import FootstepPlan, Pose
from planner.planner import Planner
from planner.robot_model import Side
from planner.verify import violations

_OFF_M, _OFF_RAD = 0.007, 0.01
_BLOCK_M, _AHEAD_STEPS = 0.3, 5


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Replanning benchmark.

    folder: maps and queries.json. maps: names to run, all if none. names: planners. count: queries
    per map. epsilon: bound that plans are to keep. blocks: steps between two changes of the map; 0
    for none. seed: of where feet land.
    """

    folder: Annotated[Path, tyro.conf.Positional]
    maps: tuple[str, ...] = ()
    names: tuple[str, ...] = ("adstar", "ara")
    count: int = 10
    epsilon: float = PlannerOptions.epsilon
    blocks: int = 0
    seed: int = 0


@dataclass(kw_only=True)
class Walk:
    """One walk as it goes on, and what planning again took: seconds, expansions, bounds."""

    planner: Planner
    free: OccupancyGrid
    goal: Pose
    rng: np.random.Generator
    spent: list[tuple[float, int, float]]
    wrong: int = 0
    lost: int = 0

    def go(self, start: Pose, blocks: int) -> None:
        """Walks from a pose to the goal, or until there is no plan."""
        plan = self.planner.plan(start=start, goal=self.goal)
        feet = np.array(plan.start_feet_world)
        for number in range(1, 1000):
            if not plan.found or len(plan) <= 2:
                break
            side = Side(int(plan.side[0]))
            off = self.rng.normal(size=4) * (_OFF_M, _OFF_M, 0.0, _OFF_RAD)
            feet[side] = plan.pose_world[0] + off
            floor = self._with_block(plan) if blocks and number % blocks == 0 else None
            began = time.process_time()
            if floor is not None:
                self.planner.take_map(floor)
            plan = self.planner.plan(start_feet_world=feet, first_side=side.other, goal=self.goal)
            self.spent.append((time.process_time() - began, plan.expansions, plan.epsilon))
            if plan.found:
                grid, model = self.planner.grid, self.planner.model
                self.wrong += bool(violations(plan, grid, model, stood_freely=False))
        self.lost += not plan.found

    def _with_block(self, plan: FootstepPlan) -> OccupancyGrid:
        """The map with a block on the plan, but neither at its end nor off the map."""
        if len(plan) < 2 * _AHEAD_STEPS:
            return self.free
        cells = np.array(self.free.cells)
        size = self.free.resolution_m
        x, y = self.free.world_to_grid(plan.pose_world[_AHEAD_STEPS, :2])
        row, col, half = int(y / size), int(x / size), math.ceil(_BLOCK_M / 2 / size)
        cells[max(row - half, 0) : row + half, max(col - half, 0) : col + half] = Cell.OCCUPIED
        return self.free.with_cells(cells)


def row_of(name: str, grid: OccupancyGrid, queries: list[dict], arguments: Arguments) -> str:
    """One line of the table."""
    options = PlannerOptions(name=name, epsilon=arguments.epsilon, stop_at_first=True, refine=False)
    spent: list[tuple[float, int, float]] = []
    wrong = lost = 0
    for number, query in enumerate(queries[:1] + queries):
        walk = Walk(
            planner=Planner(grid, ROBOT, options),
            free=grid,
            goal=tuple(query["goal"]),
            rng=np.random.default_rng([arguments.seed, number]),
            spent=spent,
        )
        walk.go(tuple(query["start"]), arguments.blocks)
        if number == 0:  # compiles
            spent.clear()
        else:
            wrong, lost = wrong + walk.wrong, lost + walk.lost
    spent_s, expansions, bound = np.array(spent).T

    def three(values: np.ndarray, digits: int) -> str:
        return " / ".join(
            f"{v:.{digits}f}" for v in (*np.percentile(values, (50, 95)), values.max())
        )

    return (
        f"{len(spent)} | {three(spent_s * 1e3, 1)} | {three(expansions, 0)} "
        f"| {100 * np.mean(expansions > 0):.0f} % | {three(bound, 2)} | {wrong} | {lost} |"
    )


def main() -> None:
    """Runs the benchmark and prints its table."""
    arguments = tyro.cli(Arguments)
    print(
        "| map | planner | replans | ms, median / p95 / max | expansions | searched | bound "
        "| wrong plans | lost |\n|---|---|---|---|---|---|---|---|---|"
    )
    for map_name, grid, queries in queries_by_map(
        arguments.folder, arguments.maps, arguments.count
    ):
        for name in arguments.names:
            print(f"| {map_name} | `{name}` | {row_of(name, grid, queries, arguments)}", flush=True)


if __name__ == "__main__":
    main()
