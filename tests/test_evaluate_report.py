"""The report of `evaluate`: its text and figures, alone and beside another evaluation."""

from __future__ import annotations

import json

from app.commands import evaluate
from app.evaluation.figures import FIGURES, drawn, write_figures
from app.evaluation.report_text import report
from app.evaluation.sections import mode_row
from app.evaluation.tables import plain_joint, table
from sim.robots import get_robot
from tests.evaluations import (
    WORDS,
    document_of,
    made_up,
    made_up_evaluation,
    measured_results,
    stairs_row,
)
from tests.programs import ROOT, picture_at, refusal


def test_pictures_and_text_of_made_up_stairs_and_limits(tmp_path):
    made_results = measured_results()
    document = document_of(made_results, "own.measured.json", ("stairs", "limits"))
    document["stairs"] = [r for name, r in made_results.items() if name.startswith("stairs")]
    write_figures(document, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"stairs.png", "limits.png"}
    text = report(document)
    assert "| 10 cm | none | 100 | 99.0 %, 9.9 s | 97.0 %, 9.7 s | trained for |" in text
    assert "| 10 cm | joints, degrees ±3 | 100 | - | 100.0 %, 10.0 s | withstood |" in text
    assert "up to 10 cm, a foot margin of 1.3 cm" in text
    assert "Stored: own.measured.json." in text


def test_no_legend_covers_what_is_drawn():
    """In the figures of the evaluation that the docs show; each has a legend."""
    file = ROOT / "docs" / "evaluation" / "jvrc1" / "evaluation.json"
    document = json.loads(file.read_text())
    document["beside"] = dict(document)
    for name, (section, *_) in FIGURES.items():
        if section not in document:
            continue
        figure = drawn(document, name)
        figure.draw_without_rendering()
        (legend,) = figure.legends
        covered = legend.get_window_extent()
        panels = [axes.get_window_extent() for axes in figure.axes]
        assert not any(covered.overlaps(panel) for panel in panels), name
        assert covered.x0 >= 0, name
        assert covered.x1 <= figure.bbox.x1, name


def test_another_policy_beside(tmp_path, capsys):
    """The document of one evaluation, read into the report of another."""
    results = {"modes-forward": mode_row(made_up("forward"))}
    other = document_of(results)
    other["stairs"] = [stairs_row("up", 0.10, 0.5), stairs_row("down", 0.15, 0.25)]
    other["modes"] = [{**other["modes"][0], "falls": 1}]
    folder = tmp_path / "other"
    folder.mkdir()
    (folder / "evaluation.json").write_text(json.dumps(other))
    mine = document_of(results)
    mine["stairs"] = [stairs_row("up", 0.10, 1.0)]
    mine["beside"] = evaluate.read_beside(folder, "jvrc1")
    text = report(mine)
    assert "| forward | 0 of 1 | 1 of 1 | 2.0 / 4.7 cm | 2.0 / 4.7 cm |" in text
    assert "| 10 cm up | 100.0 % of 100 | 50.0 % of 100 |" in text
    assert "15 cm down" not in text
    assert "--reward quiet" in text
    write_figures({"beside": mine["beside"], "modes": mine["modes"]}, tmp_path)
    assert "](beside.png)" in text
    picture_at(tmp_path / "beside.png")
    words = [*WORDS, "--out", str(tmp_path / "out"), "--beside"]
    assert "cannot be read (No such file" in refusal(capsys, *words, tmp_path)
    told = refusal(capsys, *words, folder, "--robot", "hrp5p")
    assert "is of jvrc1, not of hrp5p" in told
    (folder / "evaluation.json").write_text(json.dumps(other | {"modes": []}))
    assert "has no modes; measure it" in refusal(capsys, *words, folder)
    (folder / "evaluation.json").write_text("{}")
    told = refusal(capsys, *words, folder)
    assert f"is not an evaluation of format {evaluate.FORMAT}" in told


