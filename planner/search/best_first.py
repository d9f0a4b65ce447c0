"""Anytime weighted A* (ARA*) over the footstep lattice, compiled.

After Likhachev, Gordon and Thrun, "ARA*: Anytime A* with Provable Bounds on Sub-Optimality", 2003:
searches with a falling weight epsilon on the heuristic, each going on from the costs that the ones
before found. A state whose cost falls after it was expanded waits for the next search (INCONS). The
search goes from the start to the goal or, with the steps turned round, the other way.

A state is the node of the foot that was placed last. OPEN is a row of buckets of equal width in f,
each a stack. A bucket holds states in any order, but a search ends only when the lower edge of the
first bucket in use is not below the cost of the plan, so bounds are exact.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.collision import clearance_at
from planner.compiled import (
    BITS,
    LOW,
    Slots,
    next_block,
    njit_arrays,
    njit_no_refcount,
    slot_of,
    take_slot,
)
from planner.heuristics.heuristic import Heuristic, estimate
from planner.heuristics.rounded_plans import rounded_bound
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
    Int64s,
    Lattice,
    check_node,
    clearance_cost,
    far_from_all,
    pair_free,
    radius_of,
    step_climbs,
)

# Places on the lattice: what a search for a first plan tells apart, which is less than a state.
#
# Where the path of the body leads on and steps do not, a search fills all that is around with
# states that differ by a cell or by a few degrees before it tries another way. So here, once a
# state of a place was expanded, only those are that have clearly less before them, after the cells
# of hybrid A* (Dolgov, Thrun, Montemerlo and Diebel, "Path Planning for Autonomous Vehicles in
# Unknown Semi-structured Environments", 2010). A plan may be missed by that.

_SIZE_M, _SIZE_RAD = 0.15, math.pi / 4
_CLEARLY_UM = 100_000


class Places(NamedTuple):
    """Places of so many cells along both axes, of so many headings and of one side.

    number, least_um (n,): a hash table of the places where states were expanded, n a power of two:
    their numbers from 1, 0 where there is none, and the least estimate of those states; (0,) where
    all states are to be.
    """

    number: NDArray[np.int64]
    least_um: NDArray[np.int32]
    cells: int
    headings: int


EVERY_STATE = Places(np.zeros(0, np.int64), np.zeros(0, np.int32), 1, 1)


def places_of(lattice: Lattice, most: int) -> Places:
    """Places of a lattice, nothing expanded in any, for at most so many expansions."""
    cells = max(1, round(_SIZE_M / lattice.cell_m))
    headings = max(1, round(_SIZE_RAD / (2 * math.pi) * lattice.headings))
    room = 1 << (2 * most).bit_length()
    return Places(np.zeros(room, np.int64), np.zeros(room, np.int32), cells, headings)


@njit_no_refcount
def takes_place(lattice: Lattice, places: Places, node: int, estimate_um: int) -> bool:
    """Whether the node has clearly less before it than those expanded in its place, which it notes.

    estimate_um: what is before it.
    """
    row, cell = node % (2 * lattice.headings), node // (2 * lattice.headings)
    across = (lattice.cols + places.cells - 1) // places.cells
    turns = (lattice.headings + places.headings - 1) // places.headings
    place = cell // lattice.cols // places.cells * across + cell % lattice.cols // places.cells
    number = (place * turns + row // 2 // places.headings) * 2 + row % 2 + 1
    last = len(places.number) - 1
    at = (number * 0x9E3779B1 >> 7) & last
    while places.number[at] != 0 and places.number[at] != number:
        at = at + 1 & last
    if places.number[at] == number and estimate_um > places.least_um[at] - _CLEARLY_UM:
        return False
    places.number[at], places.least_um[at] = number, estimate_um
    return True


BUCKETS = 1 << 13
FROM_START = 0  # marks a root; node 0 lies on the rim, so it never is a predecessor

# Entries of Tree.scalars
USED, CURSOR, EXPANSIONS, BEST_UM, BEST_NODE, BASE_UM, SHIFT, ROUND, SLACK_UM, SPARE = range(10)
SCALARS = 10

# What `expand` returns
EXHAUSTED, FINISHED, IMPROVED, OUT_OF_BUDGET, OUT_OF_ENTRIES = range(5)
# Costs of nodes are 32 bit: no plan costs as much as this, so none that would overflow is followed.
NO_COST = (1 << 31) - 1
_NO_KEY = 1 << 40


class Tree(NamedTuple):
    """State of a search, kept between calls of `expand`.

    steps: `Lattice.steps` for a search from the start; for one from the goal the same turned round,
    and `is_backward`. slots: those of the space; kept there are cost_um: cost of a node from the
    roots, 0 where none is known; before: the node that it was reached from, FROM_START for a root;
    round: number of the search that expanded it. entry_node, entry_next: stacks of the buckets;
    head (BUCKETS + 1,): first entry of each, the last for INCONS. goals (n,): nodes at which a
    plan is complete, in rising order, and goal_um (n,): what is still to be paid there.
    scalars[USED]: so many entries were ever in use; scalars[SPARE]: 1 more than the first of those
    that are used again, 0 for none.
    scalars[SLACK_UM]: states are kept that cost up to so much more than the best plan; 0 for a tree
    that is not used again. places: see `places.py`.
    """

    steps: NDArray[np.int64]
    is_backward: bool

    slots: Slots
    cost_um: NDArray[np.int32]
    before: NDArray[np.int32]
    round: NDArray[np.uint8]
    entry_node: NDArray[np.int32]
    entry_next: NDArray[np.int32]
    head: NDArray[np.int32]
    goals: NDArray[np.int64]
    goal_um: NDArray[np.int64]
    scalars: NDArray[np.int64]
    places: Places


@njit_no_refcount
def _push(tree: Tree, node: int, key_um: int) -> None:
    scalars = tree.scalars
    bucket = (key_um - scalars[BASE_UM]) >> scalars[SHIFT]
    bucket = min(max(bucket, 0), BUCKETS - 1)
    scalars[CURSOR] = min(scalars[CURSOR], bucket)
    put(tree, node, bucket)


@njit_no_refcount
def put(tree: Tree, node: int, bucket: int) -> None:
    """Adds an entry for a node to a bucket; there must be room for it."""
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
def seed(tree: Tree, nodes: NDArray[np.int64], costs_um: NDArray[np.int64]) -> None:
    """Puts the roots (n,) into the tree, to be taken up by `begin_round`."""
    for i in range(len(nodes)):
        node, cost = nodes[i], costs_um[i]
        slot = take_slot(tree.slots, node)
        old = tree.cost_um[slot]
        if old == 0 or cost < old:
            tree.cost_um[slot] = cost
            tree.before[slot] = FROM_START
            put(tree, node, BUCKETS)
            _offer(tree, node, cost)


@njit_no_refcount
def _offer(tree: Tree, node: int, cost_um: int) -> bool:
    """Takes the node for the end of the plan if it is one of the goals and the best so far."""
    scalars, goals = tree.scalars, tree.goals
    if len(goals) == 0 or node < goals[0] or node > goals[-1]:
        return False
    index = np.searchsorted(goals, node)
    if goals[index] != node or cost_um + tree.goal_um[index] >= scalars[BEST_UM]:
        return False
    scalars[BEST_UM] = cost_um + tree.goal_um[index]
    scalars[BEST_NODE] = node
    return True


@njit_no_refcount
def _limit_um(scalars: NDArray[np.int64]) -> int:
    """What a state's cost and heuristic must stay below for the state to be kept."""
    return min(scalars[BEST_UM] + scalars[SLACK_UM], NO_COST)


