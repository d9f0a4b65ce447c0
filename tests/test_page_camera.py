"""The camera of a page: what it sees at first, how it follows, and whose hands it minds."""

from __future__ import annotations

import math

import numpy as np
import pytest

from app.viewer.camera import (
    FIELD_OF_VIEW_RAD,
    FOLLOW_DISTANCE_M,
    FOLLOW_HEIGHT_M,
    HANDS_OFF_S,
    Follower,
    Met,
    Sight,
    behind,
    centred,
    from_above,
    overview,
    towards,
)
from app.viewer.obstacles import Obstacle
from app.viewer.pointer import Surface, surface_of
from maps.map_files import load_map
from tests.scenes import HALL

FRAME_S = 1 / 30
LANDSCAPE, PHONE = 1.5, 390 / 844


def seen_at(sight: Sight, point_m: np.ndarray, aspect: float) -> tuple[float, float]:
    """Where a point is in the window: -1 to 1 from left to right and from below to above."""
    right = np.cross(sight.forward, (0, 0, 1.0))
    right /= np.linalg.norm(right)
    away_m = point_m - sight.position_m
    scale = 1 / math.tan(FIELD_OF_VIEW_RAD / 2) / (away_m @ sight.forward)
    up = np.cross(right, sight.forward)
    return float(scale * (away_m @ right) / aspect), float(scale * (away_m @ up))


@pytest.mark.parametrize(
    ("aspect", "right_edge", "lower_edge"),
    [(LANDSCAPE, 0.56, -1.0), (2.2, 0.56, -1.0), (PHONE, 1.0, -0.34)],
)
def test_the_whole_map_is_seen_at_first_where_the_panel_is_not(aspect, right_edge, lower_edge):
    sight = overview(HALL, aspect)
    for corner in ((-2, -3, 0), (6, -3, 0), (6, 3, 0), (-2, 3, 0)):
        x, y = seen_at(sight, np.array(corner, float), aspect)
        assert -1 <= x <= right_edge
        assert lower_edge <= y <= 1


@pytest.mark.parametrize(("aspect", "place"), [(LANDSCAPE, (-0.22, 0)), (PHONE, (0, 0.33))])
def test_a_point_is_put_in_the_middle_of_what_is_free(aspect, place):
    forward = np.array([0.6, 0.0, -0.8])
    sight = centred(np.array([1.0, 2.0, 0.5]), forward, 4.0, aspect)
    assert sight.distance_m == pytest.approx(4.0)
    assert sight.forward == pytest.approx(forward)
    assert seen_at(sight, np.array([1.0, 2.0, 0.5]), aspect) == pytest.approx(place, abs=1e-9)


@pytest.mark.parametrize("aspect", [LANDSCAPE, 2.2, PHONE])
def test_from_above_the_map_is_seen_as_a_plan_is_drawn(aspect):
    sight = from_above(HALL, aspect)
    corners = ((-2, -3, 0), (6, -3, 0), (6, 3, 0), (-2, 3, 0))
    places = np.array([seen_at(sight, np.array(corner, float), aspect) for corner in corners])
    assert np.abs(places).max() <= 1
    # Upright: what is east is to the right, what is north is up.
    assert places[1, 0] - places[0, 0] > 0.3
    assert places[3, 1] - places[0, 1] > 0.3
    assert places[0, 1] == pytest.approx(places[1, 1], abs=1e-6)


def nothing(_origin: object, _direction: object) -> None:
    """What a ray meets where there is nothing."""


def shows_feet(sight: Sight, robot_m: np.ndarray, surface: Surface) -> bool:
    """Whether nothing rises above the line from the camera to just above the ground at a robot."""
    foot_m = robot_m + np.array([0.0, 0.0, 0.05])
    for share in np.linspace(0.0, 0.99, 800):
        point_m = sight.position_m + share * (foot_m - sight.position_m)
        if point_m[2] < surface.height_m(point_m) - 1e-9:
            return False
    return True


def test_from_behind_one_looks_along_with_the_robot():
    robot_m, yaw_rad = np.array([1.0, 2.0, 0.1]), 2.0
    sight = towards(robot_m, behind(yaw_rad), FOLLOW_DISTANCE_M, LANDSCAPE, nothing)
    middle_m = robot_m + np.array([0.0, 0.0, FOLLOW_HEIGHT_M])
    assert seen_at(sight, middle_m, LANDSCAPE) == pytest.approx((-0.22, 0), abs=1e-9)
    assert math.atan2(sight.forward[1], sight.forward[0]) == pytest.approx(yaw_rad)
    assert sight.forward[2] < 0
    assert sight.distance_m == pytest.approx(FOLLOW_DISTANCE_M)


@pytest.mark.parametrize("aspect", [LANDSCAPE, PHONE])
@pytest.mark.parametrize("name", ["room.png", "stairs.yaml"])
def test_the_feet_are_seen_from_behind_over_walls_and_only_then_more_steeply(name, aspect):
    grid = load_map(f"maps/{name}")
    surface, rng = surface_of(grid), np.random.default_rng(4)
    x0, y0, x1, y1 = grid.bounds_world()
    steeper = 0
    for _ in range(60):
        place, yaw_rad = rng.uniform((x0, y0), (x1, y1)), rng.uniform(-math.pi, math.pi)
        turns_rad = np.arange(16) * (math.pi / 8)
        around = place + 0.25 * np.column_stack([np.cos(turns_rad), np.sin(turns_rad)])
        ground_m = float(grid.height_m(place))
        if any(surface.height_m(point) > ground_m + 0.5 for point in around):
            continue  # No robot stands in a wall.
        robot_m, forward = np.array([*place, ground_m]), behind(yaw_rad)
        sight = towards(robot_m, forward, 4.5, aspect, surface.met)
        assert shows_feet(sight, robot_m, surface)
        ahead = np.array([math.cos(yaw_rad), math.sin(yaw_rad)])
        assert sight.forward[:2] / np.linalg.norm(sight.forward[:2]) == pytest.approx(ahead)
        if sight.forward != pytest.approx(forward):
            steeper += 1
            assert sight.forward[2] < forward[2]
    assert 0 < steeper < 60


