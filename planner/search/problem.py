"""The search problem: lattice and heuristic of a goal, the request, the task, and its result."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.collision import Terrain
from planner.compiled import njit_arrays, slot_of, slots_of, with_room, zeros
from planner.heuristics.distance_field import (
    lazy_path_costs,
    least_in_cells,
    path_costs,
    path_costs_to_goal,
)
from planner.heuristics.heuristic import (
    Heuristic,
    Tables,
    estimates,
    full_heuristic,
    heuristic_by_path,
    heuristic_toward_region,
    simpler_heuristic,
)
from planner.heuristics.potential import straight_cost
from planner.lattice.first_steps import first_steps
from planner.lattice.goal_region import POINT, GoalRegion, ends_in, last_foot
from planner.lattice.lattice import Int64s, Lattice, node_poses, reversed_steps
from planner.lattice.map_change import change_between, over
from planner.lattice.steps import MICRO, final_cost_um
from planner.options import FULL
from planner.plan import PlanStatus
from planner.robot_model import Side, StepModel
from planner.search.best_first import (
    BEST_NODE,
    BEST_UM,
    BUCKETS,
    NO_COST,
    OUT_OF_BUDGET,
    ROOT,
    SCALARS,
    Tree,
    expand,
    insert_roots,
)
from planner.search.search_record import SearchRecord
from planner.search.state_bins import NO_BINS
from planner.time_limit import check_time

FloatArray = NDArray[np.float64]
CLOCK_EXPANSIONS = 2048  # expansions between two looks at the clock
_ENTRIES = 1 << 16  # of a new queue, which doubles when it is full


@dataclass(kw_only=True)
class GoalContext:
    """Lattice, goal region and heuristic of one goal, made when first used.

    memory: what a planner keeps between requests, by the planner's name; it has a method
    repair(lattice, change) for changes of the map. coarse: the same goal on a lattice of coarse
    cells if this one's are fine. heuristic_name: one of `HEURISTICS`.
    """

    lattice: Lattice
    model: StepModel
    tables: Tables
    memory: dict[str, Any] = field(default_factory=dict)
    region: GoalRegion = POINT
    coarse: GoalContext | None = None
    heuristic_name: str = FULL

    @cached_property
    def heuristic(self) -> Heuristic:
        """The heuristic toward the goal, good for any start."""
        lattice, tables = self.lattice, self.tables
        if self.heuristic_name != FULL and len(self.ends):
            return simpler_heuristic(self.heuristic_name, lattice, self.model, tables, self.ends)
        if not self.region.is_point and len(self.ends):
            return heuristic_toward_region(lattice, self.model, tables, self.ends, self.region)
        cost_um = path_costs_to_goal(lattice, tables.potential, tables.goal_table)
        return full_heuristic(lattice, tables, cost_um)

    def over(self, terrain: Terrain) -> GoalContext:
        """The context over a changed terrain of the same size; takes over this one's arrays."""
        change = change_between(self.lattice, self.lattice.terrain, terrain)
        if change is None:
            return self
        lattice = over(self.lattice, terrain, change)
        for kept in self.memory.values():
            kept.repair(lattice, change)
        coarse = None if self.coarse is None else self.coarse.over(terrain)
        return replace(self, lattice=lattice, coarse=coarse)

    def body_cells(self, nodes: Int64s) -> Int64s:
        """The body's cell (n,) of nodes (n,)."""
        rows = 2 * self.lattice.headings
        return nodes // rows + self.tables.potential.cell_offsets(self.lattice.cols)[nodes % rows]

    def potentials_um(self, nodes: Int64s) -> Int64s:
        """Potential (n,) of nodes (n,)."""
        return self.tables.potential.potential_um[nodes % (2 * self.lattice.headings)]

    @cached_property
    def ends(self) -> Int64s:
        """Nodes (n,), in rising order, beside which the other foot may complete a plan."""
        return ends_in(self.lattice, self.region)


