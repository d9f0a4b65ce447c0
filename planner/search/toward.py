"""What all searches toward one goal on one map share, each part made when it is first asked for."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from planner.collision import Terrain
from planner.heuristics.distance_field import BodyPath, search_body_path
from planner.heuristics.heuristic import Heuristic
from planner.heuristics.potential import Potential
from planner.heuristics.simpler import simpler_heuristic
from planner.heuristics.tables import Tables
from planner.heuristics.toward_region import heuristic_toward_region
from planner.heuristics.turning import no_detours
from planner.lattice.lattice import Int64s, Space
from planner.lattice.map_change import change_between, over
from planner.lattice.region import POINT, Region, ends_in
from planner.options import FULL
from planner.robot_model import StepModel


@dataclass(kw_only=True)
class Toward:
    """The lattice laid out from a goal, and what is known of the way to it.

    memory: what a search that is asked again and again keeps for itself, by its name; it has a
    method mend(space, change) for changes of the map. region: of the poses that plans may end in.
    coarse: the same on a coarse lattice, where the cells of this one are fine (see `coarse.py`).
    heuristic_name: one of `HEURISTICS`.
    """

    space: Space
    model: StepModel
    tables: Tables
    memory: dict[str, Any] = field(default_factory=dict)
    region: Region = POINT
    coarse: Toward | None = None
    heuristic_name: str = FULL

    @cached_property
    def heuristic(self) -> Heuristic:
        """The heuristic toward the goal, good for any start."""
        space = self.space
        if self.heuristic_name != FULL and len(self.ends):
            return simpler_heuristic(
                self.heuristic_name, space, self.model, self.tables, self.body_cell, self.ends
            )
        if not self.region.is_point and len(self.ends):
            return heuristic_toward_region(
                space, self.model, self.tables, self.body_cell, self.ends, self.region
            )
        return self.heuristic_by(
            search_body_path(space, self.tables.potential, self.tables.endgame)
        )

    def heuristic_by(self, path: BodyPath) -> Heuristic:
        """The heuristic toward the goal's own pose with these path costs of the body."""
        space, exits = self.space, self.tables.exits
        return Heuristic(
            path.cost_um,
            path.frontier_um,
            self.body_cell,
            self.tables.potential.potential_um.reshape(-1),
            self.tables.endgame.cost_um,
            self.tables.endgame.cap_um,
            exits.turn_um,
            no_detours(space.cols, space.rows),
            exits.rim,
            exits.radius_cells,
        )

    def over(self, terrain: Terrain) -> Toward:
        """The same over a changed terrain of the same size; takes this one's arrays for its own."""
        change = change_between(self.space, self.space.terrain, terrain)
        if change is None:
            return self
        space = over(self.space, terrain, change)
        for kept in self.memory.values():
            kept.mend(space, change)
        coarse = None if self.coarse is None else self.coarse.over(terrain)
        return replace(self, space=space, coarse=coarse)

    @cached_property
    def body_cell(self) -> Int64s:
        """The body's cell from a foot's cell, per heading * 2 + side (2 H,)."""
        return body_cells_from(self.tables.potential, self.space.cols)

    @property
    def goal_nodes(self) -> Int64s:
        """Nodes of the goal feet (2,), left then right."""
        origin = self.space.origin_row * self.space.cols + self.space.origin_col
        return np.arange(2) + origin * self.space.headings * 2

    @cached_property
    def ends(self) -> Int64s:
        """Nodes (n,), in rising order, beside which the other foot may come last."""
        return ends_in(self.space, self.region)


def body_cells_from(potential: Potential, cols: int) -> Int64s:
    """The body's cell from a foot's cell as a difference of cell numbers (2 H,)."""
    return (potential.body_row * cols + potential.body_col).reshape(-1)


def body_cells_of(toward: Toward, nodes: Int64s) -> Int64s:
    """The body's cell (n,) of nodes (n,)."""
    rows = 2 * toward.space.headings
    return nodes // rows + toward.body_cell[nodes % rows]
