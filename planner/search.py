"""Anytime weighted A* (ARA*) over the footstep lattice, compiled.

After Likhachev, Gordon and Thrun, "ARA*: Anytime A* with Provable Bounds on Sub-Optimality", 2003:
searches with a falling weight epsilon on the heuristic, each going on from the costs that the ones
before found. A state whose cost falls after it was expanded waits for the next search (INCONS).

A state is the node of the foot that was placed last. OPEN is a row of buckets of equal width in f,
each a stack. A bucket holds states in any order, but a search ends only when the lower edge of the
first bucket in use is not below the cost of the plan, so bounds are exact.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planner.space import (
    Space,
    clearance_cost,
    half_clearance,
    node_free,
    pair_free,
)

BUCKETS = 1 << 13
FROM_START = 0  # node 0 lies on the rim, so it never is a predecessor

# Entries of Tree.scalars
USED, CURSOR, EXPANSIONS, BEST_UM, BEST_NODE, BASE_UM, SHIFT, ROUND, LEAST_UM = range(9)
SCALARS = 9

# What `expand` returns
EXHAUSTED, FINISHED, IMPROVED, OUT_OF_BUDGET, OUT_OF_ENTRIES = range(5)
NO_COST = 1 << 40


class Heuristic(NamedTuple):
    """The heuristic as the search reads it: see `guide.py`."""

    cost_um: NDArray[np.int32]
    frontier_um: int
    body_cell: NDArray[np.int64]
    potential_um: NDArray[np.int64]


class Tree(NamedTuple):
    """State of a search, kept between calls of `expand`.

    cost_um (nodes,): cost from the start, 0 where none is known. before (nodes,): the node stepped
    from, FROM_START for a first step. round (nodes,): number of the search that
    expanded the node. entry_node, entry_next: stacks of the buckets; head (BUCKETS + 1,): first
    entry of each, the last for INCONS. goals (2,): nodes of the goal's feet.
    """

    cost_um: NDArray[np.int32]
    before: NDArray[np.int32]
    round: NDArray[np.uint8]
    entry_node: NDArray[np.int32]
    entry_next: NDArray[np.int32]
    head: NDArray[np.int32]
    goals: NDArray[np.int64]
    final_um: int
    scalars: NDArray[np.int64]


@njit(cache=True)
def estimate(space: Space, heuristic: Heuristic, node: int) -> int:
    """Cost in micrometres that no way from a node to the end of a plan falls below."""
    row = (node >> 1) % space.headings * 2 + (node & 1)
    cell = (node >> 1) // space.headings + heuristic.body_cell[row]
    path = heuristic.cost_um[cell]
    if path <= 0 or path - 1 > heuristic.frontier_um:
        path = heuristic.frontier_um + 1
    return max(path - 1 + heuristic.potential_um[row], 0)


@njit(cache=True)
def _push(tree: Tree, node: int, key_um: int) -> None:
    scalars = tree.scalars
    bucket = (key_um - scalars[BASE_UM]) >> scalars[SHIFT]
    bucket = min(max(bucket, 0), BUCKETS - 1)
    scalars[CURSOR] = min(scalars[CURSOR], bucket)
    _put(tree, node, bucket)


@njit(cache=True)
def _put(tree: Tree, node: int, bucket: int) -> None:
    entry = tree.scalars[USED]
    tree.entry_node[entry] = node
    tree.entry_next[entry] = tree.head[bucket]
    tree.head[bucket] = entry
    tree.scalars[USED] = entry + 1


@njit(cache=True)
def seed(
    space: Space,
    heuristic: Heuristic,
    tree: Tree,
    nodes: NDArray[np.int64],
    costs_um: NDArray[np.int64],
) -> None:
    """Puts the first steps (n,) into the tree, to be taken up by `begin_round`."""
    for i in range(len(nodes)):
        node, cost = nodes[i], costs_um[i]
        old = tree.cost_um[node]
        if old == 0 or cost < old:
            tree.cost_um[node] = cost
            tree.before[node] = FROM_START
            _put(tree, node, BUCKETS)
            _offer(tree, node, cost)


@njit(cache=True)
def _offer(tree: Tree, node: int, cost_um: int) -> bool:
    """Takes the node for the last but one of the plan if it is a goal foot and the best so far."""
    scalars = tree.scalars
    if (node == tree.goals[0] or node == tree.goals[1]) and (
        cost_um + tree.final_um < scalars[BEST_UM]
    ):
        scalars[BEST_UM] = cost_um + tree.final_um
        scalars[BEST_NODE] = node
        return True
    return False


@njit(cache=True)
def begin_round(space: Space, heuristic: Heuristic, tree: Tree, epsilon: float) -> int:
    """Moves OPEN and INCONS into fresh buckets for a weight epsilon.

    Returns the least g + h of any open state: no plan that is still to be found costs less.
    """
    scalars = tree.scalars
    scalars[ROUND] += 1
    queued = 128 + scalars[ROUND]
    nodes = np.empty(scalars[USED], np.int64)
    number = 0
    for bucket in range(BUCKETS + 1):
        entry = tree.head[bucket]
        tree.head[bucket] = -1
        while entry >= 0:
            node = tree.entry_node[entry]
            entry = tree.entry_next[entry]
            stale = bucket < BUCKETS and tree.round[node] == scalars[ROUND] - 1
            if stale or tree.round[node] == queued:
                continue
            if tree.cost_um[node] + estimate(space, heuristic, node) >= scalars[BEST_UM]:
                continue
            tree.round[node] = queued
            nodes[number] = node
            number += 1
    scalars[USED] = 0
    scalars[CURSOR] = BUCKETS
    least, low, high = NO_COST, NO_COST, 0
    for i in range(number):
        value = estimate(space, heuristic, nodes[i])
        cost = tree.cost_um[nodes[i]]
        least = min(least, cost + value)
        low = min(low, cost + int(epsilon * value))
        high = max(high, cost + int(epsilon * value))
    # Inflated keys fall on the way to the goal; with epsilon 1 they never do.
    scalars[BASE_UM] = low if epsilon == 1.0 else 0
    span = min(scalars[BEST_UM], high + 8_000_000) - scalars[BASE_UM]
    scalars[SHIFT] = 0
    while (span >> scalars[SHIFT]) >= BUCKETS - 1:
        scalars[SHIFT] += 1
    for i in range(number - 1, -1, -1):
        value = estimate(space, heuristic, nodes[i])
        _push(tree, nodes[i], tree.cost_um[nodes[i]] + int(epsilon * value))
    return least


@njit(cache=True)
def expand(space: Space, heuristic: Heuristic, tree: Tree, epsilon: float, budget: int) -> int:
    """Expands states until this round's search is over, the plan improves or budget is spent."""
    scalars = tree.scalars
    steps = space.steps
    most = steps.cost_um.shape[1]
    limit = scalars[EXPANSIONS] + budget
    room = len(tree.entry_node) - most - 1
    while True:
        while scalars[CURSOR] < BUCKETS and tree.head[scalars[CURSOR]] < 0:
            scalars[CURSOR] += 1
        if scalars[CURSOR] == BUCKETS:
            return EXHAUSTED
        if scalars[BASE_UM] + (scalars[CURSOR] << scalars[SHIFT]) >= scalars[BEST_UM]:
            return FINISHED
        if scalars[EXPANSIONS] >= limit:
            return OUT_OF_BUDGET
        if scalars[USED] > room:
            return OUT_OF_ENTRIES
        entry = tree.head[scalars[CURSOR]]
        node = tree.entry_node[entry]
        tree.head[scalars[CURSOR]] = tree.entry_next[entry]
        if tree.round[node] == scalars[ROUND]:
            continue
        tree.round[node] = scalars[ROUND]
        scalars[EXPANSIONS] += 1
        if _expand_node(space, heuristic, tree, epsilon, node):
            return IMPROVED


