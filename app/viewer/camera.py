"""Where a page's camera goes: what it sees at first, and how it follows the robot."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from maps.grid import OccupancyGrid

FIELD_OF_VIEW_RAD = math.radians(50)
# viser puts the panel at the bottom of a phone, over this share of the window at most.
_PHONE_ASPECT = 0.7
_PHONE_SHARE = 0.6
# Elsewhere it is at the right, over about this share.
_PANEL_SHARE = 0.22
# The first view is from the south, so far from the vertical: walls hide little floor.
_FROM_VERTICAL_RAD = math.radians(33)
_NEAREST_M = 3.0
_MARGIN = 1.17
# A camera that begins to follow comes so near, and looks at this height above the ground.
FOLLOW_DISTANCE_M = 4.5
_PHONE_DISTANCE_M = 8.0
FOLLOW_HEIGHT_M = 0.8
# So far behind in time that the picture does not sway with the gait.
_LAG_S = 0.7
# Whoever turns the view is let alone for so long.
HANDS_OFF_S = 0.4
_STILL_M = 1e-3
# What a page says of its camera may be as old as this many frames.
_REMEMBERED = 120


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
    """Whether a window of this width over height is that of a phone, held upright."""
    return aspect < _PHONE_ASPECT


def free_middle(aspect: float) -> tuple[float, float]:
    """The middle of what the panel leaves free of a window, from -1 left, down to 1 right, up.

    aspect: width over height of the window.
    """
    return (0.0, _PHONE_SHARE) if is_phone(aspect) else (-_PANEL_SHARE, 0.0)


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


class Follower:
    """One page's camera on its way after the robot.

    Whoever watches chooses direction and distance: what the page says of its camera counts, unless
    it is what it was told itself a moment ago.
    """

    def __init__(self, now: Sight, aspect: float, now_s: float) -> None:
        """Begins with the camera as it is; aspect of the window, now_s of the clock."""
        self._told = deque([now], maxlen=_REMEMBERED)
        self._sight = now
        near_m = _PHONE_DISTANCE_M if is_phone(aspect) else FOLLOW_DISTANCE_M
        self._distance_m = min(now.distance_m, near_m)
        self._now_s, self._free_from_s = now_s, -math.inf

    def next(self, seen: Sight, robot_m: np.ndarray, aspect: float, now_s: float) -> Sight | None:
        """Where the camera goes now; None if it stays.

        seen: what the page said last; robot_m (3,): the ground below the robot.
        """
        share = 1 - math.exp(-(now_s - self._now_s) / _LAG_S)
        self._now_s = now_s
        if not any(_is_alike(seen, told) for told in self._told):
            self._sight, self._distance_m = seen, seen.distance_m
            self._told.clear()
            self._told.append(seen)
            self.hold(now_s)
        if now_s < self._free_from_s:
            return None
        before = self._sight
        distance_m = before.distance_m + share * (self._distance_m - before.distance_m)
        point_m = robot_m + np.array([0.0, 0.0, FOLLOW_HEIGHT_M])
        wanted = centred(point_m, before.forward, distance_m, aspect)
        away_m = wanted.look_at_m - before.look_at_m
        if np.linalg.norm(away_m) < _STILL_M and abs(distance_m - before.distance_m) < _STILL_M:
            return None
        look_at_m = before.look_at_m + share * away_m
        self._sight = Sight(position_m=look_at_m - distance_m * before.forward, look_at_m=look_at_m)
        self._told.append(self._sight)
        return self._sight

    def hold(self, now_s: float) -> None:
        """Lets the camera alone for a moment, because somebody has their hands on the page."""
        self._free_from_s = now_s + HANDS_OFF_S


def _is_alike(one: Sight, other: Sight) -> bool:
    """Whether two cameras look the same way from as far: then nobody has turned or zoomed."""
    turned = float(np.linalg.norm(one.forward - other.forward))
    return turned < 5e-3 and abs(one.distance_m / max(other.distance_m, 1e-9) - 1) < 1e-2