@dataclass(frozen=True, kw_only=True)
class Request:
    """A plan to be found on the lattice of a goal.

    feet_lattice (2, 3): x_m, y_m, yaw_rad where the feet stand; feet_m (2,): their heights.
    stands: the robot stands nearer to an obstacle than the margins allow, and may leave.
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
    def pair_margin_m(self) -> float:
        """Margin of the body at the pair pose of the first step."""
        return 0.0 if self.stands else self.model.body_margin_m

    @property
    def feet_um(self) -> Int64s:
        """Heights of the feet (2,) in micrometres."""
        return np.rint(self.feet_m * MICRO).astype(np.int64)

    @cached_property
    def first_steps(self) -> tuple[Int64s, Int64s]:
        """Nodes (n,) and costs (n,) of the first steps with either foot, or the one asked for."""
        sides = tuple(Side) if self.first_side is None else (self.first_side,)
        return first_steps(
            self.lattice, self.model, self.feet_lattice, sides, self.pair_margin_m, self.feet_um
        )

    @property
    def has_first_step(self) -> bool:
        """Whether there is any first step."""
        return len(self.first_steps[0]) > 0

    def straight_bound(self) -> int:
        """Lower bound on plans to the goal's own pose, without the map."""
        (nodes, costs_um), lattice = self.first_steps, self.lattice
        cells = self.context.body_cells(nodes)
        across = cells % lattice.cols - lattice.origin_col
        up = cells // lattice.cols - lattice.origin_row
        straight_um = straight_cost(across, up, *self.context.tables.potential.straight_um)
        return int((costs_um + straight_um + self.context.potentials_um(nodes)).min())

    def heuristic_bound(self, heuristic: Heuristic | None = None) -> int:
        """Lower bound on plans by a heuristic toward the goal; that of the context by default."""
        nodes, costs_um = self.first_steps
        heuristic = heuristic or self.context.heuristic
        return int((costs_um + estimates(self.lattice, heuristic, nodes)).min())

    def quick_bound(self) -> int:
        """Lower bound on plans that is quick to compute."""
        return self.straight_bound() if self.context.region.is_point else self.heuristic_bound()


@dataclass(frozen=True, kw_only=True)
class SearchTask:
    """A search from roots (n,) with their costs to goals (m,) with their costs-to-go.

    The goals are in rising order. The heuristic looks toward the goals.
    """

    lattice: Lattice
    heuristic: Heuristic
    is_backward: bool
    roots: Int64s
    root_um: Int64s
    goals: Int64s
    goal_um: Int64s

    def tree(self) -> Tree:
        """A new tree with the roots in it."""
        tree = new_tree(self.lattice, self.is_backward)
        tree = tree._replace(goals=self.goals, goal_um=self.goal_um)
        insert_roots(tree, self.roots, self.root_um)
        return tree

    @property
    def is_connected(self) -> bool:
        """Whether a path of the body leads from a root to the goals, if there are any."""
        rows = self.roots % (2 * self.lattice.headings)
        cells = self.roots // (2 * self.lattice.headings) + self.heuristic.body_cell[rows]
        return len(self.goals) > 0 and bool(np.any(self.heuristic.cost_um[cells] > 0))


def new_tree(lattice: Lattice, is_backward: bool) -> Tree:
    """A tree with neither roots nor goals."""
    length = lattice.slots.length
    scalars = np.zeros(SCALARS, np.int64)
    scalars[BEST_UM] = NO_COST
    return Tree(
        steps=reversed_steps(lattice.steps) if is_backward else lattice.steps,
        is_backward=is_backward,
        slots=lattice.slots,
        cost_um=zeros(length, np.int32),
        parent=zeros(length, np.int32),
        closed_in=zeros(length, np.uint8),
        entry_node=np.empty(_ENTRIES, np.int32),
        entry_next=np.empty(_ENTRIES, np.int32),
        head=np.full(BUCKETS + 1, -1, np.int32),
        goals=np.zeros(1, np.int64),  # a node of the rim, where no step leads
        goal_um=np.zeros(1, np.int64),
        scalars=scalars,
        bins=NO_BINS,
    )


def expand_up_to(
    task: SearchTask, tree: Tree, epsilon: float, most: int, chunk: int = CLOCK_EXPANSIONS
) -> int:
    """Expands states of a tree until it has `most` or `expand` ends; what that gave back last.

    Raises OutOfTime where a limit passes on the way.
    """
    outcome = OUT_OF_BUDGET
    while outcome == OUT_OF_BUDGET and tree.expansions < most:
        check_time()
        budget = min(chunk, most - tree.expansions)
        outcome = expand(task.lattice, task.heuristic, tree, epsilon, budget)
    return outcome


def with_longer_queue(tree: Tree) -> Tree:
    """The tree with room for twice as many queue entries."""
    used = len(tree.entry_node)
    return tree._replace(
        entry_node=with_room(tree.entry_node, used, 1),
        entry_next=with_room(tree.entry_next, used, 1),
    )


def best_nodes(tree: Tree) -> Int64s:
    """Nodes (n,) of the best plan but for its last, in the order of the steps."""
    path = trace(tree, int(tree.scalars[BEST_NODE]))
    return path[::-1].copy() if tree.is_backward else path


