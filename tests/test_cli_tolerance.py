"""--goal-tolerance of plan and navigate: what is taken, what is refused, and what comes of it."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from app.cli import main
from app.options import Reach, parse_reach
from planner.plan import FootstepPlan, pair_pose

ROOM = str(Path(__file__).resolve().parent.parent / "maps" / "room.png")


def test_a_reach_is_two_numbers():
    assert parse_reach("0.1,0.2") == Reach(0.1, 0.2)


@pytest.mark.parametrize("text", ["0.1", "0.1,0.2,0.3", "-0.1,0", "0,nan", "a,b", ""])
def test_what_is_no_reach_is_named(text):
    with pytest.raises(ValueError, match=r"such as 0\.05,0\.1"):
        parse_reach(text)


def test_plan_ends_near_the_goal_and_keeps_the_goal_that_was_asked(capsys):
    words = ["plan", "--map", ROOM, "--goal", "2,1,1.5", "--json"]
    costs_m = []
    for more in ([], ["--goal-tolerance", "0.2,0.3"]):
        assert main([*words, *more]) == 0
        text = capsys.readouterr().out
        plan = FootstepPlan.from_json(text)
        assert json.loads(text)["goal"] == [2, 1, 1.5]
        off = pair_pose(plan.pose_world[-2:]) - (2, 1, 1.5)
        costs_m.append(plan.cost_m)
    assert 0.01 < math.hypot(*off[:2]) <= 0.2
    assert abs(off[2]) <= 0.3
    assert np.ptp(costs_m) > 0.05
    assert costs_m[1] < costs_m[0]


@pytest.mark.parametrize("reach", ["0.06,0", "0,0.1"])
def test_navigate_refuses_a_tolerance_that_its_own_rule_would_not_forgive(capsys, reach):
    assert main(["navigate", "--map", ROOM, "--goal", "1,0,0", "--goal-tolerance", reach]) == 2
    told = capsys.readouterr().err.strip()
    assert told.count("\n") == 0
    assert f"--goal-tolerance {reach} is more than 0.05,0.087" in told
