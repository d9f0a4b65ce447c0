"""Progress on standard error: a bar on a terminal, a plain line now and then elsewhere."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

LINE_EVERY_S = 5.0


class ProgressBar:
    """Shows how far a piece of work is; a context manager.

    Without a total nobody knows how long it takes: a bar that moves on its own, and the time.
    Standard output is never touched: it belongs to results.
    """

    def __init__(
        self, title: str, total: float | None, *, line_every_s: float = LINE_EVERY_S
    ) -> None:
        self._title = title
        self._total = total
        self._line_every_s = line_every_s
        self._line_at_s = 0.0
        self._bar: Progress | None = None
        self._task = TaskID(0)

    def __enter__(self) -> Self:
        self._line_at_s = time.monotonic() + self._line_every_s
        console = Console(stderr=True)
        if console.is_terminal:
            self._bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                TextColumn("{task.fields[amount]} {task.fields[note]}"),
                TimeElapsedColumn(),
                console=console,
                transient=True,
            )
            self._task = self._bar.add_task(
                self._title, total=self._total, amount=self._amount(0), note=""
            )
            self._bar.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    def update(self, done: float, note: str = "") -> None:
        """Tells how much of the total is done, with a short remark."""
        if self._bar is not None:
            self._bar.update(self._task, completed=done, amount=self._amount(done), note=note)
        elif time.monotonic() >= self._line_at_s:
            self._line_at_s = time.monotonic() + self._line_every_s
            say(" ".join(filter(None, (f"{self._title}:", self._amount(done), note))))

    def _amount(self, done: float) -> str:
        return "" if self._total is None else f"{done:g}/{self._total:g}"


def say(line: str) -> None:
    """One line of news on standard error."""
    print(line, file=sys.stderr, flush=True)
