"""One ARA* run: seeds, heuristic, rounds of falling epsilon, and the plan or why there is none."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner import search
from planner.body_path import search_body_path
from planner.connect import first_steps
from planner.endgame import Endgame
from planner.exits import SECTORS, Exits
from planner.flood import Flood, Verdict, new_flood, spread
from planner.guide import Potential
from planner.lattice import MICRO, final_cost_um, foot_position
from planner.model import Side, StepModel
from planner.options import PlannerOptions
from planner.plan import PlanStatus
from planner.search import Heuristic, Tree
from planner.space import Space

FloatArray = NDArray[np.float64]
Int64s = NDArray[np.int64]
_BUDGET = 4096  # expansions between two looks at the clock
# A search that has no plan after so many expansions takes turns with the floods from start and
# goal, which may find that there is none: so many expansions against so many nodes of each flood,
# which double from turn to turn, because the longer there is no plan the likelier there is none.
_PATIENCE, _TURN, _FLOOD_TURN, _FLOOD_TURN_MOST = 1 << 15, 1 << 13, 1 << 12, 1 << 14


@dataclass(frozen=True, kw_only=True)
class Request:
    """A search on the lattice.

    feet_lattice (2, 3): x_m, y_m, yaw_rad where the feet stand; feet_m (2,): how high.
    """

    space: Space
    model: StepModel
    heuristic: Heuristic
    feet_lattice: FloatArray
    feet_m: FloatArray
    stands: bool
    first_side: Side | None


@dataclass(frozen=True, kw_only=True)
class Result:
    """What came of it: side (N,), pose_lattice (N, 3), cost and proven bound, or a reason.

    z_m (N,): height of the ground under each step.
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


def _failure(status: PlanStatus, reason: str, expansions: int = 0) -> Result:
    return Result(
        status=status,
        reason=reason,
        side=np.zeros(0, np.int8),
        pose_lattice=np.zeros((0, 3)),
        z_m=np.zeros(0),
        expansions=expansions,
    )


def plan_ara(request: Request, options: PlannerOptions, began: float) -> Result:
    """Searches until epsilon is proven or a limit of the options is reached.

    began: time.perf_counter() of the request's arrival, from which times count.
    """
    nodes, costs_um = _seeds(request)
    if not len(nodes):
        side = "" if request.first_side is None else f" with the {request.first_side.name.lower()}"
        return _failure(
            PlanStatus.NO_PATH, f"start: no first step{side} is free of obstacles and in limits"
        )
    heuristic = request.heuristic
    if not _can_reach(request.space, heuristic, nodes):
        return _failure(
            PlanStatus.NO_PATH,
            "the goal cannot be reached: obstacles enclose the start or the goal "
            "for a body of this width",
        )
    tree = _new_tree(request, nodes)
    search.seed(request.space, heuristic, tree, nodes, costs_um)
    return _Run(request, options, began, heuristic, tree, nodes).result()


def _seeds(request: Request) -> tuple[Int64s, Int64s]:
    """Nodes and costs of the first steps with either foot, or with the one asked for."""
    sides = Side if request.first_side is None else (request.first_side,)
    # A robot that stands too near to an obstacle must be able to leave.
    margin_m = 0.0 if request.stands else request.model.body_margin_m
    found = [
        first_steps(
            request.space,
            request.model,
            request.feet_lattice[side.other],
            side,
            margin_m,
            round(float(request.feet_m[side.other]) * MICRO),
        )
        for side in sides
    ]
    return np.concatenate([f[0] for f in found]), np.concatenate([f[1] for f in found])


def build_heuristic(
    space: Space, potential: Potential, endgame: Endgame, exits: Exits
) -> Heuristic:
    """The heuristic toward the goal of a space, good for any start."""
    path = search_body_path(space, potential, endgame)
    return Heuristic(
        path.cost_um,
        path.frontier_um,
        (potential.body_row * space.cols + potential.body_col).reshape(-1),
        potential.potential_um.reshape(-1),
        endgame.cost_um,
        endgame.cap_um,
        exits.turn_um,
        np.zeros((space.cols * space.rows, SECTORS), np.int32),
        exits.rim,
        exits.radius_cells,
    )