@njit(cache=True)
def _expand_node(space: Space, heuristic: Heuristic, tree: Tree, epsilon: float, node: int) -> bool:
    """Relaxes all steps from a node; whether a better plan came of it."""
    scalars, steps = tree.scalars, space.steps
    here = tree.cost_um[node]
    row = (node >> 1) % space.headings * 2 + (node & 1)
    cell = (node >> 1) // space.headings
    half_base = cell // space.cols * 4 * space.cols + cell % space.cols * 2
    improved = False
    for k in range(steps.cost_um.shape[1]):
        to = node + steps.d_node[row, k]
        cost = here + steps.cost_um[row, k]
        if cost == here:
            continue
        old = tree.cost_um[to]
        if (old != 0 and cost >= old) or not node_free(space, to):
            continue
        half = half_base + steps.d_half[row, k]
        clearance_m = half_clearance(space, half)
        if not pair_free(space, half, steps.half_heading[row, k], clearance_m):
            continue
        cost += clearance_cost(space, clearance_m)
        if old != 0 and cost >= old:
            continue
        value = estimate(space, heuristic, to)
        if cost + value >= scalars[BEST_UM]:
            continue
        tree.cost_um[to] = cost
        tree.before[to] = node
        improved |= _offer(tree, to, cost)
        if tree.round[to] != scalars[ROUND]:
            _push(tree, to, cost + int(epsilon * value))
        elif epsilon == 1.0:
            tree.round[to] = 0
            _push(tree, to, cost + value)
        else:
            _put(tree, to, BUCKETS)
    return improved


def trace(tree: Tree, node: int) -> list[int]:
    """Nodes of the plan that ends in a node, in the order of the steps."""
    path = [node]
    while tree.before[path[-1]] != FROM_START:
        path.append(int(tree.before[path[-1]]))
    return path[::-1]
