"""The loops that repeat a plain function inline, held to that function on random floors."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from maps.grid import Cell
from planner.collision import terrain_of
from planner.heuristics import heuristic
from planner.heuristics.distance_field import path_costs_to_goal
from planner.heuristics.heuristic import full_heuristic, tables_of
from planner.lattice import lattice
from planner.lattice.lattice import COST_UM, D_NODE, build_lattice, node_free
from planner.search import ad_star_tree, state_bins
from planner.search.best_first import (
    BASE_UM,
    BUCKETS,
    SHIFT,
    expand,
    insert_roots,
    start_iteration,
)
from planner.search.problem import new_tree
from planner.search.reachability import BACKWARD, FORWARD, flood
from planner.search.state_bins import new_bins
from tests.compiled import from_python
from tests.planner_floor import CLIMBING, STAIRS, fine_model, scatter, walled

estimate = from_python(heuristic.estimate)
decoded = from_python(lattice.decoded)
edge_cost_um = from_python(ad_star_tree.edge_cost_um)
enters_bin = from_python(state_bins.enters_bin)

GOAL = (1.3, 1.2, 0.4)
ROOT_UM = 5_000_000
FLAT, TREADS = fine_model(), fine_model(limits=CLIMBING, level_margin_m=0.0)
ON_FLOORS_BOTH_WAYS = pytest.mark.parametrize(
    ("model", "treads", "is_backward"),
    [(*floor, back) for floor in ((FLAT, ()), (TREADS, STAIRS)) for back in (False, True)],
)


def setting(model, treads, seed):
    """The lattice and the heuristic of a goal among random obstacles."""
    grid = walled(treads=treads)
    cells = np.array(grid.cells)
    scatter(np.random.default_rng(seed), cells, 8, 3)
    cells[9:15, 10:16] = Cell.FREE
    grid = grid.with_cells(cells)
    tables = tables_of(model)
    lattice = build_lattice(grid, terrain_of(grid, False), model, tables.steps, GOAL)
    cost_um = path_costs_to_goal(lattice, tables.potential, tables.goal_table)
    return lattice, full_heuristic(lattice, tables, cost_um)


def free_nodes(lattice, seed):
    """Some free nodes, far enough from the rim for all steps."""
    rows = 2 * lattice.headings
    inner = np.arange(lattice.nodes).reshape(lattice.rows, lattice.cols, rows)[12:-12, 12:-12]
    drawn = np.random.default_rng(seed).choice(inner.reshape(-1), 400, replace=False)
    return [int(node) for node in drawn if node_free(lattice, node)]


def edges_from(lattice, tree, node):
    """Cost of the edge to each node to which there is a step; below 0 where it is not allowed."""
    steps = tree.steps[node % (2 * lattice.headings)]
    ends = node + steps[steps[:, COST_UM] > 0, D_NODE]
    return {int(to): edge_cost_um(lattice, tree, node, to) for to in ends}


def open_nodes(tree):
    """The bucket of each node in the open list."""
    found = {}
    for bucket in np.flatnonzero(tree.head[:BUCKETS] >= 0):
        entry = tree.head[bucket]
        while entry >= 0:
            found[int(tree.entry_node[entry])] = int(bucket)
            entry = tree.entry_next[entry]
    return found


@ON_FLOORS_BOTH_WAYS
def test_expansion_reaches_what_the_edges_say_with_keys_by_the_estimate(model, treads, is_backward):
    lattice, heuristic = setting(model, treads, seed=3)
    epsilon, reached, refused = 1.7, 0, 0
    for node in free_nodes(lattice, seed=4):
        tree = new_tree(lattice, is_backward)
        insert_roots(tree, np.array([node]), np.array([ROOT_UM]))
        start_iteration(lattice, heuristic, tree, epsilon)
        expand(lattice, heuristic, tree, epsilon, 1)
        assert tree.expansions == 1
        buckets = open_nodes(tree)
        for to, cost_um in edges_from(lattice, tree, node).items():
            if cost_um < 0:
                refused += 1
                assert to not in buckets
                continue
            reached += 1
            key_um = ROOT_UM + cost_um + int(epsilon * estimate(lattice, heuristic, to))
            bucket = (key_um - int(tree.scalars[BASE_UM])) >> int(tree.scalars[SHIFT])
            assert buckets.pop(to) == min(bucket, BUCKETS - 1)
        assert not buckets
    assert min(reached, refused) > 40


@ON_FLOORS_BOTH_WAYS
def test_a_flood_reaches_what_the_edges_allow_and_meets_the_other_there(model, treads, is_backward):
    lattice, _ = setting(model, treads, seed=3)
    tree, mine = new_tree(lattice, is_backward), BACKWARD if is_backward else FORWARD
    seen, refused, met = np.zeros(lattice.nodes, np.uint8), 0, 0

    def meets(node):
        """Whether it meets the other flood by expanding this node, and what it then has to do."""
        stack, ends = np.full(tree.steps.shape[1], node, np.int32), np.array([1, 1])
        seen[node] = mine
        return flood(lattice, seen, stack, tree.steps, mine, ends, 0, 1), stack[: ends[0]], ends

    for node in free_nodes(lattice, seed=5):
        edges = edges_from(lattice, tree, node)
        allowed = sorted(to for to, cost_um in edges.items() if cost_um >= 0)
        has_met, stack, ends = meets(node)
        assert not has_met
        assert sorted(stack) == allowed
        assert ends[1] == 1 + len(allowed)
        refused += len(edges) - len(allowed)
        # The other flood has been at one of the ends, or where no step is allowed.
        for to, cost_um in edges.items():
            seen[[node, *edges]] = 0
            seen[to] = 3 - mine
            assert meets(node)[0] == (cost_um >= 0)
            met += cost_um >= 0
        seen[[node, *edges]] = 0
    assert min(met, refused) > 40


def test_nodes_share_a_bin_where_their_decoded_parts_do():
    lattice, _ = setting(FLAT, (), seed=3)
    bins, rows = new_bins(lattice, 10), 2 * lattice.headings
    rng, shared = np.random.default_rng(5), {True: 0, False: 0}
    cells = rng.integers(5, 9, (60, 2)) @ (lattice.cols, 1)
    nodes = cells * rows + rng.integers(0, 8, 60)

    def parts(node):
        col, row, heading, side = decoded(lattice, node)
        col, row = col + lattice.origin_col, row + lattice.origin_row
        return col // bins.cells, row // bins.cells, heading // bins.headings, side

    for one, other in itertools.combinations(nodes, 2):
        fresh = new_bins(lattice, 10)
        assert enters_bin(lattice, fresh, one, 500_000)
        is_same = parts(one) == parts(other)
        assert enters_bin(lattice, fresh, other, 500_000) != is_same
        shared[is_same] += 1
    assert min(shared.values()) > 50
