"""What a search for a first plan tells apart, and what it may forget."""

import numpy as np

from planner.collision import terrain_of
from planner.heuristics.heuristic import tables_of
from planner.lattice.lattice import build_lattice
from planner.search.best_first import enters_bin, new_bins
from tests.planner_floor import FLOOR
from tests.planner_oracle import small_model

MODEL = small_model()
TERRAIN = terrain_of(FLOOR, False)
SPACE = build_lattice(FLOOR, TERRAIN, MODEL, tables_of(MODEL).steps, (2.0, 1.5, 0.3))


def node_at(col, row, heading, side):
    cell = (row + SPACE.origin_row) * SPACE.cols + col + SPACE.origin_col
    return (cell * SPACE.headings + heading) * 2 + side


def test_of_all_states_each_place_takes_one():
    fine = SPACE._replace(cell_m=0.05)
    places = new_bins(fine, fine.nodes)
    assert (places.cells, places.headings) == (3, 1)
    taken = sum(enters_bin(fine, places, node, 500_000) for node in range(fine.nodes))
    assert taken == -(-fine.cols // 3) * -(-fine.rows // 3) * fine.headings * 2
    assert np.count_nonzero(places.key) == taken


def test_a_place_is_taken_again_only_by_states_that_have_clearly_less_before_them():
    places, node = new_bins(SPACE, 100), node_at(3, -2, 5, 1)
    estimates_um = 900_000, 850_000, 790_000, 790_000, 900_000, 600_000
    taken = [enters_bin(SPACE, places, node, value) for value in estimates_um]
    assert taken == [True, False, True, False, False, True]


def test_the_other_foot_stands_in_another_place_and_so_does_one_turned_by_a_quarter():
    places = new_bins(SPACE, 100)
    quarter = SPACE.headings // 4
    for at in ((0, 0, 0, 0), (0, 0, 0, 1), (0, 0, quarter, 0), (places.cells, 0, 0, 0)):
        assert enters_bin(SPACE, places, node_at(*at), 500_000)
        assert not enters_bin(SPACE, places, node_at(*at), 500_000)
