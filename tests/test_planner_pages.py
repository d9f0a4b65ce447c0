"""Arrays over the lattice take up memory where they are written and nowhere else."""

import mmap
import sys
from pathlib import Path

import numpy as np
import pytest

from planner.compiled import in_tiles, tiled, zeros


@pytest.mark.parametrize("count", [0, 5, 1 << 22])
def test_zeros_are_zeros_that_can_be_written(count):
    array = zeros(count, np.int32)
    assert array.shape == (count,)
    assert array.dtype == np.int32
    assert not array.any()
    array[count // 2 :] = 7
    assert array.sum() == 7 * (count - count // 2)


@pytest.mark.skipif(sys.platform != "linux", reason="asks Linux how much memory is used")
def test_a_number_here_and_there_takes_up_a_page_each():
    array = zeros(1 << 26, np.uint8)
    before = resident_bytes()
    array[:: 1 << 21] = 1
    assert resident_bytes() - before < 32 * 4 * mmap.PAGESIZE + (1 << 20)


def resident_bytes():
    return int(Path("/proc/self/statm").read_text().split()[1]) * mmap.PAGESIZE


def test_every_cell_has_a_place_of_its_own_and_neighbours_share_tiles():
    cols, rows = 21, 10
    places = {in_tiles(c, r, cols) for c in range(cols) for r in range(rows)}
    assert len(places) == cols * rows
    assert max(places) < tiled(cols, rows)
    tiles = {in_tiles(c, r, cols) // 64 for c in range(8, 16) for r in range(8)}
    assert len(tiles) == 1
