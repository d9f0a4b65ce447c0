"""Light or dark: each page has a switch of its own, and the map on it follows."""

from __future__ import annotations

from typing import Any

import viser
from viser._messages import SceneNodeUpdateMessage

from app.viewer.html_page import DARK_COOKIE, keep_dark
from app.viewer.scene import DARK, LIGHT, map_colours
from app.viewer.server import PageServer, use_theme


class ThemeSwitches:
    """A switch on each page, at the place `order` among the controls; the browser keeps it."""

    def __init__(self, server: PageServer, *, order: float) -> None:
        self._server, self._order = server, order
        # Pages that are to be dark as soon as there is a map on them.
        self._opening: dict[int, viser.ClientHandle] = {}
        server.on_client_connect(self._came)
        server.on_client_disconnect(self._left)

    def show(self) -> None:
        """Darkens pages that have opened since, where that was chosen before."""
        for client_id, client in list(self._opening.items()):
            if self._server.has_all(client_id):
                self._opening.pop(client_id, None)
                self._paint(client, is_dark=True)

    def _came(self, client: viser.ClientHandle) -> None:
        is_dark = self._server.cookie(client.client_id, DARK_COOKIE) == "1"
        switch: Any = client.gui.add_checkbox(
            "Dark", initial_value=is_dark, order=self._order, hint="On this page alone."
        )
        switch.on_update(lambda _event: self._switched(client, is_dark=switch.value))
        if is_dark:
            self._opening[client.client_id] = client

    def _left(self, client: viser.ClientHandle) -> None:
        self._opening.pop(client.client_id, None)

    def _switched(self, client: viser.ClientHandle, *, is_dark: bool) -> None:
        self._opening.pop(client.client_id, None)
        self._server.run_script(client, keep_dark(is_dark=is_dark))
        self._paint(client, is_dark=is_dark)

    def _paint(self, client: viser.ClientHandle, *, is_dark: bool) -> None:
        use_theme(client.gui, is_dark=is_dark)
        for name, colours in map_colours(DARK if is_dark else LIGHT).items():
            if self._server.scene.get_handle_by_name(name) is not None:
                message = SceneNodeUpdateMessage(name, dict(colours))
                client._websock_connection.queue_message(message)
