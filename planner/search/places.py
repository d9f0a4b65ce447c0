"""Places on the lattice: what a search for a first plan tells apart, which is less than a state.

Where the path of the body leads on and steps do not, a search fills all that is around with states
that differ by a cell or by a few degrees before it tries another way. So here, once a state of a
place was expanded, only those are that have clearly less before them, after the cells of hybrid A*
(Dolgov, Thrun, Montemerlo and Diebel, "Path Planning for Autonomous Vehicles in Unknown
Semi-structured Environments", 2010). A plan may be missed by that.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.jit import lean
from planner.lattice.lattice import Space

_SIZE_M, _SIZE_RAD = 0.15, math.pi / 4
_CLEARLY_UM = 100_000


class Places(NamedTuple):
    """Places of so many cells along both axes, of so many headings and of one side.

    number, least_um (n,): a hash table of the places where states were expanded, n a power of two:
    their numbers from 1, 0 where there is none, and the least estimate of those states; (0,) where
    all states are to be.
    """

    number: NDArray[np.int64]
    least_um: NDArray[np.int32]
    cells: int
    headings: int


EVERY_STATE = Places(np.zeros(0, np.int64), np.zeros(0, np.int32), 1, 1)


def places_of(space: Space, most: int) -> Places:
    """Places of a lattice, nothing expanded in any, for at most so many expansions."""
    cells = max(1, round(_SIZE_M / space.cell_m))
    headings = max(1, round(_SIZE_RAD / (2 * math.pi) * space.headings))
    room = 1 << (2 * most).bit_length()
    return Places(np.zeros(room, np.int64), np.zeros(room, np.int32), cells, headings)


@lean
def takes_place(space: Space, places: Places, node: int, estimate_um: int) -> bool:
    """Whether the node has clearly less before it than those expanded in its place, which it notes.

    estimate_um: what is before it.
    """
    row, cell = node % (2 * space.headings), node // (2 * space.headings)
    across = (space.cols + places.cells - 1) // places.cells
    turns = (space.headings + places.headings - 1) // places.headings
    place = cell // space.cols // places.cells * across + cell % space.cols // places.cells
    number = (place * turns + row // 2 // places.headings) * 2 + row % 2 + 1
    last = len(places.number) - 1
    at = (number * 0x9E3779B1 >> 7) & last
    while places.number[at] != 0 and places.number[at] != number:
        at = at + 1 & last
    if places.number[at] == number and estimate_um > places.least_um[at] - _CLEARLY_UM:
        return False
    places.number[at], places.least_um[at] = number, estimate_um
    return True
