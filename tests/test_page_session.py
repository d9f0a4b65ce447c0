"""A live robot without a browser: goals, boxes and robots that come at any time."""

from __future__ import annotations

import contextlib
import math
import os
import signal
import sys
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest

from app.navigation.live_navigator import LiveNavigator, WalkHistory
from app.navigation.navigator import Navigator, NavigatorConfig
from app.navigation.planner_process import Answer, PlannerProcess, World
from app.navigation.replanner import Replanner
from app.navigation.route import plan_through
from app.viewer.obstacles import Obstacle, snapped
from app.viewer.session import Session
from controller.evaluation.gait_summary import LEAST_STEPS
from planner.options import PlannerOptions
from planner.planner import Planner
from tests.scenes import HALL, POLICY, ROBOT, wait_until

# Straight ahead is what every policy that walks can do.
AHEAD = (2.0, 0.0, 0.0)


@contextlib.contextmanager
def lived(*arguments: Any, **options: Any) -> Iterator[Session]:
    """A session that lives as fast as it can."""
    session = Session(*arguments, **options)
    session.clock.factor = math.inf
    session.start()
    try:
        yield session
    finally:
        session.close()


@pytest.fixture
def session() -> Iterator[Session]:
    with lived(HALL, ROBOT, POLICY) as session:
        yield session


def wait_for(session: Session, wanted: Callable[[Any], object]) -> Any:
    """The first snapshot that is as wanted."""

    def met() -> Any:
        snapshot = session.snapshot
        return snapshot if wanted(snapshot) else None

    return wait_until(met)


def box_at(x_m: float, y_m: float, size_m: float = 0.4) -> Obstacle:
    x, y = (float(value) for value in HALL.world_to_grid((x_m, y_m)))
    return snapped(Obstacle(number=0, x_m=x, y_m=y, size_x_m=size_m, size_y_m=size_m), HALL)


def test_it_walks_to_a_goal_and_tells_how(session):
    session.go_to(AHEAD)
    end = wait_for(session, lambda now: now.status == "reached")
    assert end.plan is not None
    assert end.done == len(end.plan) == len(end.placed_side) == len(end.foot_error_m)
    assert end.goal_error[0] < 0.1
    assert end.qpos[0] == pytest.approx(2.0, abs=0.15)
    assert end.notice is None
    assert session.history.forces()[1:, -1].sum() == pytest.approx(9.81 * ROBOT.mass_kg, rel=0.2)


def test_a_goal_off_the_map_is_refused_with_another_on_offer(session):
    session.go_to((2.0, 2.9, 0.0))
    told = wait_for(session, lambda now: now.notice)
    assert told.notice.text.startswith("no plan: goal:")
    assert told.status == "standing"
    session.go_to(told.notice.alternative)
    wait_for(session, lambda now: now.status == "walking" and now.notice is None)


def test_numbers_that_are_none_are_refused_and_nothing_ends(session):
    session.go_to((math.nan, 0, 0))
    wait_for(session, lambda now: now.notice and "finite" in now.notice.text)
    session.go_to(AHEAD)
    wait_for(session, lambda now: now.status == "walking")


def test_a_new_goal_while_it_walks(session):
    session.go_to((3.0, 0.0, 0.0))
    wait_for(session, lambda now: len(now.placed_side) >= 2)
    session.go_to((1.5, 0.0, 0.0))
    end = wait_for(session, lambda now: now.status == "reached" and now.goal[0] == 1.5)
    assert end.qpos[0] == pytest.approx(1.5, abs=0.15)


@pytest.mark.slow
def test_a_box_in_the_way_is_walked_around(session):
    session.clock.factor = 4.0
    session.go_to((3.0, 0.0, 0.0))
    wait_for(session, lambda now: len(now.placed_side) >= 1)
    before = session.snapshot.plan
    session.set_obstacles([box_at(1.9, 0.0)])
    after = wait_for(session, lambda now: now.replans >= 1 and now.plan is not before)
    near = np.abs(after.plan.pose_world[:, :2] - (1.9, 0.0)).max(axis=1)
    assert near.min() > 0.2
    # Without walls in the physics there is no distance to one.
    wait_for(session, lambda now: now.clearance_m is not None)


