"""All planners side by side on large maps: `python -m benchmarks.compare_planners --side-m 60`.

The square maps are drawn from the seed. `office`: rooms of 6 m by 6 m with doors in three of four
walls and four pieces of furniture each. `boxes`: one box of 0.2 to 1.5 m per --box-area-m2 of
floor. `detour`: empty but for walls right across it that leave a door of 1.2 m at alternating ends.
Start and goal are random free poses at least half a side apart. Each planner makes a first plan,
and unless --first-only one with its default effort; none has seen the map before, and every plan is
checked by exact polygons. Times are CPU time of this one thread from the map to the plan, with
distance field and heuristic; compiling and the tables of the robot come before. Costs are relative
to the least cost found by any planner for the query.
"""

from __future__ import annotations

import math
import resource
import sys
import time
from dataclasses import dataclass
from typing import Literal

import numpy as np
import tyro

from benchmarks.planner import ROBOT
from maps.grid import Cell, OccupancyGrid
from planner.collision import terrain_of
from planner.endpoints import what_blocks
from planner.options import PLANNERS, PlannerOptions
from planner.plan import Pose, feet_at
from planner.planner import Planner
from planner.verify import violations

_CELL_M, _ROOM_M, _DOOR_M, _WALL_CELLS = 0.05, 6.0, 1.2, 3


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """All planners on large maps.

    maps: office, boxes, detour. side_m: of the square maps. box_area_m2: of floor to a box. walls:
    of the detour. names: planners to run. count: queries per map. seed: of maps, queries and
    planners. limit_s: time limit of a plan; 0 for none. first_only: leave default effort out.
    """

    maps: tuple[Literal["office", "boxes", "detour"], ...] = ("office",)
    side_m: float = 60.0
    box_area_m2: float = 4.0
    walls: int = 3
    names: tuple[str, ...] = PLANNERS
    count: int = 10
    seed: int = 0
    limit_s: float = 20.0
    first_only: bool = False


def office(side_m: float, seed: int) -> OccupancyGrid:
    """A square office of rooms, with an outer wall."""
    rng = np.random.default_rng(seed)
    side, room, door = (round(v / _CELL_M) for v in (side_m, _ROOM_M, _DOOR_M))
    cells = np.zeros((side, side), np.uint8)
    for wall in range(0, side + 1, room):
        first = min(wall, side - _WALL_CELLS)
        cells[first : first + _WALL_CELLS] = Cell.OCCUPIED
        cells[:, first : first + _WALL_CELLS] = Cell.OCCUPIED
    for row in range(0, side, room):
        for col in range(0, side, room):
            for axis, at in ((0, row), (1, col)):
                place = int(rng.integers(10, room - door - 10))
                if at and rng.random() < 0.75:
                    gap = np.s_[row : row + _WALL_CELLS, col + place : col + place + door]
                    if axis:
                        gap = np.s_[row + place : row + place + door, col : col + _WALL_CELLS]
                    cells[gap] = Cell.FREE
            for _ in range(4):
                height, width = rng.integers(6, 30, 2)
                y, x = rng.integers(5, room - 35, 2)
                cells[row + y : row + y + height, col + x : col + x + width] = Cell.OCCUPIED
    for edge in (np.s_[:_WALL_CELLS], np.s_[-_WALL_CELLS:]):
        cells[edge] = cells[:, edge] = Cell.OCCUPIED
    return OccupancyGrid(cells=cells, resolution_m=_CELL_M)


def boxes(side_m: float, box_area_m2: float, seed: int) -> OccupancyGrid:
    """A square floor with boxes at random places."""
    rng = np.random.default_rng(seed)
    side = round(side_m / _CELL_M)
    cells = np.zeros((side, side), np.uint8)
    for _ in range(round(side_m**2 / box_area_m2)):
        height, width = rng.integers(4, 31, 2)
        row, col = rng.integers(0, side, 2)
        cells[row : row + height, col : col + width] = Cell.OCCUPIED
    return OccupancyGrid(cells=cells, resolution_m=_CELL_M)


def detour(side_m: float, walls: int) -> OccupancyGrid:
    """A square floor with walls right across it, and a door at alternating ends of them."""
    side, door = round(side_m / _CELL_M), round(_DOOR_M / _CELL_M)
    cells = np.zeros((side, side), np.uint8)
    for number in range(walls):
        col = (number + 1) * side // (walls + 1)
        rows = np.s_[:-door] if number % 2 else np.s_[door:]
        cells[rows, col : col + _WALL_CELLS] = Cell.OCCUPIED
    return OccupancyGrid(cells=cells, resolution_m=_CELL_M)


