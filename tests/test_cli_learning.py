"""The commands `evaluate` and `trials` from the words typed to what they write and say."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import pytest

from app.cli import main
from controller.step_sequences import MODES

ROOM = str(Path(__file__).resolve().parent.parent / "maps" / "room.png")


def test_evaluate_writes_a_row_for_every_mode(tmp_path, capsys):
    words = ["evaluate", "--sections", "modes", "--episodes", "1", "--workers", "2", "--json"]
    assert main([*words, "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert (tmp_path / "evaluation.json").read_text() == printed
    document = json.loads(printed)
    assert [row["mode"] for row in document["modes"]] == [*MODES, "standing", "mixed"]
    for row in document["modes"]:
        assert row["episodes"] == 1
        # 400 ticks hold at least the four steps that every episode but a standing one has.
        if row["mode"] not in ("standing", "mixed") and row["falls"] == 0:
            assert row["landings"] >= 4
            assert 0 < row["error_m_median"] <= row["error_m_p95"] < 0.2
    report = (tmp_path / "report.md").read_text()
    assert all(f"| {mode} |" in report for mode in MODES)
    assert cv2.imread(str(tmp_path / "errors.png")) is not None


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


@pytest.mark.parametrize("command", ["evaluate", "trials"])
def test_missing_policy_is_told_in_one_line(command, tmp_path, capsys):
    words = [command, "--policy", "none.safetensors", "--out", str(tmp_path)]
    if command == "trials":
        words += ["--map", ROOM]
    assert main(words) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "no policy file none.safetensors" in error
