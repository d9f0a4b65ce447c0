"""Who may speak to the page's server: pages that it served, with a key where others can reach it.

A page from elsewhere in the same browser may open a socket to this machine, and a name of its own
that it turns to 127.0.0.1 makes that look like one of its own addresses (DNS rebinding). So the
names under which the server is asked for, and the place that a socket comes from, must be its own.
"""

from __future__ import annotations

import asyncio
import contextlib
import http
import ipaddress
import logging
import secrets
import socket
from collections.abc import Awaitable, Callable, Iterator, Sequence
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from app.output import one_line, say

LOOPBACK = ("localhost", "127.0.0.1", "::1")
ANY_ADDRESS = ("0.0.0.0", "::", "")
KEY, COOKIE = "key", "footfall-key"
# Codes with which a socket is closed over which nonsense came: of this file, and of websockets.
_NONSENSE = (1008, 1002, 1003, 1007, 1009)
_REFUSED = "this page cannot have sent that"  # the reason of those of this file
# Pages send clicks and numbers; a map to upload comes in pieces that are smaller.
MOST_BYTES = 4 * 1024 * 1024

Handler = Callable[[ServerConnection], Awaitable[None]]
Answer = Callable[[ServerConnection, Request], Response | None]


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach a server at this address."""
    with contextlib.suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    return host == "localhost"


@dataclass(frozen=True)
class Access:
    """What a request must be like to be answered.

    host: the address that is served at. names: further ones under which the server may be asked
    for, such as that of a proxy, with its port where that is not the usual one. key: what the link
    must carry, none for loopback addresses.
    """

    host: str
    names: tuple[str, ...] = ()
    key: str = field(default="", repr=False)

    @classmethod
    def at(cls, host: str, names: Sequence[str] = ()) -> Access:
        """Access to a server at this address, with a new key if others can reach it."""
        return cls(host, tuple(names), "" if is_loopback(host) else secrets.token_urlsafe(16))

    def refusal(self, request: Request) -> str:
        """Why a request is not answered; empty if it is."""
        asked, origin = request.headers.get_all("Host"), request.headers.get_all("Origin")
        if len(asked) != 1 or not self._is_own(_host_of(f"//{asked[0]}")):
            return f"the name {', '.join(asked) or 'none'} is not of this page; see --allow-host"
        if request.headers.get("Upgrade", "").lower() == "websocket" and not all(
            self._is_own_page(place, asked[0]) for place in origin
        ):
            return f"a page of {', '.join(origin)} may not steer this robot; see --allow-host"
        if self.key and not self._has_key(request):
            return "open the link that was printed, with its key"
        return ""

    def _is_own(self, name: str) -> bool:
        if name in (*map(_host_of, self._places), self.host.lower()) or (
            is_loopback(self.host) and name in LOOPBACK
        ):
            return True
        if self.host not in ANY_ADDRESS:
            return False
        with contextlib.suppress(ValueError):
            ipaddress.ip_address(name)
            return True  # a number cannot be turned to another machine
        return name in (*LOOPBACK, socket.gethostname().lower())

    def _is_own_page(self, origin: str, asked: str) -> bool:
        # On another port of the same machine is another program's page.
        scheme, _, place = origin.lower().partition("://")
        is_same = scheme in ("http", "https") and place == asked.lower()
        return is_same or f"//{place}" in self._places

    @property
    def _places(self) -> list[str]:
        return [f"//{name}" for name in self.names]

    def _has_key(self, request: Request) -> bool:
        given = self._key_of_link(request)
        with contextlib.suppress(CookieError):
            cookies = SimpleCookie(request.headers.get("Cookie", ""))
            given += [cookies[COOKIE].value] if COOKIE in cookies else []
        return any(secrets.compare_digest(k.encode(), self.key.encode()) for k in given)

    def _key_of_link(self, request: Request) -> list[str]:
        return parse_qs(urlsplit(request.path).query).get(KEY, [])

    def guard(self, answer: Answer) -> Answer:
        """The answers of a server to those that may ask, and to others why not."""

        def guarded(connection: ServerConnection, request: Request) -> Response | None:
            refusal = self.refusal(request)
            if refusal:
                return connection.respond(http.HTTPStatus.FORBIDDEN, f"{refusal}\n")
            response = answer(connection, request)
            if response is not None and self.key and self._key_of_link(request):
                # What the page loads, and its socket, come without the link's key.
                response.headers["Set-Cookie"] = (
                    f"{COOKIE}={self.key}; HttpOnly; SameSite=Strict; Path=/"
                )
                response.headers["Referrer-Policy"] = "no-referrer"
            return response

        return guarded


def _host_of(address: str) -> str:
    """The host of an address, in small letters; empty where it is none."""
    with contextlib.suppress(ValueError):
        return (urlsplit(address).hostname or "").lower()
    return ""


def survives(handler: Handler) -> Handler:
    """The handler of connections, which ends one that sends nonsense, with one line about it."""

    async def surviving(connection: ServerConnection) -> None:
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(_tell_of_task)
        try:
            await handler(connection)
        except (ConnectionClosed, asyncio.CancelledError):
            raise
        except Exception as error:
            await refuse(connection, error)
        else:
            sent = connection.protocol.close_sent
            if sent is not None and sent.code in _NONSENSE and sent.reason != _REFUSED:
                _tell_of(sent.reason or "no message")

    return surviving


async def refuse(connection: ServerConnection, error: Exception) -> None:
    """Ends a connection over which something came that cannot be carried out, and says so once."""
    if connection.protocol.close_sent is None:
        _tell_of(f"{type(error).__name__}: {error}")
        await connection.close(_NONSENSE[0], _REFUSED)


def _tell_of(what: str) -> None:
    say(f"warning: a page sent what cannot be carried out ({one_line(what)[:120]})")


def _tell_of_task(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """One line about a message that could not be carried out."""
    error = context.get("exception")
    told = context.get("message") if error is None else f"{type(error).__name__}: {error}"
    _tell_of(str(told))


@contextlib.contextmanager
def guarding(access: Access, dressed: Callable[[Answer], Answer]) -> Iterator[None]:
    """Lets servers of websockets that start inside answer whom `access` lets in, and no others.

    `dressed` makes what is answered from what the server would. viser starts its own server and
    gives no way to look at requests first, nor to change its page.
    """
    serve = websockets.asyncio.server.serve

    def guarded(handler: Handler, *place: Any, process_request: Answer, **options: Any) -> Any:
        options |= {"max_size": MOST_BYTES}
        # Handshakes that fail are told to whoever asked.
        logging.getLogger("websockets.server").setLevel(logging.CRITICAL)
        return serve(
            survives(handler),
            *place,
            process_request=access.guard(dressed(process_request)),
            **options,
        )

    websockets.asyncio.server.serve = guarded  # type: ignore[misc,assignment]
    try:
        yield
    finally:
        websockets.asyncio.server.serve = serve  # type: ignore[misc]
