"""How the loops of this package are compiled.

numba counts the references to every array that a function is given, in each call and with locked
instructions, also for those that come in tuples: with the spaces, heuristics and trees of a search
that took more time than the search itself. A function that makes no arrays need not count any, for
its caller holds all that it is given.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from numba import njit

_Function = TypeVar("_Function", bound=Callable[..., object])
_jit: Any = njit  # its types do not know of the option


def lean(function: _Function) -> _Function:
    """Compiles a function that makes no arrays, takes none from others and gives none back.

    Nobody would count them. That it makes none the compiler checks.
    """
    compiled: _Function = _jit(cache=True, _nrt=False)(function)
    return compiled


def allocating(function: _Function) -> _Function:
    """Compiles a function that makes arrays; said in so many words for those that `lean` ones call.

    They would else do as their callers do.
    """
    compiled: _Function = _jit(cache=True, _nrt=True)(function)
    return compiled
