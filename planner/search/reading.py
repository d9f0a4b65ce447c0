"""What is read from a search tree, compiled."""

from __future__ import annotations

import numpy as np

from planner.jit import allocating
from planner.lattice.lattice import Int64s, Space
from planner.lattice.slots import LOW, slot_of
from planner.search.best_first import FROM_START, Tree


@allocating
def trace(tree: Tree, node: int) -> Int64s:
    """Nodes (n,) from a root to a node, both included."""
    number = 0
    here: int = node
    while here != FROM_START:
        number += 1
        here = np.int64(tree.before[slot_of(tree.slots, here)])  # type: ignore[assignment]
    path = np.empty(number, np.int64)
    here = node
    while number > 0:
        number -= 1
        path[number] = here
        here = np.int64(tree.before[slot_of(tree.slots, here)])  # type: ignore[assignment]
    return path


@allocating
def costs_of(tree: Tree, nodes: Int64s) -> Int64s:
    """Costs of nodes (n,) in micrometres, 0 where none is known."""
    costs_um = np.empty(len(nodes), np.int64)
    for i in range(len(nodes)):
        costs_um[i] = tree.cost_um[slot_of(tree.slots, nodes[i])]
    return costs_um


@allocating
def expanded_in_cells(space: Space, tree: Tree) -> Int64s:
    """How many nodes were expanded in each of the lattice's cells (rows * cols,)."""
    done = np.zeros(space.cols * space.rows, np.int64)
    of_block, rows = tree.slots.of_block, 2 * space.headings
    for node in range(len(done) * rows):
        if of_block[node // (LOW + 1)] and tree.round[slot_of(tree.slots, node)]:
            done[node // rows] += 1
    return done
