"""Ways through waypoints: the joined plan, the list that is typed, and the robot that walks it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest

from app.navigation.route import Waypoint, feet_after, first_leg, plan_through
from app.output import InputError
from app.viewer.page import Page, open_page
from app.viewer.session import Session
from app.viewer.waypoints import text_of, waypoints_of
from benchmarks.page_watcher import Watcher, painted_in_background
from planner.plan import FootstepPlan, PlanWaypoint, feet_at, pair_pose
from planner.planner import Planner
from planner.verify import violations
from tests.scenes import HALL, POLICY, ROBOT, wait_until

WIDTH_M = ROBOT.step_model.stance_width_m
VIA = ((1.0, 0.3, 0.5), (1.6, 0.0, -0.5))
GOAL = (2.4, 0.2, 0.0)


def through(*via: tuple[float, float, float]) -> FootstepPlan:
    planner = Planner(HALL, ROBOT.step_model)
    feet = feet_at((0.0, 0.0, 0.0), WIDTH_M)
    return plan_through(planner, goal=GOAL, start_feet_world=feet, first_side=None, via=via)


def joints(plan: FootstepPlan) -> list[int]:
    """After how many steps both feet are on each waypoint."""
    return [point.step for point in plan.waypoints]


def test_a_plan_through_waypoints_is_one_plan_with_both_feet_on_each():
    plan = through(*VIA)
    assert plan.found
    assert tuple(point.pose for point in plan.waypoints) == VIA
    assert not any(point.stands for point in plan.waypoints)
    # The verifier knows nothing of joints: sides in turn, limits, room for feet and body.
    assert violations(plan, HALL, ROBOT.step_model) == []
    for pose, joint in zip(VIA, joints(plan), strict=True):
        feet = plan.pose_world[joint - 2 : joint]
        assert pair_pose(feet) == pytest.approx(pose, abs=1e-6)
    assert pair_pose(feet_after(plan)) == pytest.approx(GOAL, abs=1e-6)
    assert (np.diff(plan.side) != 0).all()


def test_the_cost_of_a_way_is_that_of_its_legs_and_not_less_than_without_waypoints():
    planner = Planner(HALL, ROBOT.step_model)
    feet = feet_at((0.0, 0.0, 0.0), WIDTH_M)
    direct = planner.plan(goal=GOAL, start_feet_world=feet)
    plan = through(*VIA)
    assert plan.cost_m > direct.cost_m
    first = planner.plan(goal=VIA[0], start_feet_world=feet)
    assert joints(plan)[0] == len(first)
    assert plan.cost_m > first.cost_m


def test_a_waypoint_where_the_feet_stand_already_costs_no_step():
    plan = through((0.0, 0.0, 0.0), VIA[0])
    assert joints(plan)[0] == 0
    assert len(plan) > joints(plan)[1] > 0


def test_a_plan_to_a_waypoint_at_which_the_robot_stands_says_so_at_its_end():
    planner = Planner(HALL, ROBOT.step_model)
    feet = feet_at((0.0, 0.0, 0.0), WIDTH_M)
    asked: Any = {"goal": VIA[0], "start_feet_world": feet, "first_side": None}
    plan = plan_through(planner, **asked, stands=True)
    assert plan.waypoints == (PlanWaypoint(pose=VIA[0], step=len(plan), stands=True),)
    plain = plan_through(planner, **asked)
    assert plain.waypoints == ()
    assert np.array_equal(plan.pose_world, plain.pose_world)


def test_a_waypoint_that_cannot_be_reached_is_named():
    planner = Planner(HALL, ROBOT.step_model)
    feet = feet_at((0.0, 0.0, 0.0), WIDTH_M)
    wall = (1.0, 2.95, 0.0)
    plan = plan_through(
        planner, goal=GOAL, start_feet_world=feet, first_side=None, via=(VIA[0], wall)
    )
    assert not plan.found
    assert plan.reason.startswith("waypoint 2: the left foot at 1.00,3.05 would be off")
    assert plan.goal == wall


def test_a_way_ends_where_the_robot_stands_next():
    a, b, c = (Waypoint(pose=(x, 0.0, 0.0), stands=x == 2) for x in (1.0, 2.0, 3.0))
    assert first_leg((a, b, c), GOAL) == ((a.pose,), b.pose)
    assert first_leg((a, c), GOAL) == ((a.pose, c.pose), GOAL)
    assert first_leg((), GOAL) == ((), GOAL)


def test_a_typed_list_is_read_and_written_the_same():
    text = "2, 1, 90\n-0.5, 0, -45, stand"
    waypoints = waypoints_of(f"\n{text}°\n".replace("stand°", "stand"))
    assert [point.stands for point in waypoints] == [False, True]
    assert waypoints[0].pose == pytest.approx((2, 1, math.pi / 2))
    assert text_of(waypoints) == text
    assert waypoints_of("") == ()


@pytest.mark.parametrize("line", ["2, 1", "2, 1, 90, run", "a, b, c", "1, 2, nan", "stand"])
def test_a_line_that_is_no_waypoint_is_named(line):
    with pytest.raises(InputError, match=r"^waypoint in line 2: .* such as 2, 1, 90"):
        waypoints_of(f"0, 0, 0\n{line}")


def test_the_robot_walks_through_one_stands_at_another_and_reaches_the_goal():
    session = Session(HALL, ROBOT, POLICY)
    session.clock.factor = math.inf
    session.start()
    try:
        through_it = Waypoint(pose=(0.8, 0.2, 0.3))
        stands = Waypoint(pose=(1.5, 0.0, 0.0), stands=True)
        session.set_waypoints([through_it, stands])
        session.go_to((2.2, 0.0, 0.0))
        # What plan.json is made of: one is passed on the way, and the plan ends at the other one.
        plan: Any = wait_until(lambda: session.walk().plans and session.walk().plans[0])
        assert [point.pose for point in plan.waypoints] == [through_it.pose, stands.pose]
        assert [point.stands for point in plan.waypoints] == [False, True]
        assert plan.waypoints[1].step == len(plan)
        wait_until(lambda: session.snapshot.waypoints == (stands,))
        stood: Any = wait_until(lambda: session.snapshot.waypoints == () and session.snapshot)
        # Both feet beside each other at the second, and none of it counts as a new plan.
        assert stood.placed_world[-2:, :2].mean(axis=0) == pytest.approx((1.5, 0.0), abs=0.1)
        end: Any = wait_until(
            lambda: session.snapshot.status == "reached" and session.snapshot, "it is there"
        )
        assert end.goal == (2.2, 0.0, 0.0)
        assert end.replans == 0
        assert end.walk == stood.walk
        # Near the first one the feet were on its pose, too.
        near_m = np.hypot(*(end.placed_world[:, :2] - (0.8, 0.2)).T)
        assert (near_m < WIDTH_M / 2 + 0.06).sum() >= 2
        session.undo()
        wait_until(lambda: session.snapshot.goal is None)
        assert session.snapshot.waypoints == (through_it, stands)
    finally:
        session.close()


@pytest.fixture
def page() -> Iterator[Page]:
    with open_page(HALL, ROBOT, POLICY, title="way") as page, painted_in_background(page):
        page.text_every_s = 0.0
        page.session.start()
        yield page


def test_waypoints_are_clicked_with_shift_typed_reordered_and_cleared(page):
    watcher = Watcher(page.server.url)
    wait_until(lambda: page.visitors == 1)

    def listed() -> str:
        return page.panel.waypoints.text.value

    def ends_with(line: str) -> bool:
        return listed().rpartition("\n")[2].startswith(line)

    for x_m in (1.0, 2.0):
        watcher.click("/map/slab", (x_m, 0.0, 5.0), (0.0, 0.0, -1.0), modifier="shift")
        wait_until(partial(ends_with, f"{x_m:g}, 0, "))
    assert page.session.snapshot.goal is None
    page.panel.waypoints.text.value = "2, 0, 0, stand\n1, 0, 180"
    # What is being typed stays until it is set.
    page.session.add_waypoint(Waypoint(pose=(3.0, 0.0, 0.0)))
    wait_until(lambda: len(page.session.snapshot.waypoints) == 3)
    page.panel.waypoints.set()
    wait_until(lambda: [point.stands for point in page.session.snapshot.waypoints] == [True, False])
    page.panel.waypoints.text.value = "nonsense"
    page.panel.waypoints.set()
    wait_until(lambda: "waypoint in line 1" in page.panel.notice.content)
    page.panel.waypoints.clear()
    wait_until(lambda: page.session.snapshot.waypoints == ())
    page.session.undo()
    wait_until(lambda: listed() == "2, 0, 0, stand\n1, 0, 180")
    watcher.close()


def test_a_refused_waypoint_leaves_the_typed_goal_and_moves_to_the_pose_on_offer(page):
    watcher = Watcher(page.server.url)
    wait_until(lambda: page.visitors == 1)
    page.session.clock.factor = 0.0
    wall = Waypoint(pose=(1.0, 2.95, 0.5))
    page.session.set_waypoints([Waypoint(pose=VIA[0]), wall])
    page.session.go_to(GOAL)
    notice: Any = wait_until(lambda: page.session.snapshot.notice)
    assert notice.text.startswith("no plan: waypoint 2: the left foot at")
    assert notice.waypoint == wall
    wait_until(lambda: page.panel.goal.pose == pytest.approx(GOAL))
    # One word for both, so that none covers the other; that at the free pose is above.
    label = page.server.scene.get_handle_by_name("/waypoint_1/word")
    wait_until(lambda: label.text == "2, refused")
    assert label.anchor == "bottom-center"
    assert page.server.scene.get_handle_by_name("/alternative/word").anchor == "top-center"
    assert not page.server.scene.get_handle_by_name("/refused").visible
    wait_until(lambda: page.server.scene.get_handle_by_name("/alternative").visible)
    wait_until(lambda: "Move the waypoint" in page.panel._take_offer.label)
    page.panel.take_offer()
    wait_until(lambda: page.session.snapshot.goal == GOAL)
    now = page.session.snapshot
    assert now.waypoints == (Waypoint(pose=VIA[0]), Waypoint(pose=notice.alternative))
    assert now.notice is None
    wait_until(lambda: label.text == "2")
    watcher.close()


def test_a_waypoint_to_stand_at_is_named_too_and_refused_alone(page):
    page.session.clock.factor = 0.0
    page.session.set_waypoints([Waypoint(pose=(1.0, 2.95, 0.5), stands=True)])
    page.session.go_to(GOAL)
    notice: Any = wait_until(lambda: page.session.snapshot.notice)
    assert notice.text.startswith("no plan: waypoint 1: the left foot at")
    page.session.set_waypoints([])
    page.session.go_to((1.0, 2.95, 0.5))
    other: Any = wait_until(
        lambda: page.session.snapshot.notice != notice and page.session.snapshot.notice
    )
    assert other.text.startswith("no plan: goal: ")
    assert other.waypoint is None
