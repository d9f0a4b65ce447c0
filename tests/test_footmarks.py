"""Footprints on the floor of films: which are shown when, by a walk made up by hand."""

from __future__ import annotations

import numpy as np
import pytest

from app.navigation.navigator import Placed
from app.pictures.rendering import Footmarks, footmarks_of
from planner.plan import FootstepPlan, feet_at
from planner.robot_model import FootShape, Side

FOOT = FootShape(length_m=0.2, width_m=0.1)


def plan_of(*steps: tuple[Side, float]) -> FootstepPlan:
    """Steps of a side each, at x and the height 0.3."""
    return FootstepPlan(
        start_feet_world=feet_at((0, 0, 0), 0.2),
        start=(0, 0, 0),
        goal=(1, 0, 0),
        side=np.array([side for side, _ in steps], np.int8),
        pose_world=np.array([[x_m, 0, 0.3, 0] for _, x_m in steps]),
    )


def placed_at(side: Side, x_m: float, time_s: float) -> Placed:
    pose = np.array([x_m, 0.0, 0.3, 0.0])
    return Placed(side=side, asked_world=pose, placed_world=pose, time_s=time_s)


def shown(marks: Footmarks, time_s: float) -> list[tuple[float, bool]]:
    """x and whether it is a full print, of all marks of that time."""
    now = (marks.from_s <= time_s) & (time_s < marks.until_s)
    return sorted(zip(marks.pose_world[now, 0], marks.rgba[now, 3] > 0.5, strict=True))


def test_a_planned_step_gives_way_to_where_the_foot_came_down():
    plans = [(0.0, plan_of((Side.LEFT, 1.0), (Side.RIGHT, 2.0)))]
    marks = footmarks_of(FOOT, plans, [placed_at(Side.LEFT, 1.01, 1.5)])
    assert shown(marks, 0.0) == [(1.0, False), (2.0, False)]
    assert shown(marks, 1.5) == [(1.01, True), (2.0, False)]
    assert shown(marks, 99.0) == [(1.01, True), (2.0, False)]


def test_a_new_plan_takes_the_place_of_the_old_one():
    plans = [
        (0.0, plan_of((Side.LEFT, 1.0), (Side.RIGHT, 2.0), (Side.LEFT, 3.0))),
        (1.5, plan_of((Side.RIGHT, 2.5))),
    ]
    marks = footmarks_of(
        FOOT, plans, [placed_at(Side.LEFT, 1.0, 1.5), placed_at(Side.RIGHT, 2.5, 2.5)]
    )
    assert shown(marks, 1.4) == [(1.0, False), (2.0, False), (3.0, False)]
    assert shown(marks, 1.5) == [(1.0, True), (2.5, False)]
    assert shown(marks, 2.5) == [(1.0, True), (2.5, True)]


def test_no_walk_leaves_no_marks():
    assert shown(footmarks_of(FOOT, [], []), 0.0) == []


def test_they_lie_on_the_ground_in_the_colour_of_their_foot():
    mujoco = pytest.importorskip("mujoco")
    marks = footmarks_of(FOOT, [(0.0, plan_of((Side.LEFT, 1.0), (Side.RIGHT, 2.0)))], [])
    scene = mujoco.MjvScene(mujoco.MjModel.from_xml_string("<mujoco/>"), 100)
    marks.add_to(scene, 0.0)
    assert scene.ngeom == 2
    left, right = scene.geoms[0], scene.geoms[1]
    assert left.pos[0] == pytest.approx(1.0)
    assert left.pos[2] - left.size[2] == pytest.approx(0.3)
    assert list(left.size[:2]) == pytest.approx([0.1, 0.05])
    # Blue for the left foot, orange for the right one.
    assert left.rgba[2] > left.rgba[0]
    assert right.rgba[0] > right.rgba[2]
    full = mujoco.MjvScene(mujoco.MjModel.from_xml_string("<mujoco/>"), 1)
    marks.add_to(full, 0.0)
    assert full.ngeom == 1
