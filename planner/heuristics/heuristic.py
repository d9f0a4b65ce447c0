"""The heuristic as searches read it, compiled: potential, distance field, goal table, turning."""

from __future__ import annotations

import contextlib
import hashlib
import math
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from planner.cache import cache_folder, source_digest
from planner.compiled import njit_arrays, njit_inner
from planner.heuristics.distance_field import least_in_cells, path_costs
from planner.heuristics.goal_table import GoalTable, build_goal_table
from planner.heuristics.potential import Potential, build_potential
from planner.heuristics.table_file import read_tables, write_tables
from planner.heuristics.turning import (
    ExitTable,
    TurnEstimate,
    build_exit_table,
    build_turn_estimate,
    exit_bound,
    no_detours,
)
from planner.heuristics.wavefront import NOWHERE_UM
from planner.lattice.goal_region import GoalRegion
from planner.lattice.lattice import Int64s, Lattice
from planner.lattice.steps import MICRO, StepTable, build_step_table, final_cost_um, moved_cells
from planner.robot_model import StepModel


class Tables(NamedTuple):
    """Steps on the lattice, and the parts of the heuristic that know no map."""

    steps: StepTable
    potential: Potential
    goal_table: GoalTable
    exits: ExitTable
    turns: TurnEstimate


_KINDS = StepTable, Potential, GoalTable, ExitTable, TurnEstimate


@lru_cache(maxsize=8)
def tables_of(model: StepModel) -> Tables:
    """The tables of a step model, which are made once and then kept in a file of the cache."""
    folder = cache_folder()
    if folder is None:
        return _build_tables(model)
    # A float's repr tells it to the last bit.
    key = f"{source_digest()} numpy {np.__version__} opencv {cv2.__version__} {model!r}"
    path = folder / f"tables-{hashlib.sha256(key.encode()).hexdigest()[:16]}"
    kept = read_tables(path, key, _KINDS)
    if kept is None:
        made = _build_tables(model)
        # Where the disk is full they are made again the next time.
        with contextlib.suppress(OSError):
            write_tables(path, key, made)
        # Of what was read the arrays are laid out in one way, for which the search is compiled.
        kept = read_tables(path, key, _KINDS) or list(made)
    return Tables(*kept)


def _build_tables(model: StepModel) -> Tables:
    steps = build_step_table(model)
    potential = build_potential(model, steps)
    goal_table = build_goal_table(model, steps, potential)
    turns = build_turn_estimate(potential, goal_table)
    return Tables(steps, potential, goal_table, build_exit_table(steps, potential), turns)


class Heuristic(NamedTuple):
    """Arrays of a heuristic, made for one lattice and one end; rows are heading * 2 + side.

    cost_um (rows * cols,): path costs + 1 as in `distance_field.py`; frontier_um: the cost that
    cells without a path count as. body_cell (2 H,): the body's cell from a foot's. potential_um
    (2 H,). goal_table_um, cap_um: see `GoalTable`. turn_um, rim, radius_cells: see `ExitTable`.
    detour_um: see `no_detours`; filled in as the search goes on.
    """

    cost_um: NDArray[np.int32]
    frontier_um: int
    body_cell: Int64s
    potential_um: Int64s
    goal_table_um: NDArray[np.int32]
    cap_um: int
    turn_um: Int64s
    detour_um: NDArray[np.int32]
    rim: Int64s
    radius_cells: int


def heuristic_by_path(
    lattice: Lattice,
    potential: Potential,
    cost_um: NDArray[np.int32],
    potential_um: Int64s,
    frontier_um: int = NOWHERE_UM,
) -> Heuristic:
    """The heuristic of path costs (cells,) and potentials (2 H,) alone."""
    rows = len(potential_um)
    return Heuristic(
        cost_um,
        frontier_um,
        potential.cell_offsets(lattice.cols),
        potential_um,
        np.zeros((1, 1, rows), np.int32),
        0,
        np.zeros((rows, 1), np.int64),
        np.zeros((1, 1), np.int32),
        np.zeros((0, 4), np.int64),
        lattice.cols + lattice.rows,  # no bound by a rim: all is within the circle
    )


def full_heuristic(lattice: Lattice, tables: Tables, cost_um: NDArray[np.int32]) -> Heuristic:
    """The heuristic toward the goal's own pose with these path costs (cells,)."""
    exits = tables.exits
    by_path = heuristic_by_path(lattice, tables.potential, cost_um, tables.potential.potential_um)
    return by_path._replace(
        goal_table_um=tables.goal_table.cost_um,
        cap_um=tables.goal_table.cap_um,
        turn_um=exits.turn_um,
        detour_um=no_detours(lattice.cols, lattice.rows),
        rim=exits.rim,
        radius_cells=exits.radius_cells,
    )


@njit_inner
def estimate(lattice: Lattice, heuristic: Heuristic, node: int) -> int:
    """Lower bound in micrometres on the cost from a node to the end of a plan."""
    row, cell = node % (2 * lattice.headings), node // (2 * lattice.headings)
    body = cell + heuristic.body_cell[row]
    path = heuristic.cost_um[body] - 1
    if path < 0 or path > heuristic.frontier_um:
        path = heuristic.frontier_um
    goal_table_um = heuristic.goal_table_um
    reach = len(goal_table_um) // 2
    col = cell % lattice.cols - lattice.origin_col + reach
    up = cell // lattice.cols - lattice.origin_row + reach
    exact = heuristic.cap_um
    if 0 <= col <= 2 * reach and 0 <= up <= 2 * reach:
        exact = goal_table_um[up, col, row]
    least = exit_bound(
        heuristic.detour_um,
        heuristic.turn_um,
        heuristic.cost_um,
        heuristic.frontier_um,
        heuristic.rim,
        (heuristic.radius_cells, lattice.cols, lattice.origin_col, lattice.origin_row),
        body,
        row,
    )
    return max(path + heuristic.potential_um[row], exact, least)


