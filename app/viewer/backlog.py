"""How what is to be seen reaches a page: what is kept, in order, however much there was before."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from functools import partial
from typing import Any


class OneThreadEvent(asyncio.Event):
    """An event that is set in its loop's thread alone.

    viser sets the event of a buffer in whatever thread writes to it, and then once more in the
    loop's thread. The first can meet a change of who waits: "deque mutated during iteration", once
    in some 100,000 messages with several pages open, in the middle of somebody's frame.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__()
        self._loop_of_waiters = loop

    def set(self) -> None:
        """Wakes who waits; in another thread nothing happens."""
        try:
            running = asyncio.get_running_loop()
        except RuntimeError:
            return
        if running is self._loop_of_waiters:
            super().set()


def calm(buffer: Any) -> None:
    """Lets any thread write to this buffer of viser's; see OneThreadEvent."""
    buffer.message_event = OneThreadEvent(buffer.event_loop)


def shorten(buffer: Any) -> None:
    """Lets a page that opens get what this buffer keeps without a look at what it does not.

    viser numbers all messages that there ever were, keeps the latest of each kind, and looks every
    number up whenever a page opens: half a second for each hour that a robot walked.
    """
    buffer._window_loop = partial(windows, buffer)


async def windows(
    buffer: Any, client_id: int, backlog_last_id: int, backlog_done_message: Any
) -> AsyncGenerator[list[Any], None]:
    """What one page is to be sent, piece by piece, until the buffer is closed.

    All that is kept up to `backlog_last_id` comes first, then the message that says so, if there
    is one, then what is new. A page that lags gets the latest of each kind. Nothing is sent that
    is half of something: viser's `atomic`.
    """
    sent_id = -1
    try:
        while not buffer.done:
            is_backlog = backlog_done_message is not None
            last_id = backlog_last_id if is_backlog else buffer.message_counter - 1
            window, sent_id = _after(buffer, client_id, sent_id, last_id)
            # What everybody has seen may be thrown away.
            buffer.generator_cursors[client_id] = sent_id
            if is_backlog and sent_id >= last_id:
                window.append(backlog_done_message)
                backlog_done_message = None
            if window:
                yield window
            else:
                await buffer.message_event.wait()
                buffer.message_event.clear()
            if not window or sent_id == buffer.message_counter - 1:
                await asyncio.sleep(buffer.window_duration_sec)
    finally:
        buffer.generator_cursors.pop(client_id, None)


def _after(buffer: Any, client_id: int, sent_id: int, last_id: int) -> tuple[list[Any], int]:
    """The next messages after `sent_id` that are kept, and up to which number that is all."""
    with buffer.buffer_lock:
        if buffer.atomic_counter:
            return [], sent_id
        newer = [
            number
            for number, message in buffer.message_from_id.items()
            if sent_id < number <= last_id and message.excluded_self_client != client_id
        ]
        taken = newer[: buffer.max_window_size]
        window = [buffer.message_from_id[number] for number in taken]
    return window, taken[-1] if len(taken) < len(newer) else max(sent_id, last_id)
