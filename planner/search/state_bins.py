"""Bins of states, of which a search for a first plan expands few."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.compiled import njit_inner
from planner.lattice.lattice import Lattice

_BIN_M, _BIN_RAD = 0.15, math.pi / 4
_CLEARLY_LOWER_UM = 100_000


class StateBins(NamedTuple):
    """Bins of states for a search for a first plan, as in hybrid A*.

    A state is expanded only if its heuristic is clearly lower than that of all states of its bin
    expanded before, so the search soon tries another way where the body's path continues and steps
    do not. It may miss plans. After Dolgov, Thrun, Montemerlo and Diebel, "Path Planning for
    Autonomous Vehicles in Unknown Semi-structured Environments", 2010.

    cells, headings: size of a bin, which holds states of one side. key, least_um (n,): hash table
    of the bins in use, n a power of two: their numbers from 1, 0 for a free place, and the least
    heuristic expanded there. (0,): every state is expanded.
    """

    key: NDArray[np.int64]
    least_um: NDArray[np.int32]
    cells: int
    headings: int


NO_BINS = StateBins(np.zeros(0, np.int64), np.zeros(0, np.int32), 1, 1)


def new_bins(lattice: Lattice, expansions: int) -> StateBins:
    """Empty bins for at most so many expansions."""
    cells = max(1, round(_BIN_M / lattice.cell_m))
    headings = max(1, round(_BIN_RAD / (2 * math.pi) * lattice.headings))
    room = 1 << (2 * expansions).bit_length()
    return StateBins(np.zeros(room, np.int64), np.zeros(room, np.int32), cells, headings)


@njit_inner
def enters_bin(lattice: Lattice, bins: StateBins, node: int, heuristic_um: int) -> bool:
    """Whether a node is to be expanded, which its bin then remembers."""
    row, cell = node % (2 * lattice.headings), node // (2 * lattice.headings)
    bin_cols = (lattice.cols + bins.cells - 1) // bins.cells
    bin_headings = (lattice.headings + bins.headings - 1) // bins.headings
    number = cell // lattice.cols // bins.cells * bin_cols + cell % lattice.cols // bins.cells
    key = (number * bin_headings + row // 2 // bins.headings) * 2 + row % 2 + 1
    last = len(bins.key) - 1
    at = (key * 0x9E3779B1 >> 7) & last
    while bins.key[at] != 0 and bins.key[at] != key:
        at = at + 1 & last
    if bins.key[at] == key and heuristic_um > bins.least_um[at] - _CLEARLY_LOWER_UM:
        return False
    bins.key[at], bins.least_um[at] = key, heuristic_um
    return True
