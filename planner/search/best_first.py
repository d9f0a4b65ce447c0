"""Best-first search over the footstep lattice: open list and expansion of states, compiled.

`expand` is ImprovePath of ARA* (Likhachev, Gordon and Thrun, "ARA*: Anytime A* with Provable Bounds
on Sub-Optimality", 2003): a search with a weight epsilon on the heuristic that continues from the
costs of the iterations before it. A state whose cost falls after its expansion waits in INCONS for
the next iteration. The search goes from the start to the goal or, with reversed steps, the other
way.

A state is the node of the foot that was placed last. OPEN is a row of buckets of equal width in f,
each a stack. A bucket holds states in any order, but an iteration ends only when the lower edge of
the first bucket in use is not below the cost of the plan, so bounds are exact.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.collision import clearance_at, radius_of
from planner.compiled import (
    BITS,
    LOW,
    Slots,
    first_not_below,
    next_block,
    njit_arrays,
    njit_inner,
    njit_inner_arrays,
    njit_no_refcount,
    slot_of,
    take_slot,
)
from planner.heuristics.heuristic import Heuristic, estimate
from planner.heuristics.turning import exit_bound
from planner.lattice.lattice import (
    BLOCKED,
    COST_UM,
    D_CELL,
    D_COL,
    D_HALF,
    D_NODE,
    D_ROW,
    FREE,
    HALF_HEADING,
    TO_ROW,
    UNKNOWN,
    Lattice,
    check_node,
    clearance_cost,
    far_from_all,
    out_of_frame,
    pair_free,
    step_climbs,
)
from planner.search.state_bins import StateBins, enters_bin

BUCKETS = 1 << 13
INCONS = BUCKETS  # the bucket after those of OPEN
ROOT = 0  # as a parent: node 0 lies on the rim, so it is never one

# Entries of `Tree.scalars`. USED: queue entries ever in use. SPARE: 1 + the first entry that is
# free again, 0 for none. CURSOR: no bucket before it has entries. BASE_UM: lower edge of the first
# bucket. SHIFT: a bucket is 1 << SHIFT micrometres wide. BEST_UM: cost of the best plan, NO_COST
# without one. BEST_NODE: the goal where it ends. ITERATION: number of the iteration. SLACK_UM:
# states are kept that cost up to this much more than the best plan.
USED, CURSOR, EXPANSIONS, BEST_UM, BEST_NODE, BASE_UM, SHIFT, ITERATION, SLACK_UM, SPARE = range(10)
SCALARS = 10

# What `expand` returns
EXHAUSTED, FINISHED, IMPROVED, OUT_OF_BUDGET, OUT_OF_ENTRIES = range(5)
# Costs of nodes are 32 bit: no plan costs as much as this, so no cost overflows.
NO_COST = (1 << 31) - 1
_NO_KEY = 1 << 40


class Tree(NamedTuple):
    """Search tree and open list, kept between calls of `expand`.

    steps (2 H, K, 8): `Lattice.steps`, or the same reversed if `is_backward`. slots: those of the
    lattice; by slot are cost_um: cost-to-come from the roots, 0 if unreached; parent: the node
    before, or ROOT; closed_in: number of the iteration that expanded the node. entry_node,
    entry_next: entries of the queue; head (BUCKETS + 1,): first entry of each bucket, -1 for none.
    goals (n,): nodes at which a plan is complete, in rising order; goal_um (n,): cost-to-go there.
    scalars (SCALARS,): see above. bins: see `StateBins`.
    """

    steps: NDArray[np.int64]
    is_backward: bool

    slots: Slots
    cost_um: NDArray[np.int32]
    parent: NDArray[np.int32]
    closed_in: NDArray[np.uint8]
    entry_node: NDArray[np.int32]
    entry_next: NDArray[np.int32]
    head: NDArray[np.int32]
    goals: NDArray[np.int64]
    goal_um: NDArray[np.int64]
    scalars: NDArray[np.int64]
    bins: StateBins

    @property
    def best_um(self) -> int:
        """Cost of the best plan, NO_COST without one."""
        return int(self.scalars[BEST_UM])

    @property
    def expansions(self) -> int:
        """States expanded so far."""
        return int(self.scalars[EXPANSIONS])


@njit_inner
def insert(tree: Tree, node: int, key_um: int) -> None:
    """Adds a node with key f to OPEN."""
    scalars = tree.scalars
    bucket = (key_um - scalars[BASE_UM]) >> scalars[SHIFT]
    bucket = min(max(bucket, 0), BUCKETS - 1)
    scalars[CURSOR] = min(scalars[CURSOR], bucket)
    push_entry(tree, node, bucket)


@njit_inner
def push_entry(tree: Tree, node: int, bucket: int) -> None:
    """Adds an entry for a node to a bucket; `entry_node` must have room for it.

    Give a constant as `int(INCONS)`: numba compiles a function anew for each literal.
    """
    scalars = tree.scalars
    entry = scalars[SPARE] - 1
    if entry >= 0:
        scalars[SPARE] = tree.entry_next[entry] + 1
    else:
        entry = scalars[USED]
        scalars[USED] = entry + 1
    tree.entry_node[entry] = node
    tree.entry_next[entry] = tree.head[bucket]
    tree.head[bucket] = entry


@njit_no_refcount
def insert_roots(tree: Tree, nodes: NDArray[np.int64], costs_um: NDArray[np.int64]) -> None:
    """Puts roots (n,) into the tree and into INCONS."""
    for i in range(len(nodes)):
        node, cost = nodes[i], costs_um[i]
        slot = take_slot(tree.slots, node)
        old = tree.cost_um[slot]
        if old == 0 or cost < old:
            tree.cost_um[slot] = cost
            tree.parent[slot] = ROOT
            push_entry(tree, node, int(INCONS))
            _note_plan(tree, node, cost)


@njit_inner
def _note_plan(tree: Tree, node: int, cost_um: int) -> bool:
    """Notes the plan that ends at a node if that is a goal and the plan the best; whether it is."""
    scalars, goals = tree.scalars, tree.goals
    if len(goals) == 0 or node < goals[0] or node > goals[-1]:
        return False
    index = first_not_below(goals, node)
    if goals[index] != node or cost_um + tree.goal_um[index] >= scalars[BEST_UM]:
        return False
    scalars[BEST_UM] = cost_um + tree.goal_um[index]
    scalars[BEST_NODE] = node
    return True


@njit_inner
def _limit_um(scalars: NDArray[np.int64]) -> int:
    """States whose cost + heuristic is not below this are not kept."""
    return min(scalars[BEST_UM] + scalars[SLACK_UM], NO_COST)


@njit_arrays
def start_iteration(lattice: Lattice, heuristic: Heuristic, tree: Tree, epsilon: float) -> int:
    """Moves OPEN and INCONS into OPEN with keys for a weight epsilon.

    Returns the least g + h of all open states, a lower bound on all plans not found yet.
    """
    scalars = tree.scalars
    scalars[ITERATION] += 1
    queued = 128 + scalars[ITERATION]
    limit_um = _limit_um(scalars)
    nodes = np.empty(scalars[USED], np.int64)
    values_um = np.empty(scalars[USED], np.int64)
    number = 0
    for bucket in range(BUCKETS + 1):
        entry = tree.head[bucket]
        tree.head[bucket] = -1
        while entry >= 0:
            node: int = np.int64(tree.entry_node[entry])  # type: ignore[assignment]
            entry = tree.entry_next[entry]
            slot = slot_of(lattice.slots, node)
            stale = bucket < BUCKETS and tree.closed_in[slot] == scalars[ITERATION] - 1
            if stale or tree.closed_in[slot] == queued:
                continue
            value = estimate(lattice, heuristic, node)
            if tree.cost_um[slot] + value >= limit_um:
                continue
            tree.closed_in[slot] = queued
            nodes[number], values_um[number] = node, value
            number += 1
    scalars[USED] = scalars[SPARE] = 0
    scalars[CURSOR] = BUCKETS
    least, low, high = _NO_KEY, _NO_KEY, 0
    for i in range(number):
        value, cost = values_um[i], tree.cost_um[slot_of(lattice.slots, nodes[i])]
        least = min(least, cost + value)
        low = min(low, cost + int(epsilon * value))
        high = max(high, cost + int(epsilon * value))
    # Inflated keys fall on the way to the goal; with epsilon 1 they never do.
    scalars[BASE_UM] = low if epsilon == 1.0 else 0
    span = min(limit_um, high + 8_000_000) - scalars[BASE_UM]
    scalars[SHIFT] = 0
    while (span >> scalars[SHIFT]) >= BUCKETS - 1:
        scalars[SHIFT] += 1
    for i in range(number - 1, -1, -1):
        cost = tree.cost_um[slot_of(lattice.slots, nodes[i])]
        insert(tree, nodes[i], cost + int(epsilon * values_um[i]))
    return least


@njit_no_refcount
def expand(lattice: Lattice, heuristic: Heuristic, tree: Tree, epsilon: float, budget: int) -> int:
    """Expands states until the iteration ends, the plan improves or the budget is spent."""
    scalars, head, closed_in = tree.scalars, tree.head, tree.closed_in
    of_block = lattice.slots.of_block
    entry_node, entry_next = tree.entry_node, tree.entry_next
    limit = scalars[EXPANSIONS] + budget
    room = len(entry_node) - tree.steps.shape[1] - 1
    cursor = scalars[CURSOR]
    while True:
        while cursor < BUCKETS and head[cursor] < 0:
            cursor += 1
        scalars[CURSOR] = cursor
        if cursor == BUCKETS:
            return EXHAUSTED
        if scalars[BASE_UM] + (cursor << scalars[SHIFT]) >= scalars[BEST_UM]:
            return FINISHED
        if scalars[EXPANSIONS] >= limit:
            return OUT_OF_BUDGET
        if scalars[USED] > room:
            return OUT_OF_ENTRIES
        if cursor == BUCKETS - 1:
            _double_width(lattice, heuristic, tree, epsilon)
            cursor = scalars[CURSOR]
            continue
        entry = head[cursor]
        node: int = np.int64(entry_node[entry])  # type: ignore[assignment]
        head[cursor] = entry_next[entry]
        entry_next[entry] = scalars[SPARE] - 1
        scalars[SPARE] = entry + 1
        block: int = np.int64(of_block[node >> BITS])  # type: ignore[assignment]
        slot = block << BITS | node & LOW
        if closed_in[slot] == scalars[ITERATION]:
            continue
        closed_in[slot] = scalars[ITERATION]
        if len(tree.bins.key) > 0:
            value = estimate(lattice, heuristic, node)
            if not enters_bin(lattice, tree.bins, node, value):
                continue
        scalars[EXPANSIONS] += 1
        if _expand_node(lattice, heuristic, tree, epsilon, node, slot):
            return IMPROVED
        cursor = scalars[CURSOR]


@njit_inner_arrays
def _double_width(lattice: Lattice, heuristic: Heuristic, tree: Tree, epsilon: float) -> None:
    """Doubles the buckets' width once only the last one is in use, which has no upper edge.

    Otherwise its states would be expanded newest first, whatever their keys.
    """
    scalars = tree.scalars
    nodes = np.empty(scalars[USED], np.int64)
    ends = np.zeros(3, np.int64)
    for k in range(2):
        entry = tree.head[BUCKETS - 1 + k]
        ends[k + 1] = ends[k]
        while entry >= 0:
            nodes[ends[k + 1]] = tree.entry_node[entry]
            ends[k + 1] += 1
            entry = tree.entry_next[entry]
        tree.head[BUCKETS - 1 + k] = -1
    scalars[USED] = scalars[SPARE] = 0
    scalars[CURSOR] = BUCKETS
    scalars[SHIFT] += 1
    for i in range(ends[1] - 1, -1, -1):
        slot = slot_of(lattice.slots, nodes[i])
        if tree.closed_in[slot] != scalars[ITERATION]:
            value = estimate(lattice, heuristic, nodes[i])
            insert(tree, nodes[i], tree.cost_um[slot] + int(epsilon * value))
    for i in range(ends[2] - 1, ends[1] - 1, -1):
        push_entry(tree, nodes[i], int(INCONS))


@njit_inner
def _expand_node(
    lattice: Lattice, heuristic: Heuristic, tree: Tree, epsilon: float, node: int, slot: int
) -> bool:
    """Relaxes all steps from a node in a slot; whether a better plan was found.

    Has `heuristic.estimate` inline, its cheapest parts first.
    """
    # Local names: reading arrays from the tuples in the loop costs more than the loop itself.
    scalars, cost_um, closed_in = tree.scalars, tree.cost_um, tree.closed_in
    steps, node_state, parent = tree.steps, lattice.node_state, tree.parent
    of_block, used = lattice.slots.of_block, lattice.slots.used
    clearance_m, size_m = lattice.terrain.clearance_m, lattice.terrain.resolution_m
    frame, cell_m = lattice.frame, lattice.cell_m
    turn_cos, turn_sin = lattice.cos, lattice.sin
    path_um, frontier_um = heuristic.cost_um, heuristic.frontier_um
    body_cell, potential_um = heuristic.body_cell, heuristic.potential_um
    goal_table_um = heuristic.goal_table_um
    detour_um, turn_um, rim = heuristic.detour_um, heuristic.turn_um, heuristic.rim
    circle = heuristic.radius_cells, lattice.cols, lattice.origin_col, lattice.origin_row
    radii_m = radius_of(lattice.foot), radius_of(lattice.body)
    iteration = scalars[ITERATION]
    here = np.int64(cost_um[slot])
    cell = node // (2 * lattice.headings)
    row = node - cell * 2 * lattice.headings
    inward_m = (1 - 2 * (row & 1)) * lattice.half_stance_m
    up = cell // lattice.cols
    across = cell - up * lattice.cols
    half_base = up * 4 * lattice.cols + across * 2
    across, up = across - lattice.origin_col, up - lattice.origin_row
    reach = len(goal_table_um) // 2
    uneven = len(lattice.node_um) > 0
    improved, limit_um = False, _limit_um(scalars)
    for k in range(steps.shape[1]):
        if steps[row, k, COST_UM] == 0:
            continue
        to = node + steps[row, k, D_NODE]
        cost = here + steps[row, k, COST_UM]
        block: int = np.int64(of_block[to >> BITS])  # type: ignore[assignment]
        if block == 0:
            block = next_block(of_block, used, to)
            # To read a fresh page first and write to it later takes twice the time to get it.
            cost_um[block << BITS] = parent[block << BITS] = 0
            node_state[block << BITS] = closed_in[block << BITS] = 0
        at = block << BITS | to & LOW
        old = np.int64(cost_um[at])
        if old != 0 and cost >= old:
            continue
        state = node_state[at]
        to_row, d_col, d_row = steps[row, k, TO_ROW], steps[row, k, D_COL], steps[row, k, D_ROW]
        if state == UNKNOWN:
            # The other foot steps, and its body is on the side of this one.
            x, y = (across + d_col) * cell_m, (up + d_row) * cell_m - inward_m
            foot = out_of_frame(frame, x, y)
            turn = turn_cos[to_row & ~1], turn_sin[to_row & ~1]
            if uneven or not far_from_all(clearance_m, size_m, foot, turn, inward_m, radii_m):
                state = check_node(lattice, to, at)
            else:
                node_state[at] = state = FREE
        if state == BLOCKED:
            continue
        body = cell + steps[row, k, D_CELL] + body_cell[to_row]
        path: int = np.int64(path_um[body]) - 1  # type: ignore[assignment]
        if path < 0 or path > frontier_um:
            path = frontier_um
        value = path + potential_um[to_row]
        if abs(across + d_col) <= reach and abs(up + d_row) <= reach:
            exact = goal_table_um[up + d_row + reach, across + d_col + reach, to_row]
            value = max(value, exact)
        else:
            value = max(value, heuristic.cap_um)
        if cost + value >= limit_um:
            continue
        value = max(
            value, exit_bound(detour_um, turn_um, path_um, frontier_um, rim, circle, body, to_row)
        )
        if cost + value >= limit_um:
            continue
        x, y = (across + 0.5 * d_col) * cell_m, (up + 0.5 * d_row) * cell_m
        x, y = out_of_frame(frame, x, y)
        clear_m = clearance_at(clearance_m, size_m, x, y)
        if clear_m <= radii_m[1]:
            half = half_base + steps[row, k, D_HALF]
            if not pair_free(lattice, half, steps[row, k, HALF_HEADING]):
                continue
        if uneven:
            support, swing = (to, node) if tree.is_backward else (node, to)
            if not step_climbs(lattice, support, swing):
                continue
        if clear_m < lattice.clearance[0]:
            cost += clearance_cost(lattice, clear_m)
            if (old != 0 and cost >= old) or cost + value >= limit_um:
                continue
        cost_um[at] = cost
        parent[at] = node
        if _note_plan(tree, to, cost):
            improved, limit_um = True, _limit_um(scalars)
        if closed_in[at] != iteration:
            insert(tree, to, cost + int(epsilon * value))
        elif epsilon == 1.0:
            closed_in[at] = 0
            insert(tree, to, cost + value)
        else:
            push_entry(tree, to, int(INCONS))
    return improved