def _can_reach(space: Space, heuristic: Heuristic, nodes: Int64s) -> bool:
    """Whether a path of the body leads to the goal from any of the nodes (n,)."""
    rows, cells = nodes % (2 * space.headings), nodes // (2 * space.headings)
    return bool(np.any(heuristic.cost_um[cells + heuristic.body_cell[rows]] > 0))


def _new_tree(request: Request, seeds: Int64s) -> Tree:
    space = request.space
    nodes = space.cols * space.rows * space.headings * 2
    origin = (space.origin_row * space.cols + space.origin_col) * space.headings * 2
    scalars = np.zeros(search.SCALARS, np.int64)
    scalars[search.BEST_UM] = search.NO_COST
    entries = (1 << 16) + len(seeds)
    return Tree(
        cost_um=np.zeros(nodes, np.int32),
        before=np.zeros(nodes, np.int32),
        round=np.zeros(nodes, np.uint8),
        entry_node=np.empty(entries, np.int32),
        entry_next=np.empty(entries, np.int32),
        head=np.full(search.BUCKETS + 1, -1, np.int32),
        goals=np.array([origin, origin + 1]),
        final_um=final_cost_um(request.model),
        scalars=scalars,
    )


_ENCLOSED = {
    Verdict.GOAL_ENCLOSED: "obstacles leave no steps from outside to the goal",
    Verdict.START_ENCLOSED: "obstacles leave no steps out from the start",
}


