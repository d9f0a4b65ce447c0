"""The heuristic as searches read it, compiled: see `guide.py`, `endgame.py` and `exits.py`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.heuristics.rounded_plans import NOT_ROUNDED, Rounded, rounded_bound
from planner.heuristics.turning import exit_bound
from planner.jit import allocating, lean
from planner.lattice.lattice import Space


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
    rounded: Rounded = NOT_ROUNDED


def of_path(
    space: Space,
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
        space.cols + space.rows,  # no bound by a rim: all is within the circle
    )


@lean
def estimate(space: Space, heuristic: Heuristic, node: int) -> int:
    """Cost in micrometres that no way from a node to the end of a plan falls below."""
    row, cell = node % (2 * space.headings), node // (2 * space.headings)
    body = cell + heuristic.body_cell[row]
    path = heuristic.cost_um[body] - 1
    if path < 0 or path > heuristic.frontier_um:
        path = heuristic.frontier_um
    endgame_um = heuristic.endgame_um
    reach = len(endgame_um) // 2
    col = cell % space.cols - space.origin_col + reach
    up = cell // space.cols - space.origin_row + reach
    exact = heuristic.cap_um
    if 0 <= col <= 2 * reach and 0 <= up <= 2 * reach:
        exact = endgame_um[up, col, row]
    least = exit_bound(
        heuristic.detour_um,
        heuristic.turn_um,
        heuristic.cost_um,
        heuristic.frontier_um,
        heuristic.rim,
        (heuristic.radius_cells, space.cols, space.origin_col, space.origin_row),
        body,
        row,
    )
    near = rounded_bound(heuristic.rounded, col - reach, up - reach, row)
    return max(path + heuristic.potential_um[row], exact, least, near)


@allocating
def estimates(space: Space, heuristic: Heuristic, nodes: NDArray[np.int64]) -> NDArray[np.int64]:
    """`estimate` of nodes (n,)."""
    values_um = np.empty(len(nodes), np.int64)
    for i in range(len(nodes)):
        values_um[i] = estimate(space, heuristic, nodes[i])
    return values_um
