"""Wishes from many threads, fulfilled by one."""

from __future__ import annotations

import queue
from collections.abc import Callable


class Wishes:
    """Things to do, in the order in which they were wished for."""

    def __init__(self) -> None:
        self._queue: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()

    def add(self, wish: Callable[[], None]) -> None:
        """Returns at once; from any thread."""
        self._queue.put(wish)

    def grant(self, wait_s: float, fulfil: Callable[[Callable[[], None]], None]) -> None:
        """Has all that are there fulfilled; waits for one for so long."""
        try:
            wish = self._queue.get(timeout=wait_s) if wait_s > 0 else self._queue.get_nowait()
            while True:
                fulfil(wish)
                wish = self._queue.get_nowait()
        except queue.Empty:
            return
