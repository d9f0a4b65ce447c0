"""Arrays over the whole lattice, of which a search touches a small part."""

from __future__ import annotations

import mmap
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from planner.jit import lean

_SMALL_BYTES = 1 << 21


def zeros(count: int, dtype: DTypeLike) -> NDArray[Any]:
    """Zeros (count,) that take up memory only on the small pages where they are written.

    numpy asks for huge pages: each takes 2 MB and the time to clear them for a single number. Where
    the system has no other pages, or cannot be asked, these are numpy's own.
    """
    size = count * np.dtype(dtype).itemsize
    if size < _SMALL_BYTES or not hasattr(mmap, "MADV_NOHUGEPAGE"):
        return np.zeros(count, dtype)
    memory = mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    memory.madvise(mmap.MADV_NOHUGEPAGE)
    return np.frombuffer(memory, dtype)


def tiled(cols: int, rows: int) -> int:
    """How many places `in_tiles` has for so many columns and rows."""
    return (cols // 8 + 1) * (rows // 8 + 1) * 64


@lean
def in_tiles(col: int, row: int, cols: int) -> int:
    """Place of a cell where those of 8 x 8 cells follow one another, then those of the next.

    A search comes to cells that lie together. Row by row each row of them takes pages of its own.
    """
    return (row >> 3) * (cols // 8 + 1) + (col >> 3) << 6 | (row & 7) << 3 | col & 7
