"""What `plan` says, writes and draws."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np

from app.cli import main
from app.output import ExitCode

ROOT = Path(__file__).resolve().parent.parent

ROOM = str(ROOT / "maps" / "room.png")

GOAL = ("--goal", "2,1,1.57")


def test_a_plan_as_a_document(capsys):
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
    picture = cv2.imread(str(image))
    assert picture is not None
    assert min(picture.shape[:2]) >= 200


def test_what_refinement_saves_is_told_and_drawn(tmp_path, capsys):
    out, image = tmp_path / "plan.json", tmp_path / "refinement.png"
    words = ("plan", "--map", ROOM, *GOAL, "--out", str(out))
    assert main((*words, "--refine-image", str(image))) == ExitCode.DONE
    refined = json.loads(out.read_text())
    before_m = refined["cost_before_refinement_m"]
    assert refined["cost_m"] < before_m
    assert f"refined from {before_m:.2f} m" in capsys.readouterr().out
    picture = cv2.imread(str(image))
    assert picture is not None
    # Two maps side by side.
    assert picture.shape[1] > 1.5 * picture.shape[0]
    assert main((*words, "--no-refine")) == ExitCode.DONE
    assert "refined" not in capsys.readouterr().out
    searched = json.loads(out.read_text())
    assert searched["cost_before_refinement_m"] is None
    assert searched["cost_m"] == before_m


def test_a_picture_of_refinement_needs_refinement(capsys):
    words = ("plan", "--map", ROOM, *GOAL, "--refine-image", "x.png", "--no-refine")
    assert main(words) == ExitCode.BAD_INPUT
    assert "--no-refine" in capsys.readouterr().err


def test_the_document_says_when_there_is_no_plan(tmp_path, capsys):
    words = ("plan", "--map", ROOM, "--goal", "99,0,0", "--json", "--out", str(tmp_path / "p"))
    assert main(words) == ExitCode.NO_PLAN
    out = capsys.readouterr().out
    assert json.loads(out)["status"] == "off_map"
    assert (tmp_path / "p").read_text() == out
