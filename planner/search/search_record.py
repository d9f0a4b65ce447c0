"""How a search went: cost and bound over time, and where it expanded states; for pictures."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.compiled import LOW, njit_arrays, slot_of
from planner.lattice.lattice import Int64s, Lattice
from planner.lattice.steps import MICRO
from planner.search.best_first import NO_COST, Tree

FloatArray = NDArray[np.float64]


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


class Recorder:
    """Collects a record; began: time.perf_counter() of the request's arrival."""

    def __init__(self, began: float) -> None:
        self._began = began
        self._moments: list[tuple[float, float, float]] = []

    def note(self, best_um: int, lower_bound_um: int) -> None:
        """Notes the cost of the best plan now, NO_COST without one, and the bound."""
        cost_m = best_um / MICRO if best_um < NO_COST else math.inf
        elapsed_s = time.perf_counter() - self._began
        self._moments.append((elapsed_s, cost_m, lower_bound_um / MICRO))

    def record(self, lattice: Lattice, tree: Tree) -> SearchRecord:
        """The record of the search that made a tree."""
        number = _expansions_per_cell(lattice, tree)
        cell = np.flatnonzero(number)
        x_m = (cell % lattice.cols - lattice.origin_col) * lattice.cell_m
        y_m = (cell // lattice.cols - lattice.origin_row) * lattice.cell_m
        moments = np.array(self._moments).reshape(-1, 3)
        return SearchRecord(
            time_s=moments[:, 0],
            cost_m=moments[:, 1],
            lower_bound_m=moments[:, 2],
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
