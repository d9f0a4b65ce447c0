"""The heuristic as searches read it, compiled: potential, distance field, goal table, turning."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.compiled import njit_arrays, njit_no_refcount
from planner.heuristics.distance_field import BodyPath, least_in_cells, spread_from
from planner.heuristics.goal_table import GoalTable, build_goal_table
from planner.heuristics.potential import Potential, build_potential
from planner.heuristics.turning import (
    Exits,
    Facing,
    build_exits,
    build_facing,
    exit_bound,
    no_detours,
)
from planner.heuristics.wavefront import NOWHERE_UM
from planner.lattice.goal_region import GoalRegion
from planner.lattice.lattice import Int64s, Lattice
from planner.lattice.steps import MICRO, StepTable, build_step_table, final_cost_um, moved_cells
from planner.robot_model import StepModel


class Heuristic(NamedTuple):
    """Arrays of a heuristic, made for one lattice and one end.

    detour_um: see `no_detours`; filled in as the search goes on.
    """

    cost_um: NDArray[np.int32]
    frontier_um: int
    body_cell: NDArray[np.int64]
    potential_um: NDArray[np.int64]
    endgame_um: NDArray[np.int32]
    cap_um: int
    turn_um: NDArray[np.int64]
    detour_um: NDArray[np.int32]
    rim: NDArray[np.int64]
    radius_cells: int


def of_path(
    lattice: Lattice,
    cost_um: NDArray[np.int32],
    frontier_um: int,
    body_cell: NDArray[np.int64],
    potential_um: NDArray[np.int64],
) -> Heuristic:
    """The heuristic of path costs (cells,) and potentials (2 H,) alone."""
    rows = len(potential_um)
    return Heuristic(
        cost_um,
        frontier_um,
        body_cell,
        potential_um,
        np.zeros((1, 1, rows), np.int32),
        0,
        np.zeros((rows, 1), np.int64),
        np.zeros((1, 1), np.int32),
        np.zeros((0, 4), np.int64),
        lattice.cols + lattice.rows,  # no bound by a rim: all is within the circle
    )


@njit_no_refcount
def estimate(lattice: Lattice, heuristic: Heuristic, node: int) -> int:
    """Cost in micrometres that no way from a node to the end of a plan falls below."""
    row, cell = node % (2 * lattice.headings), node // (2 * lattice.headings)
    body = cell + heuristic.body_cell[row]
    path = heuristic.cost_um[body] - 1
    if path < 0 or path > heuristic.frontier_um:
        path = heuristic.frontier_um
    endgame_um = heuristic.endgame_um
    reach = len(endgame_um) // 2
    col = cell % lattice.cols - lattice.origin_col + reach
    up = cell // lattice.cols - lattice.origin_row + reach
    exact = heuristic.cap_um
    if 0 <= col <= 2 * reach and 0 <= up <= 2 * reach:
        exact = endgame_um[up, col, row]
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
def estimates(
    lattice: Lattice, heuristic: Heuristic, nodes: NDArray[np.int64]
) -> NDArray[np.int64]:
    """`estimate` of nodes (n,)."""
    values_um = np.empty(len(nodes), np.int64)
    for i in range(len(nodes)):
        values_um[i] = estimate(lattice, heuristic, nodes[i])
    return values_um


# What every search of one robot shares, made once per step model.


class Tables(NamedTuple):
    """Steps on the lattice, and the parts of the heuristic that know no map."""

    steps: StepTable
    potential: Potential
    goal_table: GoalTable
    exits: Exits
    facing: Facing


@lru_cache(maxsize=8)
def tables_of(model: StepModel) -> Tables:
    """The tables of a step model; made at the first call, which takes a while."""
    steps = build_step_table(model)
    potential = build_potential(model, steps)
    goal_table = build_goal_table(model, steps, potential)
    facing = build_facing(potential, goal_table)
    return Tables(steps, potential, goal_table, build_exits(steps, potential), facing)


# The heuristic toward a goal that is a region.


def heuristic_toward_region(
    lattice: Lattice,
    model: StepModel,
    tables: Tables,
    body_cell: Int64s,
    ends: Int64s,
    region: GoalRegion,
) -> Heuristic:
    """Least cost to the end of a plan at any of the nodes (n,), of which there must be one.

    By the inequality (1) of `potential.py`, summed up to an end e,

        h(s) = p(s) + min over e of [ D(cell(s), cell(e)) - p(e) ] + cost of the last step.

    The table of the empty map is exact for the goal's own pose. It is consistent, so from a state
    to an end it falls by no more than the way costs, and what is left of it at e is too much by at
    most its largest value at any e.
    """
    final_um = final_cost_um(model)
    base_um, path = path_to_ends(lattice, tables, body_cell, ends, final_um)
    potential_um = tables.potential.potential_um.reshape(-1)
    slack_um = _most_exact(lattice, tables, ends) - final_um
    goal_table, exits = tables.goal_table, tables.exits
    return Heuristic(
        path.cost_um,
        path.frontier_um,
        body_cell,
        base_um + potential_um,
        np.maximum(goal_table.cost_um - np.int32(slack_um), 0),
        max(goal_table.cap_um - slack_um, 0),
        base_um + exits.turn_um,
        no_detours(lattice.cols, lattice.rows),
        exits.rim,
        # No end may lie within the circle wherever its bound is used.
        exits.radius_cells + math.ceil(region.reach_m / model.cell_m) + 2,
    )


def path_to_ends(
    lattice: Lattice, tables: Tables, body_cell: Int64s, ends: Int64s, final_um: int
) -> tuple[int, BodyPath]:
    """What every end of a plan (n,) adds at least, and the path costs to the nearest end."""
    potential_um, rows = tables.potential.potential_um.reshape(-1), 2 * lattice.headings
    value_um = final_um - potential_um[ends % rows]
    cells, least_um = least_in_cells(ends // rows + body_cell[ends % rows], value_um)
    base_um = int(least_um.min())
    return base_um, spread_from(lattice, tables.potential, cells, least_um - base_um)


def _most_exact(lattice: Lattice, tables: Tables, ends: Int64s) -> int:
    """What a plan costs at most on the empty map from an end (n,) to the goal's own pose."""
    goal_table, rows = tables.goal_table, 2 * lattice.headings
    reach = len(goal_table.cost_um) // 2
    cell = ends // rows
    col = np.clip(cell % lattice.cols - lattice.origin_col + reach, 0, 2 * reach)
    row = np.clip(cell // lattice.cols - lattice.origin_row + reach, 0, 2 * reach)
    return int(goal_table.cost_um[row, col, ends % rows].max())


# The heuristics that footstep planners have long had, which know less: to compare with.
#
# All are consistent. With v the way that a step moves the body's cell and the cost of the last step
# added to each:
#
# - euclidean: e times the straight distance to the goal, where e is the least cost of a metre, over
# all steps of (cost - step_cost_m) / |v|;
# - steps: the same, and step_cost_m for each of the steps that this takes at least, which is the
# distance over the longest |v|;
# - path: the cost of the body's path around obstacles, as in `potential.py`.


def simpler_heuristic(
    name: str, lattice: Lattice, model: StepModel, tables: Tables, body_cell: Int64s, ends: Int64s
) -> Heuristic:
    """The heuristic of that name toward the ends of a plan, nodes (n,)."""
    if name == "path":
        base_um, path = path_to_ends(lattice, tables, body_cell, ends, final_cost_um(model))
        potential_um = base_um + tables.potential.potential_um.reshape(-1)
        return of_path(lattice, path.cost_um, path.frontier_um, body_cell, potential_um)
    rate = _cost_of_metre(model, tables, counts_steps=name == "steps")
    rows = 2 * lattice.headings
    row, col = np.divmod(np.arange(lattice.cols * lattice.rows), lattice.cols)
    away_m = np.hypot(col - lattice.origin_col, row - lattice.origin_row) * lattice.cell_m
    # Ends lie around the goal, none farther off than this.
    away_m -= away_m[ends // rows + body_cell[ends % rows]].max()
    cost_um = np.clip(np.floor(away_m * rate * MICRO), 0, NOWHERE_UM - 1).astype(np.int32)
    potential_um = np.full(rows, final_cost_um(model), np.int64)
    return of_path(lattice, cost_um + 1, NOWHERE_UM, body_cell, potential_um)


def _cost_of_metre(model: StepModel, tables: Tables, counts_steps: bool) -> float:
    """What it costs at least to move the body's cell by a metre."""
    table = tables.steps
    move = moved_cells(table, tables.potential.body_col, tables.potential.body_row)
    length_m = np.linalg.norm(move, axis=-1) * model.cell_m
    moving = (table.cost_um > 0) & (length_m > 0)
    step_m = model.step_cost_m
    rate = float(((table.cost_um[moving] / MICRO - step_m) / length_m[moving]).min())
    return rate + step_m / float(length_m[moving].max()) if counts_steps else rate
