"""The command `evaluate`: every section end to end, what a cut-off run keeps, what is stored."""

from __future__ import annotations

import json
import pickle
import shutil
from dataclasses import replace

import numpy as np
import pytest

from app.cli import main
from app.commands import evaluate
from app.commands.evaluate import SECTION_NAMES, EvaluateOptions
from app.evaluation import limits, sections
from app.evaluation.figures import FIGURES
from app.evaluation.hardware import HARDWARE
from app.evaluation.limits import measured_of, sole_errors_m
from app.evaluation.parts import finite
from app.evaluation.sections import SECTIONS, measure_part, mode_row, parts_of
from controller.assessment import ModeResult
from controller.evaluation.step_limits import StepWalks
from controller.policy import POLICY_FOLDER
from controller.step_sequences import MODES
from controller.tracking_limits import limits_from, load_tracking_limits, tracking_limits_path
from planner.robot_model import FootShape
from tests.evaluations import (
    LIMITS,
    ROBOT,
    WORDS,
    evaluation_setup,
    made_up,
    measured_results,
)
from tests.programs import picture_at, refusal


@pytest.mark.slow
def test_every_section_end_to_end(tmp_path, capsys, monkeypatch):
    few = [(0.0, 0.2, 0.0), (0.3, 0.2, 0.0), (0.0, 0.2, 0.3)]
    monkeypatch.setattr(limits, "step_grid", lambda *_: np.array(few))
    monkeypatch.setattr(sections, "TREAD_NOISE_M", (0.03,))
    monkeypatch.setattr(sections, "JOINT_NOISE_DEG", (3.0,))
    monkeypatch.setattr(sections, "LONG_WALK_S", 5.0)
    gains = {"servo gains": replace(HARDWARE["servo gains"], values=(0.9,))}
    monkeypatch.setattr(sections, "HARDWARE", gains)
    stored = tracking_limits_path(None, ROBOT)
    before = stored.read_bytes() if stored.exists() else None
    assert main([*WORDS, "--json", "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert (tmp_path / "evaluation.json").read_text() == printed
    document = json.loads(printed)
    assert set(SECTION_NAMES) < set(document)
    assert [row["mode"] for row in document["modes"]] == [*MODES, "standing", "mixed"]
    for row in document["modes"]:
        assert row["episodes"] == 1
        # 400 ticks hold at least the four steps that every episode but a standing one has.
        if row["mode"] not in ("standing", "mixed") and row["falls"] == 0:
            assert row["landings"] >= 4
            assert 0 < row["error_m_median"] <= row["error_m_p95"] < 0.2
    assert [row["way"] for row in document["stairs"][:2]] == ["up", "down"]
    assert len(document["gait"]["joints"]) == 12
    walked = document["gait"]["walk"]
    height = walked["pelvis_height_m"]
    assert 0.5 < height["least"] < document["gait"]["pelvis_standing_m"] < 1.0
    assert height["least"] <= height["median"]
    assert 0.03 < walked["swing_apex_m"]["median"] <= walked["swing_apex_m"]["p95"] < 0.4
    assert document["gait"]["joint_jerk_rad_s3"] > 0
    assert max(document["gait"]["force_peak"]) > 0.9
    assert document["gait"]["contact_agreement"] > 0.9
    assert len(document["push"]) == 4
    forward = [row for row in document["energy"] if row["kind"] == "forward"]
    assert forward[-1]["speed_m_s"] > forward[0]["speed_m_s"] > 0.01
    assert document["long"]["walks"] == 1
    assert len(document["limits"]["map"]["kinds"]) == 3
    text = (tmp_path / "report.md").read_text()
    assert all(f"| {mode} |" in text for mode in MODES)
    for name in [name for name in FIGURES if not name.startswith("beside")]:
        assert f"]({name})" in text
        picture_at(tmp_path / name)
    # One walk does not tell 99 %: what is stored beside the weights stays as it is.
    assert (stored.read_bytes() if stored.exists() else None) == before


def test_a_run_that_is_cut_off_goes_on_where_it_was(tmp_path, capsys, monkeypatch):
    words = [*WORDS, "--sections", "modes", "--json", "--out", str(tmp_path)]
    asked = []

    def assess(robot, controller, mode, **settings):
        asked.append(mode)
        if len(asked) == 3:
            raise KeyboardInterrupt
        return made_up(mode or "mixed")

    monkeypatch.setattr(sections, "assess_mode", assess)
    assert main(words) == 130
    assert capsys.readouterr().err.splitlines()[-1] == "interrupted"
    rows = json.loads((tmp_path / "evaluation.json").read_text())["modes"]
    assert [row["mode"] for row in rows] == ["forward", "backward"]
    assert "| backward |" in (tmp_path / "report.md").read_text()
    assert main(words) == 0
    assert asked[2] == "sideways"
    assert asked[3:5] == ["sideways", "curved"]
    assert len(asked) == 3 + 8
    # The same again has nothing left to do; another seed has all.
    assert main(words) == 0
    assert len(asked) == 11
    assert main([*words, "--seed", "2"]) == 0
    assert len(asked) == 21


def test_a_mode_in_numbers():
    row = mode_row(made_up("forward"))
    assert row["error_m_median"] == 0.02
    assert row["heading_deg_median"] == pytest.approx(2.0)
    assert (row["along_m_median"], row["across_m_median"]) == (0.01, 0.02)
    assert row["error_m_quantiles"][0] == 0.01
    assert row["error_m_quantiles"][25] == 0.02
    assert row["error_m_quantiles"][50] == 0.05
    none = made_up("standing")
    none = ModeResult(
        **{
            **vars(none),
            "landing_error_m": np.zeros(0),
            "landing_heading_error_rad": np.zeros(0),
            "landing_offset_m": np.zeros((0, 2)),
        }
    )
    assert finite(mode_row(none))["along_m_p95"] is None
    assert finite(mode_row(none))["error_m_median"] is None


def test_what_planning_is_to_know_by_hand():
    made_results = measured_results()
    found = measured_of(evaluation_setup(), made_results)
    assert found is not None
    assert found.limits == limits_from({**LIMITS, "z_m": [-0.01, 0.10]})
    assert found.foot_margin_m == 0.013
    assert found.body_margin_m == 0.071
    assert found.evidence["widest_shape"] == "hips"
    without = {name: r for name, r in made_results.items() if not name.startswith("stairs")}
    flat = measured_of(evaluation_setup(), without)
    assert flat is not None
    assert flat.limits.z_m == ROBOT.step_model.limits.z_m
    failed = made_results["limits-region"] | {"found": False}
    assert measured_of(evaluation_setup(), made_results | {"limits-region": failed}) is None
    assert measured_of(evaluation_setup(), {}) is None


def test_a_sole_that_is_off_and_turned():
    """3 cm off, turned by 0.1 rad; a corner of a sole of 0.3 x 0.4 m is 0.25 m from its middle."""
    walks = StepWalks(
        upright=np.array([True]),
        robot=np.array([0]),
        error_m=np.array([0.03]),
        heading_error_rad=np.array([0.1]),
    )
    assert sole_errors_m(walks, FootShape(length_m=0.4, width_m=0.3)) == pytest.approx([0.055])


def test_stored_beside_the_weights_from_enough_episodes_on(tmp_path, capsys):
    made_results = measured_results()
    for ending in (".safetensors", ".json"):
        shutil.copy(POLICY_FOLDER / f"jvrc1{ending}", tmp_path / f"own{ending}")
    options = EvaluateOptions(out=tmp_path, policy=tmp_path / "own.safetensors")
    for episodes, name in ((99, None), (100, "own.measured.json")):
        measured = measured_of(evaluation_setup(episodes), made_results)
        assert evaluate.store_limits(options, evaluation_setup(episodes), measured) == name
        assert load_tracking_limits(ROBOT, options.policy) == (measured if name else None)
    assert "99 episodes are too few" in capsys.readouterr().err


@pytest.mark.slow
def test_the_model_based_controller_is_measured_beside_the_policy(tmp_path, monkeypatch, capsys):
    pytest.importorskip("mink")
    monkeypatch.setattr(sections, "QUICK_STEPS_S", ())
    words = [*WORDS, "--sections", "pace,modes", "--beside", "lipm", "--json"]
    monkeypatch.setattr(sections, "MODES", ("forward",))
    assert main([*words, "--out", str(tmp_path)]) == 0
    document = json.loads(capsys.readouterr().out)
    beside = document["beside"]
    assert beside == {
        key: value
        for key, value in json.loads((tmp_path / "lipm" / "evaluation.json").read_text()).items()
        if key in evaluate.SHOWN_BESIDE
    }
    assert beside["controller"]["kp_nm_rad"]["L_KNEE"] == 6000.0
    for each in (document, beside):
        (pace,) = each["pace"]
        assert pace["falls"] == 0
        assert pace["speed_m_s"] == pytest.approx(pace["step_m"] / 1.1, rel=0.05)
        assert [row["falls"] for row in each["modes"]] == [0, 0, 0]
    assert document["pace"] != beside["pace"]
    assert "| falls, lipm |" in (tmp_path / "report.md").read_text()


def test_sections_are_chosen_by_name(capsys, tmp_path):
    assert tuple(SECTIONS) == SECTION_NAMES
    told = refusal(capsys, *WORDS, "--sections", "modes,walks", "--out", tmp_path)
    assert "'walks' is not one of modes, stairs" in told


def test_part_is_measured_by_its_name_in_another_process_as_in_this_one():
    setup = evaluation_setup(1)
    parts = {part.name: part for part in parts_of(setup)}
    assert {name: part.needs for name, part in parts.items() if part.needs} == {
        "limits-sway": ("limits-region",)
    }
    sent = pickle.loads(pickle.dumps(setup))
    here, there = parts["modes-standing"].measure({}), measure_part(sent, {}, "modes-standing")
    assert finite(here) == finite(there)
    not_found = {"limits-region": {"found": False}}
    assert measure_part(sent, not_found, "limits-sway")["walks"] == 0