class _Run:
    """The rounds of one search and the limits on them."""

    def __init__(
        self,
        request: Request,
        options: PlannerOptions,
        began: float,
        heuristic: Heuristic,
        tree: Tree,
        seeds: Int64s,
    ) -> None:
        self.request = request
        self.options = options
        self.began = began
        self.heuristic = heuristic
        self.tree = tree
        self.time_to_first_s = 0.0
        self.least_um = 0
        self.proven = math.inf
        self.first_expansions = 0
        self.verdict = Verdict.OPEN
        self._seeds = seeds
        self._flood: Flood | None = None
        self._flood_turn = _FLOOD_TURN

    def result(self) -> Result:
        """Runs all rounds and reads the plan from the tree."""
        epsilon = self.options.epsilon
        while self._round(epsilon):
            epsilon = _next_epsilon(epsilon)
        expansions = self._expansions
        if self._best_um < search.NO_COST:
            self._tighten_bound()
            return self._plan(expansions)
        if self.verdict in _ENCLOSED:
            assert self._flood is not None
            poses = int(self._flood.ends[1] + self._flood.ends[3])
            reason = f"the goal cannot be reached: {_ENCLOSED[self.verdict]} ({poses} poses tried)"
            return _failure(PlanStatus.NO_PATH, reason, expansions)
        if self._limit_reached():
            self._tighten_bound()
            reason = (
                f"no plan found within {self._limit_reached()}; "
                f"any plan costs at least {self.least_um / MICRO:.2f} m"
            )
            return _failure(PlanStatus.TIMED_OUT, reason, expansions)
        reason = (
            "the goal cannot be reached: all poses that steps lead to were searched "
            f"({expansions} expansions)"
        )
        return _failure(PlanStatus.NO_PATH, reason, expansions)

    @property
    def _best_um(self) -> int:
        return int(self.tree.scalars[search.BEST_UM])

    @property
    def _expansions(self) -> int:
        return int(self.tree.scalars[search.EXPANSIONS])

    def _round(self, epsilon: float) -> bool:
        """One search with a weight; whether another one may follow."""
        space, heuristic = self.request.space, self.heuristic
        self.least_um = int(search.begin_round(space, heuristic, self.tree, epsilon))
        self._note_bound()
        if self.proven <= self.options.final_epsilon:
            return False
        while True:
            outcome = search.expand(space, heuristic, self.tree, epsilon, self._budget())
            if outcome == search.OUT_OF_ENTRIES:
                self.tree = self.tree._replace(
                    entry_node=_doubled(self.tree.entry_node),
                    entry_next=_doubled(self.tree.entry_next),
                )
            elif outcome == search.IMPROVED:
                if self.time_to_first_s == 0.0:
                    self.time_to_first_s = time.perf_counter() - self.began
                    self.first_expansions = self._expansions
                if self.options.stop_at_first:
                    return False
            elif outcome in (search.FINISHED, search.EXHAUSTED):
                if self._best_um < search.NO_COST and epsilon == 1.0:
                    self.proven = 1.0
                return self._best_um < search.NO_COST and self.proven > self.options.final_epsilon
            if self._limit_reached() or self._improved_enough() or self._is_enclosed():
                return False

    def _is_enclosed(self) -> bool:
        """Whether the floods, if it is their turn, find that no steps lead to the goal."""
        if self._may_be_enclosed() and self._expansions >= _PATIENCE:
            if self._flood is None:
                self._flood = new_flood(self.request.space, self._seeds, self.tree.goals)
            self._flood, self.verdict = spread(self.request.space, self._flood, self._flood_turn)
            self._flood_turn = min(2 * self._flood_turn, _FLOOD_TURN_MOST)
        return self.verdict in _ENCLOSED

    def _may_be_enclosed(self) -> bool:
        return self.verdict is Verdict.OPEN and self._best_um == search.NO_COST

    def _tighten_bound(self) -> None:
        """Takes over what the open states prove now that the search stopped in mid-round."""
        if self.proven > 1.0:
            space, heuristic = self.request.space, self.heuristic
            self.least_um = int(search.begin_round(space, heuristic, self.tree, 1.0))
            self._note_bound()

    def _note_bound(self) -> None:
        """Takes over what the least g + h of all open states proves."""
        best = self._best_um
        if best < search.NO_COST:
            self.proven = min(self.proven, best / min(best, max(self.least_um, 1)))

    def _budget(self) -> int:
        """Expansions until one of the limits is to be looked at again."""
        budget = self.options.max_expansions - self._expansions
        if self.options.time_limit_s:
            budget = min(budget, _BUDGET)
        if self._may_be_enclosed():
            budget = min(budget, max(_TURN, _PATIENCE - self._expansions))
        left = self._left_to_improve()
        return max(0, budget if left is None else min(budget, left))

    def _left_to_improve(self) -> int | None:
        """Expansions left to spend on a better plan than the first; None without a limit."""
        if self.options.improve_expansions is None or self._best_um == search.NO_COST:
            return None
        return self.first_expansions + self.options.improve_expansions - self._expansions

    def _improved_enough(self) -> bool:
        left = self._left_to_improve()
        return left is not None and left <= 0

    def _limit_reached(self) -> str:
        """The limit that ended the search, in words; empty if none did."""
        if self._expansions >= self.options.max_expansions:
            return f"{self.options.max_expansions} expansions"
        limit_s = self.options.time_limit_s
        if limit_s is not None and time.perf_counter() - self.began >= limit_s:
            return f"{limit_s:g} s"
        return ""

    def _plan(self, expansions: int) -> Result:
        space, model = self.request.space, self.request.model
        last = int(self.tree.scalars[search.BEST_NODE])
        nodes = np.array(search.trace(self.tree, last))
        other = self.tree.goals[1 - (last & 1)]
        nodes = np.append(nodes, other)
        side = (nodes & 1).astype(np.int8)
        heading = (nodes >> 1) % space.headings
        cell = (nodes >> 1) // space.headings
        col = (cell % space.cols - space.origin_col).astype(float)
        row = (cell // space.cols - space.origin_row).astype(float)
        position = np.array(
            [foot_position(c, r, s, model) for c, r, s in zip(col, row, side, strict=True)]
        )
        yaw_rad = heading * (2 * np.pi / space.headings)
        cost_um = int(self.tree.cost_um[last]) + self.tree.final_um
        return Result(
            status=PlanStatus.FOUND,
            side=side,
            pose_lattice=np.column_stack([position, yaw_rad]),
            z_m=space.node_um[nodes] / MICRO if len(space.node_um) else np.zeros(len(nodes)),
            cost_m=cost_um / MICRO,
            epsilon=self.proven,
            expansions=expansions,
            time_to_first_s=self.time_to_first_s,
        )


def _next_epsilon(epsilon: float) -> float:
    """The next weight: two fifths of what is above 1, and 1 itself once that is little."""
    return 1.0 + 0.4 * (epsilon - 1.0) if epsilon > 1.3 else 1.0


def _doubled(array: NDArray[np.int32]) -> NDArray[np.int32]:
    return np.concatenate([array, np.empty_like(array)])
