from __future__ import annotations

import dataclasses
import json

import pytest

from app.navigation.report import (
    NavigationReport,
    Outcome,
    Percentiles,
    PolicyFile,
    SensedSummary,
    installed_versions,
)
from app.output import ExitCode
from controller.evaluation.gait_summary import GaitSummary
from planner.plan import NarrowPlace

REPORT = NavigationReport(
    outcome=Outcome.REACHED,
    goal_error_m=0.03,
    goal_error_rad=0.02,
    steps_planned=31,
    steps_taken=31,
    foot_error_m=Percentiles(median=0.02, p95=0.05, max=0.07),
    min_clearance_m=0.21,
    planning_time_s=0.05,
    compile_time_s=0.5,
    sim_time_s=35.2,
    wall_time_s=4.1,
    robot="jvrc1",
    map="maps/room.png",
    start=(0, 0, 0),
    goal=(2, 1, 1.57),
    seed=0,
    policy=PolicyFile(file="controller/policies/jvrc1.safetensors", sha256="ab" * 32),
    versions={"mujoco": "4.0.0"},
)


def test_the_document_is_the_agreed_one():
    assert json.loads(REPORT.to_json()) == {
        "format": "navigation-report/1",
        "outcome": "reached",
        "reason": "",
        "goal_error_m": 0.03,
        "goal_error_rad": 0.02,
        "steps_planned": 31,
        "steps_taken": 31,
        "replans": 0,
        "recovery_steps": 0,
        "foot_error_m": {"median": 0.02, "p95": 0.05, "max": 0.07},
        "min_clearance_m": 0.21,
        "planning_time_s": 0.05,
        "compile_time_s": 0.5,
        "sim_time_s": 35.2,
        "wall_time_s": 4.1,
        "robot": "jvrc1",
        "map": "maps/room.png",
        "start": [0, 0, 0],
        "goal": [2, 1, 1.57],
        "seed": 0,
        "policy": {"file": "controller/policies/jvrc1.safetensors", "sha256": "ab" * 32},
        "versions": {"mujoco": "4.0.0"},
    }


GAIT = GaitSummary(
    pelvis_height_m={"median": 0.8, "least": 0.75, "at_rest": 0.81},
    pelvis_bob_m=0.02,
    swing_apex_m={"median": 0.07, "p95": 0.08},
    touchdown_speed_m_s=None,
    peak_force_weights=1.1,
    cost_of_transport=0.4,
    speed_m_s=0.28,
)
PLACE = NarrowPlace(x=1.5, y=-0.25, width_m=0.65, needed_m=0.842)
BY_MODEL = {"name": "lipm", "rate_hz": 200}
SENSED = SensedSummary(
    walked_m=4.5,
    turned_rad=3.1,
    drift_m=0.02,
    drift_rad=0.01,
    own_foot_error_m={"median": 0.01, "p95": 0.02, "max": 0.03},
    localization_error_m=None,
)
ENGINE = {"name": "drake", "version": "1.51.1", "contact": {"approximation": "sap"}}
WITH_ALL = dataclasses.replace(
    REPORT, gait=GAIT, narrow_place=PLACE, controller=BY_MODEL, sensed=SENSED, engine=ENGINE
)


def test_every_field_is_in_the_document():
    fields = {field.name for field in dataclasses.fields(NavigationReport)}
    assert set(json.loads(WITH_ALL.to_json())) == fields | {"format"}
    without = set(json.loads(REPORT.to_json()))
    left_out = {"controller", "engine", "gait", "narrow_place", "sensed"}
    assert without == (fields | {"format"}) - left_out


@pytest.mark.parametrize(
    "report",
    [
        REPORT,
        WITH_ALL,
        NavigationReport(
            outcome=Outcome.NO_PATH,
            reason="the goal is walled in",
            start=(0, 0, 0),
            goal=(9, 9, 0),
            robot="jvrc1",
            map="m.png",
            seed=3,
        ),
    ],
)
def test_reading_undoes_writing(report):
    assert NavigationReport.from_json(report.to_json()) == report


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda d: d.pop("seed"), "'seed' is missing"),
        (lambda d: d.update(extra=1), "'extra' is unknown"),
        (lambda d: d.update(format="navigation-report/9"), "navigation-report/9"),
        (lambda d: d.update(outcome="won"), "won"),
        (lambda d: d.update(goal=[1, 2]), "not enough values"),
        (lambda d: d.update(policy={"path": "x"}), "path"),
    ],
)
def test_a_wrong_document_is_refused_by_name(change, told):
    document = json.loads(REPORT.to_json())
    change(document)
    with pytest.raises(ValueError, match=told):
        NavigationReport.from_json(json.dumps(document))


def test_a_number_that_json_lacks_is_refused():
    with pytest.raises(ValueError, match="JSON"):
        dataclasses.replace(REPORT, goal_error_m=float("nan")).to_json()


def test_percentiles_of_hand_worked_numbers():
    # 21 values 0 .. 0.20: the middle one, and the one 95 % of the way along.
    error = Percentiles.of([i / 100 for i in range(21)])
    assert error is not None
    assert (error.median, error.p95, error.max) == pytest.approx((0.10, 0.19, 0.20))
    assert Percentiles.of([]) is None


def test_exit_codes():
    codes = {outcome: outcome.exit_code for outcome in Outcome}
    assert codes == {
        Outcome.REACHED: ExitCode.DONE,
        Outcome.NO_PATH: ExitCode.NO_PLAN,
        Outcome.FELL: ExitCode.WALK_FAILED,
        Outcome.COLLIDED: ExitCode.WALK_FAILED,
        Outcome.TIMED_OUT: ExitCode.WALK_FAILED,
    }


def test_policy_file_is_named_by_its_bytes(tmp_path):
    path = tmp_path / "policy.bin"
    path.write_bytes(b"abc")
    sha256 = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert PolicyFile.of(path) == PolicyFile(file=str(path), sha256=sha256)


def test_versions_name_the_simulator():
    assert {"python", "mujoco"} <= set(installed_versions())


def test_summary_tells_the_errors_in_centimetres():
    assert "from the goal: 3.0 cm, 1.1 degrees" in REPORT.summary()
