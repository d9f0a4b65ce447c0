"""Footstep planner on the queries of benchmark folders: `python -m benchmarks.planner FOLDER ...`.

A FOLDER holds maps with their YAML and queries.json: per map name a dict with `map` (image) and
`queries`, each with start and goal (x_m, y_m, yaw_rad midway between the feet) and
best_known_cost_m (or null). Every query is planned twice, to the first plan and to epsilon 1, and
twice more with walls all around the goal or the start, until it is told that no path leads there.
Times are CPU time of this one thread; compiling and the tables of the robot come before.
Every plan is checked by exact polygons.
"""

from __future__ import annotations

import itertools
import json
import math
import resource
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from maps.grid import Cell, OccupancyGrid
from maps.map_files import load_map
from planner.endpoints import Footing
from planner.options import PlannerOptions
from planner.plan import FootstepPlan, PlanStatus, feet_at
from planner.planner import Planner
from planner.robot_model import BodyShape, FootShape, StepLimits, StepModel
from planner.verify import violations

ROBOT = StepModel(
    foot=FootShape(length_m=0.20, width_m=0.10),
    body=BodyShape(length_m=0.24, width_m=0.36),
    limits=StepLimits(x_m=(-0.15, 0.30), y_m=(0.15, 0.35), yaw_rad=(-0.2, 0.4)),
    steps=(
        *((x, 0.2, 0.0) for x in (0.0, 0.3, 0.2, 0.1, -0.15)),
        *((0.0, 0.35, 0.0), (0.15, 0.3, 0.0), (0.2, 0.2, 0.4), (0.0, 0.25, 0.4)),
        *((0.25, 0.25, 0.2), (0.2, 0.25, -0.2), (0.1, 0.2, -0.2), (-0.1, 0.25, 0.2)),
    ),
    stance_width_m=0.2,
    step_cost_m=0.1,
    cell_m=0.05,
    headings=64,
)

_WALL_M = 0.8, 0.95  # from a goal to the near and the far side of the walls that shut it in


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Footstep planner benchmark.

    folders: each with maps and queries.json; what they give is told apart. drawn: so many queries
    drawn at random on each map, from this seed, in place of those of the file. maps: names to run,
    all if none. count: queries per map. limit_s: time limit of the runs to epsilon 1. cell_m: cell
    of the search lattice. epsilon: weight of the first search; the planner's own default is higher,
    for plans that need no proof.
    """

    folders: Annotated[tuple[Path, ...], tyro.conf.Positional]
    drawn: int = 0
    seed: int = 1
    maps: tuple[str, ...] = ()
    count: int = 1000
    limit_s: float = 7.0
    cell_m: float = 0.05
    epsilon: float = 1.2


def queries_by_map(
    folder: Path, maps: tuple[str, ...], count: int
) -> Iterator[tuple[str, OccupancyGrid, list[dict[str, Any]]]]:
    """Name, grid and the first queries of a folder's maps: of those named, or of all."""
    document = json.loads((folder / "queries.json").read_text(encoding="utf-8"))
    for name in maps or document:
        yield name, load_map(folder / document[name]["map"]), document[name]["queries"][:count]


def drawn_queries(
    grid: OccupancyGrid, model: StepModel, count: int, seed: int
) -> list[dict[str, Any]]:
    """Queries between random poses at which the robot can stand, 2 m apart or more."""
    rng, queries = np.random.default_rng(seed), list[dict[str, Any]]()
    x0, y0, x1, y1 = grid.bounds_world()
    footing = Footing(grid, model, unknown_is_free=False)
    while len(queries) < count:
        start, goal = rng.uniform((x0, y0, -math.pi), (x1, y1, math.pi), (2, 3)).tolist()
        ends = (feet_at(pose, model.stance_width_m) for pose in (start, goal))
        if math.dist(start[:2], goal[:2]) >= 2.0 and all(map(footing.may_stand, ends)):
            number = len(queries)
            queries.append({"id": number, "start": start, "goal": goal, "best_known_cost_m": None})
    return queries


def shut_in(grid: OccupancyGrid, pose: Sequence[float]) -> OccupancyGrid:
    """The map with four walls around a pose in the world."""
    cells, size = np.array(grid.cells), grid.resolution_m
    x, y = grid.world_to_grid(np.array(pose[:2]))
    near, far = (math.ceil(away_m / size) for away_m in _WALL_M)
    up, across = np.indices(cells.shape)
    away = np.maximum(abs(up - int(y / size)), abs(across - int(x / size)))
    cells[(away >= near) & (away <= far)] = Cell.OCCUPIED
    return grid.with_cells(cells)


def refused(
    grid: OccupancyGrid,
    model: StepModel,
    query: dict[str, Any],
    options: PlannerOptions,
    end: str,
) -> float:
    """CPU time in seconds until it is known that walls shut an end in; nan if they do not.

    end: "goal" or "start".
    """
    if max(abs(a - b) for a, b in zip(query["start"][:2], query["goal"][:2], strict=True)) < 2.0:
        return math.nan
    plan, spent_s = timed(Planner(shut_in(grid, query[end]), model, options), query)
    return spent_s if plan.status is PlanStatus.NO_PATH else math.nan


