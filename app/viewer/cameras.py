"""The cameras of all pages that are open, each with a will of its own."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import viser

from app.viewer.camera import FIELD_OF_VIEW_RAD, Follower, Sight, is_phone, overview
from maps.grid import OccupancyGrid

# Of a window that has not said so far which shape it has.
_ASPECT = 1.5
# A page that has just opened may go to where all pages begin after it was aimed.
_OPENS_FOR_S = 20.0
_AIM_EVERY_S = 1.0
_ALIKE_M = 0.05


@dataclass(kw_only=True)
class _Visitor:
    """Somebody's page: how to reach it, its switch, and its follower while that is on.

    is_upright: whether the camera was aimed for a phone that is held upright. opened_s, aimed_s:
    when the page opened, and when it was aimed, by the clock.
    """

    client: viser.ClientHandle
    is_upright: bool
    # Any: viser's types say that the value of a switch cannot be set.
    switch: Any
    opened_s: float
    aimed_s: float
    follower: Follower | None = None


class Cameras:
    """Aims the camera of each page that opens, and lets it follow the robot where that is wanted.

    Each page has a switch of its own in the panel, at the place `order` among the controls.
    """

    def __init__(self, server: viser.ViserServer, grid: OccupancyGrid, *, order: float) -> None:
        self._grid, self._order = grid, order
        self._begin = overview(grid, _ASPECT)
        aim_pages(server, self._begin)
        self._visitors: dict[int, _Visitor] = {}
        self._lock = threading.Lock()
        server.on_client_connect(self._came)
        server.on_client_disconnect(self._left)

    @property
    def count(self) -> int:
        """How many pages are open."""
        return len(self._visitors)

    def show(self, ground_m: np.ndarray) -> None:
        """Moves the cameras that follow; ground_m (3,) is the ground below the robot."""
        now_s = time.monotonic()
        with self._lock:
            visitors = list(self._visitors.values())
        for visitor in visitors:
            follower, camera = visitor.follower, visitor.client.camera
            sight = None
            if follower is not None:
                sight = follower.next(_sight(camera), ground_m, camera.aspect, now_s)
            elif is_phone(camera.aspect) != visitor.is_upright or self._is_astray(visitor, now_s):
                # The phone has been turned: what was free of the panel is not so any more.
                sight = overview(self._grid, camera.aspect)
                visitor.aimed_s = now_s
            visitor.is_upright = is_phone(camera.aspect)
            if sight is not None:
                _aim(visitor.client, sight)

    def _is_astray(self, visitor: _Visitor, now_s: float) -> bool:
        """Whether a page that has just opened looks from where all begin, not from its place."""
        if now_s - visitor.opened_s > _OPENS_FOR_S or now_s - visitor.aimed_s < _AIM_EVERY_S:
            return False
        camera = visitor.client.camera
        place_m, wanted = np.array(camera.position), overview(self._grid, camera.aspect)
        astray_m = np.linalg.norm(place_m - self._begin.position_m)
        return bool(astray_m < _ALIKE_M < np.linalg.norm(place_m - wanted.position_m))

    def hold(self, client_id: int) -> None:
        """Lets the camera of this page alone for a moment: its pointer is dragging something."""
        visitor = self._visitors.get(client_id)
        if visitor is not None and visitor.follower is not None:
            visitor.follower.hold(time.monotonic())

    def toggle(self, client_id: int) -> None:
        """Follows on this page, or does so no longer."""
        visitor = self._visitors.get(client_id)
        if visitor is not None:
            visitor.switch.value = not visitor.switch.value

    def _came(self, client: viser.ClientHandle) -> None:
        switch = client.gui.add_checkbox(
            "Camera follows",
            initial_value=False,
            order=self._order,
            hint="On this page alone. Turn the view and come nearer as you like meanwhile.",
        )
        aspect = client.camera.aspect
        now_s = time.monotonic()
        visitor = _Visitor(
            client=client,
            switch=switch,
            is_upright=is_phone(aspect),
            opened_s=now_s,
            aimed_s=now_s,
        )
        switch.on_update(lambda _event: self._switched(visitor))
        with self._lock:
            self._visitors[client.client_id] = visitor
        _aim(client, overview(self._grid, aspect))

    def _left(self, client: viser.ClientHandle) -> None:
        with self._lock:
            self._visitors.pop(client.client_id, None)

    def _switched(self, visitor: _Visitor) -> None:
        wanted = visitor.switch.value
        camera = visitor.client.camera
        follower = Follower(_sight(camera), camera.aspect, time.monotonic())
        visitor.follower = follower if wanted else None


def aim_pages(server: viser.ViserServer, sight: Sight) -> None:
    """What pages see when they open, and after "Reset View"."""
    camera = server.initial_camera
    camera.position, camera.look_at = sight.position_m, sight.look_at_m
    camera.fov = FIELD_OF_VIEW_RAD


def _sight(camera: viser.CameraHandle) -> Sight:
    return Sight(position_m=np.array(camera.position), look_at_m=np.array(camera.look_at))


def _aim(client: viser.ClientHandle, sight: Sight) -> None:
    with client.atomic():
        client.camera.position = sight.position_m
        client.camera.look_at = sight.look_at_m
