"""Mending a kept search tree after a change of the map, compiled.

A node whose step from the one before it is no longer allowed, or costs more, is cut off with all
that hangs on it. What borders on the cut is open again, and so is what may lower others where
something became free: the search then finds the rest anew.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.jit import allocating, lean
from planner.lattice.lattice import COST_UM, D_NODE, Space, node_free
from planner.lattice.region import may_end_at
from planner.lattice.slots import slot_of
from planner.search.best_first import FROM_START, Tree
from planner.search.graft import step_um

Nodes = NDArray[np.int32]
_MARK = 255  # of `Tree.round`, which no round has


@allocating
def cut(space: Space, tree: Tree, cells: NDArray[np.int64]) -> Nodes:
    """Takes out of the tree what a change near some cells (n,) cuts off; the nodes taken out."""
    rows = 2 * space.headings
    removed = np.empty(1 << 10, np.int32)
    number = 0
    for i in range(len(cells)):
        for row in range(rows):
            node: int = cells[i] * rows + row
            slot = slot_of(tree.slots, node)
            known: int = np.int64(tree.cost_um[slot])  # type: ignore[assignment]
            if known == 0 or _stands(space, tree, node, known):
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


@lean
def _stands(space: Space, tree: Tree, node: int, known: int) -> bool:
    """Whether a node can still be reached from the one before it, and for no more.

    That one may have been cut off itself, and the node then follows it.
    """
    slot = slot_of(tree.slots, node)
    before: int = np.int64(tree.before[slot])  # type: ignore[assignment]
    if before == FROM_START:
        return may_end_at(space, node)
    cost_before_um = tree.cost_um[slot_of(tree.slots, before)]
    if cost_before_um == 0:
        return True
    cost = step_um(space, tree, before, node)
    return cost >= 0 and cost_before_um + cost <= known


@allocating
def border(
    space: Space,
    tree: Tree,
    removed: Nodes,
    cells: NDArray[np.int64],
) -> Nodes:
    """Known nodes (n,) from which steps may lead to removed ones, or lower others from some cells.

    Rounds must have been counted anew (see `graft.renew`).
    """
    rows, steps = 2 * space.headings, space.steps
    found = np.empty(1 << 10, np.int32)
    number = 0
    for i in range(len(removed)):
        node: int = np.int64(removed[i])  # type: ignore[assignment]
        if not node_free(space, node):
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
            if _may_lower(space, tree, node, tree.cost_um[slot]):
                tree.round[slot] = _MARK
                found = _with_room(found, number)
                found[number] = node
                number += 1
    for i in range(number):
        tree.round[slot_of(tree.slots, found[i])] = 0
    return found[:number]


@lean
def _may_lower(space: Space, tree: Tree, node: int, cost_um: int) -> bool:
    """Whether a step from a node would come to a free one that is not known, or is for less."""
    row = node % (2 * space.headings)
    for k in range(tree.steps.shape[1]):
        if tree.steps[row, k, COST_UM] == 0:
            continue
        to = node + tree.steps[row, k, D_NODE]
        old = np.int64(tree.cost_um[slot_of(tree.slots, to)])
        is_lower = old == 0 or cost_um + tree.steps[row, k, COST_UM] < old
        if is_lower and node_free(space, to):
            return True
    return False


@allocating
def _with_room(nodes: Nodes, used: int) -> Nodes:
    """The array, twice as long once it is full."""
    if used < len(nodes):
        return nodes
    return np.concatenate((nodes, np.empty_like(nodes)))
