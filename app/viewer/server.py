"""The web server of the page: viser's, made quiet and kept on this machine."""

from __future__ import annotations

import contextlib
import io
import socket

import viser

from app.errors import InputError
from app.viewer.backlog import calm, shorten

LOCAL = "127.0.0.1"


class PageServer(viser.ViserServer):
    """A viser server that opens no tunnel to other networks, whatever a page asks for."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Refuses: what is served here is for those who can reach this machine."""
        return None

    def calm(self) -> None:
        """Makes viser's buffers bear many threads and long hours; before any page is open."""
        messages = self._websock_server
        calm(messages.get_message_buffer())
        shorten(messages.get_message_buffer())
        # These run before anybody waits for the messages of a new page.
        messages.on_client_connect(lambda connection: calm(connection.get_message_buffer()))

    def stop(self) -> None:
        """Ends the server, without viser's word about it on standard output."""
        with contextlib.redirect_stdout(io.StringIO()):
            super().stop()

    @property
    def url(self) -> str:
        """What to type into the browser."""
        host = self.get_host()
        return f"http://{'localhost' if host in ('0.0.0.0', '::') else host}:{self.get_port()}"


def open_server(*, host: str = LOCAL, port: int = 0, title: str) -> PageServer:
    """A server at this address; with port 0 the system chooses a free one.

    Raises:
        InputError: The address cannot be had.
    """
    port = _free_port(host, port)
    # viser announces itself on standard output, which belongs to results.
    with contextlib.redirect_stdout(io.StringIO()):
        server = PageServer(host=host, port=port, label=title, verbose=False)
    server.calm()
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    return server


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