class StubPlanner:
    """Takes the place of the planner's process: answers when it is told to."""

    def __init__(self) -> None:
        self.number = 0
        self._asked: Any = None
        self._kept: list[Answer] = []

    def ask(self, **asked: Any) -> int:
        self.number += 1
        self._asked = asked
        return self.number

    def answers(self) -> list[Answer]:
        kept, self._kept = self._kept, []
        return kept

    def answer(self, *, is_last: bool) -> None:
        plan = plan_through(Planner(HALL, ROBOT.step_model), **self._asked)
        self._kept.append(Answer(number=self.number, plan=plan, is_last=is_last))


def test_a_box_that_comes_while_a_walk_is_improved_begins_no_new_walk():
    planner: Any = StubPlanner()
    navigator = LiveNavigator(HALL, ROBOT, POLICY, start=(0, 0, 0), goal=(0, 0, 0))
    navigator.tick()
    replanner: Any = Replanner(planner, WalkHistory(), navigator)
    replanner.ask(AHEAD, fresh=True)
    planner.answer(is_last=True)
    replanner.listen()
    while navigator.replan_point().first_side is None:
        navigator.tick()
    replanner.ask((1.5, 0.0, 0.0), fresh=True)
    replanner.plan_anew()
    assert replanner.question.fresh
    planner.answer(is_last=False)
    replanner.listen()
    # Its first plan is walked already, the better one is still being thought of.
    assert navigator.goal == (1.5, 0.0, 0.0)
    replanner.plan_anew()
    assert not replanner.question.fresh


@pytest.mark.slow
def test_it_stops_where_the_way_is_closed(session):
    session.clock.factor = 4.0
    session.go_to((3.0, 0.0, 0.0))
    wait_for(session, lambda now: len(now.placed_side) >= 1)
    session.set_obstacles([box_at(3.0, 0.0, 1.0)])
    end = wait_for(session, lambda now: now.status == "stopped")
    assert "no plan" in end.notice.text
    assert end.qpos[0] < 2.0


@pytest.mark.slow
def test_reset_puts_it_back_whatever_has_happened(session):
    session.go_to(AHEAD)
    wait_for(session, lambda now: now.status == "reached")
    session.reset()
    back = wait_for(session, lambda now: now.status == "standing")
    assert back.qpos[:2] == pytest.approx((0, 0), abs=0.1)
    session.reset((1.0, 1.0, math.pi / 2))
    moved = wait_for(session, lambda now: now.qpos[1] > 0.8)
    assert moved.qpos[:2] == pytest.approx((1, 1), abs=0.1)


def test_it_is_not_put_where_it_cannot_stand_and_another_place_is_offered(session):
    session.reset((2.0, 2.9, 0.0))
    told = wait_for(session, lambda now: now.notice)
    assert told.notice.text.startswith("the robot cannot stand there: ")
    assert told.notice.puts_robot
    assert told.notice.alternative[0] == pytest.approx(2.0, abs=0.05)
    assert 2.0 < told.notice.alternative[1] < 2.9
    assert told.qpos[:2] == pytest.approx((0, 0), abs=0.1)
    session.reset(told.notice.alternative)
    moved = wait_for(session, lambda now: now.qpos[1] > 1.5)
    assert moved.notice is None


def test_a_start_that_a_box_has_taken_does_not_swallow_the_robot(session):
    session.reset((1.0, 1.0, 0.0))
    wait_for(session, lambda now: now.qpos[1] > 0.8)
    session.go_to((2.5, 1.0, 0.0))
    wait_for(session, lambda now: now.qpos[0] > 2.0)
    session.stop()
    session.set_obstacles([box_at(1.0, 1.0)])
    session.reset()
    told = wait_for(session, lambda now: now.notice and now.notice.puts_robot)
    assert told.qpos[0] > 1.9


def test_a_click_on_a_wall_is_told_to_be_one(session):
    session.set_obstacles([box_at(2.0, 0.0)])
    session.go_to((1.8, 0.0, 0.0), in_the_way="a wall")
    told = wait_for(session, lambda now: now.notice)
    assert told.notice.text == "no plan: a wall stands there"
    # On this side of it, not behind.
    assert 1.0 < told.notice.alternative[0] < 1.8


