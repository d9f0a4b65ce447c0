"""Where what is known of a node is kept: in the order in which searches come to the nodes.

A search comes to few nodes of a lattice, here and there. In arrays over all of them nearly each
would take a page of memory of its own, and the time to clear it. So a block of nodes gets its slots
when it is first come to, next to those of the block before.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.jit import allocating, lean
from planner.lattice.pages import zeros

BITS = 7
LOW = (1 << BITS) - 1


class Slots(NamedTuple):
    """Slots of all nodes of a lattice that were come to; arrays of so many are `length` long.

    of_block (blocks,): number of the slots of each block of 128 nodes, 0 for none: slots that are
    never written to. used (1,): how many blocks have any.
    """

    of_block: NDArray[np.int32]
    used: NDArray[np.int64]

    @property
    def length(self) -> int:
        """How many slots there may be."""
        return (len(self.of_block) + 1) << BITS


def slots_for(nodes: int) -> Slots:
    """Slots for nodes that are numbered from 0, none in use."""
    return Slots(zeros((nodes >> BITS) + 1, np.int32), np.zeros(1, np.int64))


@lean
def slot_of(slots: Slots, node: int) -> int:
    """The slot of a node; one in which nothing is known if it has none."""
    block: int = np.int64(slots.of_block[node >> BITS])  # type: ignore[assignment]
    return block << BITS | node & LOW


@lean
def take_slot(slots: Slots, node: int) -> int:
    """The slot of a node, which it gets if it has none."""
    block: int = np.int64(slots.of_block[node >> BITS])  # type: ignore[assignment]
    if block == 0:
        block = next_block(slots.of_block, slots.used, node)
    return block << BITS | node & LOW


@lean
def next_block(of_block: NDArray[np.int32], used: NDArray[np.int64], node: int) -> int:
    """The number of new slots for the block of a node."""
    used[0] += 1
    of_block[node >> BITS] = used[0]
    return used[0]


@allocating
def slots_of(slots: Slots, nodes: NDArray[np.int64]) -> NDArray[np.int64]:
    """`slot_of` nodes (n,)."""
    found = np.empty(len(nodes), np.int64)
    for i in range(len(nodes)):
        found[i] = slot_of(slots, nodes[i])
    return found
