"""Compiled code: its arrays, slots and caches, and functions that count no references."""

from __future__ import annotations

import ast
import mmap
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import TypeGuard

import numba
import numpy as np
import pytest

import planner
from planner import compiled
from planner.compiled import (
    njit_arrays,
    njit_no_refcount,
    on_compiling,
    slots_for,
    slots_of,
    tiled,
    zeros,
)
from tests.compiled import from_python

first_not_below = from_python(compiled.first_not_below)
in_tiles = from_python(compiled.in_tiles)
slot_of = from_python(compiled.slot_of)
take_slot = from_python(compiled.take_slot)


def test_nodes_get_slots_of_their_own_when_they_are_come_to():
    slots = slots_for(1000)
    nodes = np.random.default_rng(0).permutation(1000)
    nobodys = {slot_of(slots, node) for node in range(1000)}
    taken = np.array([take_slot(slots, int(node)) for node in nodes])
    assert len(np.unique(taken)) == 1000
    assert not nobodys & set(taken.tolist())
    assert taken.max() < slots.length
    np.testing.assert_array_equal(slots_of(slots, nodes), taken)
    assert [take_slot(slots, int(node)) for node in nodes] == taken.tolist()


def test_a_place_in_ascending_numbers_is_what_numpy_says():
    numbers = np.array([-7, -7, 0, 3, 3, 3, 12])
    for value in range(-9, 13):
        assert first_not_below(numbers, value) == np.searchsorted(numbers, value)
    assert first_not_below(numbers, 13) == 6


@pytest.mark.parametrize("count", [0, 5, 1 << 22])
def test_zeros_are_zeros_that_can_be_written(count):
    array = zeros(count, np.int32)
    assert array.shape == (count,)
    assert array.dtype == np.int32
    assert not array.any()
    array[count // 2 :] = 7
    assert array.sum() == 7 * (count - count // 2)


@pytest.mark.skipif(sys.platform != "linux", reason="asks Linux how much memory is used")
@pytest.mark.skipif(sys.platform != "linux", reason="asks Linux for pages")
@pytest.mark.parametrize("count", [1 << 58, 1 << 80])
def test_zeros_for_which_there_is_no_room_are_told_as_such(count):
    with pytest.raises(MemoryError):
        zeros(count, np.int32)


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


FOLDER = Path(planner.__file__).parent
# What njit_no_refcount functions may give back: numbers, and tuples of numbers.
PLAIN = {"None", "bool", "int", "float", "tuple", "_Box"}


BOTH = {"njit_no_refcount", "njit_inner"}, {"njit_arrays", "njit_inner_arrays"}
INNER = {"njit_inner", "njit_inner_arrays"}


def trees() -> list[ast.Module]:
    """The files of the package."""
    return [ast.parse(path.read_text(encoding="utf-8")) for path in sorted(FOLDER.rglob("*.py"))]


def is_compiled(node: ast.AST, by: set[str]) -> TypeGuard[ast.FunctionDef]:
    """Whether a node is a function with one of these decorators."""
    return isinstance(node, ast.FunctionDef) and bool(names_in(*node.decorator_list) & by)


def compiled_functions(by: set[str]) -> list[ast.FunctionDef]:
    """The functions of the package that are compiled by one of these decorators."""
    return [node for tree in trees() for node in ast.walk(tree) if is_compiled(node, by)]


def is_plain(function: ast.FunctionDef) -> bool:
    """Whether a function gives back numbers only."""
    assert function.returns is not None
    return names_in(function.returns) <= PLAIN


def names_in(*nodes: ast.AST) -> set[str]:
    return {n.id for node in nodes for n in ast.walk(node) if isinstance(n, ast.Name)}


def test_lean_functions_neither_give_back_arrays_nor_take_any_from_others():
    functions = compiled_functions(BOTH[0])
    assert len(functions) > 50
    giving = {f.name for f in compiled_functions(BOTH[1]) if not is_plain(f)}
    assert "trace" in giving
    for function in functions:
        assert is_plain(function), function.name
        assert not names_in(function) & giving, function.name


def test_every_loop_is_compiled_by_one_of_the_two():
    users = [
        path.name
        for path in FOLDER.rglob("*.py")
        if "from numba" in path.read_text(encoding="utf-8")
    ]
    assert users == ["compiled.py"]


def named_by_python(tree: ast.Module) -> set[str]:
    """What the functions of a file that are not compiled, and the file itself, name of planner."""
    known = {node.name for node in tree.body if is_compiled(node, set().union(*BOTH))}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("planner."):
            known |= {alias.name for alias in node.names}
    plain = [node for node in tree.body if not is_compiled(node, set().union(*BOTH))]
    return known & names_in(*plain)


def test_what_python_calls_has_an_entry_and_nothing_else():
    python = set().union(*(named_by_python(tree) for tree in trees()))
    assert "relax" in python
    inner = {function.name for function in compiled_functions(INNER)}
    assert len(inner) > 50
    assert not inner & python
    others = {function.name for function in compiled_functions(set().union(*BOTH) - INNER)}
    assert others <= python


def test_a_function_without_an_entry_says_so_to_python():
    with pytest.raises(TypeError, match="first_not_below has no entry for Python"):
        compiled.first_not_below(np.arange(3), 1)


@njit_no_refcount
def _makes_an_array(count: int) -> int:
    return len(np.empty(count))


@njit_arrays
def _makes_one_too(count: int) -> int:
    return len(np.empty(count))


@njit_no_refcount
def _calls_one_that_does(count: int) -> int:
    return _makes_one_too(count) + 1


def test_a_lean_function_that_makes_an_array_is_refused():
    with pytest.raises(numba.TypingError):
        _makes_an_array(3)


def test_a_lean_function_may_call_one_that_makes_arrays():
    assert _calls_one_that_does(3) == 4


LOOK_UP = """
import sys
import numpy as np
from planner.compiled import slots_for, slots_of

slots_of(slots_for(10), np.arange(3))
print("numba.np.linalg" in sys.modules)
"""


def test_what_compiling_needs_is_loaded_for_compiling_alone(tmp_path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    told = [
        subprocess.check_output([sys.executable, "-c", LOOK_UP], env=environment, text=True)
        for _ in range(2)
    ]
    assert [line.strip() for line in told] == ["True", "False"]


def test_compiling_is_timed_once_for_a_function_and_what_it_calls():
    @njit_no_refcount
    def called(number: int) -> int:
        return number + 1

    @njit_no_refcount
    def calling(number: int) -> int:
        return 2 * called(number)

    began = time.perf_counter()
    with on_compiling() as compiling:
        assert calling(3) == 8
    assert 0 < compiling.taken_s <= time.perf_counter() - began
    with on_compiling() as compiling:
        assert calling(4) == 10
    assert compiling.taken_s == 0