def test_where_no_way_leads_the_nearest_place_with_one_is_offered():
    # A wall across the hall, from x = 1.5 m.
    cells = np.zeros((120, 160), np.uint8)
    cells[:, 70:74] = 1
    with lived(HALL.with_cells(cells), ROBOT, POLICY) as session:
        session.go_to((3.0, 0.5, 0.0))
        told = wait_for(session, lambda now: now.notice)
        assert told.notice.text.startswith("no plan: ")
        x_m, y_m, yaw_rad = told.notice.alternative
        assert (y_m, yaw_rad) == (pytest.approx(0.5, abs=0.1), 0.0)
        assert 0.9 < x_m < 1.5
        session.go_to(told.notice.alternative)
        wait_for(session, lambda now: now.status == "walking" and now.notice is None)


def test_a_box_cannot_be_set_on_the_robot(session):
    assert session.is_on_robot(box_at(0.3, 0.3))
    assert not session.is_on_robot(box_at(1.0, 0.0))


@pytest.mark.slow
def test_it_rests_when_it_has_nowhere_to_go(session):
    session.clock.factor = 1.0
    wait_for(session, lambda now: now.speed > 0.5)
    wait_for(session, lambda now: now.speed == 0)
    session.go_to(AHEAD)
    wait_for(session, lambda now: now.time_s > 0.1)


@pytest.mark.slow
def test_a_planner_that_dies_is_replaced(session):
    session.go_to(AHEAD)
    wait_for(session, lambda now: now.status == "walking")
    died = session.planner_pid
    os.kill(died, signal.SIGKILL)
    session.go_to((1.5, 0.0, 0.0))
    wait_for(session, lambda now: now.goal[0] == 1.5)
    assert session.planner_pid != died


def test_a_planner_that_never_starts_is_given_up(monkeypatch):
    monkeypatch.setattr("app.navigation.planner_process.answer_questions", sys.exit)
    world = World(grid=HALL, model=ROBOT.step_model, options=PlannerOptions())
    with (
        contextlib.closing(PlannerProcess(world)) as planner,
        pytest.raises(RuntimeError, match="died 3 times"),
    ):
        wait_until(lambda: planner.is_ready(wait_s=1.0))


def test_a_living_session_tells_that_its_planner_never_starts(monkeypatch):
    monkeypatch.setattr("app.navigation.planner_process.answer_questions", sys.exit)
    with lived(HALL, ROBOT, POLICY) as session:
        failure = wait_until(lambda: session.failure)
        assert "died 3 times" in str(failure)
        assert session.snapshot.loading


def test_it_tells_what_loads_and_a_goal_waits_for_it(session):
    assert session.snapshot.loading == "loading the planner"
    session.go_to(AHEAD)
    wait_for(session, lambda now: now.status == "planning" and now.loading)
    wait_for(session, lambda now: now.status == "walking" and not now.loading)


@pytest.mark.parametrize("name", ["ara", "rrtconnect"])
def test_with_a_goal_it_walks_as_navigate_does(name, monkeypatch):
    # The second plans in another process, because it would hold up this one.
    options = PlannerOptions(name=name, seed=3)
    config = NavigatorConfig(planner=options)
    walk = Navigator(HALL, ROBOT, POLICY, start=(0, 0, 0), goal=AHEAD, seed=3, config=config)
    walk.plan()
    while walk.outcome is None:
        walk.tick()
    made_here: list[Planner] = []

    def make(*arguments: Any) -> Planner:
        made_here.append(Planner(*arguments))
        return made_here[-1]

    monkeypatch.setattr("app.navigation.navigator.Planner", make)
    with lived(HALL, ROBOT, POLICY, goal=AHEAD, seed=3, options=options) as session:
        assert len(made_here) == (name == "ara")
        wait_for(session, lambda _now: session.ended is not None)
    ended: Any = session.ended
    assert ended.outcome is walk.outcome
    assert len(ended.qpos) == len(walk.qpos)
    np.testing.assert_array_equal(ended.qpos[:-1], walk.qpos[:-1])


def test_a_robot_that_was_put_anywhere_stands_there_until_it_is_sent():
    start = (1.0, 1.0, 1.0)
    planner = Planner(HALL, ROBOT.step_model)
    navigator = LiveNavigator(HALL, ROBOT, POLICY, start=start, goal=start, planner=planner)
    np.testing.assert_allclose(
        navigator.walker.cursor.window[0].mean(axis=0)[:2], (1, 1), atol=1e-2
    )
    for _ in range(80):
        navigator.tick()
    assert navigator.outcome is None
    # Its feet: in half-sitting the pelvis is 7 cm behind the middle between them.
    away_m, turned_rad = navigator.goal_error
    assert away_m < 0.02
    assert turned_rad < 0.05