def test_the_gait_stands_beside_the_papers_peaks_of_the_same_robot():
    document = document_of({})
    loads = {
        "peak_torque_nm": 90.0,
        "rms_torque_nm": 30.0,
        "torque_limit_nm": 600.0,
        "peak_speed_rad_s": 1.5,
        "speed_limit_rad_s": 8.0,
    }
    walk = {
        "pelvis_height_m": {"median": 0.79, "least": 0.75, "at_rest": None},
        "pelvis_bob_m": 0.03,
        "swing_apex_m": {"median": 0.07, "p95": 0.12},
        "touchdown_speed_m_s": {"median": 0.15, "p95": 0.3},
        "peak_force_weights": 1.15,
        "cost_of_transport": 0.4,
        "speed_m_s": 0.28,
    }
    document["gait"] = {
        "walks": 16,
        "falls": 0,
        "step_m": 0.3,
        "joints": [{"joint": joint.name, **loads} for joint in get_robot("hrp5p").joints],
        "joint_jerk_rad_s3": 150.0,
        "pelvis_standing_m": 0.8,
        "walk": walk,
        "force_peak": [1.1, 1.15],
        "contact_agreement": 1.0,
        "lift_off_lag_s": 0.0,
        "touch_down_lag_s": None,
    }
    ours = report(document)
    assert "| swing apex, median / 95th percentile | 7.0 / 12.0 cm |" in ours
    assert "| the same at rest (half-sitting: 0.800 m) | - |" in ours
    assert "contact, median / 95th percentile | 0.15 / 0.30 m/s |" in ours
    assert "84.4" not in ours
    theirs = report({**document, "robot": "hrp5p"})
    assert "| hip pitch | 84.4 / 97.9 | 0.9 | 1.57 / 1.5 | 1.0 |" in theirs
    document["gait"]["walk"] = {**walk, "touchdown_speed_m_s": None, "cost_of_transport": None}
    assert "contact, median / 95th percentile | - / - m/s |" in report(document)
    document["gait"]["walk"] = None
    assert "swing apex" not in report(document)


def test_two_controllers_side_by_side(tmp_path, capsys):
    by_model = {"name": "lipm", "rate_hz": 200, "state": "true base pose"}
    mine = made_up_evaluation(1.0)
    other = made_up_evaluation(2.0, policy_sha256=None, trained=None, controller=by_model)
    mine["beside"] = evaluate.shown_beside(other)
    write_figures(mine, tmp_path)
    text = report(mine)
    for name in FIGURES.keys() - {"limits.png"}:
        assert f"]({name})" in text
        picture_at(tmp_path / name)
    assert "The other is controller lipm (200 Hz; true base pose), evaluated with seed 1" in text
    for line in (
        "| mode | falls, policy | falls, lipm |",
        "| 10 cm down, joints ±3° | 90.0 % of 100 | 45.0 % of 100 |",
        "| hip pitch | 75 | 150 | 600 | 1.50 | 1.50 | 8 |",
        "| peak force of one foot, weights | 1.10 | 2.20 |",
        "| from behind | 100 % / 100 % | 50 % / 50 % |",
        "| sideways, 30 cm | 0.70 | 1.40 |",
        "| 0.5 s | 8 of 8 | 8 of 8 | - | - |",
        "policy: 1 of 8 fell; lipm: 1 of 8 fell",
    ):
        assert line in text
    assert report(other).startswith("# How well jvrc1 follows its steps\n\nController lipm (200")
    told = refusal(capsys, *WORDS, "--beside", "policy", "--out", tmp_path / "out")
    assert "--beside policy: that is who walks already; give lipm" in told


def test_names_of_joints_and_tables():
    names = ("L_HIP_R", "left_hip_roll_joint", "LCR", "LKP", "left_knee", "LAP")
    assert [plain_joint(name) for name in names] == [
        *("hip roll", "hip roll", "hip roll", "knee", "knee", "ankle pitch"),
    ]
    shown = table([{"x": 1}], ("a", "{x}"), ("b", lambda row: f"{2 * row['x']}"))
    assert shown == ["| a | b |", "|---|---|", "| 1 | 2 |"]
