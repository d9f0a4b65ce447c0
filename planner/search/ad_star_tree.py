"""Edits of the AD* search tree: add a path, reopen nodes, repair it after a map change. Compiled.

A map change invalidates edges of the tree: a node whose edge is no longer allowed, or costs more,
is removed with its whole subtree. Neighbours of removed nodes are reopened, and so are nodes that
may lower others where cells became free; the search then finds the rest anew.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.compiled import (
    BITS,
    njit_arrays,
    njit_inner,
    njit_inner_arrays,
    njit_no_refcount,
    slot_of,
    take_slot,
    with_room,
)
from planner.heuristics.heuristic import Heuristic, estimate
from planner.lattice.goal_region import may_end_at
from planner.lattice.lattice import (
    COST_UM,
    D_HALF,
    D_NODE,
    HALF_HEADING,
    Int64s,
    Lattice,
    clearance_cost,
    half_clearance,
    node_free,
    pair_known_free,
    step_climbs,
)
from planner.search.best_first import (
    BEST_NODE,
    BEST_UM,
    BUCKETS,
    CURSOR,
    INCONS,
    ITERATION,
    NO_COST,
    ROOT,
    SPARE,
    USED,
    Tree,
    push_entry,
)

Nodes = NDArray[np.int32]
_MARK = 255  # of `Tree.closed_in`: no iteration has this number
_NOT_ALLOWED = -1
_with_room = njit_inner_arrays(with_room)


@njit_arrays
def costs_of(tree: Tree, nodes: Int64s) -> Int64s:
    """Cost of nodes (n,) from the roots in micrometres, 0 where unreached."""
    costs_um = np.empty(len(nodes), np.int64)
    for i in range(len(nodes)):
        costs_um[i] = tree.cost_um[slot_of(tree.slots, nodes[i])]
    return costs_um


@njit_no_refcount
def find_best_goal(tree: Tree) -> None:
    """Notes the cost and last node of the cheapest plan in the tree, if it has reached a goal."""
    scalars = tree.scalars
    scalars[BEST_UM], scalars[BEST_NODE] = NO_COST, 0
    for i in range(len(tree.goals)):
        known = np.int64(tree.cost_um[slot_of(tree.slots, tree.goals[i])])
        if known != 0 and known + tree.goal_um[i] < scalars[BEST_UM]:
            scalars[BEST_UM] = known + tree.goal_um[i]
            scalars[BEST_NODE] = tree.goals[i]


@njit_no_refcount
def heuristic_shift_um(lattice: Lattice, heuristic: Heuristic, tree: Tree) -> int:
    """By how much a heuristic must be lowered to hold for the goals, which are first steps."""
    shift = -NO_COST
    for i in range(len(tree.goals)):
        value = estimate(lattice, heuristic, tree.goals[i]) - tree.goal_um[i]
        shift = max(shift, value)
    return shift


@njit_inner
def edge_cost_um(lattice: Lattice, tree: Tree, node: int, to: int) -> int:
    """Cost of the tree's edge between two nodes; below 0 where it is not allowed."""
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
def add_path(lattice: Lattice, tree: Tree, nodes: NDArray[np.int64]) -> None:
    """Lowers the costs of a path's nodes (n,), in the order of its steps, to those along it.

    Nodes whose cost falls are reopened.
    """
    for i in range(len(nodes) - 1, 0, -1):
        node, to = nodes[i], nodes[i - 1]
        cost = np.int64(tree.cost_um[slot_of(tree.slots, node)]) + edge_cost_um(
            lattice, tree, node, to
        )
        slot = take_slot(tree.slots, to)
        known = np.int64(tree.cost_um[slot])
        if known == 0 or cost < known:
            tree.cost_um[slot] = cost
            tree.parent[slot] = node
            push_entry(tree, to, INCONS)


