"""What is done to a kept search tree apart from searching, compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.heuristics.heuristic import Heuristic, estimate
from planner.jit import allocating, lean
from planner.lattice.lattice import (
    COST_UM,
    D_HALF,
    D_NODE,
    HALF_HEADING,
    Space,
    clearance_cost,
    half_clearance,
    node_free,
    pair_known_free,
)
from planner.lattice.rise import step_climbs
from planner.lattice.slots import BITS, slot_of, take_slot
from planner.search import best_first as search
from planner.search.best_first import BUCKETS, NO_COST, Tree

_NOT_ALLOWED = -1


@lean
def find_best(tree: Tree) -> None:
    """Notes the goal of the tree that gives the cheapest plan, if the tree has come to any."""
    scalars = tree.scalars
    scalars[search.BEST_UM], scalars[search.BEST_NODE] = NO_COST, 0
    for i in range(len(tree.goals)):
        known = np.int64(tree.cost_um[slot_of(tree.slots, tree.goals[i])])
        if known != 0 and known + tree.goal_um[i] < scalars[search.BEST_UM]:
            scalars[search.BEST_UM] = known + tree.goal_um[i]
            scalars[search.BEST_NODE] = tree.goals[i]


@lean
def shift_um(space: Space, heuristic: Heuristic, tree: Tree) -> int:
    """By how much a heuristic must be lowered to hold for the first steps that are the goals."""
    shift = -NO_COST
    for i in range(len(tree.goals)):
        value = estimate(space, heuristic, tree.goals[i]) - tree.goal_um[i]
        shift = max(shift, value)
    return shift


@lean
def step_um(space: Space, tree: Tree, node: int, to: int) -> int:
    """Cost of the step of the tree that joins two nodes; below 0 where it is not allowed."""
    row, cell = node % (2 * space.headings), node // (2 * space.headings)
    steps = tree.steps
    for k in range(steps.shape[1]):
        if steps[row, k, COST_UM] == 0 or steps[row, k, D_NODE] != to - node:
            continue
        if not node_free(space, to):
            return _NOT_ALLOWED
        half = cell // space.cols * 4 * space.cols + cell % space.cols * 2 + steps[row, k, D_HALF]
        if not pair_known_free(space, half, steps[row, k, HALF_HEADING]):
            return _NOT_ALLOWED
        if len(space.node_um) > 0:
            support, swing = (to, node) if tree.is_backward else (node, to)
            if not step_climbs(space, support, swing):
                return _NOT_ALLOWED
        extra = clearance_cost(space, half_clearance(space, half))
        return steps[row, k, COST_UM] + extra
    return _NOT_ALLOWED


@lean
def graft(space: Space, tree: Tree, nodes: NDArray[np.int64]) -> None:
    """Lowers the costs of a way's nodes (n,), in the order of the steps, to what it costs.

    Those that fall are open again.
    """
    for i in range(len(nodes) - 1, 0, -1):
        node, to = nodes[i], nodes[i - 1]
        cost = np.int64(tree.cost_um[slot_of(tree.slots, node)]) + step_um(space, tree, node, to)
        slot = take_slot(tree.slots, to)
        known = np.int64(tree.cost_um[slot])
        if known == 0 or cost < known:
            tree.cost_um[slot] = cost
            tree.before[slot] = node
            search.put(tree, to, BUCKETS)


@allocating
def renew(tree: Tree) -> None:
    """Counts rounds from 0 again, and drops entries of nodes that are not open or not known."""
    scalars, head = tree.scalars, tree.head
    done = np.uint8(scalars[search.ROUND])
    kept = np.empty(scalars[search.USED], np.int32)
    number = 0
    for bucket in range(BUCKETS + 1):
        entry = head[bucket]
        head[bucket] = -1
        while entry >= 0:
            node = tree.entry_node[entry]
            entry = tree.entry_next[entry]
            slot = slot_of(tree.slots, node)
            closed = bucket < BUCKETS and tree.round[slot] == done
            if not closed and tree.cost_um[slot] != 0:
                kept[number] = node
                number += 1
    tree.round[: tree.slots.used[0] + 1 << BITS] = 0
    scalars[search.ROUND] = 0
    scalars[search.USED] = scalars[search.SPARE] = 0
    scalars[search.CURSOR] = BUCKETS
    for i in range(number):
        slot = slot_of(tree.slots, kept[i])
        if tree.round[slot] == 0:
            tree.round[slot] = 1
            search.put(tree, kept[i], BUCKETS)
    for i in range(number):
        tree.round[slot_of(tree.slots, kept[i])] = 0


@lean
def reopen(tree: Tree, nodes: NDArray[np.int32]) -> None:
    """Makes known nodes (n,) open; there must be room for them."""
    for i in range(len(nodes)):
        search.put(tree, nodes[i], BUCKETS)