def test_a_changed_map_leaves_the_robot_as_it_is():
    """The same walk, tick for tick, whether or not a far box was set down on the way."""
    ends = []
    for changes in (False, True):
        planner = Planner(HALL, ROBOT.step_model)
        navigator = LiveNavigator(
            HALL, ROBOT, POLICY, start=(0, 0, 0), goal=(0, 0, 0), planner=planner
        )
        navigator.tick()
        replan_point = navigator.replan_point()
        plan = planner.plan(goal=AHEAD, start_feet_world=replan_point.feet_world)
        assert navigator.go(AHEAD, plan, replan_point, fresh=True)
        for tick in range(200):
            if changes and tick == 100:
                navigator.set_grid(HALL.with_cells(np.eye(120, 160, 60, dtype=np.uint8)), planner)
            navigator.tick()
        ends.append(navigator.qpos[-1])
    # Not to the bit: the contact solver starts anew.
    np.testing.assert_allclose(ends[1], ends[0], atol=2e-3)


def test_a_fresh_walk_forgets_how_the_one_before_was_walked():
    planner = Planner(HALL, ROBOT.step_model)
    navigator = LiveNavigator(HALL, ROBOT, POLICY, start=(0, 0, 0), goal=(0, 0, 0), planner=planner)
    navigator.tick()
    # The second walk is too short to have a gait of its own.
    for goal, has_gait in ((AHEAD, True), ((2.1, 0.0, 0.0), False)):
        replan_point = navigator.replan_point()
        plan = planner.plan(goal=goal, start_feet_world=replan_point.feet_world)
        assert (len(plan) >= LEAST_STEPS) == has_gait
        assert navigator.go(goal, plan, replan_point, fresh=True)
        while navigator.outcome is None:
            navigator.tick()
        assert (navigator.report().gait is not None) == has_gait


def is_restored(times: int, now: Any) -> bool:
    return now.restores > times and now.requested is None


@pytest.mark.slow
def test_boxes_goal_and_start_are_taken_back_and_made_again(session):
    box = box_at(2.5, 2.0)
    session.go_to(AHEAD)
    wait_for(session, lambda now: now.goal == AHEAD)
    session.set_obstacles([box])
    wait_for(session, lambda now: now.obstacles == (box,))
    session.go_to((2.0, 1.0, 0.0))
    wait_for(session, lambda now: now.goal == (2.0, 1.0, 0.0))
    session.reset((1.0, 1.0, 0.0))
    wait_for(session, lambda now: now.start[0] == 1.0 and now.goal is None)
    # A refused goal changes nothing, and so is nothing to be taken back.
    session.go_to((2.0, 2.9, 0.0))
    wait_for(session, lambda now: now.notice and not now.requested)
    session.undo()
    wait_for(session, lambda now: now.goal == (2.0, 1.0, 0.0) and now.start == (0, 0, 0))
    session.undo()
    wait_for(session, lambda now: now.goal == AHEAD)
    session.undo()
    wait_for(session, lambda now: now.obstacles == () and now.goal == AHEAD)
    session.undo()
    wait_for(session, lambda now: now.goal is None)
    session.undo()
    wait_for(session, lambda now: now.notice and now.notice.text == "there is nothing to undo")
    for _ in range(4):
        before = session.snapshot.restores
        session.redo()
        wait_for(session, partial(is_restored, before))
    assert session.snapshot.start == (1.0, 1.0, 0.0)
    assert session.snapshot.obstacles == (box,)


def test_a_way_that_a_box_has_closed_is_open_again_after_one_undo(session):
    session.clock.factor = 4.0
    session.go_to((3.0, 0.0, 0.0))
    wait_for(session, lambda now: len(now.placed_side) >= 1)
    session.set_obstacles([box_at(3.0, 0.0, 1.0)])
    wait_for(session, lambda now: now.goal is None)
    session.undo()
    back = wait_for(session, lambda now: now.goal == (3.0, 0.0, 0.0))
    assert back.obstacles == ()
