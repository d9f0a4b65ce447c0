"""Whether any steps at all lead from the start to the goal: two floods of the lattice that meet.

A* expands the states near the best way first, so it proves that there is no way only after it
expanded every reachable state. A flood notes only whether a state was reached, not at what cost.
One goes forward from the first steps and one backward from the goal feet, in turns, so the smaller
enclosed side is exhausted first. Each expands its newest state first, so that they soon meet where
there is a way. Both use the steps and checks of the search, so the verdict is exact.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.compiled import njit_no_refcount, with_room, zeros
from planner.lattice.lattice import (
    COST_UM,
    D_HALF,
    D_NODE,
    HALF_HEADING,
    Lattice,
    node_free,
    pair_known_free,
    step_climbs,
    turned_round,
)

FORWARD, BACKWARD = 1, 2
_CHUNK = 1 << 12  # nodes of one flood before it is the other's turn


class Verdict(IntEnum):
    """Result of two floods: open, they met, or which of them was exhausted before."""

    OPEN = 0
    MET = 1
    GOAL_ENCLOSED = 2
    START_ENCLOSED = 3

    @property
    def is_enclosed(self) -> bool:
        """Whether there is no way."""
        return self in (Verdict.GOAL_ENCLOSED, Verdict.START_ENCLOSED)


class Flood(NamedTuple):
    """State of the two floods, kept between calls of `expand_both`.

    seen (nodes,): FORWARD or BACKWARD where a flood has reached, 0 elsewhere. back_steps:
    `Lattice.steps` reversed. forward, backward: stacks of nodes to expand. ends (4,): for each of
    the two, how many are on the stack and how many were reached in all.
    """

    seen: NDArray[np.uint8]
    back_steps: NDArray[np.int64]
    forward: NDArray[np.int32]
    backward: NDArray[np.int32]
    ends: NDArray[np.int64]


def why_enclosed(verdict: Verdict, flood: Flood) -> str:
    """Why the goal cannot be reached, where floods proved that."""
    is_goal = verdict is Verdict.GOAL_ENCLOSED
    where = "from outside to the goal" if is_goal else "out from the start"
    poses = int(flood.ends[1] + flood.ends[3])
    return f"the goal cannot be reached: obstacles leave no steps {where} ({poses} poses tried)"


def new_flood(lattice: Lattice, seeds: NDArray[np.int64], goals: NDArray[np.int64]) -> Flood:
    """Floods from the first steps (n,) and from the goal's nodes (m,), nothing expanded."""
    seen = zeros(lattice.cols * lattice.rows * lattice.headings * 2, np.uint8)
    forward = np.unique(seeds).astype(np.int32)
    backward = np.array([goal for goal in goals if node_free(lattice, int(goal))], np.int32)
    seen[forward] = FORWARD
    seen[backward] |= BACKWARD
    return Flood(
        seen=seen,
        back_steps=turned_round(lattice.steps),
        forward=with_room(forward, len(forward), lattice.steps.shape[1]),
        backward=with_room(backward, len(backward), lattice.steps.shape[1]),
        ends=np.array([len(forward), len(forward), len(backward), len(backward)]),
    )


def expand_both(lattice: Lattice, flood: Flood, budget: int) -> tuple[Flood, Verdict]:
    """Expands so many nodes of each flood; the floods and a verdict."""
    if np.any(flood.seen[flood.backward[: min(2, int(flood.ends[2]))]] == FORWARD | BACKWARD):
        return flood, Verdict.MET
    for done in range(0, budget, _CHUNK):
        chunk = min(_CHUNK, budget - done)
        most = chunk * lattice.steps.shape[1]
        flood = flood._replace(
            forward=with_room(flood.forward, int(flood.ends[0]), most),
            backward=with_room(flood.backward, int(flood.ends[2]), most),
        )
        for stack, steps, mine, at, dry in (
            (flood.backward, flood.back_steps, BACKWARD, 2, Verdict.GOAL_ENCLOSED),
            (flood.forward, lattice.steps, FORWARD, 0, Verdict.START_ENCLOSED),
        ):
            if _expand(lattice, flood.seen, stack, steps, mine, flood.ends, at, chunk):
                return flood, Verdict.MET
            if flood.ends[at] == 0:
                return flood, dry
    return flood, Verdict.OPEN


@njit_no_refcount
def _expand(
    lattice: Lattice,
    seen: NDArray[np.uint8],
    stack: NDArray[np.int32],
    steps: NDArray[np.int64],
    mine: int,
    ends: NDArray[np.int64],
    at: int,
    budget: int,
) -> bool:
    """Expands up to so many nodes of one flood; whether it met the other."""
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
