"""Whether any steps at all lead from the start to the goal: two floods of the lattice that meet.

A* looks at the states near the best way first, so it learns that there is no way only when it has
seen every pose the robot can come to. A flood asks less of each state: whether it was reached, not
at what cost. One flood goes forward from the first steps and one backward from the goal feet, in
turns, so the smaller enclosed side is exhausted first and a goal in a pocket costs little more
than the pocket. Each goes on from its newest state, so that they soon meet where there is a way.
Both follow the very steps and checks of the search, so neither verdict is a guess.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.compiled import njit_no_refcount, zeros
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


class Verdict(IntEnum):
    """What two floods know: nothing yet, that they met, or which of them ran dry before."""

    OPEN = 0
    MET = 1
    GOAL_ENCLOSED = 2
    START_ENCLOSED = 3


class Flood(NamedTuple):
    """State of the two floods, kept between calls of `spread`.

    seen (nodes,): FORWARD or BACKWARD where a flood has come, 0 elsewhere. back_steps: the steps
    that end in a row, as `Lattice.steps` has those that begin in it. forward, backward: stacks of
    the nodes that have yet to go on. ends (4,): for each of the two, how many are on the stack and
    how many were ever come to.
    """

    seen: NDArray[np.uint8]
    back_steps: NDArray[np.int64]
    forward: NDArray[np.int32]
    backward: NDArray[np.int32]
    ends: NDArray[np.int64]


def new_flood(lattice: Lattice, seeds: NDArray[np.int64], goals: NDArray[np.int64]) -> Flood:
    """Floods from the first steps (n,) and from the goal's nodes (2,), neither gone on yet."""
    seen = zeros(lattice.cols * lattice.rows * lattice.headings * 2, np.uint8)
    forward = np.unique(seeds).astype(np.int32)
    backward = np.array([goal for goal in goals if node_free(lattice, int(goal))], np.int32)
    seen[forward] = FORWARD
    seen[backward] |= BACKWARD
    return Flood(
        seen=seen,
        back_steps=turned_round(lattice.steps),
        forward=_with_room(forward, lattice.steps.shape[1]),
        backward=_with_room(backward, lattice.steps.shape[1]),
        ends=np.array([len(forward), len(forward), len(backward), len(backward)]),
    )


def spread(lattice: Lattice, flood: Flood, budget: int) -> tuple[Flood, Verdict]:
    """Lets each flood go on from as many nodes as the budget says; the flood and a verdict."""
    if np.any(flood.seen[flood.backward[: min(2, int(flood.ends[2]))]] == FORWARD | BACKWARD):
        return flood, Verdict.MET
    for done in range(0, budget, _CHUNK):
        chunk = min(_CHUNK, budget - done)
        most = chunk * lattice.steps.shape[1]
        flood = flood._replace(
            forward=_with_room(flood.forward, most, int(flood.ends[0])),
            backward=_with_room(flood.backward, most, int(flood.ends[2])),
        )
        for stack, steps, mine, at, dry in (
            (flood.backward, flood.back_steps, BACKWARD, 2, Verdict.GOAL_ENCLOSED),
            (flood.forward, lattice.steps, FORWARD, 0, Verdict.START_ENCLOSED),
        ):
            if _go_on(lattice, flood.seen, stack, steps, mine, flood.ends, at, chunk):
                return flood, Verdict.MET
            if flood.ends[at] == 0:
                return flood, dry
    return flood, Verdict.OPEN


_CHUNK = 1 << 12


def _with_room(stack: NDArray[np.int32], room: int, used: int | None = None) -> NDArray[np.int32]:
    """The stack, copied to a longer one if there is not room for so many more."""
    used = len(stack) if used is None else used
    if len(stack) >= used + room:
        return stack
    longer = np.empty(2 * (used + room), np.int32)
    longer[:used] = stack[:used]
    return longer


@njit_no_refcount
def _go_on(
    lattice: Lattice,
    seen: NDArray[np.uint8],
    stack: NDArray[np.int32],
    steps: NDArray[np.int64],
    mine: int,
    ends: NDArray[np.int64],
    at: int,
    budget: int,
) -> bool:
    """Goes on from up to so many nodes of one flood; whether it met the other."""
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
