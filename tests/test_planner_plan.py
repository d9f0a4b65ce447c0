"""Plans: poses of feet, and the file that a plan is kept in."""

from __future__ import annotations

import dataclasses
import json
import math
import re

import numpy as np
import pytest

from planner.plan import FootstepPlan, PlanWaypoint, feet_at, pair_pose, relative_step, wrap_angle
from planner.robot_model import Side
from tests.planner_floor import FLOOR, plan_on_lattice, small_plan
from tests.planner_oracle import small_model


@pytest.fixture(scope="module")
def plan():
    return small_plan()


def test_feet_stand_left_and_right_of_their_pose():
    feet = feet_at((1.0, 2.0, math.pi / 2), 0.2)
    np.testing.assert_allclose(
        feet, [[0.9, 2.0, 0.0, math.pi / 2], [1.1, 2.0, 0.0, math.pi / 2]], atol=1e-12
    )
    np.testing.assert_allclose(pair_pose(feet), (1.0, 2.0, math.pi / 2))


def test_the_mean_heading_goes_the_short_way():
    feet = np.array([[0.0, 0.1, 0.0, 3.1], [0.0, -0.1, 0.0, -3.1]])
    assert abs(pair_pose(feet)[2]) == pytest.approx(math.pi, abs=1e-9)


def test_a_step_is_counted_outward_for_either_foot():
    support = np.array([1.0, 1.0, 0.0, math.pi / 2])
    left = np.array([0.7, 1.3, 0.0, math.pi / 2 + 0.1])
    np.testing.assert_allclose(relative_step(support, left, Side.LEFT), (0.3, 0.3, 0.1))
    right = np.array([1.3, 1.3, 0.0, math.pi / 2 - 0.1])
    np.testing.assert_allclose(relative_step(support, right, Side.RIGHT), (0.3, 0.3, 0.1))


def test_angles_wrap_into_one_turn():
    np.testing.assert_allclose(
        wrap_angle([3.5 * math.pi, -3.5 * math.pi]), (-math.pi / 2, math.pi / 2)
    )


def test_a_plan_survives_its_file(plan):
    again = FootstepPlan.from_json(plan.to_json())
    np.testing.assert_array_equal(again.pose_world, plan.pose_world)
    np.testing.assert_array_equal(again.side, plan.side)
    np.testing.assert_array_equal(again.start_feet_world, plan.start_feet_world)
    assert again.to_json() == plan.to_json()


def test_durations_of_steps_survive_the_file_and_are_for_all_steps_or_none(plan):
    paced = dataclasses.replace(plan, step_s=np.linspace(0.7, 1.4, len(plan)))
    again = FootstepPlan.from_json(paced.to_json())
    np.testing.assert_array_equal(again.step_s, paced.step_s)
    document = json.loads(paced.to_json())
    assert document["steps"][0]["step_s"] == 0.7
    assert "step_s" not in json.loads(plan.to_json())["steps"][0]
    assert FootstepPlan.from_json(plan.to_json()).step_s is None
    del document["steps"][1]["step_s"]
    with pytest.raises(ValueError, match="steps have a step_s: give all or none"):
        FootstepPlan.from_json(json.dumps(document))
    document["steps"][1]["step_s"] = 0.0
    with pytest.raises(ValueError, match="must be a positive number"):
        FootstepPlan.from_json(json.dumps(document))


def test_waypoints_survive_the_file_and_must_lie_on_the_way(plan):
    points = (
        PlanWaypoint(pose=(1.0, 2.0, 0.5), step=2),
        PlanWaypoint(pose=(2.0, 2.0, 0.0), step=len(plan), stands=True),
    )
    led = dataclasses.replace(plan, waypoints=points)
    document = json.loads(led.to_json())
    assert document["waypoints"][0] == {"x": 1, "y": 2, "yaw": 0.5, "step": 2, "stands": False}
    assert FootstepPlan.from_json(led.to_json()).waypoints == points
    assert FootstepPlan.from_json(plan.to_json()).waypoints == ()
    document["waypoints"].reverse()
    with pytest.raises(ValueError, match="are not in the order of"):
        FootstepPlan.from_json(json.dumps(document))
    for wrong in ({"step": -1}, {"step": len(plan) + 1}, {"step": 1.5}, {"stands": 1}, {"x": "a"}):
        document["waypoints"] = [{"x": 1, "y": 2, "yaw": 0.5, "step": 2, "stands": False, **wrong}]
        with pytest.raises(ValueError, match=r"^not a plan: "):
            FootstepPlan.from_json(json.dumps(document))


def test_the_file_has_the_documented_keys(plan):
    document = json.loads(plan.to_json())
    assert document["format"] == "footstep-plan/1"
    assert list(document) == [
        *("format", "robot", "map", "start", "goal", "status", "reason", "start_feet", "steps"),
        *("cost_m", "cost_before_refinement_m", "epsilon", "expansions"),
        *("time_to_first_s", "time_s", "planner"),
    ]
    assert document["status"] == "found"
    assert document["start_feet"]["left"] == plan.start_feet_world[0].tolist()
    first = document["steps"][0]
    assert first["side"] == Side(int(plan.side[0])).name.lower()
    assert [first[key] for key in ("x", "y", "z", "yaw")] == plan.pose_world[0].tolist()
    assert document["steps"][-1]["x"] == plan.pose_world[-1, 0]


def test_an_unproven_bound_is_null_in_the_file():
    failed = plan_on_lattice(FLOOR, small_model(), start=(1, 1, 0), goal=(9, 9, 0))
    document = json.loads(failed.to_json())
    assert document["epsilon"] is None
    assert document["steps"] == []
    assert FootstepPlan.from_json(failed.to_json()).epsilon == math.inf


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.pop("steps"), "'steps' is missing"),
        (lambda d: d.update(format="footstep-plan/9"), "footstep-plan/9"),
        (lambda d: d["steps"][0].update(side="middle"), "'middle'"),
        (lambda d: d["steps"][0].update(x="far"), "far"),
        (lambda d: d.update(start=[0, 0]), r"\[0, 0\] must be 3 finite numbers"),
        (lambda d: d.update(status="maybe"), "maybe"),
    ],
)
def test_a_file_that_is_no_plan_is_refused(plan, change, message):
    document = json.loads(plan.to_json())
    change(document)
    with pytest.raises(ValueError, match="not a plan") as error:
        FootstepPlan.from_json(json.dumps(document))
    assert re.search(message, str(error.value))
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize("text", ["", "[1]", "{}", "{"])
def test_text_that_is_no_plan_is_refused(text):
    with pytest.raises(ValueError, match="not a plan"):
        FootstepPlan.from_json(text)


def test_plans_are_read_only(plan):
    with pytest.raises(ValueError, match="read-only"):
        plan.pose_world[0, 0] = 1.0
