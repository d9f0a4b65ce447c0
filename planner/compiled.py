"""How the loops of this package are compiled, and the memory that they work on."""

from __future__ import annotations

import contextlib
import mmap
import os
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, NoReturn, TypeVar

import numpy as np
from numba import config, njit
from numba.core import event
from numba.core.caching import FunctionCache
from numba.core.registry import CPUDispatcher
from numba.core.runtime.nrt import rtsys
from numpy.typing import DTypeLike, NDArray

from planner.cache import cache_folder

_Function = TypeVar("_Function", bound=Callable[..., object])
_Scalar = TypeVar("_Scalar", bound=np.generic)
_jit: Any = njit  # its types do not know of the option
_config: Any = config
FUNCTIONS: list[Any] = []  # all that is compiled, as far as its files are imported


def njit_no_refcount(function: _Function) -> _Function:
    """Compiles a function that makes no arrays, takes none from others and gives none back.

    numba counts references to all arrays that a function is given, those in tuples too, which took
    more time than the search itself. Where none are made, which the compiler checks, the caller
    holds all of them.
    """
    return _compiled(function, _nrt=False)


def njit_arrays(function: _Function) -> _Function:
    """Compiles a function that makes arrays, with reference counting.

    Needed for each that an `njit_no_refcount` function calls: it would else do as its caller does.
    """
    return _compiled(function, _nrt=True)


def njit_inner(function: _Function) -> _Function:
    """As `njit_no_refcount`, for a function that compiled ones alone call.

    It is compiled without the code that takes its arguments over from Python, which for the tuples
    of arrays here is longer than most functions. Called from Python it raises TypeError.
    """
    return _inner(_compiled(function, _nrt=False, no_cpython_wrapper=True))


def njit_inner_arrays(function: _Function) -> _Function:
    """As `njit_arrays`, for a function that compiled ones alone call: see `njit_inner`."""
    return _inner(_compiled(function, _nrt=True, no_cpython_wrapper=True))


class _Cache(FunctionCache):
    """A cache that gives compiled functions back without all that compiling needs.

    numba by itself first loads how every function of Python and numpy is compiled, which takes
    0.15 s and 10 MB. Where something has to be compiled after all it does so then.
    """

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        rtsys.initialize(target_context)  # what arrays in compiled code need
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)


_HAS_QUICK_CACHE = all(
    hasattr(FunctionCache, name) for name in ("_guard_against_spurious_io_errors", "_load_overload")
)  # these are numba's own business: it may come to do without


class _Inner(CPUDispatcher):
    """A compiled function without an entry for Python, where numba would call address 0."""

    def __call__(self, *_: object) -> NoReturn:
        name = self.py_func.__name__
        raise TypeError(f"{name} has no entry for Python: compiled functions call it")


def _inner(function: Any) -> Any:
    if isinstance(function, CPUDispatcher):  # it is not where NUMBA_DISABLE_JIT is set
        function.__class__ = _Inner
    return function


def _compiled(function: _Function, **options: bool) -> _Function:
    """The function, compiled when it is called, or taken from the cache of these sources.

    Without the entry for callers in C, which nobody uses, compiling takes a twelfth less. No
    divisor is 0, so there is no code that raises an error for it.
    numba asks where the cache is when a function is decorated, so it is told for that long only:
    other code in the process keeps to its own.
    """
    folder, before = cache_folder(), _config.CACHE_DIR
    _config.CACHE_DIR = str(folder or "")
    try:
        jit = _jit(cache=folder is not None, no_cfunc_wrapper=True, error_model="numpy", **options)
        compiled: Any = jit(function)
    finally:
        _config.CACHE_DIR = before
    if _HAS_QUICK_CACHE and type(getattr(compiled, "_cache", None)) is FunctionCache:
        compiled._cache.__class__ = _Cache
    FUNCTIONS.append(compiled)
    return compiled


class _CompilesSooner(event.Listener):
    """Lets LLVM optimise this package's functions less, which takes it a quarter less time.

    The loops are as fast: they are not such as can be vectorised. A level in NUMBA_OPT holds.
    """

    def __init__(self) -> None:
        self._before: list[tuple[Any, Any]] = []

    def on_start(self, event: Any) -> None:
        self._before.append((_config.OPT, _config.LOOP_VECTORIZE))
        if event.data["dispatcher"].py_func.__module__.startswith("planner."):
            _config.OPT, _config.LOOP_VECTORIZE = type(_config.OPT)(2), 0

    def on_end(self, event: Any) -> None:
        _config.OPT, _config.LOOP_VECTORIZE = self._before.pop()


