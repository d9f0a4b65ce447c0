"""A page without a browser: a connection that a server takes for one of viser's own."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import msgspec
import numpy as np
import viser
import zstandard
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from app.viewer.page import Page

_SEEN_M = (0.0, -5.0, 5.0)
_WAIT_LIMIT_S = 300.0


class Watcher:
    """Opens the page at an address; hears all that comes until it is closed.

    `heard` counts the messages by kind, `heard_of` by the node that they are about; `last` has the
    latest of each kind, `last_of` of each kind and node. `shape_px` is the window's width and
    height. One that is lazy never reads what it is sent. `cookie` is what a browser would send.
    """

    def __init__(
        self,
        url: str,
        *,
        is_lazy: bool = False,
        width_px: int = 900,
        height_px: int = 600,
        cookie: str = "",
    ) -> None:
        self.heard: Counter[str] = Counter()
        self.heard_of: Counter[str] = Counter()
        self.last: dict[str, dict[str, Any]] = {}
        self.last_of: dict[tuple[str, str], dict[str, Any]] = {}
        self.shape_px = width_px, height_px
        self._socket = connect(
            url.replace("http", "ws", 1),
            subprotocols=[f"viser-v{viser.__version__}"],  # type: ignore[list-item]
            max_size=None,
            compression=None,
            additional_headers={"Cookie": cookie} if cookie else None,
        )
        self.say_camera(_SEEN_M, (0.0, 0.0, 0.0))
        self._ears = threading.Thread(target=self._listen, daemon=True)
        if not is_lazy:
            self._ears.start()

    def say_camera(
        self, position: tuple[float, float, float], look_at: tuple[float, float, float]
    ) -> None:
        """Tells the server where this page's camera is; a server counts no page before."""
        self._send(
            type="ViewerCameraMessage",
            wxyz=(1.0, 0.0, 0.0, 0.0),
            position=position,
            fov=0.9,
            near=0.01,
            far=1000.0,
            image_height=self.shape_px[1],
            image_width=self.shape_px[0],
            look_at=look_at,
            up_direction=(0.0, 0.0, 1.0),
        )

    def click(
        self,
        name: str,
        from_m: Sequence[float],
        along: Sequence[float],
        *,
        modifier: str | None = None,
    ) -> None:
        """Clicks this node by a ray from a point of the world, with a key held if one is named."""
        self._send(
            type="SceneNodeClickMessage",
            name=name,
            instance_index=None,
            ray_origin=tuple(from_m),
            ray_direction=tuple(along),
            screen_pos=(0.5, 0.5),
            modifier=modifier,
        )

    def close(self) -> None:
        """Closes the page politely."""
        self._socket.close()

    def vanish(self) -> None:
        """Is gone without a word, as when a laptop falls asleep or a browser crashes."""
        with contextlib.suppress(OSError):
            self._socket.socket.shutdown(2)

    def _send(self, **message: Any) -> None:
        self._socket.send(msgspec.msgpack.encode(message))

    def _listen(self) -> None:
        unzip = zstandard.ZstdDecompressor()
        try:
            for raw in self._socket:
                assert isinstance(raw, bytes)
                packed = int(np.frombuffer(raw[8:16], "<u8")[0])
                window = msgspec.msgpack.decode(unzip.decompress(raw[16 : 16 + packed]))
                for message in window["messages"]:
                    kind, name = message["type"], message.get("name", "")
                    self.heard[kind] += 1
                    self.heard_of[name] += 1
                    self.last[kind] = self.last_of[kind, name] = message
        except (ConnectionClosed, OSError):
            return


@contextlib.contextmanager
def painted_in_background(page: Page) -> Iterator[None]:
    """Lets a thread of its own draw the page meanwhile."""
    ends = threading.Event()
    painter = threading.Thread(target=lambda: page.run(ends.is_set), name="painter")
    painter.start()
    try:
        yield
    finally:
        ends.set()
        painter.join()


def wait(
    wanted: Callable[[], bool], pass_time: Callable[[], None] = lambda: time.sleep(0.001)
) -> None:
    """Waits until something is so; raises TimeoutError after five minutes."""
    until_s = time.monotonic() + _WAIT_LIMIT_S
    while not wanted():
        if time.monotonic() > until_s:
            raise TimeoutError("waited in vain")
        pass_time()