@njit_arrays
def begin_round(lattice: Lattice, heuristic: Heuristic, tree: Tree, epsilon: float) -> int:
    """Moves OPEN and INCONS into fresh buckets for a weight epsilon.

    Returns the least g + h of any open state: no plan that is still to be found costs less.
    """
    scalars = tree.scalars
    scalars[ROUND] += 1
    queued = 128 + scalars[ROUND]
    limit_um = _limit_um(scalars)
    nodes = np.empty(scalars[USED], np.int64)
    values_um = np.empty(scalars[USED], np.int64)
    number = 0
    for bucket in range(BUCKETS + 1):
        entry = tree.head[bucket]
        tree.head[bucket] = -1
        while entry >= 0:
            node = tree.entry_node[entry]
            entry = tree.entry_next[entry]
            slot = slot_of(lattice.slots, node)
            stale = bucket < BUCKETS and tree.round[slot] == scalars[ROUND] - 1
            if stale or tree.round[slot] == queued:
                continue
            value = estimate(lattice, heuristic, node)
            if tree.cost_um[slot] + value >= limit_um:
                continue
            tree.round[slot] = queued
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
        _push(tree, nodes[i], cost + int(epsilon * values_um[i]))
    return least


@njit_no_refcount
def expand(lattice: Lattice, heuristic: Heuristic, tree: Tree, epsilon: float, budget: int) -> int:
    """Expands states until this round's search is over, the plan improves or budget is spent."""
    scalars, head, rounds = tree.scalars, tree.head, tree.round
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
            _widen(lattice, heuristic, tree, epsilon)
            cursor = scalars[CURSOR]
            continue
        entry = head[cursor]
        node: int = np.int64(entry_node[entry])  # type: ignore[assignment]
        head[cursor] = entry_next[entry]
        entry_next[entry] = scalars[SPARE] - 1
        scalars[SPARE] = entry + 1
        block: int = np.int64(of_block[node >> BITS])  # type: ignore[assignment]
        slot = block << BITS | node & LOW
        if rounds[slot] == scalars[ROUND]:
            continue
        rounds[slot] = scalars[ROUND]
        if len(tree.places.least_um) > 0:
            value = estimate(lattice, heuristic, node)
            if not takes_place(lattice, tree.places, node, value):
                continue
        scalars[EXPANSIONS] += 1
        if _expand_node(lattice, heuristic, tree, epsilon, node, slot):
            return IMPROVED
        cursor = scalars[CURSOR]


