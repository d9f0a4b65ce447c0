"""First plans of several searches on large open maps: `python -m benchmarks.open_maps`.

Two square maps are drawn from the seed. `boxes` has one box of 0.2 to 1.5 m per --box-area-m2 of
floor, and start and goal at least half a side apart. `detour` is empty but for walls right across
it that leave a door of 1.2 m at alternating ends, and start and goal on either side of one or more
of them. Every query is planned once by each planner, to its first plan, by a planner that has not
seen the map; every plan is checked by exact polygons. Times are CPU time of this one thread from
the map to the plan, with distance field and heuristic; compiling and the tables of the robot come
before. Costs are relative to those of the first planner.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import tyro

from benchmarks.compare_planners import compile_planner, draw_queries, measure
from maps.grid import Cell, OccupancyGrid
from planner.options import PlannerOptions

_CELL_M, _DOOR_M, _WALL_CELLS = 0.05, 1.2, 3


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """First plans on large open maps.

    maps: boxes, detour or both. side_m: of the square maps. box_area_m2: of floor to a box. walls:
    of the detour. names: planners. count: queries per map. seed: of maps, queries and planners.
    """

    maps: tuple[str, ...] = ("boxes", "detour")
    side_m: float = 40.0
    box_area_m2: float = 4.0
    walls: int = 3
    names: tuple[str, ...] = ("ara", "rstar")
    count: int = 20
    seed: int = 0


def with_boxes(side_m: float, box_area_m2: float, seed: int) -> OccupancyGrid:
    """A square floor with boxes at random places."""
    rng = np.random.default_rng(seed)
    side = round(side_m / _CELL_M)
    cells = np.zeros((side, side), np.uint8)
    for _ in range(round(side_m**2 / box_area_m2)):
        height, width = rng.integers(4, 31, 2)
        row, col = rng.integers(0, side, 2)
        cells[row : row + height, col : col + width] = Cell.OCCUPIED
    return OccupancyGrid(cells=cells, resolution_m=_CELL_M)


def with_walls(side_m: float, walls: int) -> OccupancyGrid:
    """A square floor with walls right across it, and a door at alternating ends of them."""
    side, door = round(side_m / _CELL_M), round(_DOOR_M / _CELL_M)
    cells = np.zeros((side, side), np.uint8)
    for number in range(walls):
        col = (number + 1) * side // (walls + 1)
        rows = np.s_[:-door] if number % 2 else np.s_[door:]
        cells[rows, col : col + _WALL_CELLS] = Cell.OCCUPIED
    return OccupancyGrid(cells=cells, resolution_m=_CELL_M)


def draw_maps(arguments: Arguments) -> dict[str, OccupancyGrid]:
    """The maps of the arguments by name. Raises ValueError for an unknown name."""
    drawn = {
        "boxes": with_boxes(arguments.side_m, arguments.box_area_m2, arguments.seed),
        "detour": with_walls(arguments.side_m, arguments.walls),
    }
    for name in arguments.maps:
        if name not in drawn:
            raise ValueError(f"map {name!r} must be one of {', '.join(drawn)}")
    return {name: drawn[name] for name in arguments.maps}


def main() -> None:
    """Runs the planners and prints the table."""
    arguments = tyro.cli(Arguments)
    print(
        "| map | planner | first plan, ms, median / p95 | expansions, median / p95 | its cost, "
        "median / p95 | bound | found |\n|---|---|---|---|---|---|---|"
    )
    for map_name, grid in draw_maps(arguments).items():
        queries = draw_queries(grid, arguments.count, arguments.seed)
        first_m = np.full(len(queries), math.nan)
        for name in arguments.names:
            options = PlannerOptions(
                name=name, stop_at_first=True, seed=arguments.seed, refine=False
            )
            compile_planner(options)
            spent_s, cost_m, expansions, bound = measure(grid, queries, options).T
            if name == arguments.names[0]:
                first_m = cost_m
            pairs = [
                f"{np.nanmedian(values):.{digits}f} / {np.nanpercentile(values, 95):.{digits}f}"
                for values, digits in ((spent_s * 1e3, 0), (expansions, 0), (cost_m / first_m, 2))
            ]
            found = np.isfinite(cost_m)
            print(
                f"| {map_name} | `{name}` | {' | '.join(pairs)} | {np.median(bound[found]):.2f} "
                f"| {found.sum()} of {len(queries)} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
