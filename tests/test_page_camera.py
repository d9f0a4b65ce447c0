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
    Sight,
    centred,
    from_above,
    from_behind,
    overview,
)
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


def test_from_behind_one_looks_along_with_the_robot():
    robot_m, yaw_rad = np.array([1.0, 2.0, 0.1]), 2.0
    sight = from_behind(robot_m, yaw_rad, LANDSCAPE)
    middle_m = robot_m + np.array([0.0, 0.0, FOLLOW_HEIGHT_M])
    assert seen_at(sight, middle_m, LANDSCAPE) == pytest.approx((-0.22, 0), abs=1e-9)
    assert math.atan2(sight.forward[1], sight.forward[0]) == pytest.approx(yaw_rad)
    assert sight.forward[2] < 0
    assert sight.distance_m == pytest.approx(FOLLOW_DISTANCE_M)


def test_a_view_that_is_chosen_stays_though_the_page_says_the_old_one_yet():
    old = overview(HALL, LANDSCAPE)
    follower, robot_m = Follower(old, LANDSCAPE, 0.0), np.zeros(3)
    follower.jump(from_behind(robot_m, 0.0, LANDSCAPE))
    told = follower.next(old, robot_m, LANDSCAPE, FRAME_S)
    assert told is None or told.forward == pytest.approx(from_behind(robot_m, 0, 1.5).forward)


def test_straight_down_is_a_way_to_look():
    sight = centred(np.zeros(3), np.array([0.0, 0.0, -1.0]), 3.0, LANDSCAPE)
    assert np.isfinite(sight.position_m).all()


class Watched:
    """A page that does what its camera is told, `late` frames later; the robot stands or walks."""

    def __init__(self, late: int = 0) -> None:
        self.now_s, self.robot_m = 0.0, np.zeros(3)
        self.told = [overview(HALL, LANDSCAPE)]
        self.late = late
        self.follower = Follower(self.told[0], LANDSCAPE, self.now_s)

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