def timed(planner: Planner, query: dict[str, Any]) -> tuple[FootstepPlan, float]:
    """A plan and its CPU time in seconds."""
    began = time.process_time()
    plan = planner.plan(start=query["start"], goal=query["goal"])
    return plan, time.process_time() - began


def run_map(
    grid: OccupancyGrid, queries: list[dict[str, Any]], arguments: Arguments
) -> dict[str, np.ndarray]:
    """Measurements (n,) of all queries of a map, by name; `wrong` (n,): plans that are wrong."""
    model = StepModel(**{**vars(ROBOT), "cell_m": arguments.cell_m})
    quick = PlannerOptions(epsilon=arguments.epsilon, stop_at_first=True, refine=False)
    full = PlannerOptions(
        epsilon=arguments.epsilon,
        improve_expansions=None,
        time_limit_s=arguments.limit_s,
        max_expansions=10**9,
        refine=False,
    )
    # Compiles, and makes the tables of the robot.
    Planner(grid, model, full).plan(start=queries[0]["start"], goal=queries[0]["goal"])
    rows: list[dict[str, float]] = []
    for query in queries:
        first, first_s = timed(Planner(grid, model, quick), query)
        best, best_s = timed(Planner(grid, model, full), query)
        faults = [violations(plan, grid, model)[:1] for plan in (first, best)]
        for fault in itertools.chain(*faults):
            print(f"query {query['id']}: {fault}", file=sys.stderr)
        # A plan that was not found in time has no cost to compare with.
        best_m = best.cost_m if best.found else math.nan
        known_m = query["best_known_cost_m"] or best_m
        rows.append(
            {
                "first_s": first_s,
                "first_ratio": first.cost_m / best_m,
                "first_expansions": first.expansions,
                "best_s": best_s,
                "best_ratio": best_m / known_m,
                "proven": best.found and best.epsilon == 1.0,
                "expansions": best.expansions,
                "goal_shut_s": refused(grid, model, query, full, "goal"),
                "start_shut_s": refused(grid, model, query, full, "start"),
                "wrong": sum(map(len, faults)),
                "id": query["id"],
            }
        )
    return {name: np.array([row[name] for row in rows], float) for name in rows[0]}


def row_of(name: str, rows: dict[str, np.ndarray]) -> str:
    """One line of the table."""

    def pair(values: np.ndarray, unit: float) -> str:
        return f"{np.nanmedian(values) * unit:.1f} / {np.nanpercentile(values, 95) * unit:.1f}"

    return (
        f"| {name} | {pair(rows['first_s'], 1e3)} "
        f"| {np.median(rows['first_expansions']):.0f} / {rows['first_expansions'].max():.0f} "
        f"| {np.nanmedian(rows['first_ratio']):.2f} "
        f"| {pair(rows['best_s'], 1e3)} / {rows['best_s'].max() * 1e3:.0f} "
        f"({int(rows['proven'].sum())} of {len(rows['proven'])}) "
        f"| {np.nanmedian(rows['best_ratio']):.3f} | {np.median(rows['expansions']):.0f} "
        f"| {pair(rows['goal_shut_s'], 1e3)} | {pair(rows['start_shut_s'], 1e3)} "
        f"| {rows['wrong'].sum():.0f} |"
    )


def worst_of(name: str, rows: dict[str, np.ndarray]) -> str:
    """The five slowest and dearest queries of a map, by number."""

    def worst(key: str, unit: float, form: str) -> str:
        values = np.nan_to_num(rows[key], nan=-math.inf)
        order = np.argsort(-values, kind="stable")[:5]
        return ", ".join(f"{rows['id'][k]:.0f}: {rows[key][k] * unit:{form}}" for k in order)

    return (
        f"{name}, worst five: first plan, ms, {worst('first_s', 1e3, '.1f')}; "
        f"its cost over optimum {worst('first_ratio', 1.0, '.2f')}; "
        f"to epsilon 1, ms, {worst('best_s', 1e3, '.0f')}"
    )


def main() -> None:
    """Runs the benchmark and prints its table."""
    arguments = tyro.cli(Arguments)
    print(
        "| map | first plan, ms, median / p95 | its expansions, median / most | its cost over "
        "optimum | to epsilon 1, ms, median / p95 / most (proven) | optimum over best known "
        "| expansions | goal shut in, ms, median / p95 | start shut in | wrong plans |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    worst = []
    for folder in arguments.folders:
        for name, grid, queries in queries_by_map(folder, arguments.maps, arguments.count):
            if arguments.drawn:
                queries = drawn_queries(grid, ROBOT, arguments.drawn, arguments.seed)
            label = name if len(arguments.folders) == 1 else f"{folder.name}/{name}"
            rows = run_map(grid, queries, arguments)
            print(row_of(label, rows), flush=True)
            worst.append(worst_of(label, rows))
    print("\n".join(["", *worst]))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"peak memory {peak:.0f} MB")


if __name__ == "__main__":
    main()
