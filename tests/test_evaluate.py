"""The command `evaluate`: every section end to end, what a cut-off run keeps, what is stored."""

from __future__ import annotations

import json
import pickle
import shutil
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from app.cli import main
from app.commands import evaluate
from app.commands.evaluate import SECTION_NAMES, EvaluateOptions
from app.evaluation import limits, sections
from app.evaluation.figures import FIGURES, write_figures
from app.evaluation.hardware import HARDWARE
from app.evaluation.limits import measured_of, sole_errors_m
from app.evaluation.parts import EvaluationSetup, finite
from app.evaluation.report_text import report
from app.evaluation.sections import SECTIONS, measure_part, mode_row, parts_of
from app.evaluation.tables import plain_joint, table
from controller.assessment import ModeResult
from controller.evaluation.step_limits import StepWalks
from controller.policy import POLICY_FOLDER, load_policy
from controller.step_sequences import MODES
from controller.tracking_limits import limits_from, load_tracking_limits, tracking_limits_path
from planner.robot_model import FootShape
from sim.robots import get_robot
from tests.programs import picture_at, refusal

ROBOT = get_robot("jvrc1")
WORDS = ["evaluate", "--episodes", "1", "--workers", "2"]
LIMITS = {"x_m": [-0.1, 0.3], "y_m": [0.17, 0.3], "yaw_rad": [-0.1, 0.3], "z_m": [-0.01, 0.01]}


def stairs_row(way: str, rise_m: float, success: float, kind: str = "none", noise: float = 0.0):
    """A row of the section stairs, made up."""
    return {
        "way": way,
        "rise_m": rise_m,
        "noise_kind": kind,
        "noise": noise,
        "episodes": 100,
        "success": success,
        "length_s_mean": 10 * success,
    }


@pytest.fixture
def measured_results():
    """Parts of the sections stairs and limits, made up."""
    kinds = [
        {"x_m": x, "y_m": y, "yaw_rad": yaw, "success": 0.9 + x, "error_m_p95": 0.01 + abs(x)}
        for x in (-0.1, 0.0, 0.1)
        for y in (0.2, 0.3)
        for yaw in (0.0, 0.3)
    ]
    return {
        "stairs-a": stairs_row("up", 0.10, 0.99),
        "stairs-b": stairs_row("down", 0.10, 0.97),
        "stairs-c": stairs_row("up", 0.15, 0.985),
        "stairs-d": stairs_row("up", 0.20, 0.5),
        "stairs-e": stairs_row("down", 0.10, 1.0, "joint", 3.0),
        "limits-map": {"walks_each": 3, "kinds": kinds},
        "limits-region": {
            "walks_each": 100,
            "tried": [{"limits": LIMITS, "success": 0.8}, {"limits": LIMITS, "success": 0.995}],
            "found": True,
            "landings": 900,
            "sole_error_m_p99": 0.01234,
        },
        "limits-sway": {
            "walks": 9,
            "body_beyond_box_m": {"head": [-0.2, -0.1], "hips": [0.05, 0.0701]},
        },
    }


def evaluation_setup(episodes: int = 100) -> EvaluationSetup:
    return EvaluationSetup(robot=ROBOT, controller=load_policy(ROBOT), episodes=episodes, seed=1)


def document_of(results, stored=None, names=SECTION_NAMES):
    """evaluation.json of these results, of sections of these names."""
    setup = evaluation_setup()
    parts = [part for name in names for part in SECTIONS[name](setup)]
    return evaluate.document_of(setup, parts, results, stored)


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


def made_up(mode: str) -> ModeResult:
    return ModeResult(
        mode=mode,
        episodes=1,
        falls=0,
        episode_ticks=np.array([400]),
        landing_error_m=np.array([0.05, 0.01, 0.02]),
        landing_heading_error_rad=np.radians([1.0, 3.0, 2.0]),
        landing_offset_m=np.array([[0.03, -0.04], [-0.01, 0.0], [0.0, 0.02]]),
    )


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


def test_what_planning_is_to_know_by_hand(measured_results):
    found = measured_of(evaluation_setup(), measured_results)
    assert found is not None
    assert found.limits == limits_from({**LIMITS, "z_m": [-0.01, 0.10]})
    assert found.foot_margin_m == 0.013
    assert found.body_margin_m == 0.071
    assert found.evidence["widest_shape"] == "hips"
    without = {name: r for name, r in measured_results.items() if not name.startswith("stairs")}
    flat = measured_of(evaluation_setup(), without)
    assert flat is not None
    assert flat.limits.z_m == ROBOT.step_model.limits.z_m
    failed = measured_results["limits-region"] | {"found": False}
    assert measured_of(evaluation_setup(), measured_results | {"limits-region": failed}) is None
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


