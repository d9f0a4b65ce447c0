"""A limit on the clock: whoever computes for long looks at it on the way."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Iterator
from contextvars import ContextVar

_until_s: ContextVar[float] = ContextVar("_until_s", default=math.inf)


class OutOfTime(Exception):
    """The limit has passed before there was anything to give back."""


@contextlib.contextmanager
def within(time_s: float) -> Iterator[None]:
    """Limits what is done inside to so many seconds from now, or to an earlier limit outside."""
    token = _until_s.set(min(time.perf_counter() + time_s, _until_s.get()))
    try:
        yield
    finally:
        _until_s.reset(token)


def time_left_s() -> float:
    """Seconds until the limit, inf without one."""
    until_s = _until_s.get()
    return until_s - time.perf_counter() if until_s < math.inf else math.inf


def is_late(ahead_s: float = 0.0) -> bool:
    """Whether the limit has passed, or will before so many seconds have."""
    return time_left_s() <= ahead_s


def check_time(ahead_s: float = 0.0) -> None:
    """Raises OutOfTime if it is late."""
    if is_late(ahead_s):
        raise OutOfTime
