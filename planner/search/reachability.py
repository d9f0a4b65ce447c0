"""Whether any steps at all lead from the start to the goal: two floods of the lattice that meet.

A* expands the states near the best way first, so it proves that there is no way only after it
expanded every reachable state. A flood notes only whether a state was reached, not at what cost.
One goes forward from the first steps and one backward from the goal feet, in turns, so the smaller
enclosed side is exhausted first. Each expands its newest state first, so that they soon meet where
there is a way. Both use the steps and checks of the search, so the verdict is exact.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from planner.compiled import njit_arrays, njit_no_refcount, with_room, zeros
from planner.lattice.lattice import (
    COST_UM,
    D_HALF,
    D_NODE,
    HALF_HEADING,
    Int64s,
    Lattice,
    node_free,
    pair_known_free,
    reversed_steps,
    step_climbs,
)
from planner.time_limit import check_time

FORWARD, BACKWARD = 1, 2
_CHUNK = 1 << 12  # nodes of one flood before it is the other's turn


class Verdict(IntEnum):
    """Result of two floods: open, they met, or which of them was exhausted before."""

    OPEN = 0
    MET = 1
    GOAL_ENCLOSED = 2
    START_ENCLOSED = 3


class Floods:
    """The two floods, from first steps (n,) and from the goal's nodes (m,), and their verdict."""

    def __init__(self, lattice: Lattice, seeds: Int64s, goals: Int64s) -> None:
        self._lattice = lattice
        self._back_steps = reversed_steps(lattice.steps)
        # FORWARD or BACKWARD where a flood has reached a node, 0 elsewhere.
        self._seen = zeros(lattice.nodes, np.uint8)
        # Stacks of nodes to expand; for each of the two, how many are on it and how many were.
        self._forward = np.unique(seeds).astype(np.int32)
        self._backward = goals[nodes_free(lattice, goals)].astype(np.int32)
        self._ends = np.repeat([len(self._forward), len(self._backward)], 2)
        self._seen[self._forward] = FORWARD
        self._seen[self._backward] |= BACKWARD
        has_met = np.any(self._seen[self._backward] == FORWARD | BACKWARD)
        self.verdict = Verdict.MET if has_met else Verdict.OPEN

    def expand(self, budget: int) -> Verdict:
        """Expands so many nodes of each flood while the verdict is open; the verdict.

        Raises OutOfTime where a limit passes on the way.
        """
        for done in range(0, budget, _CHUNK):
            check_time()
            chunk = min(_CHUNK, budget - done)
            most = chunk * self._lattice.steps.shape[1]
            self._forward = with_room(self._forward, int(self._ends[0]), most)
            self._backward = with_room(self._backward, int(self._ends[2]), most)
            for stack, steps, mine, at, dry in (
                (self._backward, self._back_steps, BACKWARD, 2, Verdict.GOAL_ENCLOSED),
                (self._forward, self._lattice.steps, FORWARD, 0, Verdict.START_ENCLOSED),
            ):
                if self.verdict is not Verdict.OPEN:
                    return self.verdict
                if flood(self._lattice, self._seen, stack, steps, mine, self._ends, at, chunk):
                    self.verdict = Verdict.MET
                elif self._ends[at] == 0:
                    self.verdict = dry
        return self.verdict

    @property
    def reason(self) -> str:
        """Why the goal cannot be reached, where the floods prove that; else empty."""
        if self.verdict not in (Verdict.GOAL_ENCLOSED, Verdict.START_ENCLOSED):
            return ""
        is_goal = self.verdict is Verdict.GOAL_ENCLOSED
        where = "from outside to the goal" if is_goal else "out from the start"
        poses = int(self._ends[1] + self._ends[3])
        return f"the goal cannot be reached: obstacles leave no steps {where} ({poses} poses tried)"


@njit_arrays
def nodes_free(lattice: Lattice, nodes: Int64s) -> NDArray[np.bool_]:
    """`node_free` (n,) of nodes (n,)."""
    free = np.empty(len(nodes), np.bool_)
    for i in range(len(nodes)):
        free[i] = node_free(lattice, nodes[i])
    return free


@njit_no_refcount
def flood(
    lattice: Lattice,
    seen: NDArray[np.uint8],
    stack: NDArray[np.int32],
    steps: NDArray[np.int64],
    mine: int,
    ends: NDArray[np.int64],
    at: int,
    budget: int,
) -> bool:
    """Expands up to so many nodes of one flood; whether it met the other.

    stack: its nodes to expand; ends[at]: how many there are, ends[at + 1]: how many were reached.
    seen (nodes,): marks of both floods; nodes that bear its own mark, `mine`, are left alone.
    """
    top = ends[at]
    rows = 2 * lattice.headings
    other = 3 - mine
    uneven = len(lattice.node_um) > 0
    while top > 0 and budget > 0:
        # The newest first: its neighbours are still in the processor's cache.
        top, budget = top - 1, budget - 1
        node: int = np.int64(stack[top])  # type: ignore[assignment]
        row, cell = node % rows, node // rows
        half_base = cell // lattice.cols * 4 * lattice.cols + cell % lattice.cols * 2
        for k in range(steps.shape[1]):
            if steps[row, k, COST_UM] == 0:
                continue
            to = node + steps[row, k, D_NODE]
            mark = seen[to]
            if mark & mine or not node_free(lattice, to):
                continue
            half = half_base + steps[row, k, D_HALF]
            if not pair_known_free(lattice, half, steps[row, k, HALF_HEADING]):
                continue
            if uneven and not (
                step_climbs(lattice, node, to)
                if mine == FORWARD
                else step_climbs(lattice, to, node)
            ):
                continue
            if mark & other:
                return True
            seen[to] = mark | mine
            stack[top] = to
            top += 1
            ends[at + 1] += 1
    ends[at] = top
    return False