@njit_arrays
def reset_iterations(tree: Tree) -> None:
    """Numbers iterations from 0 again, and drops queue entries of closed or unreached nodes."""
    scalars, head = tree.scalars, tree.head
    done = np.uint8(scalars[ITERATION])
    kept = np.empty(scalars[USED], np.int32)
    number = 0
    for bucket in range(BUCKETS + 1):
        entry = head[bucket]
        head[bucket] = -1
        while entry >= 0:
            node = tree.entry_node[entry]
            entry = tree.entry_next[entry]
            slot = slot_of(tree.slots, node)
            closed = bucket < BUCKETS and tree.closed_in[slot] == done
            if not closed and tree.cost_um[slot] != 0:
                kept[number] = node
                number += 1
    tree.closed_in[: tree.slots.used[0] + 1 << BITS] = 0
    scalars[ITERATION] = 0
    scalars[USED] = scalars[SPARE] = 0
    scalars[CURSOR] = BUCKETS
    for i in range(number):
        slot = slot_of(tree.slots, kept[i])
        if tree.closed_in[slot] == 0:
            tree.closed_in[slot] = 1
            push_entry(tree, kept[i], INCONS)
    for i in range(number):
        tree.closed_in[slot_of(tree.slots, kept[i])] = 0


@njit_no_refcount
def reopen(tree: Tree, nodes: NDArray[np.int32]) -> None:
    """Opens nodes (n,) of the tree; the queue must have room for them."""
    for i in range(len(nodes)):
        push_entry(tree, nodes[i], INCONS)


@njit_arrays
def remove_invalid(lattice: Lattice, tree: Tree, cells: NDArray[np.int64]) -> Nodes:
    """Removes nodes in cells (n,) whose edge is invalid, with their subtrees; the removed nodes."""
    rows = 2 * lattice.headings
    removed = np.empty(1 << 10, np.int32)
    number = 0
    for i in range(len(cells)):
        for row in range(rows):
            node: int = cells[i] * rows + row
            slot = slot_of(tree.slots, node)
            known: int = np.int64(tree.cost_um[slot])  # type: ignore[assignment]
            if known == 0 or _is_still_reached(lattice, tree, node, known):
                continue
            removed = _with_room(removed, number, 1)
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
            if tree.parent[slot] == node:
                removed = _with_room(removed, number, 1)
                removed[number] = to
                number += 1
                tree.cost_um[slot] = 0
    return removed[:number]


@njit_inner
def _is_still_reached(lattice: Lattice, tree: Tree, node: int, known: int) -> bool:
    """Whether the edge to a node is still allowed and costs no more.

    True if its parent has been removed: the node then is removed as a part of that subtree.
    """
    slot = slot_of(tree.slots, node)
    before: int = np.int64(tree.parent[slot])  # type: ignore[assignment]
    if before == ROOT:
        return may_end_at(lattice, node)
    cost_before_um = tree.cost_um[slot_of(tree.slots, before)]
    if cost_before_um == 0:
        return True
    cost = edge_cost_um(lattice, tree, before, node)
    return cost >= 0 and cost_before_um + cost <= known


@njit_arrays
def nodes_to_reopen(
    lattice: Lattice,
    tree: Tree,
    removed: Nodes,
    cells: NDArray[np.int64],
) -> Nodes:
    """Nodes (n,) of the tree with an edge to a removed one; in cells (m,), with one that lowers.

    Iterations must have been reset.
    """
    rows, steps = 2 * lattice.headings, lattice.steps
    found = np.empty(1 << 10, np.int32)
    number = 0
    for i in range(len(removed)):
        node: int = np.int64(removed[i])  # type: ignore[assignment]
        if not node_free(lattice, node):
            continue
        row = node % rows
        # The tree grows from the goal, so the steps of the robot lead toward its roots.
        for k in range(steps.shape[1]):
            near = node + steps[row, k, D_NODE]
            slot = slot_of(tree.slots, near)
            if (
                steps[row, k, COST_UM] == 0
                or tree.cost_um[slot] == 0
                or tree.closed_in[slot] == _MARK
            ):
                continue
            tree.closed_in[slot] = _MARK
            found = _with_room(found, number, 1)
            found[number] = near
            number += 1
    for i in range(len(cells)):
        for row in range(rows):
            node = cells[i] * rows + row
            slot = slot_of(tree.slots, node)
            if tree.cost_um[slot] == 0 or tree.closed_in[slot] == _MARK:
                continue
            if _can_lower_successor(lattice, tree, node, tree.cost_um[slot]):
                tree.closed_in[slot] = _MARK
                found = _with_room(found, number, 1)
                found[number] = node
                number += 1
    for i in range(number):
        tree.closed_in[slot_of(tree.slots, found[i])] = 0
    return found[:number]


@njit_inner
def _can_lower_successor(lattice: Lattice, tree: Tree, node: int, cost_um: int) -> bool:
    """Whether an edge from a node would reach a free one that is unreached or costs more."""
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
