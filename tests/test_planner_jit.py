"""Compiled functions that count no references neither make arrays nor give any back."""

from __future__ import annotations

import ast
from pathlib import Path

import numba
import numpy as np
import pytest

import planner
from planner.compiled import njit_arrays, njit_no_refcount

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