@njit_arrays
def trace(tree: Tree, node: int) -> Int64s:
    """Path (n,) of nodes from a root to a node, both included."""
    number = 0
    here: int = node
    while here != ROOT:
        number += 1
        here = np.int64(tree.parent[slot_of(tree.slots, here)])  # type: ignore[assignment]
    path = np.empty(number, np.int64)
    here = node
    while number > 0:
        number -= 1
        path[number] = here
        here = np.int64(tree.parent[slot_of(tree.slots, here)])  # type: ignore[assignment]
    return path


def forward_task(request: Request) -> SearchTask:
    """From the first steps to the goal region."""
    ends, (nodes, costs_um) = request.context.ends, request.first_steps
    return SearchTask(
        lattice=request.lattice,
        heuristic=request.context.heuristic,
        is_backward=False,
        roots=nodes,
        root_um=costs_um,
        goals=ends,
        goal_um=np.full(len(ends), final_cost_um(request.model)),
    )


def backward_task(request: Request, further_um: int | None = None) -> SearchTask:
    """From the goal region to the first steps; further_um: as in `heuristic_to_start`."""
    ends, (nodes, costs_um) = request.context.ends, request.first_steps
    order = np.argsort(nodes)
    return SearchTask(
        lattice=request.lattice,
        heuristic=heuristic_to_start(request, further_um),
        is_backward=True,
        roots=ends,
        root_um=np.full(len(ends), final_cost_um(request.model)),
        goals=nodes[order],
        goal_um=costs_um[order],
    )


def heuristic_to_start(request: Request, further_um: int | None = None) -> Heuristic:
    """Lower bound on the cost from the start, for a search from the goal.

    By inequality (1) of `potential.py`, summed from a first step s,

        h(t) = min over s of [ cost(s) + p(s) + D(cell(s), cell(t)) ] - p(t).

    further_um: D is exact only where paths to the goal pass that cost at most so much more than the
    cheapest, and lower elsewhere; None: everywhere.
    """
    (nodes, costs_um), context, lattice = request.first_steps, request.context, request.lattice
    potential = context.tables.potential
    values_um = costs_um + context.potentials_um(nodes)
    cells, least_um = least_in_cells(context.body_cells(nodes), values_um)
    base_um = int(least_um.min())
    seeds = cells, least_um - base_um
    if further_um is None:
        cost_um = path_costs(lattice, potential, *seeds)
    else:
        ends = np.unique(context.body_cells(context.ends))
        cost_um = lazy_path_costs(lattice, potential, *seeds, ends, further_um)
    return heuristic_by_path(lattice, potential, cost_um, base_um - potential.potential_um)


@dataclass(frozen=True, kw_only=True)
class Result:
    """A plan in the lattice frame, with its cost and proven bound, or why there is none.

    side (N,), pose_lattice (N, 3). z_m (N,): height of the ground under each step. record: if the
    options ask for one.
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


def out_of_time(request: Request, limit_s: float) -> Result:
    """The result where the time ran out before there was a plan."""
    reason = f"no plan found within {limit_s:g} s"
    if request.context.region.is_point and request.has_first_step:
        reason += f"; any plan costs at least {request.straight_bound() / MICRO:.2f} m"
    return failure(PlanStatus.TIMED_OUT, reason)


def no_first_step(request: Request) -> Result:
    """The result where no first step is possible from where the feet stand."""
    side = "" if request.first_side is None else f" with the {request.first_side.name.lower()}"
    reason = f"start: no first step{side} is free of obstacles and in limits"
    return failure(PlanStatus.NO_PATH, reason)


def no_body_path() -> Result:
    """The result where the body has no way from the start to the goal."""
    reason = "the goal cannot be reached: obstacles leave no way for a body of this size"
    return failure(PlanStatus.NO_PATH, reason)


def result_of(
    request: Request,
    nodes: Int64s,
    *,
    cost_um: int,
    epsilon: float,
    expansions: int,
    time_to_first_s: float,
) -> Result:
    """The plan whose steps are the nodes (N - 1,) and then the other foot beside the last."""
    lattice, last = request.lattice, int(nodes[-1])
    side = (nodes & 1).astype(np.int8)
    poses, (x, y, last_um) = node_poses(lattice, nodes), last_foot(lattice, last)
    height_um = np.zeros(len(nodes))
    if len(lattice.node_um):
        height_um = lattice.node_um[slots_of(lattice.slots, nodes)].astype(np.float64)
    return Result(
        status=PlanStatus.FOUND,
        side=np.append(side, 1 - side[-1]),
        pose_lattice=np.vstack([poses, (x, y, poses[-1, 2])]),
        z_m=np.append(height_um, last_um) / MICRO,
        cost_m=cost_um / MICRO,
        epsilon=epsilon,
        expansions=expansions,
        time_to_first_s=time_to_first_s,
    )