@njit_arrays
def _widen(lattice: Lattice, heuristic: Heuristic, tree: Tree, epsilon: float) -> None:
    """Doubles the buckets' width once only the last is in use, which holds every higher key.

    Without it the states there would be searched newest first, whatever they cost.
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
        if tree.round[slot] != scalars[ROUND]:
            value = estimate(lattice, heuristic, nodes[i])
            _push(tree, nodes[i], tree.cost_um[slot] + int(epsilon * value))
    for i in range(ends[2] - 1, ends[1] - 1, -1):
        put(tree, nodes[i], BUCKETS)


@njit_no_refcount
def _expand_node(
    lattice: Lattice, heuristic: Heuristic, tree: Tree, epsilon: float, node: int, slot: int
) -> bool:
    """Relaxes all steps from a node in a slot; whether a better plan came of it."""
    # Arrays in local names: taken from the tuples in the loop they cost more than the loop itself.
    scalars, cost_um, rounds = tree.scalars, tree.cost_um, tree.round
    steps, node_state, before = tree.steps, lattice.node_state, tree.before
    of_block, used = lattice.slots.of_block, lattice.slots.used
    clearance_m, size_m = lattice.terrain.clearance_m, lattice.terrain.resolution_m
    (ox, oy, cos, sin), cell_m = lattice.frame, lattice.cell_m
    turn_cos, turn_sin = lattice.cos, lattice.sin
    path_um, frontier_um = heuristic.cost_um, heuristic.frontier_um
    body_cell, potential_um = heuristic.body_cell, heuristic.potential_um
    endgame_um = heuristic.endgame_um
    detour_um, turn_um, rim = heuristic.detour_um, heuristic.turn_um, heuristic.rim
    circle = heuristic.radius_cells, lattice.cols, lattice.origin_col, lattice.origin_row
    radii_m = radius_of(lattice.foot), radius_of(lattice.body)
    round_now = scalars[ROUND]
    here = np.int64(cost_um[slot])
    cell = node // (2 * lattice.headings)
    row = node - cell * 2 * lattice.headings
    inward_m = (1 - 2 * (row & 1)) * lattice.half_stance_m
    up = cell // lattice.cols
    across = cell - up * lattice.cols
    half_base = up * 4 * lattice.cols + across * 2
    across, up = across - lattice.origin_col, up - lattice.origin_row
    reach = len(endgame_um) // 2
    uneven = len(lattice.node_um) > 0
    rounded = heuristic.rounded
    is_rounded = len(rounded.cost_um) > 0
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
            cost_um[block << BITS] = before[block << BITS] = 0
            node_state[block << BITS] = rounds[block << BITS] = 0
        at = block << BITS | to & LOW
        old = np.int64(cost_um[at])
        if old != 0 and cost >= old:
            continue
        state = node_state[at]
        to_row, d_col, d_row = steps[row, k, TO_ROW], steps[row, k, D_COL], steps[row, k, D_ROW]
        if state == UNKNOWN:
            # The other foot steps, and its body is on the side of this one.
            x, y = (across + d_col) * cell_m, (up + d_row) * cell_m - inward_m
            foot = ox + cos * x - sin * y, oy + sin * x + cos * y
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
            exact = endgame_um[up + d_row + reach, across + d_col + reach, to_row]
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
        if is_rounded:
            value = max(value, rounded_bound(rounded, across + d_col, up + d_row, to_row))
            if cost + value >= limit_um:
                continue
        x, y = (across + 0.5 * d_col) * cell_m, (up + 0.5 * d_row) * cell_m
        x, y = ox + cos * x - sin * y, oy + sin * x + cos * y
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
        before[at] = node
        if _offer(tree, to, cost):
            improved, limit_um = True, _limit_um(scalars)
        if rounds[at] != round_now:
            _push(tree, to, cost + int(epsilon * value))
        elif epsilon == 1.0:
            rounds[at] = 0
            _push(tree, to, cost + value)
        else:
            put(tree, to, BUCKETS)
    return improved


def with_more_entries(tree: Tree) -> Tree:
    """The tree with room for twice as many entries."""
    used = len(tree.entry_node)
    entry_node, entry_next = np.empty(2 * used, np.int32), np.empty(2 * used, np.int32)
    entry_node[:used], entry_next[:used] = tree.entry_node, tree.entry_next
    return tree._replace(entry_node=entry_node, entry_next=entry_next)


# What is read from a search tree, compiled.


@njit_arrays
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


@njit_arrays
def costs_of(tree: Tree, nodes: Int64s) -> Int64s:
    """Costs of nodes (n,) in micrometres, 0 where none is known."""
    costs_um = np.empty(len(nodes), np.int64)
    for i in range(len(nodes)):
        costs_um[i] = tree.cost_um[slot_of(tree.slots, nodes[i])]
    return costs_um


@njit_arrays
def expanded_in_cells(lattice: Lattice, tree: Tree) -> Int64s:
    """How many nodes were expanded in each of the lattice's cells (rows * cols,)."""
    done = np.zeros(lattice.cols * lattice.rows, np.int64)
    of_block, rows = tree.slots.of_block, 2 * lattice.headings
    for node in range(len(done) * rows):
        if of_block[node // (LOW + 1)] and tree.round[slot_of(tree.slots, node)]:
            done[node // rows] += 1
    return done
