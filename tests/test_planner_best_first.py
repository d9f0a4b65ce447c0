"""The loops that repeat a plain function inline, held to that function on random floors."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from maps.grid import Cell
from planner.collision import terrain_of
from planner.heuristics.distance_field import path_costs_to_goal
from planner.heuristics.heuristic import estimate, full_heuristic, tables_of
from planner.lattice.lattice import COST_UM, D_NODE, build_lattice, decoded, node_free
from planner.search.ad_star_tree import edge_cost_um
from planner.search.best_first import (
    BASE_UM,
    BUCKETS,
    SHIFT,
    enters_bin,
    expand,
    insert_roots,
    new_bins,
    start_iteration,
)
from planner.search.problem import new_tree
from tests.planner_floor import fine_model, scatter
from tests.planner_treads import LIMITS, STAIRS, floor

GOAL = (1.3, 1.2, 0.4)
ROOT_UM = 5_000_000
FLAT, TREADS = fine_model(), fine_model(limits=LIMITS, level_margin_m=0.0)


def setting(model, treads, seed):
    """The lattice and the heuristic of a goal among random obstacles."""
    grid = floor(*treads, rows=24, cols=24)
    cells = np.array(grid.cells)
    scatter(np.random.default_rng(seed), cells, 8, 3)
    cells[9:15, 10:16] = Cell.FREE
    grid = grid.with_cells(cells)
    tables = tables_of(model)
    lattice = build_lattice(grid, terrain_of(grid, False), model, tables.steps, GOAL)
    cost_um = path_costs_to_goal(lattice, tables.potential, tables.goal_table)
    return lattice, full_heuristic(lattice, tables, cost_um)


def open_nodes(tree):
    """The bucket of each node in the open list."""
    found = {}
    for bucket in np.flatnonzero(tree.head[:BUCKETS] >= 0):
        entry = tree.head[bucket]
        while entry >= 0:
            found[int(tree.entry_node[entry])] = int(bucket)
            entry = tree.entry_next[entry]
    return found


@pytest.mark.parametrize("is_backward", [False, True])
@pytest.mark.parametrize(("model", "treads"), [(FLAT, ()), (TREADS, STAIRS)])
def test_expansion_reaches_what_the_edges_say_with_keys_by_the_estimate(model, treads, is_backward):
    lattice, heuristic = setting(model, treads, seed=3)
    rng, epsilon = np.random.default_rng(4), 1.7
    rows, reached, refused = 2 * lattice.headings, 0, 0
    inner = np.arange(lattice.nodes).reshape(lattice.rows, lattice.cols, rows)[12:-12, 12:-12]
    for node in rng.choice(inner.reshape(-1), 400, replace=False):
        if not node_free(lattice, node):
            continue
        tree = new_tree(lattice, is_backward)
        insert_roots(tree, np.array([node]), np.array([ROOT_UM]))
        start_iteration(lattice, heuristic, tree, epsilon)
        expand(lattice, heuristic, tree, epsilon, 1)
        assert tree.expansions == 1
        buckets = open_nodes(tree)
        steps = tree.steps[node % rows]
        for to in node + steps[steps[:, COST_UM] > 0, D_NODE]:
            cost_um = edge_cost_um(lattice, tree, node, to)
            if cost_um < 0:
                refused += 1
                assert to not in buckets
                continue
            reached += 1
            key_um = ROOT_UM + cost_um + int(epsilon * estimate(lattice, heuristic, to))
            bucket = (key_um - int(tree.scalars[BASE_UM])) >> int(tree.scalars[SHIFT])
            assert buckets.pop(int(to)) == min(bucket, BUCKETS - 1)
        assert not buckets
    assert min(reached, refused) > 40


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
