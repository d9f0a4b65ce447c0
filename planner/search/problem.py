"""What every search is asked, and what it answers."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.collision import Terrain
from planner.compiled import slots_of
from planner.heuristics.distance_field import BodyPath, search_body_path
from planner.heuristics.heuristic import (
    Heuristic,
    Tables,
    heuristic_toward_region,
    simpler_heuristic,
)
from planner.heuristics.potential import body_cells_from
from planner.heuristics.turning import no_detours
from planner.lattice.first_steps import first_steps
from planner.lattice.lattice import POINT, Int64s, Lattice, Region, beside, ends_in, height_beside
from planner.lattice.map_change import change_between, over
from planner.lattice.steps import MICRO
from planner.options import FULL
from planner.plan import PlanStatus
from planner.robot_model import Side, StepModel

# What all searches toward one goal on one map share, each part made when it is first asked for.


@dataclass(kw_only=True)
class GoalContext:
    """The lattice laid out from a goal, and what is known of the way to it.

    memory: what a search that is asked again and again keeps for itself, by its name; it has a
    method mend(space, change) for changes of the map. region: of the poses that plans may end in.
    coarse: the same on a coarse lattice, where the cells of this one are fine (see `coarse.py`).
    heuristic_name: one of `HEURISTICS`.
    """

    lattice: Lattice
    model: StepModel
    tables: Tables
    memory: dict[str, Any] = field(default_factory=dict)
    region: Region = POINT
    coarse: GoalContext | None = None
    heuristic_name: str = FULL

    @cached_property
    def heuristic(self) -> Heuristic:
        """The heuristic toward the goal, good for any start."""
        lattice = self.lattice
        if self.heuristic_name != FULL and len(self.ends):
            return simpler_heuristic(
                self.heuristic_name, lattice, self.model, self.tables, self.body_cell, self.ends
            )
        if not self.region.is_point and len(self.ends):
            return heuristic_toward_region(
                lattice, self.model, self.tables, self.body_cell, self.ends, self.region
            )
        return self.heuristic_by(
            search_body_path(lattice, self.tables.potential, self.tables.goal_table)
        )

    def heuristic_by(self, path: BodyPath) -> Heuristic:
        """The heuristic toward the goal's own pose with these path costs of the body."""
        lattice, exits = self.lattice, self.tables.exits
        return Heuristic(
            path.cost_um,
            path.frontier_um,
            self.body_cell,
            self.tables.potential.potential_um.reshape(-1),
            self.tables.goal_table.cost_um,
            self.tables.goal_table.cap_um,
            exits.turn_um,
            no_detours(lattice.cols, lattice.rows),
            exits.rim,
            exits.radius_cells,
        )

    def over(self, terrain: Terrain) -> GoalContext:
        """The same over a changed terrain of the same size; takes this one's arrays for its own."""
        change = change_between(self.lattice, self.lattice.terrain, terrain)
        if change is None:
            return self
        lattice = over(self.lattice, terrain, change)
        for kept in self.memory.values():
            kept.mend(lattice, change)
        coarse = None if self.coarse is None else self.coarse.over(terrain)
        return replace(self, lattice=lattice, coarse=coarse)

    @cached_property
    def body_cell(self) -> Int64s:
        """The body's cell from a foot's cell, per heading * 2 + side (2 H,)."""
        return body_cells_from(self.tables.potential, self.lattice.cols)

    @property
    def goal_nodes(self) -> Int64s:
        """Nodes of the goal feet (2,), left then right."""
        origin = self.lattice.origin_row * self.lattice.cols + self.lattice.origin_col
        return np.arange(2) + origin * self.lattice.headings * 2

    @cached_property
    def ends(self) -> Int64s:
        """Nodes (n,), in rising order, beside which the other foot may come last."""
        return ends_in(self.lattice, self.region)


def body_cells_of(context: GoalContext, nodes: Int64s) -> Int64s:
    """The body's cell (n,) of nodes (n,)."""
    rows = 2 * context.lattice.headings
    return nodes // rows + context.body_cell[nodes % rows]


FloatArray = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Request:
    """A search on the lattice.

    feet_lattice (2, 3): x_m, y_m, yaw_rad where the feet stand; feet_m (2,): how high.
    """

    context: GoalContext
    feet_lattice: FloatArray
    feet_m: FloatArray
    stands: bool
    first_side: Side | None

    @property
    def lattice(self) -> Lattice:
        """The lattice."""
        return self.context.lattice

    @property
    def model(self) -> StepModel:
        """The robot."""
        return self.context.model

    @property
    def heuristic(self) -> Heuristic:
        """The heuristic toward the goal."""
        return self.context.heuristic


