"""Where a page's camera goes: what it sees at first, and how it follows the robot."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import viser
from numpy.typing import ArrayLike

from app.viewer.html_page import PHONE_SHARE
from app.viewer.pointer import SurfaceHit
from maps.grid import OccupancyGrid

# What a ray from a point (3,) along a direction (3,) meets first: floor, wall or box.
Met = Callable[[ArrayLike, ArrayLike], SurfaceHit | None]

FIELD_OF_VIEW_RAD = math.radians(50)
# The panel is at the bottom of a phone, over this share of the window at most.
_PHONE_ASPECT = 0.7
# Elsewhere it is at the right, over about this share.
_PANEL_SHARE = 0.22
# The first view is from the south, so far from the vertical: walls hide little floor.
_FROM_VERTICAL_RAD = math.radians(33)
_NEAREST_M = 3.0
_MARGIN = 1.17
# A camera that begins to follow comes so near, and looks at this height above the ground.
FOLLOW_DISTANCE_M = 4.5
_PHONE_DISTANCE_M = 5.5
FOLLOW_HEIGHT_M = 0.8
_BEHIND_RAD = math.radians(20)
# Where walls hide the feet it looks down more steeply, in steps, and no more than this.
_STEEPEST_RAD, _STEEPER_RAD = math.radians(80), math.radians(3)
# The feet: so far to the sides as the camera sees them, so far above the ground.
_FEET_ASIDE_M, _FEET_HEIGHT_M = (-0.15, 0.0, 0.15), 0.05
# So far behind in time that the picture does not sway with the gait.
_LAG_S = 0.7
# Whoever turns the view is let alone for so long.
HANDS_OFF_S = 0.4
_STILL_M = 1e-3
# What a page says of its camera may be as old as this many turns of the view.
_REMEMBERED = 120
# Of a window that has not said so far which shape it has.
_ASPECT = 1.5
# A page that has just opened may go to where all pages begin after it was aimed.
_OPENS_FOR_S = 20.0
_AIM_EVERY_S = 1.0
_ALIKE_M = 0.05
VIEWS = ("Overview", "Above", "Behind")


@dataclass(frozen=True, kw_only=True)
class Sight:
    """A camera in the world: position_m (3,) and the point look_at_m (3,) in its middle."""

    position_m: np.ndarray
    look_at_m: np.ndarray

    @property
    def distance_m(self) -> float:
        """From the camera to the point that it looks at."""
        return float(np.linalg.norm(self.look_at_m - self.position_m))

    @property
    def forward(self) -> np.ndarray:
        """The direction of view (3,), of length 1."""
        away_m: np.ndarray = self.look_at_m - self.position_m
        return away_m / max(self.distance_m, 1e-9)


def is_phone(aspect: float) -> bool:
    """Whether a window of this aspect, width over height, is that of a phone held upright."""
    return aspect < _PHONE_ASPECT


def free_middle(aspect: float) -> tuple[float, float]:
    """The middle of what the panel leaves free, from -1 left, down to 1 right, up of a window."""
    return (0.0, PHONE_SHARE) if is_phone(aspect) else (-_PANEL_SHARE, 0.0)


def centred(point_m: np.ndarray, forward: np.ndarray, distance_m: float, aspect: float) -> Sight:
    """The camera that looks along forward (3,) and shows the point (3,) where no panel is."""
    right_share, up_share = free_middle(aspect)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    length = float(np.linalg.norm(right))
    # Straight down there is no telling which way is right.
    right = right / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])
    up = np.cross(right, forward)
    half_m = distance_m * math.tan(FIELD_OF_VIEW_RAD / 2)
    look_at_m = point_m - half_m * (right_share * aspect * right + up_share * up)
    return Sight(position_m=look_at_m - distance_m * forward, look_at_m=look_at_m)


def overview(grid: OccupancyGrid, aspect: float, *, beside_panel: bool = True) -> Sight:
    """The camera that sees the whole map from the south, above, and where the panel is not."""
    x0, y0, x1, y1 = grid.bounds_world()
    middle_m = np.array([(x0 + x1) / 2, (y0 + y1) / 2, 0.0])
    right_share, up_share = free_middle(aspect) if beside_panel else (0.0, 0.0)
    sin, cos = math.sin(_FROM_VERTICAL_RAD), math.cos(_FROM_VERTICAL_RAD)
    tangent = math.tan(FIELD_OF_VIEW_RAD / 2)
    # The southern edge is the nearest to the camera, and so the widest in the window.
    nearer_m = (y1 - y0) / 2 * sin
    wide_m = (x1 - x0) / 2 / (tangent * aspect * (1 - abs(right_share)))
    tall_m = (y1 - y0) / 2 * cos / (tangent * (1 - abs(up_share)))
    distance_m = max(_MARGIN * (max(wide_m, tall_m) + nearer_m), _NEAREST_M)
    forward = np.array([0.0, sin, -cos])
    if beside_panel:
        return centred(middle_m, forward, distance_m, aspect)
    return Sight(position_m=middle_m - distance_m * forward, look_at_m=middle_m)


def from_above(grid: OccupancyGrid, aspect: float) -> Sight:
    """The camera that sees the whole map as a plan is drawn: from above, y upward."""
    tilted = overview(grid, aspect)
    x0, y0, x1, y1 = grid.bounds_world()
    # A hair from the vertical, where it would not be known which way is up.
    forward = np.array([0.0, 1e-3, -1.0])
    middle_m = np.array([(x0 + x1) / 2, (y0 + y1) / 2, 0.0])
    return centred(middle_m, forward / np.linalg.norm(forward), tilted.distance_m, aspect)


def towards(
    robot_m: np.ndarray, forward: np.ndarray, distance_m: float, aspect: float, met: Met
) -> Sight:
    """The camera that looks along forward (3,) at a robot on the ground at robot_m (3,).

    Where floor, walls or boxes would hide the feet it looks down more steeply.
    """
    point_m = robot_m + np.array([0.0, 0.0, FOLLOW_HEIGHT_M])
    level = math.hypot(forward[0], forward[1])
    sight = centred(point_m, forward, distance_m, aspect)
    if level < 1e-6:
        return sight
    ahead = np.array([forward[0], forward[1], 0.0]) / level
    down_rad = math.atan2(-forward[2], level)
    while _hides_feet(sight, robot_m, met) and down_rad < _STEEPEST_RAD:
        down_rad = min(down_rad + _STEEPER_RAD, _STEEPEST_RAD)
        forward = math.cos(down_rad) * ahead - np.array([0.0, 0.0, math.sin(down_rad)])
        sight = centred(point_m, forward, distance_m, aspect)
    return sight


def _hides_feet(sight: Sight, robot_m: np.ndarray, met: Met) -> bool:
    """Whether a ray from the camera to the feet of the robot at robot_m (3,) ends before them."""
    away = robot_m - sight.position_m
    aside = np.array([-away[1], away[0], 0.0]) / max(math.hypot(away[0], away[1]), 1e-9)
    for aside_m in _FEET_ASIDE_M:
        foot_m = robot_m + aside_m * aside + np.array([0.0, 0.0, _FEET_HEIGHT_M])
        hit = met(sight.position_m, foot_m - sight.position_m)
        if hit is not None:
            hit_m = math.dist(sight.position_m, (hit.x_m, hit.y_m, hit.z_m))
            if hit_m < math.dist(sight.position_m, foot_m):
                return True
    return False


def behind(yaw_rad: float) -> np.ndarray:
    """The direction (3,) in which one looks from behind, and above, a robot that faces yaw_rad."""
    level, down = math.cos(_BEHIND_RAD), math.sin(_BEHIND_RAD)
    return np.array([level * math.cos(yaw_rad), level * math.sin(yaw_rad), -down])


def near_m(aspect: float) -> float:
    """How far a camera that follows is from what it looks at, unless somebody zooms."""
    return _PHONE_DISTANCE_M if is_phone(aspect) else FOLLOW_DISTANCE_M


class Follower:
    """One page's camera on its way after the robot.

    Whoever watches chooses direction and distance: what the page says of its camera counts, unless
    it is what it was told itself a moment ago. While something hides the feet, the camera looks
    down more steeply than was chosen.
    """

    def __init__(self, now: Sight, aspect: float, now_s: float, met: Met) -> None:
        """Begins with the camera as it is; aspect of the window, now_s of the clock."""
        self._told = deque([now], maxlen=_REMEMBERED)
        self._sight, self._forward = now, now.forward
        self._distance_m = min(now.distance_m, near_m(aspect))
        self._now_s, self._free_from_s, self._met = now_s, -math.inf, met

    def next(self, seen: Sight, robot_m: np.ndarray, aspect: float, now_s: float) -> Sight | None:
        """Where the camera goes now; None if it stays.

        seen: what the page said last; robot_m (3,): the ground below the robot.
        """
        share = 1 - math.exp(-(now_s - self._now_s) / _LAG_S)
        self._now_s = now_s
        if not any(_is_alike(seen, told) for told in self._told):
            self._sight, self._distance_m = seen, seen.distance_m
            self._forward = seen.forward
            self._told.clear()
            self._told.append(seen)
            self.hold(now_s)
        if now_s < self._free_from_s:
            return None
        before = self._sight
        distance_m = before.distance_m + share * (self._distance_m - before.distance_m)
        wanted = towards(robot_m, self._forward, distance_m, aspect, self._met)
        away_m = wanted.look_at_m - before.look_at_m
        turn = wanted.forward - before.forward
        if (
            max(np.linalg.norm(away_m), np.linalg.norm(turn)) < _STILL_M
            and abs(distance_m - before.distance_m) < _STILL_M
        ):
            return None
        look_at_m, forward = before.look_at_m + share * away_m, before.forward + share * turn
        forward /= np.linalg.norm(forward)
        self._sight = Sight(position_m=look_at_m - distance_m * forward, look_at_m=look_at_m)
        if not _is_alike(self._sight, self._told[-1]):
            self._told.append(self._sight)
        return self._sight

    def jump(self, robot_m: np.ndarray, forward: np.ndarray, aspect: float) -> Sight:
        """Where the camera is to look from along forward (3,), at once; for the rest see `next`."""
        # The page may say the old place for long.
        self._sight = towards(robot_m, forward, near_m(aspect), aspect, self._met)
        self._forward, self._distance_m = forward, self._sight.distance_m
        self._told.append(self._sight)
        return self._sight

    def hold(self, now_s: float) -> None:
        """Lets the camera alone for a moment, because somebody has their hands on the page."""
        self._free_from_s = now_s + HANDS_OFF_S


def _is_alike(one: Sight, other: Sight) -> bool:
    """Whether two cameras look the same way from as far: then nobody has turned or zoomed."""
    turned = float(np.linalg.norm(one.forward - other.forward))
    return turned < 5e-3 and abs(one.distance_m / max(other.distance_m, 1e-9) - 1) < 1e-2


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
    opened_s: float = field(default_factory=time.monotonic)
    aimed_s: float = field(default_factory=time.monotonic)
    follower: Follower | None = None


class Cameras:
    """Aims the camera of each page that opens, and lets it follow the robot where that is wanted.

    Each page has a switch of its own in the panel, at the place `order` among the controls. `met`
    says what is between camera and robot.
    """

    def __init__(
        self, server: viser.ViserServer, grid: OccupancyGrid, *, order: float, met: Met
    ) -> None:
        self._grid, self._order, self._met = grid, order, met
        self._begin = overview(grid, _ASPECT)
        aim_pages(server, self._begin)
        self._visitors: dict[int, _Visitor] = {}
        self._lock = threading.Lock()
        self._robot_m, self._yaw_rad = np.zeros(3), 0.0
        server.on_client_connect(self._came)
        server.on_client_disconnect(self._left)

    @property
    def count(self) -> int:
        """How many pages are open."""
        return len(self._visitors)

    def show(self, ground_m: np.ndarray, yaw_rad: float) -> None:
        """Moves the cameras that follow; ground_m (3,) is the ground below the robot."""
        now_s = time.monotonic()
        self._robot_m, self._yaw_rad = ground_m, yaw_rad
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

    def toggle(self, client_id: int | None) -> None:
        """Follows on this page, or does so no longer."""
        if client_id is not None and (visitor := self._visitors.get(client_id)) is not None:
            visitor.switch.value = not visitor.switch.value

    def _came(self, client: viser.ClientHandle) -> None:
        switch = client.gui.add_checkbox(
            "Camera follows",
            initial_value=False,
            order=self._order,
            hint="On this page alone. Turn the view and come nearer as you like meanwhile.",
        )
        aspect = client.camera.aspect
        visitor = _Visitor(client=client, switch=switch, is_upright=is_phone(aspect))
        switch.on_update(lambda _event: self._switched(visitor))
        views = client.gui.add_button_group("View", VIEWS, order=self._order)
        views.on_click(lambda event: self.look(visitor, event.target.value))
        with self._lock:
            self._visitors[client.client_id] = visitor
        _aim(client, overview(self._grid, aspect))

    def look(self, visitor: _Visitor, view: str) -> None:
        """Aims a page's camera as one of VIEWS says; behind the robot it goes on to follow."""
        aspect = visitor.client.camera.aspect
        follows = view == "Behind"
        if follows:
            follower = visitor.follower = self._follower(visitor)
            sight = follower.jump(self._robot_m, behind(self._yaw_rad), aspect)
        else:
            visitor.follower = None
            sight = (from_above if view == "Above" else overview)(self._grid, aspect)
        if visitor.switch.value != follows:
            visitor.switch.value = follows
        _aim(visitor.client, sight)

    def _left(self, client: viser.ClientHandle) -> None:
        with self._lock:
            self._visitors.pop(client.client_id, None)

    def _switched(self, visitor: _Visitor) -> None:
        if not visitor.switch.value:
            visitor.follower = None
        elif visitor.follower is None:
            visitor.follower = self._follower(visitor)

    def _follower(self, visitor: _Visitor) -> Follower:
        camera = visitor.client.camera
        return Follower(_sight(camera), camera.aspect, time.monotonic(), self._met)


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