def draw_queries(grid: OccupancyGrid, count: int, seed: int) -> list[tuple[Pose, Pose]]:
    """Pairs of free poses, at least half the map's side apart."""
    rng, terrain = np.random.default_rng(seed), terrain_of(grid, False)
    side_m = grid.size_m[0]

    def free() -> Pose:
        while True:
            x_m, y_m, yaw_rad = rng.uniform((0, 0, -math.pi), (side_m, side_m, math.pi))
            feet = feet_at((x_m, y_m, yaw_rad), ROBOT.stance_width_m)
            if not what_blocks(grid, terrain, ROBOT, feet):
                return x_m, y_m, yaw_rad

    queries: list[tuple[Pose, Pose]] = []
    while len(queries) < count:
        start, goal = free(), free()
        if math.dist(start[:2], goal[:2]) >= side_m / 2:
            queries.append((start, goal))
    return queries


def compile_planner(options: PlannerOptions) -> None:
    """Compiles a planner and makes the tables of the robot, on a small map."""
    small = office(2 * _ROOM_M, options.seed)
    start, goal = draw_queries(small, 1, options.seed)[0]
    Planner(small, ROBOT, options).plan(start=start, goal=goal)


def measure(
    grid: OccupancyGrid, queries: list[tuple[Pose, Pose]], options: PlannerOptions
) -> np.ndarray:
    """CPU time in s, cost in m (nan without a plan), expansions and proven bound (n, 4).

    Each query has a planner of its own; faults of plans are printed.
    """
    rows = []
    for start, goal in queries:
        began = time.process_time()
        plan = Planner(grid, ROBOT, options).plan(start=start, goal=goal)
        spent_s = time.process_time() - began
        rows.append(
            (spent_s, plan.cost_m if plan.found else math.nan, plan.expansions, plan.epsilon)
        )
        faults = violations(plan, grid, ROBOT) if plan.found else [plan.reason]
        for fault in faults[:1]:
            print(f"{options.name} from {start} to {goal}: {fault}", file=sys.stderr)
    return np.array(rows)


def main() -> None:
    """Runs all planners and prints the table."""
    arguments = tyro.cli(Arguments)
    side_m, seed = arguments.side_m, arguments.seed
    print(
        "| map | planner | first plan, ms, median / p95 | expansions | its cost | bound "
        "| default effort, ms, median / p95 | expansions | its cost | bound | found |\n"
        "|---|---|---|---|---|---|---|---|---|---|---|"
    )
    for name in arguments.maps:
        if name == "office":
            grid = office(side_m, seed)
        elif name == "boxes":
            grid = boxes(side_m, arguments.box_area_m2, seed)
        else:
            grid = detour(side_m, arguments.walls)
        compare(name, grid, arguments)


def compare(map_name: str, grid: OccupancyGrid, arguments: Arguments) -> None:
    """Runs all planners on a map and prints its rows."""
    queries = draw_queries(grid, arguments.count, arguments.seed)
    efforts = (True,) if arguments.first_only else (True, False)
    rows = {}
    for name in arguments.names:
        for first in efforts:
            options = PlannerOptions(
                name=name,
                stop_at_first=first,
                time_limit_s=arguments.limit_s or None,
                seed=arguments.seed,
                refine=False,
            )
            compile_planner(options)
            rows[name, first] = measure(grid, queries, options)
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            print(f"{name}: {peak:.0f} MB", file=sys.stderr)
    least_m = np.nanmin([measured[:, 1] for measured in rows.values()], axis=0)
    for name in arguments.names:
        columns = ["- | - | - | -"] * 2
        for column, first in enumerate(efforts):
            spent_s, cost_m, expansions, bound = rows[name, first].T
            median, p95 = np.percentile(spent_s * 1e3, (50, 95))
            columns[column] = (
                f"{median:.0f} / {p95:.0f} | {np.median(expansions):.0f} "
                f"| {np.nanmedian(cost_m / least_m):.2f} "
                f"| {np.median(bound[np.isfinite(cost_m)]):.2f}"
            )
        found = np.isfinite(cost_m).sum()
        print(f"| {map_name} | `{name}` | {' | '.join(columns)} | {found} of {len(queries)} |")


if __name__ == "__main__":
    main()