def test_stored_beside_the_weights_from_enough_episodes_on(tmp_path, measured_results, capsys):
    for ending in (".safetensors", ".json"):
        shutil.copy(POLICY_FOLDER / f"jvrc1{ending}", tmp_path / f"own{ending}")
    options = EvaluateOptions(out=tmp_path, policy=tmp_path / "own.safetensors")
    for episodes, name in ((99, None), (100, "own.measured.json")):
        measured = measured_of(evaluation_setup(episodes), measured_results)
        assert evaluate.store_limits(options, evaluation_setup(episodes), measured) == name
        assert load_tracking_limits(ROBOT, options.policy) == (measured if name else None)
    assert "99 episodes are too few" in capsys.readouterr().err


def test_pictures_and_text_of_made_up_stairs_and_limits(tmp_path, measured_results):
    document = document_of(measured_results, "own.measured.json", ("stairs", "limits"))
    document["stairs"] = [r for name, r in measured_results.items() if name.startswith("stairs")]
    write_figures(document, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"stairs.png", "limits.png"}
    text = report(document)
    assert "| 10 cm | none | 100 | 99.0 %, 9.9 s | 97.0 %, 9.7 s | trained for |" in text
    assert "| 10 cm | joints, degrees ±3 | 100 | - | 100.0 %, 10.0 s | withstood |" in text
    assert "up to 10 cm, a foot margin of 1.3 cm" in text
    assert "Stored: own.measured.json." in text


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


CURVES = ("force_mean", "force_low", "force_high", "contact_mean", "indicator_mean")


def made_up_evaluation(scale: float, **who) -> dict:
    """evaluation.json with every section but limits; figures grow with the scale."""
    walk = {
        "pelvis_height_m": {"median": 0.8, "least": 0.75, "at_rest": 0.8},
        "pelvis_bob_m": 0.01 * scale,
        "swing_apex_m": {"median": 0.05 * scale, "p95": 0.1},
        "touchdown_speed_m_s": {"median": 0.15, "p95": 0.3},
        "peak_force_weights": 1.1 * scale,
        "cost_of_transport": 0.4 * scale,
        "speed_m_s": 0.28,
    }
    loads = {"peak_torque_nm": 50.0 * scale, "peak_speed_rad_s": 1.5, "rms_torque_nm": 20.0}
    limits = {"torque_limit_nm": 600.0, "speed_limit_rad_s": 8.0}
    joints: list[dict[str, Any]] = [
        {"joint": joint.name, **loads, **limits} for joint in ROBOT.joints
    ]
    joints[-6]["peak_torque_nm"] *= 1.5  # the right leg's first joint
    walks = {"walks": 8, "falls": 2}
    return {
        **document_of({"modes-forward": mode_row(made_up("forward"))}),
        **who,
        "stairs": [
            stairs_row(way, 0.10, 0.9 / scale, kind, noise)
            for way in ("up", "down")
            for kind, noise in (("none", 0.0), ("tread", 0.02), ("joint", 3.0))
        ],
        "gait": {
            **walks,
            "step_m": 0.3,
            "joints": joints,
            "joint_jerk_rad_s3": 150.0,
            "pelvis_standing_m": 0.8,
            "walk": walk,
            "cycle_time_s": [0.5, 1.5],
            **{name: [[0.5, 1.0], [1.0, 0.5]] for name in CURVES},
            "force_peak": [1.1, 1.15],
            "contact_agreement": 1.0,
            "lift_off_lag_s": 0.0,
            "touch_down_lag_s": None,
        },
        "push": [
            {
                "direction": "from behind",
                "walks": 8,
                "impulses_ns": [6.2, 12.5],
                "success": [1, 0.5],
            }
        ],
        "energy": [
            {
                **walks,
                "kind": "sideways",
                "step": [0.0, 0.3, 0.0],
                "speed_m_s": 0.1,
                "cost_of_transport": 0.7 * scale,
                "power_w": 20.0,
            }
        ],
        "pace": [
            {**walks, "step_s": 1.1, "step_m": 0.3, "speed_m_s": 0.28},
            {**walks, "step_s": 0.5, "step_m": 0.3, "falls": 8, "speed_m_s": None},
        ],
        "hardware": [
            {
                **walks,
                "what": "delay",
                "value": 5.0,
                "unit": "ms",
                "error_m_median": 0.01 * scale,
                "error_m_p95": 0.02 * scale,
            },
            {
                **walks,
                "what": "grip",
                "value": 0.1,
                "unit": "times the model's friction",
                "falls": 8,
                "error_m_median": None,
                "error_m_p95": None,
            },
        ],
        "long": {"walks": 8, "seconds": 60.0, "falls": 1, "fell_at_s": [12.0]},
    }


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


def test_names_of_joints_and_tables():
    names = ("L_HIP_R", "left_hip_roll_joint", "LCR", "LKP", "left_knee", "LAP")
    assert [plain_joint(name) for name in names] == [
        *("hip roll", "hip roll", "hip roll", "knee", "knee", "ankle pitch"),
    ]
    shown = table([{"x": 1}], ("a", "{x}"), ("b", lambda row: f"{2 * row['x']}"))
    assert shown == ["| a | b |", "|---|---|", "| 1 | 2 |"]


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
