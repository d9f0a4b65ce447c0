"""What a page is sent: all that is kept, in order, then what is new, and never half of a thing."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from itertools import chain
from typing import Any

import pytest
from viser import _messages as messages
from viser.infra import ClientId
from viser.infra._async_message_buffer import AsyncMessageBuffer

from app.viewer.server import make_thread_safe, skip_superseded

DONE = messages.ReplayDoneMessage()


def run(script: Callable[[AsyncMessageBuffer], Awaitable[None]]) -> None:
    async def play() -> None:
        buffer = AsyncMessageBuffer(asyncio.get_running_loop(), persistent_messages=True)
        make_thread_safe(buffer)
        skip_superseded(buffer)
        await asyncio.wait_for(script(buffer), 60)

    asyncio.run(play())


def put(buffer: AsyncMessageBuffer, name: str, x_m: float) -> None:
    buffer.push(messages.SetPositionMessage(name, (x_m, 0.0, 0.0)))


def told(window: Any) -> list[Any]:
    return [
        "done" if message is DONE else (message.name, message.position[0]) for message in window
    ]


def test_what_is_kept_comes_first_then_its_end_then_what_is_new():
    async def script(buffer: AsyncMessageBuffer) -> None:
        for x_m in range(1000):
            put(buffer, "/a", x_m)
        put(buffer, "/b", 1)
        page = buffer.window_generator(0, DONE)
        put(buffer, "/c", 2)
        assert told(await anext(page)) == [("/a", 999), ("/b", 1), "done"]
        assert told(await anext(page)) == [("/c", 2)]
        waits = asyncio.ensure_future(anext(page))
        await asyncio.sleep(0.05)
        assert not waits.done()
        put(buffer, "/a", 3)
        assert told(await waits) == [("/a", 3)]
        await page.aclose()
        assert buffer.generator_cursors == {}

    run(script)


def test_much_comes_in_pieces_and_nothing_is_lost():
    async def script(buffer: AsyncMessageBuffer) -> None:
        for number in range(300):
            put(buffer, f"/{number}", number)
        page = buffer.window_generator(0, DONE)
        pieces = [told(await anext(page)) for _ in range(3)]
        assert [len(piece) for piece in pieces] == [128, 128, 45]
        assert [*chain(*pieces)] == [*((f"/{n}", n) for n in range(300)), "done"]

    run(script)


def test_a_page_that_lags_gets_the_latest_and_its_lag_is_known():
    async def script(buffer: AsyncMessageBuffer) -> None:
        put(buffer, "/a", 0)
        lazy, quick = (buffer.window_generator(number, DONE) for number in (0, 1))
        assert told(await anext(lazy)) == told(await anext(quick)) == [("/a", 0), "done"]
        for x_m in range(1, 4):
            put(buffer, "/a", x_m)
            assert told(await anext(quick)) == [("/a", x_m)]
        assert (buffer.generator_cursors[0], buffer.generator_cursors[1]) == (0, 3)
        assert told(await anext(lazy)) == [("/a", 3)]

    run(script)


def test_half_of_a_thing_is_not_sent_and_its_own_words_come_back_to_nobody():
    async def script(buffer: AsyncMessageBuffer) -> None:
        page = buffer.window_generator(5, DONE)
        assert told(await anext(page)) == ["done"]
        buffer.atomic_start()
        waits = asyncio.ensure_future(anext(page))
        put(buffer, "/a", 0)
        await asyncio.sleep(0.05)
        assert not waits.done()
        own = messages.SetPositionMessage("/own", (0.0, 0.0, 0.0))
        own.excluded_self_client = ClientId(5)
        buffer.push(own)
        put(buffer, "/b", 1)
        buffer.atomic_end()
        assert told(await waits) == [("/a", 0), ("/b", 1)]

    run(script)


def test_a_buffer_that_is_closed_ends_its_pages():
    async def script(buffer: AsyncMessageBuffer) -> None:
        page = buffer.window_generator(0, DONE)
        await anext(page)
        waits = asyncio.ensure_future(anext(page))
        await asyncio.sleep(0.05)
        buffer.set_done()
        with pytest.raises(StopAsyncIteration):
            await waits

    run(script)