def test_a_view_that_is_chosen_stays_though_the_page_says_the_old_one_yet():
    old = overview(HALL, LANDSCAPE)
    follower, robot_m = Follower(old, LANDSCAPE, 0.0, nothing), np.zeros(3)
    follower.jump(robot_m, behind(0.0), LANDSCAPE)
    told = follower.next(old, robot_m, LANDSCAPE, FRAME_S)
    assert told is None or told.forward == pytest.approx(behind(0.0))


def test_straight_down_is_a_way_to_look():
    sight = centred(np.zeros(3), np.array([0.0, 0.0, -1.0]), 3.0, LANDSCAPE)
    assert np.isfinite(sight.position_m).all()


class Watched:
    """A page that does what its camera is told, `late` frames later; the robot stands or walks."""

    def __init__(self, late: int = 0, met: Met = nothing) -> None:
        self.now_s, self.robot_m = 0.0, np.zeros(3)
        self.told = [overview(HALL, LANDSCAPE)]
        self.late = late
        self.follower = Follower(self.told[0], LANDSCAPE, self.now_s, met)

    @property
    def seen(self) -> Sight:
        return self.told[max(0, len(self.told) - 1 - self.late)]

    def frames(self, count: int, speed_m_s: float = 0.0) -> list[Sight | None]:
        answers = []
        for _ in range(count):
            self.now_s += FRAME_S
            self.robot_m = self.robot_m + np.array([speed_m_s * FRAME_S, 0, 0])
            answers.append(self.follower.next(self.seen, self.robot_m, LANDSCAPE, self.now_s))
            self.told.append(answers[-1] or self.told[-1])
        return answers

    def robot_in_window(self) -> tuple[float, float]:
        return seen_at(self.told[-1], self.robot_m + np.array([0, 0, FOLLOW_HEIGHT_M]), LANDSCAPE)


@pytest.mark.parametrize("late", [0, 1, 10])
def test_it_comes_near_and_stays_with_the_robot_however_late_the_page_is(late):
    watched = Watched(late)
    watched.frames(300)
    assert watched.told[-1].distance_m == pytest.approx(FOLLOW_DISTANCE_M, abs=0.01)
    assert watched.robot_in_window() == pytest.approx((-0.22, 0), abs=0.01)
    watched.frames(300, speed_m_s=0.3)
    # Behind by the lag of 0.7 s: 0.21 m of 4.5 m.
    assert watched.robot_in_window() == pytest.approx((-0.22, 0), abs=0.08)
    moved_m = np.diff([sight.look_at_m[0] for sight in watched.told[-200:]])
    assert moved_m == pytest.approx(0.3 * FRAME_S, rel=0.02)


def test_a_robot_that_stands_costs_no_messages():
    watched = Watched()
    watched.frames(400)
    assert watched.frames(30) == [None] * 30


def test_who_turns_the_view_is_let_alone_and_then_followed_from_there():
    watched = Watched()
    watched.frames(300)
    ours = watched.told[-1]
    theirs = Sight(
        position_m=ours.look_at_m - 2.5 * np.array([0.6, 0.0, -0.8]), look_at_m=ours.look_at_m
    )
    watched.told.append(theirs)
    wait = math.floor(HANDS_OFF_S / FRAME_S)
    assert watched.frames(wait, speed_m_s=0.3) == [None] * wait
    watched.frames(300, speed_m_s=0.3)
    assert watched.told[-1].forward == pytest.approx([0.6, 0.0, -0.8])
    assert watched.told[-1].distance_m == pytest.approx(2.5)


def test_it_waits_while_the_pointer_drags_something():
    watched = Watched()
    watched.frames(10)
    watched.follower.hold(watched.now_s)
    assert watched.frames(5, speed_m_s=0.3) == [None] * 5
    assert any(watched.frames(60, speed_m_s=0.3))


def test_while_it_follows_it_looks_over_a_box_and_then_comes_down_again():
    # In metres of the grid frame; in the world its middle is at -0.7, 0, behind the robot at 0, 0.
    box = Obstacle(number=0, x_m=1.3, y_m=3.0, size_x_m=0.4, size_y_m=1.5)
    surface = surface_of(HALL).with_boxes([box])
    watched = Watched(met=surface.met)
    watched.told.append(watched.follower.jump(watched.robot_m, behind(0.0), LANDSCAPE))
    hidden = downs = 0
    for _ in range(500):
        watched.frames(1, speed_m_s=0.3)
        hidden += not shows_feet(watched.told[-1], watched.robot_m, surface)
        downs = max(downs, -watched.told[-1].forward[2])
    assert downs > 0.5
    assert hidden < 30
    assert watched.told[-1].forward == pytest.approx(behind(0.0), abs=1e-2)
