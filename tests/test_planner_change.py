"""What a change of the map changes on a lattice, against the steps of lattices made anew."""

from __future__ import annotations

import numpy as np
import pytest

from maps.grid import Cell
from planner.collision import terrain_of
from planner.heuristics.heuristic import tables_of
from planner.lattice.goal_region import may_end_at
from planner.lattice.lattice import COST_UM, D_NODE, build_lattice, node_free
from planner.lattice.map_change import change_between
from planner.search.ad_star_tree import edge_cost_um
from planner.search.problem import new_tree
from tests.planner_floor import walled
from tests.planner_oracle import small_model

GOAL = (1.3, 1.2, 0.4)
MODELS = {
    "plain": small_model(),
    "shy": small_model(clearance_m=0.2, clearance_cost_m=0.2, body_margin_m=0.02),
}


def steps_over(grid, model, nodes):
    """Costs (n, K) of the steps from nodes (n,) and whether a plan may end there (n,).

    Of a lattice made for this map; below 0 where a step is not allowed.
    """
    lattice = build_lattice(grid, terrain_of(grid, False), model, tables_of(model).steps, GOAL)
    tree = new_tree(lattice, lattice.steps, False)
    rows = 2 * lattice.headings
    costs_um = np.full((len(nodes), lattice.steps.shape[1]), -1, np.int64)
    for i, node in enumerate(nodes):
        if not node_free(lattice, node):
            continue
        for k in np.flatnonzero(lattice.steps[node % rows, :, COST_UM]):
            to = int(node + lattice.steps[node % rows, k, D_NODE])
            costs_um[i, k] = edge_cost_um(lattice, tree, int(node), to)
    return costs_um, np.array([may_end_at(lattice, node) for node in nodes])


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
@pytest.mark.parametrize("resolution_m", [0.1, 0.05])
def test_only_steps_with_feet_near_to_a_change_see_it(resolution_m, model):
    rng = np.random.default_rng(7)
    scale = round(0.1 / resolution_m)
    grid = walled(26 * scale, 26 * scale, origin=(0.3, -0.2, 0.5), resolution_m=resolution_m)
    cells = np.array(grid.cells)
    cells[5:7, 8:9] = Cell.OCCUPIED
    before = grid.with_cells(cells)
    row, col = rng.integers(9, 14, 2) * scale
    cells[5:7, 8:9] = Cell.FREE
    cells[row, col] = Cell.OCCUPIED
    after = grid.with_cells(cells)
    lattice = build_lattice(before, terrain_of(before, False), model, tables_of(model).steps, GOAL)
    rows = 2 * lattice.headings
    # One node of eleven away from the rim, which all headings and sides are among.
    up, across = np.meshgrid(np.arange(6, lattice.rows - 6), np.arange(6, lattice.cols - 6))
    nodes = ((up * lattice.cols + across).reshape(-1, 1) * rows + np.arange(rows)).reshape(-1)[::11]
    old_um, old_ends = steps_over(before, model, nodes)
    new_um, new_ends = steps_over(after, model, nodes)
    change = change_between(lattice, terrain_of(before, False), terrain_of(after, False))
    assert change is not None
    here = nodes // rows
    there = (nodes[:, None] + lattice.steps[nodes % rows, :, D_NODE]) // rows
    dearer = (old_um >= 0) & ((new_um < 0) | (new_um > old_um))
    cheaper = (new_um >= 0) & ((old_um < 0) | (old_um > new_um))
    for steps, found in ((dearer, change.shut), (cheaper, change.freed)):
        assert steps.sum() > 20
        assert np.isin(np.broadcast_to(here[:, None], steps.shape)[steps], found).all()
        assert np.isin(there[steps], found).all()
    lost = old_ends & ~new_ends
    assert lost.any()
    assert np.isin(here[lost], change.shut).all()
    # It is not all that is called near.
    assert len(change.shut) + len(change.freed) < 0.5 * lattice.cols * lattice.rows