@njit_arrays
def estimates(lattice: Lattice, heuristic: Heuristic, nodes: Int64s) -> Int64s:
    """`estimate` of nodes (n,)."""
    values_um = np.empty(len(nodes), np.int64)
    for i in range(len(nodes)):
        values_um[i] = estimate(lattice, heuristic, nodes[i])
    return values_um


def heuristic_toward_region(
    lattice: Lattice, model: StepModel, tables: Tables, ends: Int64s, region: GoalRegion
) -> Heuristic:
    """The heuristic toward any of the nodes (n,) of a region, of which there must be one.

    By the inequality (1) of `potential.py`, summed up to an end e,

        h(s) = p(s) + min over e of [ D(cell(s), cell(e)) - p(e) ] + cost of the last step.

    The table of the empty map is exact for the goal's own pose. It is consistent, so from a state
    to an end it falls by at most the cost of that path, and what is left of it at e is too much by
    at most its largest value at any e.
    """
    base_um, cost_um = _path_costs_to_ends(lattice, model, tables, ends)
    full, rows = full_heuristic(lattice, tables, cost_um), 2 * lattice.headings
    reach, cell = len(full.goal_table_um) // 2, ends // rows
    col = np.clip(cell % lattice.cols - lattice.origin_col + reach, 0, 2 * reach)
    row = np.clip(cell // lattice.cols - lattice.origin_row + reach, 0, 2 * reach)
    slack_um = int(full.goal_table_um[row, col, ends % rows].max()) - final_cost_um(model)
    return full._replace(
        potential_um=base_um + full.potential_um,
        goal_table_um=np.maximum(full.goal_table_um - np.int32(slack_um), 0),
        cap_um=max(full.cap_um - slack_um, 0),
        turn_um=base_um + full.turn_um,
        # No end may lie within the circle wherever its bound is used.
        radius_cells=full.radius_cells + math.ceil(region.reach_m / model.cell_m) + 2,
    )


def _path_costs_to_ends(
    lattice: Lattice, model: StepModel, tables: Tables, ends: Int64s
) -> tuple[int, NDArray[np.int32]]:
    """What every end of a plan (n,) adds at least, and the path costs to the nearest end."""
    potential, rows = tables.potential, 2 * lattice.headings
    value_um = final_cost_um(model) - potential.potential_um[ends % rows]
    bodies = ends // rows + potential.cell_offsets(lattice.cols)[ends % rows]
    cells, least_um = least_in_cells(bodies, value_um)
    base_um = int(least_um.min())
    return base_um, path_costs(lattice, potential, cells, least_um - base_um)


def simpler_heuristic(
    name: str, lattice: Lattice, model: StepModel, tables: Tables, ends: Int64s
) -> Heuristic:
    """A heuristic of other footstep planners toward the ends of a plan, nodes (n,), to compare.

    All are consistent. With v the move of the body's cell in a step and the cost of the last step
    added to each:

    - euclidean: e times the straight distance to the goal, where e is the least cost of a metre,
      over all steps of (cost - step_cost_m) / |v|;
    - steps: the same, and step_cost_m for each of the steps that this takes at least, which is the
      distance over the longest |v|;
    - path: the cost of the body's path around obstacles, as in `potential.py`.
    """
    potential, rows = tables.potential, 2 * lattice.headings
    if name == "path":
        base_um, cost_um = _path_costs_to_ends(lattice, model, tables, ends)
        return heuristic_by_path(lattice, potential, cost_um, base_um + potential.potential_um)
    rate = _cost_of_metre(model, tables, counts_steps=name == "steps")
    col = np.arange(lattice.cols) - lattice.origin_col
    row = np.arange(lattice.rows) - lattice.origin_row
    # In place and not by np.hypot: a plan whose time is up may still wait for this table.
    away_um = np.sqrt((col * col + (row * row)[:, None]).astype(float)).reshape(-1)
    away_um *= lattice.cell_m * rate * MICRO
    # Ends lie around the goal, none farther off than this.
    away_um -= away_um[ends // rows + potential.cell_offsets(lattice.cols)[ends % rows]].max()
    cost_um = np.clip(away_um, 0, NOWHERE_UM - 1, out=away_um).astype(np.int32)
    potential_um = np.full(rows, final_cost_um(model), np.int64)
    return heuristic_by_path(lattice, potential, cost_um + 1, potential_um)


def _cost_of_metre(model: StepModel, tables: Tables, counts_steps: bool) -> float:
    """Least cost of moving the body's cell by a metre."""
    table = tables.steps
    length_m = np.linalg.norm(moved_cells(table, tables.potential.body_cell), axis=-1)
    length_m = length_m * model.cell_m
    moving = (table.cost_um > 0) & (length_m > 0)
    step_m = model.step_cost_m
    rate = float(((table.cost_um[moving] / MICRO - step_m) / length_m[moving]).min())
    return rate + step_m / float(length_m[moving].max()) if counts_steps else rate
