"""The commands plan, navigate and trials: what they say, write and refuse."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import app.commands.trials
from app.cli import main
from app.navigation.report import NavigationReport, Outcome
from app.options import Reach, parse_reach
from app.output import ExitCode
from controller.policy import load_policy, save_policy
from planner.plan import FootstepPlan, pair_pose
from sim.robots import get_robot
from tests.programs import ROOM, picture_at, refusal

GOAL = ("--goal", "2,1,1.57")


def test_a_plan_as_a_document(capsys):
    main(("plan", "--map", ROOM, *GOAL))  # in a fresh clone it tells that it compiles
    capsys.readouterr()
    assert main(("plan", "--map", ROOM, *GOAL, "--json")) == ExitCode.DONE
    out, err = capsys.readouterr()
    assert err == ""
    plan = json.loads(out)
    assert plan["format"] == "footstep-plan/1"
    assert plan["status"] == "found"
    assert (plan["robot"], plan["map"]) == ("jvrc1", ROOM)
    assert (plan["start"], plan["goal"]) == ([0, 0, 0], [2, 1, 1.57])
    # The last two steps are the feet at the goal: their middle is the goal.
    last = np.array([[step[key] for key in ("x", "y", "yaw")] for step in plan["steps"][-2:]])
    np.testing.assert_allclose(last.mean(axis=0), [2, 1, 1.57], atol=1e-9)


def test_a_plan_as_files(tmp_path, capsys):
    out, image = tmp_path / "plan.json", tmp_path / "plan.png"
    words = ("plan", "--map", ROOM, *GOAL, "--out", str(out), "--image", str(image))
    assert main(words) == ExitCode.DONE
    assert "steps, cost" in capsys.readouterr().out
    assert json.loads(out.read_text())["status"] == "found"
    picture = picture_at(image)
    assert min(picture.shape[:2]) >= 200


def test_what_refinement_saves_is_told_and_drawn(tmp_path, capsys):
    out, image = tmp_path / "plan.json", tmp_path / "refinement.png"
    words = ("plan", "--map", ROOM, *GOAL, "--out", str(out))
    assert main((*words, "--refine-image", str(image))) == ExitCode.DONE
    refined = json.loads(out.read_text())
    before_m = refined["cost_before_refinement_m"]
    assert refined["cost_m"] < before_m
    assert f"refined from {before_m:.2f} m" in capsys.readouterr().out
    picture = picture_at(image)
    # Two maps side by side.
    assert picture.shape[1] > 1.5 * picture.shape[0]
    assert main((*words, "--no-refine")) == ExitCode.DONE
    assert "refined" not in capsys.readouterr().out
    searched = json.loads(out.read_text())
    assert searched["cost_before_refinement_m"] is None
    assert searched["cost_m"] == before_m


def test_a_picture_of_refinement_needs_refinement(capsys):
    words = ("plan", "--map", ROOM, *GOAL, "--refine-image", "x.png", "--no-refine")
    assert "--no-refine" in refusal(capsys, *words)


def test_the_document_says_when_there_is_no_plan(tmp_path, capsys):
    words = ("plan", "--map", ROOM, "--goal", "99,0,0", "--json", "--out", str(tmp_path / "p"))
    assert main(words) == ExitCode.NO_PLAN
    out = capsys.readouterr().out
    assert json.loads(out)["status"] == "off_map"
    assert (tmp_path / "p").read_text() == out


def navigate(tmp_path: Path, *words: str) -> int:
    return main(["navigate", "--map", ROOM, "--out", str(tmp_path), *words])


def test_walk_in_the_room_writes_what_the_contract_names(tmp_path, capsys):
    code = navigate(tmp_path, "--goal", "0.3,0.2,0.3", "--start", "-0.1,0,0", "--json")
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
    picture_at(tmp_path / "path.png")


def test_a_walk_of_four_steps_and_more_tells_of_its_gait(tmp_path, capsys):
    assert navigate(tmp_path, "--goal", "0.4,0.5,0") == 0
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
        (("--goal", "1,1,0", "--strip", "walk.txt"), 2, "must end in"),
    ],
)
def test_what_cannot_be_walked_says_why(tmp_path, capsys, words, code, complaint):
    assert navigate(tmp_path, *words) == code
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


def test_a_policy_that_does_not_see_durations_walks_at_its_own_pace_alone(tmp_path, capsys):
    """Policies from before there were paces observe all but the last field."""
    policy = load_policy(get_robot("jvrc1"))
    (weight, bias), *rest = policy.layers
    before = replace(
        policy,
        layers=((weight[:, :-2], bias), *rest),
        offset=policy.offset[:-2],
        scale=policy.scale[:-2],
        about={**policy.about, "observation": policy.about["observation"][:-1]},
    )
    path = tmp_path / "before.safetensors"
    save_policy(before, path)
    words = ("--goal", "1,1,0", "--policy", str(path))
    assert navigate(tmp_path, *words, "--pace", "fast") == 2
    assert "knows one pace, 1.1 s" in capsys.readouterr().err


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
    words = ("navigate", "--map", ROOM, "--goal", "1,0,0", "--goal-tolerance", reach)
    told = refusal(capsys, *words)
    assert f"--goal-tolerance {reach} is more than 0.05,0.087" in told


@pytest.mark.slow
def test_trials_give_the_same_results_whatever_the_workers(tmp_path, capsys):
    results = []
    for workers in ("1", "2"):
        out = tmp_path / workers
        words = ["trials", "--map", ROOM, "--count", "2", "--apart", "0.2", "--seed", "5"]
        assert main([*words, "--workers", workers, "--out", str(out)]) == 0
        assert "walks" in capsys.readouterr().out
        trials = json.loads((out / "trials.json").read_text())["trials"]
        results.append([{**trial, "planning_time_s": None} for trial in trials])
    assert results[0] == results[1]
    assert len(results[0]) == 2


def test_trials_go_on_where_they_were_stopped(tmp_path, capsys, monkeypatch):
    words = ["trials", "--map", ROOM, "--apart", "0.2", "--seed", "5", "--workers", "1"]
    words += ["--out", str(tmp_path)]
    assert main([*words, "--count", "1"]) == ExitCode.DONE
    first = json.loads((tmp_path / "trials.json").read_text())["trials"]

    def stopped(walk, trials, workers, cluster):
        assert [trial.number for trial in trials] == [1, 2]
        yield walk(trials[0])
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(app.commands.trials, "in_order", stopped)
        assert main([*words, "--count", "3", "--resume"]) == ExitCode.INTERRUPTED
    assert "2 of 3 walks are in" in capsys.readouterr().err
    document = json.loads((tmp_path / "trials.json").read_text())
    assert document["summary"]["walks"] == 2
    assert document["trials"][0] == first[0]
    # All that is asked for is there, so nobody walks.
    assert main([*words, "--count", "2", "--resume"]) == ExitCode.DONE
    assert json.loads((tmp_path / "trials.json").read_text())["trials"] == document["trials"]
    told = refusal(capsys, *words, "--count", "3", "--resume", "--pace", "fast")
    assert "have another pace" in told
    (tmp_path / "trials.json").write_text("[]")
    assert "holds no trials to go on with" in refusal(capsys, *words, "--resume")


@pytest.mark.parametrize("command", ["evaluate", "trials"])
def test_missing_policy_is_told_in_one_line(command, tmp_path, capsys):
    words = [command, "--policy", "none.safetensors", "--out", str(tmp_path)]
    if command == "trials":
        words += ["--map", ROOM]
    assert "no policy file none.safetensors" in refusal(capsys, *words)
