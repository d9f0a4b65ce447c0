"""What turning costs, for a search that wants a plan soon: estimates, not bounds as in `exits.py`.

Both come from the exact table on an empty map. To go off one way while facing another costs what a
walk of some metres costs that ends along the line it goes, less the cost of that line. To arrive
from somewhere costs what the walk from there costs that begins facing the goal, less the same.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.heuristics.goal_table import Endgame
from planner.heuristics.potential import Potential
from planner.heuristics.turning import SECTORS, straight_cost
from planner.lattice.steps import IntArray

_AWAY_CELLS = 50
_EXACT = 0.45  # of the cap of the table


@dataclass(frozen=True, kw_only=True)
class Facing:
    """Costs in micrometres that the straight way at the rate of the 2D path does not count.

    depart_um (2 H, SECTORS): to go off toward the middle of a sector, per heading * 2 + side, the
    cost of the last step included. arrive_um (2 n + 1, 2 n + 1): to come from a body cell (goal in
    the middle). exact_um: up to here the table itself knows nearly all headings.
    """

    depart_um: IntArray
    arrive_um: IntArray
    exact_um: int


def build_facing(guide: Potential, endgame: Endgame) -> Facing:
    """The estimates of a step model."""
    rows = 2 * len(guide.body_col)
    level_um = int(guide.move_um.min())
    along_um = _costs_at(guide, endgame, np.array(-_AWAY_CELLS), np.array(0), np.arange(rows))
    along_um -= _AWAY_CELLS * level_um
    headings = rows // 2
    heading, side = np.arange(rows) // 2, np.arange(rows) % 2
    middle = np.rint((np.arange(SECTORS) + 0.5) / SECTORS * headings).astype(np.int64)
    turned = (heading[:, None] - middle[None, :]) % headings
    return Facing(
        depart_um=along_um[turned * 2 + side[:, None]],
        arrive_um=_arrivals(guide, endgame, int(along_um[:2].min())),
        exact_um=int(_EXACT * endgame.cap_um),
    )


def _arrivals(guide: Potential, endgame: Endgame, aligned_um: int) -> IntArray:
    """`Facing.arrive_um`; aligned_um: what a walk costs that is straight from end to end."""
    headings = len(guide.body_col)
    reach = len(endgame.cost_um) // 2
    cells = np.arange(-reach, reach + 1)
    col, row = np.meshgrid(cells, cells)
    toward = np.rint(np.arctan2(-row, -col) / (2 * np.pi) * headings).astype(np.int64) % headings
    sides = [_costs_at(guide, endgame, col, row, 2 * toward + side) for side in range(2)]
    straight_um = straight_cost(col, row, guide)
    arrive_um = np.minimum(*sides) - straight_um - aligned_um
    return np.maximum(arrive_um, 0)


def _costs_at(
    guide: Potential, endgame: Endgame, col: IntArray, row: IntArray, state: IntArray
) -> IntArray:
    """Exact costs (...) with the body in cells (...) in states heading * 2 + side."""
    reach = len(endgame.cost_um) // 2
    foot_col = np.clip(col - guide.body_col.reshape(-1)[state] + reach, 0, 2 * reach)
    foot_row = np.clip(row - guide.body_row.reshape(-1)[state] + reach, 0, 2 * reach)
    return endgame.cost_um[foot_row, foot_col, state].astype(np.int64)
