"""Compiled code: its arrays, slots and caches, and functions that count no references."""

from __future__ import annotations

import ast
import mmap
import os
import subprocess
import sys
import time
from pathlib import Path

import numba
import numpy as np
import pytest

import planner
from planner.compiled import (
    in_tiles,
    njit_arrays,
    njit_no_refcount,
    slot_of,
    slots_for,
    slots_of,
    take_slot,
    tiled,
    zeros,
)


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


FOLDER = Path(planner.__file__).parent
# What njit_no_refcount functions may give back: numbers, and tuples of numbers.
PLAIN = {"None", "bool", "int", "float", "tuple", "_Box"}


def compiled_functions(by: str) -> list[ast.FunctionDef]:
    """The functions of the package that are compiled by this decorator."""
    nodes = [
        node
        for path in sorted(FOLDER.rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    ]
    return [
        node
        for node in nodes
        if isinstance(node, ast.FunctionDef)
        and any(isinstance(d, ast.Name) and d.id == by for d in node.decorator_list)
    ]


def is_plain(function: ast.FunctionDef) -> bool:
    """Whether a function gives back numbers only."""
    assert function.returns is not None
    return names_in(function.returns) <= PLAIN


def names_in(node: ast.AST) -> set[str]:
    return {n.id for n in ast.walk(node) if isinstance(n, ast.Name)}


def test_lean_functions_neither_give_back_arrays_nor_take_any_from_others():
    functions = compiled_functions("njit_no_refcount")
    assert len(functions) > 50
    giving = {f.name for f in compiled_functions("njit_arrays") if not is_plain(f)}
    assert "new_workspace" in giving
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


CALLEE = "from numba import njit\n\n\n@njit(cache=True)\ndef value():\n    return {}\n"
CALLER = (
    "from numba import njit\n\nfrom planner.callee import value\n\n\n"
    "@njit(cache=True)\ndef twice():\n    return 2 * value()\n"
)


@pytest.fixture
def sources(tmp_path):
    """A folder with a package `planner` of which two functions are compiled."""
    folder = tmp_path / "planner"
    folder.mkdir()
    (folder / "__init__.py").write_text(Path(planner.__file__).read_text())
    (folder / "callee.py").write_text(CALLEE.format(1))
    (folder / "caller.py").write_text(CALLER)
    return folder


def twice(sources: Path) -> str:
    """What the compiled function of the package says in a process of its own."""
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    return subprocess.run(
        [sys.executable, "-c", "from planner.caller import twice; print(twice())"],
        cwd=sources.parent,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    ).stdout.strip()


def test_a_changed_callee_in_another_file_is_compiled_anew(sources):
    for number in (1, 2):
        (sources / "callee.py").write_text(CALLEE.format(number))
        assert twice(sources) == str(2 * number)


@pytest.mark.slow
def test_caches_of_other_sources_go_once_they_are_old_and_nothing_else_does(sources):
    caches = sources / "__pycache__"
    old, used, young = (caches / f"numba-{name}" for name in ("old", "used", "young"))
    others = caches / "numbers", caches / "numba.txt"
    for folder in (old, used, young, others[0]):
        (folder / "part").mkdir(parents=True)
        (folder / "part" / "code.nbc").write_text("")
    others[1].write_text("")
    two_days_ago = time.time() - 2 * 24 * 3600
    for path in caches.rglob("*"):
        # Of `used` one file was written just now.
        if path.is_relative_to(young) or path == used / "part" / "code.nbc":
            continue
        os.utime(path, (two_days_ago, two_days_ago))
    assert twice(sources) == "2"
    assert not old.exists()
    for kept in (used, young, *others):
        assert kept.exists()
    # The cache of these sources is there now, and is left alone however old it is.
    (own,) = set(caches.glob("numba-*")) - {used, young}
    for path in (own, *own.rglob("*")):
        os.utime(path, (two_days_ago, two_days_ago))
    assert twice(sources) == "2"
    assert own.exists()