@dataclass(frozen=True, kw_only=True)
class SearchRecord:
    """How a search went.

    time_s, cost_m, least_m (k,): at each of k moments the seconds since the request, the cost of
    the best plan so far (inf before the first) and what any plan costs at least. expanded (n, 3):
    x_m, y_m of the feet's cells in which states were expanded, in the frame of the goal's pair
    pose, and how many.
    """

    time_s: FloatArray
    cost_m: FloatArray
    least_m: FloatArray
    expanded: FloatArray


@dataclass(frozen=True, kw_only=True)
class Result:
    """What came of it: side (N,), pose_lattice (N, 3), cost and proven bound, or a reason.

    z_m (N,): height of the ground under each step. record: if the options ask for one.
    """

    status: PlanStatus
    reason: str = ""
    side: NDArray[np.int8]
    pose_lattice: FloatArray
    z_m: FloatArray
    cost_m: float = 0.0
    epsilon: float = math.inf
    expansions: int = 0
    time_to_first_s: float = 0.0
    record: SearchRecord | None = None


def failure(status: PlanStatus, reason: str, expansions: int = 0) -> Result:
    """A result without a plan."""
    return Result(
        status=status,
        reason=reason,
        side=np.zeros(0, np.int8),
        pose_lattice=np.zeros((0, 3)),
        z_m=np.zeros(0),
        expansions=expansions,
    )


def no_first_step(request: Request) -> Result:
    """The result where nothing can be stepped on from where the feet stand."""
    side = "" if request.first_side is None else f" with the {request.first_side.name.lower()}"
    reason = f"start: no first step{side} is free of obstacles and in limits"
    return failure(PlanStatus.NO_PATH, reason)


def no_way() -> Result:
    """The result where no path of the body leads from the start to the goal."""
    reason = (
        "the goal cannot be reached: obstacles enclose the start or the goal for a body of this "
        "width"
    )
    return failure(PlanStatus.NO_PATH, reason)


def first_nodes(request: Request) -> tuple[Int64s, Int64s]:
    """Nodes (n,) and costs (n,) of the first steps with either foot, or with the one asked for."""
    sides = tuple(Side) if request.first_side is None else (request.first_side,)
    # A robot that stands too near to an obstacle must be able to leave.
    margin_m = 0.0 if request.stands else request.model.body_margin_m
    return first_steps(
        request.lattice,
        request.model,
        request.feet_lattice,
        sides,
        margin_m,
        np.rint(request.feet_m * MICRO).astype(np.int64),
    )


def found(
    request: Request,
    nodes: Int64s,
    *,
    cost_um: int,
    epsilon: float,
    expansions: int,
    time_to_first_s: float,
) -> Result:
    """The plan whose steps are the nodes (N - 1,) and then the other foot beside the last."""
    lattice, model, last = request.lattice, request.model, int(nodes[-1])
    side = (nodes & 1).astype(np.int8)
    heading = (nodes >> 1) % lattice.headings
    cell = (nodes >> 1) // lattice.headings
    col = (cell % lattice.cols - lattice.origin_col).astype(float)
    row = (cell // lattice.cols - lattice.origin_row).astype(float)
    out = 1 - 2 * side  # `Side.outward`
    position = np.column_stack(
        [col * model.cell_m, row * model.cell_m + out * model.stance_width_m / 2]
    )
    yaw_rad = heading * (2 * np.pi / lattice.headings)
    poses = np.column_stack([position, yaw_rad])
    height_um = np.zeros(len(nodes))
    if len(lattice.node_um):
        height_um = lattice.node_um[slots_of(lattice.slots, nodes)].astype(np.float64)
    return Result(
        status=PlanStatus.FOUND,
        side=np.append(side, 1 - side[-1]),
        pose_lattice=np.vstack([poses, (*beside(lattice, last)[:2], yaw_rad[-1])]),
        z_m=np.append(height_um, height_beside(lattice, last)) / MICRO,
        cost_m=cost_um / MICRO,
        epsilon=epsilon,
        expansions=expansions,
        time_to_first_s=time_to_first_s,
    )
