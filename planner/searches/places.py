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
from planner.lattice.space import Space

_SIZE_M, _SIZE_RAD = 0.15, math.pi / 4
_CLEARLY_UM = 100_000


class Places(NamedTuple):
    """Places of so many cells along both axes, of so many headings and of one side.

    least_um (places,): least estimate of a state that was expanded in each, 0 before; (0,) where
    all states are to be.
    """

    least_um: NDArray[np.int32]
    cells: int
    headings: int


EVERY_STATE = Places(np.zeros(0, np.int32), 1, 1)


def places_of(space: Space) -> Places:
    """Places of a lattice, nothing expanded in any."""
    cells = max(1, round(_SIZE_M / space.cell_m))
    headings = max(1, round(_SIZE_RAD / (2 * math.pi) * space.headings))
    number = -(-space.cols // cells) * -(-space.rows // cells) * -(-space.headings // headings) * 2
    return Places(np.zeros(number, np.int32), cells, headings)


@lean
def takes_place(space: Space, places: Places, node: int, estimate_um: int) -> bool:
    """Whether the node has clearly less before it than those expanded in its place, which it notes.

    estimate_um: what is before it, more than 0.
    """
    row, cell = node % (2 * space.headings), node // (2 * space.headings)
    across = (space.cols + places.cells - 1) // places.cells
    turns = (space.headings + places.headings - 1) // places.headings
    place = cell // space.cols // places.cells * across + cell % space.cols // places.cells
    place = (place * turns + row // 2 // places.headings) * 2 + row % 2
    least_um = places.least_um[place]
    if least_um != 0 and estimate_um > least_um - _CLEARLY_UM:
        return False
    places.least_um[place] = estimate_um
    return True
