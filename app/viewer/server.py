"""The web server of the page: viser's, made quiet and kept on this machine."""

from __future__ import annotations

import asyncio
import contextlib
import io
import json
import socket
import warnings
from collections.abc import AsyncGenerator, Sequence
from functools import partial
from http.cookies import CookieError, SimpleCookie
from typing import Any

import viser
from viser._messages import RunJavascriptMessage

from app.output import InputError
from app.viewer.access import ANY_ADDRESS, KEY, Access, guarding, refuse
from app.viewer.html_page import OpenedLinks, dressed
from app.viewer.messages import may_be_carried_out

LOCAL = "127.0.0.1"
# For a page that was open already when this server took the place of another: viser leaves it the
# title of that one, and says of what was being sent that it still is.
_ON_CONNECT = """
document.title = TITLE;
for (const told of document.querySelectorAll('.mantine-Notification-root'))
  if (told.innerText.startsWith('Uploading ')) told.style.display = 'none';
"""


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


def make_thread_safe(buffer: Any) -> None:
    """Lets any thread write to this buffer of viser's; see OneThreadEvent."""
    buffer.message_event = OneThreadEvent(buffer.event_loop)


def skip_superseded(buffer: Any) -> None:
    """Lets a page that opens get what this buffer keeps without a look at what it does not.

    viser looks up all messages that there ever were whenever a page opens: half a second for each
    hour that a robot walked.
    """
    buffer.caught_up = set()
    buffer._window_loop = partial(windows, buffer)


async def windows(
    buffer: Any, client_id: int, backlog_last_id: int, backlog_done_message: Any
) -> AsyncGenerator[list[Any], None]:
    """What one page is to be sent, piece by piece, until the buffer is closed.

    All that is kept up to `backlog_last_id` comes first, then the message that says so, if there
    is one, then what is new; a page that has been sent the first is among `buffer.caught_up`. One
    that lags gets the latest of each kind. Nothing is sent that is half of something: viser's
    `atomic`.
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
                if backlog_done_message is None:
                    buffer.caught_up.add(client_id)
            else:
                await buffer.message_event.wait()
                buffer.message_event.clear()
            if not window or sent_id == buffer.message_counter - 1:
                await asyncio.sleep(buffer.window_duration_sec)
    finally:
        buffer.generator_cursors.pop(client_id, None)
        buffer.caught_up.discard(client_id)


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


class PageServer(viser.ViserServer):
    """A viser server that opens no tunnel to other networks, whatever a page asks for."""

    access: Access
    links: OpenedLinks

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Refuses: what is served here is for those who can reach this machine."""
        return None

    def stop(self) -> None:
        """Ends the server, without viser's word about it on standard output."""
        with contextlib.redirect_stdout(io.StringIO()):
            super().stop()

    @property
    def url(self) -> str:
        """What to type into the browser."""
        host = self.get_host()
        host = "localhost" if host in ANY_ADDRESS else f"[{host}]" if ":" in host else host
        key = f"/?{KEY}={self.access.key}" if self.access.key else ""
        return f"http://{host}:{self.get_port()}{key}"

    def has_all(self, client_id: int) -> bool:
        """Whether this page has been sent all that there was when it opened."""
        return client_id in self.broadcast.caught_up

    def cookie(self, client_id: int, name: str) -> str:
        """What the browser of this page keeps under a name; empty where it keeps nothing."""
        connection = self._websock_server._live_connections.get(client_id)
        request = None if connection is None else connection.request
        with contextlib.suppress(CookieError):
            cookies = SimpleCookie("" if request is None else request.headers.get("Cookie", ""))
            return cookies[name].value if name in cookies else ""
        return ""

    @staticmethod
    def run_script(client: viser.ClientHandle, source: str) -> None:
        """Runs JavaScript on one page, once."""
        client._websock_connection.queue_message(RunJavascriptMessage(source=source))

    @property
    def broadcast(self) -> Any:
        """The buffer of what all pages are sent, those that open later too."""
        return self._websock_server.get_message_buffer()


def open_server(
    *,
    host: str = LOCAL,
    port: int = 0,
    title: str,
    names: Sequence[str] = (),
    access: Access | None = None,
) -> PageServer:
    """A server at this address; with port 0 the system chooses a free one.

    names: hosts besides this one under which it may be asked for. access: that of a server whose
    place this one takes, so that its pages find their way back.

    Raises:
        InputError: The address cannot be had.
    """
    port = _free_port(host, port)
    # viser announces itself on standard output, which belongs to results.
    access, links = access or Access.at(host, names), OpenedLinks()
    with (
        contextlib.redirect_stdout(io.StringIO()),
        guarding(access, partial(dressed, title=title, links=links)),
    ):
        server = PageServer(host=host, port=port, label=title, verbose=False)
    server.access, server.links = access, links
    # A page that goes while something is sent to it is nothing that anybody could mend.
    warnings.filterwarnings("ignore", message="Queued a .* on a closed connection")
    _end_who_sends_nonsense(server)
    make_thread_safe(server.broadcast)
    skip_superseded(server.broadcast)
    # Before anybody waits for the messages of a new page.
    server._websock_server.on_client_connect(
        lambda connection: make_thread_safe(connection.get_message_buffer())
    )
    use_theme(server.gui, is_dark=False)
    script = _ON_CONNECT.replace("TITLE", json.dumps(title))
    server.on_client_connect(lambda client: server.run_script(client, script))
    return server


def use_theme(gui: viser.GuiApi, *, is_dark: bool) -> None:
    """Has the pages of a server, or the one of a client, look light or dark."""
    gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=is_dark)


def _end_who_sends_nonsense(server: PageServer) -> None:
    """Ends the connection of a page whose message fails; viser would go on, with a traceback."""
    sockets = server._websock_server
    handle: Any = sockets._handle_incoming_message

    async def handled(client_id: int, message: Any) -> None:
        try:
            if may_be_carried_out(server, client_id, message):
                await handle(client_id, message)
        except Exception as error:
            if client_id in sockets._live_connections:
                await refuse(sockets._live_connections[client_id], error)

    def guard(connection: Any) -> None:
        # Its own dispatch, of the same messages; the one above tells of those that are refused.
        handle_own = connection._handle_incoming_message

        async def handled_own(client_id: int, message: Any) -> None:
            may = False
            with contextlib.suppress(Exception):
                may = may_be_carried_out(server, client_id, message)
            if may:
                await handle_own(client_id, message)

        connection._handle_incoming_message = handled_own

    sockets._handle_incoming_message = handled  # type: ignore[method-assign]
    sockets.on_client_connect(guard)


def _free_port(host: str, port: int) -> int:
    """The port itself, or a free one for 0. viser would go on to the next one that is free."""
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host, port))
            return int(probe.getsockname()[1])
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"cannot serve at {host}:{port}: {reason}") from error
