"""Compiled functions without an entry for Python, for tests that call them."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numba

_Function = TypeVar("_Function", bound=Callable[..., object])


def from_python(function: _Function) -> _Function:
    """A function that calls one that otherwise compiled functions alone call."""

    @numba.njit
    def call(*arguments):
        return function(*arguments)

    return call
