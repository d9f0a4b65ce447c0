"""The command `navigate` from the words typed to the files written."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import pytest

from app.cli import main
from app.navigation.report import NavigationReport, Outcome
from planner.plan import FootstepPlan

ROOM = str(Path(__file__).resolve().parent.parent / "maps" / "room.png")


def run(tmp_path: Path, *words: str) -> int:
    return main(["navigate", "--map", ROOM, "--out", str(tmp_path), *words])


def test_walk_in_the_room_writes_what_the_contract_names(tmp_path, capsys):
    code = run(tmp_path, "--goal", "0.3,0.2,0.3", "--start", "-0.1,0,0", "--json")
    assert code == 0
    printed = capsys.readouterr().out
    report = NavigationReport.from_json(printed)
    assert (tmp_path / "report.json").read_text() == printed
    assert report.outcome is Outcome.REACHED
    assert report.start == (-0.1, 0.0, 0.0)
    assert report.goal == (0.3, 0.2, 0.3)
    assert report.steps_taken == report.steps_planned > 0
    assert report.foot_error_m is not None
    assert report.foot_error_m.median <= report.foot_error_m.max < 0.08
    assert report.min_clearance_m is not None
    assert report.min_clearance_m > 0
    assert report.policy is not None
    assert len(report.policy.sha256) == 64
    assert {"mujoco", "python"} <= set(report.versions)
    plan = FootstepPlan.from_json((tmp_path / "plan.json").read_text())
    assert plan.start == report.start
    assert len(plan) == report.steps_planned
    assert cv2.imread(str(tmp_path / "path.png")) is not None


def test_a_walk_of_four_steps_and_more_tells_of_its_gait(tmp_path, capsys):
    assert run(tmp_path, "--goal", "0.4,0.5,0") == 0
    assert "gait: pelvis at 0." in capsys.readouterr().out
    document = json.loads((tmp_path / "report.json").read_text())
    gait, height = document["gait"], document["gait"]["pelvis_height_m"]
    assert document["steps_taken"] >= 4
    assert 0.5 < height["least"] <= height["median"] < 0.85
    assert 0.5 < height["at_rest"] < 0.85
    assert 0.5 < gait["peak_force_weights"] < 3.0
    assert 0.0 < gait["swing_apex_m"]["median"] <= gait["swing_apex_m"]["p95"] < 0.3
    assert 0.0 < gait["touchdown_speed_m_s"]["median"] < 1.5
    assert 0.02 < gait["speed_m_s"] < 0.5


@pytest.mark.parametrize(
    ("words", "code", "complaint"),
    [
        (("--goal", "0.85,0,0"), 3, "goal"),
        (("--goal", "50,0,0"), 3, "off the map"),
        (("--goal", "1,1,0", "--start", "0.85,0,0"), 3, "start"),
        (("--goal", "1,1,0", "--robot", "r2d2"), 2, "no robot 'r2d2'"),
        (("--goal", "1,1,0", "--policy", "none.safetensors"), 2, "no policy file"),
        (("--goal", "1,1"), 2, "not a pose"),
        (("--goal", "1,1,0", "--pace", "hasty"), 2, "not one of slow, normal, fast"),
        (("--goal", "1,1,0", "--robot", "hrp5p", "--pace", "fast"), 2, "knows one pace, 1.1 s"),
        (("--goal", "1,1,0", "--strip", "walk.txt"), 2, "must end in"),
    ],
)
def test_what_cannot_be_walked_says_why(tmp_path, capsys, words, code, complaint):
    assert run(tmp_path, *words) == code
    output = capsys.readouterr()
    said = output.err + output.out
    assert complaint in said
    assert "Traceback" not in said
    if code == 3:
        report = json.loads((tmp_path / "report.json").read_text())
        assert report["outcome"] == "no_path"
        assert complaint in report["reason"]
        assert report["goal_error_m"] is None
    else:
        assert len(output.err.strip().splitlines()) == 1
