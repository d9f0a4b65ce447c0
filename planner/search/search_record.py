"""How a search went: cost and bound over time, and where it expanded states; for pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.compiled import LOW, njit_arrays, slot_of
from planner.lattice.lattice import Int64s, Lattice
from planner.search.best_first import Tree

FloatArray = NDArray[np.float64]
Moment = tuple[float, float, float]  # seconds since the request, cost and lower bound in metres


@dataclass(frozen=True, kw_only=True)
class SearchRecord:
    """How a search went.

    time_s, cost_m, lower_bound_m (k,): at each of k moments the seconds since the request, the cost
    of the best plan so far (inf before the first) and the lower bound on any plan. expanded (n, 3):
    x_m, y_m of the feet's cells in which states were expanded, in the frame of the goal's pair
    pose, and how many.
    """

    time_s: FloatArray
    cost_m: FloatArray
    lower_bound_m: FloatArray
    expanded: FloatArray


def search_record(moments: Sequence[Moment], lattice: Lattice, tree: Tree) -> SearchRecord:
    """The record of the search that made a tree."""
    number = _expansions_per_cell(lattice, tree)
    cell = np.flatnonzero(number)
    x_m = (cell % lattice.cols - lattice.origin_col) * lattice.cell_m
    y_m = (cell // lattice.cols - lattice.origin_row) * lattice.cell_m
    time_s, cost_m, lower_bound_m = np.array(moments).reshape(-1, 3).T
    return SearchRecord(
        time_s=time_s,
        cost_m=cost_m,
        lower_bound_m=lower_bound_m,
        expanded=np.column_stack([x_m, y_m, number[cell]]),
    )


@njit_arrays
def _expansions_per_cell(lattice: Lattice, tree: Tree) -> Int64s:
    """Number of nodes expanded in each of the lattice's cells (rows * cols,)."""
    number = np.zeros(lattice.cols * lattice.rows, np.int64)
    of_block, rows = tree.slots.of_block, 2 * lattice.headings
    for node in range(len(number) * rows):
        if of_block[node // (LOW + 1)] and tree.closed_in[slot_of(tree.slots, node)]:
            number[node // rows] += 1
    return number
