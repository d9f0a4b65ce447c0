"""Mending a kept search tree after a change of the map, compiled.

A node whose step from the one before it is no longer allowed, or costs more, is cut off with all
that hangs on it. What borders on the cut is open again, and so is what may lower others where
something became free: the search then finds the rest anew.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.compiled import BITS, njit_arrays, njit_no_refcount, slot_of, take_slot
from planner.heuristics.heuristic import Heuristic, estimate
from planner.lattice.lattice import (
    COST_UM,
    D_HALF,
    D_NODE,
    HALF_HEADING,
    Lattice,
    clearance_cost,
    half_clearance,
    may_end_at,
    node_free,
    pair_known_free,
    step_climbs,
)
from planner.search import best_first as search
from planner.search.best_first import BUCKETS, FROM_START, NO_COST, Tree

# What is done to a kept search tree apart from searching, compiled.

_NOT_ALLOWED = -1


@njit_no_refcount
def find_best(tree: Tree) -> None:
    """Notes the goal of the tree that gives the cheapest plan, if the tree has come to any."""
    scalars = tree.scalars
    scalars[search.BEST_UM], scalars[search.BEST_NODE] = NO_COST, 0
    for i in range(len(tree.goals)):
        known = np.int64(tree.cost_um[slot_of(tree.slots, tree.goals[i])])
        if known != 0 and known + tree.goal_um[i] < scalars[search.BEST_UM]:
            scalars[search.BEST_UM] = known + tree.goal_um[i]
            scalars[search.BEST_NODE] = tree.goals[i]


@njit_no_refcount
def shift_um(lattice: Lattice, heuristic: Heuristic, tree: Tree) -> int:
    """By how much a heuristic must be lowered to hold for the first steps that are the goals."""
    shift = -NO_COST
    for i in range(len(tree.goals)):
        value = estimate(lattice, heuristic, tree.goals[i]) - tree.goal_um[i]
        shift = max(shift, value)
    return shift


@njit_no_refcount
def step_um(lattice: Lattice, tree: Tree, node: int, to: int) -> int:
    """Cost of the step of the tree that joins two nodes; below 0 where it is not allowed."""
    row, cell = node % (2 * lattice.headings), node // (2 * lattice.headings)
    steps = tree.steps
    for k in range(steps.shape[1]):
        if steps[row, k, COST_UM] == 0 or steps[row, k, D_NODE] != to - node:
            continue
        if not node_free(lattice, to):
            return _NOT_ALLOWED
        half = (
            cell // lattice.cols * 4 * lattice.cols
            + cell % lattice.cols * 2
            + steps[row, k, D_HALF]
        )
        if not pair_known_free(lattice, half, steps[row, k, HALF_HEADING]):
            return _NOT_ALLOWED
        if len(lattice.node_um) > 0:
            support, swing = (to, node) if tree.is_backward else (node, to)
            if not step_climbs(lattice, support, swing):
                return _NOT_ALLOWED
        extra = clearance_cost(lattice, half_clearance(lattice, half))
        return steps[row, k, COST_UM] + extra
    return _NOT_ALLOWED


@njit_no_refcount
def graft(lattice: Lattice, tree: Tree, nodes: NDArray[np.int64]) -> None:
    """Lowers the costs of a way's nodes (n,), in the order of the steps, to what it costs.

    Those that fall are open again.
    """
    for i in range(len(nodes) - 1, 0, -1):
        node, to = nodes[i], nodes[i - 1]
        cost = np.int64(tree.cost_um[slot_of(tree.slots, node)]) + step_um(lattice, tree, node, to)
        slot = take_slot(tree.slots, to)
        known = np.int64(tree.cost_um[slot])
        if known == 0 or cost < known:
            tree.cost_um[slot] = cost
            tree.before[slot] = node
            search.put(tree, to, BUCKETS)


@njit_arrays
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


@njit_no_refcount
def reopen(tree: Tree, nodes: NDArray[np.int32]) -> None:
    """Makes known nodes (n,) open; there must be room for them."""
    for i in range(len(nodes)):
        search.put(tree, nodes[i], BUCKETS)


Nodes = NDArray[np.int32]
_MARK = 255  # of `Tree.round`, which no round has


@njit_arrays
def cut(lattice: Lattice, tree: Tree, cells: NDArray[np.int64]) -> Nodes:
    """Takes out of the tree what a change near some cells (n,) cuts off; the nodes taken out."""
    rows = 2 * lattice.headings
    removed = np.empty(1 << 10, np.int32)
    number = 0
    for i in range(len(cells)):
        for row in range(rows):
            node: int = cells[i] * rows + row
            slot = slot_of(tree.slots, node)
            known: int = np.int64(tree.cost_um[slot])  # type: ignore[assignment]
            if known == 0 or _stands(lattice, tree, node, known):
                continue
            removed = _with_room(removed, number)
            removed[number] = node
            number += 1
            tree.cost_um[slot] = 0
    done = 0
    while done < number:
        node = np.int64(removed[done])  # type: ignore[assignment]
        done += 1
        row = node % rows
        for k in range(tree.steps.shape[1]):
            to = node + tree.steps[row, k, D_NODE]
            slot = slot_of(tree.slots, to)
            if tree.steps[row, k, COST_UM] == 0 or tree.cost_um[slot] == 0:
                continue
            if tree.before[slot] == node:
                removed = _with_room(removed, number)
                removed[number] = to
                number += 1
                tree.cost_um[slot] = 0
    return removed[:number]


@njit_no_refcount
def _stands(lattice: Lattice, tree: Tree, node: int, known: int) -> bool:
    """Whether a node can still be reached from the one before it, and for no more.

    That one may have been cut off itself, and the node then follows it.
    """
    slot = slot_of(tree.slots, node)
    before: int = np.int64(tree.before[slot])  # type: ignore[assignment]
    if before == FROM_START:
        return may_end_at(lattice, node)
    cost_before_um = tree.cost_um[slot_of(tree.slots, before)]
    if cost_before_um == 0:
        return True
    cost = step_um(lattice, tree, before, node)
    return cost >= 0 and cost_before_um + cost <= known


@njit_arrays
def border(
    lattice: Lattice,
    tree: Tree,
    removed: Nodes,
    cells: NDArray[np.int64],
) -> Nodes:
    """Known nodes (n,) from which steps may lead to removed ones, or lower others from some cells.

    Rounds must have been counted anew (see `graft.renew`).
    """
    rows, steps = 2 * lattice.headings, lattice.steps
    found = np.empty(1 << 10, np.int32)
    number = 0
    for i in range(len(removed)):
        node: int = np.int64(removed[i])  # type: ignore[assignment]
        if not node_free(lattice, node):
            continue
        row = node % rows
        # The tree grows from the goal, so the steps of the robot lead back in it.
        for k in range(steps.shape[1]):
            near = node + steps[row, k, D_NODE]
            slot = slot_of(tree.slots, near)
            if steps[row, k, COST_UM] == 0 or tree.cost_um[slot] == 0 or tree.round[slot] == _MARK:
                continue
            tree.round[slot] = _MARK
            found = _with_room(found, number)
            found[number] = near
            number += 1
    for i in range(len(cells)):
        for row in range(rows):
            node = cells[i] * rows + row
            slot = slot_of(tree.slots, node)
            if tree.cost_um[slot] == 0 or tree.round[slot] == _MARK:
                continue
            if _may_lower(lattice, tree, node, tree.cost_um[slot]):
                tree.round[slot] = _MARK
                found = _with_room(found, number)
                found[number] = node
                number += 1
    for i in range(number):
        tree.round[slot_of(tree.slots, found[i])] = 0
    return found[:number]


@njit_no_refcount
def _may_lower(lattice: Lattice, tree: Tree, node: int, cost_um: int) -> bool:
    """Whether a step from a node would come to a free one that is not known, or is for less."""
    row = node % (2 * lattice.headings)
    for k in range(tree.steps.shape[1]):
        if tree.steps[row, k, COST_UM] == 0:
            continue
        to = node + tree.steps[row, k, D_NODE]
        old = np.int64(tree.cost_um[slot_of(tree.slots, to)])
        is_lower = old == 0 or cost_um + tree.steps[row, k, COST_UM] < old
        if is_lower and node_free(lattice, to):
            return True
    return False


@njit_arrays
def _with_room(nodes: Nodes, used: int) -> Nodes:
    """The array, twice as long once it is full."""
    if used < len(nodes):
        return nodes
    return np.concatenate((nodes, np.empty_like(nodes)))