if "NUMBA_OPT" not in os.environ:
    event.register("numba:compile", _CompilesSooner())


class _Listener(event.Listener):
    """Measures compiling, of which one function's lies within that of its caller's."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell, self._depth, self._began_s = tell, 0, 0.0
        self.taken_s = 0.0

    def on_start(self, event: Any) -> None:
        if self._depth == 0:
            self._began_s = time.perf_counter()
        self._depth += 1
        function = event.data["dispatcher"].py_func
        if function.__module__.startswith("planner."):
            self._tell(function.__name__)

    def on_end(self, event: Any) -> None:
        self._depth -= 1
        if self._depth == 0:
            self.taken_s += time.perf_counter() - self._began_s


@contextlib.contextmanager
def on_compiling(tell: Callable[[str], None] = lambda _: None) -> Iterator[_Listener]:
    """Calls `tell` with the name of each function that is compiled inside.

    What it gives counts the seconds that compiling took, as `taken_s`.
    """
    listener = _Listener(tell)
    with event.install_listener("numba:compile", listener):
        yield listener


_SMALL_BYTES = 1 << 21


def zeros(count: int, dtype: DTypeLike) -> NDArray[Any]:
    """Zeros (count,) that take up memory only on the small pages where they are written.

    For arrays over the whole lattice, of which a search touches a small part: numpy asks for huge
    pages, each of which takes 2 MB and the time to clear them for a single number. Where the system
    has no other pages, or cannot be asked, these are numpy's own.
    """
    size = count * np.dtype(dtype).itemsize
    if size < _SMALL_BYTES or not hasattr(mmap, "MADV_NOHUGEPAGE"):
        return np.zeros(count, dtype)
    try:
        memory = mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    except (OSError, OverflowError):
        raise MemoryError(f"no room for {size} bytes") from None
    memory.madvise(mmap.MADV_NOHUGEPAGE)
    return np.frombuffer(memory, dtype)


def with_room(array: NDArray[_Scalar], used: int, more: int) -> NDArray[_Scalar]:
    """The array, or a longer one that begins with the first `used`, so that as many more fit."""
    if used + more <= len(array):
        return array
    longer = np.empty(2 * (used + more), array.dtype)
    longer[:used] = array[:used]
    return longer


def tiled(cols: int, rows: int) -> int:
    """How many places `in_tiles` has for so many columns and rows."""
    return (cols // 8 + 1) * (rows // 8 + 1) * 64


@njit_inner
def in_tiles(col: int, row: int, cols: int) -> int:
    """Place of a cell in tiles of 8 x 8 cells, for fewer pages of memory than row by row."""
    return (row >> 3) * (cols // 8 + 1) + (col >> 3) << 6 | (row & 7) << 3 | col & 7


BITS = 7
LOW = (1 << BITS) - 1


class Slots(NamedTuple):
    """Where arrays of `length` keep what is known of nodes: in the order in which they are reached.

    A search reaches few nodes of a lattice, here and there. In arrays over all of them nearly each
    would take a page of memory of its own.

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


@njit_inner
def slot_of(slots: Slots, node: int) -> int:
    """The slot of a node; one in which nothing is known if it has none."""
    block: int = np.int64(slots.of_block[node >> BITS])  # type: ignore[assignment]
    return block << BITS | node & LOW


@njit_inner
def take_slot(slots: Slots, node: int) -> int:
    """The slot of a node, which it gets if it has none."""
    block: int = np.int64(slots.of_block[node >> BITS])  # type: ignore[assignment]
    if block == 0:
        block = next_block(slots.of_block, slots.used, node)
    return block << BITS | node & LOW


@njit_inner
def next_block(of_block: NDArray[np.int32], used: NDArray[np.int64], node: int) -> int:
    """The number of new slots for the block of a node."""
    used[0] += 1
    of_block[node >> BITS] = used[0]
    return used[0]


@njit_arrays
def slots_of(slots: Slots, nodes: NDArray[np.int64]) -> NDArray[np.int64]:
    """`slot_of` nodes (n,)."""
    found = np.empty(len(nodes), np.int64)
    for i in range(len(nodes)):
        found[i] = slot_of(slots, nodes[i])
    return found


@njit_inner
def first_not_below(ascending: NDArray[np.int64], value: int) -> int:
    """Index of the first number that is at least this value; the last index if none is.

    numpy's own `searchsorted` brings further functions along, which take longer to compile.
    """
    low, high = 0, len(ascending) - 1
    while low < high:
        middle = (low + high) // 2
        if ascending[middle] < value:
            low = middle + 1
        else:
            high = middle
    return low
