"""The command `compare`: parameters of changed simulations recovered, and logs that are wrong."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from app.cli import main
from sim.identification.loads import smoothed
from sim.identification.robot_log import turning
from tests.changed_robot import Changes, hanging, walking
from tests.programs import refusal

CHANGES = Changes.drawn(seed=4)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("logs")


@pytest.fixture(scope="module")
def chirps(folder):
    path = folder / "hanging.csv"
    hanging(CHANGES, seconds_each=2.0).write(path)
    return path


def compared(path, *words, capsys):
    capsys.readouterr()
    assert main(["compare", str(path), "--out", str(path.parent / "out"), "--json", *words]) == 0
    return json.loads(capsys.readouterr().out)


def assert_recovered(document):
    assert len(document["joints"]) == 12
    for j, row in enumerate(document["joints"]):
        gain = row["kp_nm_rad"]["fitted"] / row["kp_nm_rad"]["model"]
        assert gain == pytest.approx(CHANGES.gain[j], rel=0.05), row["name"]
        damping = row["kd_nm_s_rad"]["fitted"] / row["kd_nm_s_rad"]["model"]
        assert damping == pytest.approx(CHANGES.damping[j], rel=0.1), row["name"]
        assert row["delay_s"]["fitted"] == pytest.approx(CHANGES.delay_s[j], abs=0.003)
        offset_deg = math.degrees(row["offset_rad"]["fitted"])
        assert offset_deg == pytest.approx(math.degrees(CHANGES.offset_rad[j]), abs=0.2)
        assert row["friction_nm"]["fitted"] == pytest.approx(CHANGES.friction_nm[j], abs=0.4)
        # Far nearer than the model: what is left is a hundredth of a degree or two.
        assert row["fitted_rms_rad"] < 0.1 * row["model_rms_rad"]
        assert row["fitted_rms_rad"] < math.radians(0.05)


def test_what_was_changed_is_found_in_a_hanging_robot(chirps, capsys):
    document = compared(chirps, "--hanging", capsys=capsys)
    assert_recovered(document)
    out = chirps.parent / "out"
    assert json.loads((out / "compare.json").read_text()) == document
    assert (out / "compare.png").stat().st_size > 50_000


def test_what_was_changed_is_found_in_a_walking_robot(folder, capsys):
    path = folder / "walking.csv"
    walking(CHANGES, steps=12).write(path)
    assert_recovered(compared(path, capsys=capsys))


def edited(chirps, change):
    """The first 5 s of the log with its cells (N, columns) changed; its path."""
    rows = [line.split(",") for line in chirps.read_text().splitlines()[:201]]
    head, cells = rows[0], np.array(rows[1:], float)
    head, cells = change(head, cells)
    path = chirps.parent / "edited.csv"
    lines = [",".join(head), *(",".join(map(repr, row)) for row in np.asarray(cells).tolist())]
    path.write_text("\n".join(lines))
    return path


def mixed_up(head, cells):
    """Two targets of the left hip have each other's name, and the right hip's yaw its sign off."""
    names = {"target_L_HIP_P_rad": "target_L_HIP_R_rad", "target_L_HIP_R_rad": "target_L_HIP_P_rad"}
    cells[:, head.index("q_R_HIP_Y_rad")] *= -1
    return [names.get(name, name) for name in head], cells


def test_joints_that_were_mixed_up_are_told(chirps, capsys):
    joints = compared(edited(chirps, mixed_up), "--hanging", capsys=capsys)["joints"]
    verdicts = {row["name"]: row["verdict"] for row in joints}
    assert verdicts["L_HIP_P"].startswith("follows the target of L_HIP_R")
    assert verdicts["L_HIP_R"].startswith("follows the target of L_HIP_P")
    assert verdicts["R_HIP_Y"].startswith("turns against its target")


def scaled(*names, by):
    def change(head, cells):
        for name in names:
            cells[:, head.index(name)] *= by
        return head, cells

    return change


def without_column(name):
    def change(head, cells):
        k = head.index(name)
        return head[:k] + head[k + 1 :], np.delete(cells, k, axis=1)

    return change


def without_rows(first, end):
    return lambda head, cells: (head, np.delete(cells, slice(first, end), axis=0))


def renamed(name, other):
    return lambda head, cells: ([other if word == name else word for word in head], cells)


def column_twice(head, cells):
    return [*head, head[1]], np.hstack([cells, cells[:, 1:2]])


def wider_than_its_head(head, cells):
    """As where a comma stands in a number."""
    return head, np.hstack([cells, cells[:, :1]])


def swapped_rows(head, cells):
    cells[[100, 101]] = cells[[101, 100]]
    return head, cells


def nan_at_1s(head, cells):
    cells[40, head.index("q_L_KNEE_rad")] = math.nan
    return head, cells


def turned_about_x(head, cells):
    """Rolls by 0.3 rad and back, and the gyroscope tells it in degrees a second."""
    time_s = cells[:, 0]
    roll = 0.3 * np.sin(3 * time_s)
    cells[:, head.index("quat_w")], cells[:, head.index("quat_x")] = (
        np.cos(roll / 2),
        np.sin(roll / 2),
    )
    cells[:, head.index("quat_y")] = cells[:, head.index("quat_z")] = 0
    cells[:, head.index("gyro_x_rad_s")] = np.degrees(0.9 * np.cos(3 * time_s))
    return head, cells


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (without_column("q_L_KNEE_rad"), "no column q_L_KNEE_rad"),
        (renamed("q_L_KNEE_rad", "q_L_KNEE_deg"), "there is q_L_KNEE_deg"),
        (without_column("quat_w"), "no column quat_w"),
        (without_column("time_s"), "no column time_s"),
        (column_twice, "column q_L_HIP_P_rad is there twice"),
        (wider_than_its_head, "cells, the first "),
        (scaled("time_s", by=1000), "time_s: rows are 25 apart"),
        (scaled("q_L_KNEE_rad", by=180 / math.pi), "q_L_KNEE_rad: "),
        (scaled("target_R_HIP_P_rad", by=180 / math.pi), "target_R_HIP_P_rad: "),
        (scaled("quat_w", "quat_x", "quat_y", "quat_z", by=2.0), "quat_z: length 2 at 0 s"),
        (swapped_rows, "time_s: 2.5 comes after 2.525"),
        (without_rows(81, 90), "a gap of 0.25 s after 2 s"),
        (without_rows(50, 300), "lasts 1.23 s"),
        (without_rows(0, 300), "there are 0 rows"),
        (nan_at_1s, "q_L_KNEE_rad is nan at time_s 1"),
        (turned_about_x, "gyro_x_rad_s, gyro_y_rad_s, gyro_z_rad_s: 57.3 times"),
    ],
)
def test_logs_that_are_wrong(change, told, chirps, capsys):
    path = edited(chirps, change)
    line = refusal(capsys, "compare", path, "--out", path.parent / "out")
    assert told in line, line


def test_files_that_are_no_logs(folder, capsys):
    for name, content, told in (
        ("a.csv", b"", "no column time_s"),
        ("b.csv", b"\xff\xfe\x00", "is not a CSV file"),
        ("c.mcap", b"nonsense", "is not an MCAP file"),
        ("d.txt", b"", "must end in .csv or .mcap"),
    ):
        path = folder / name
        path.write_bytes(content)
        assert told in refusal(capsys, "compare", path, "--out", folder / "out")
    words = "compare", folder / "none.csv", "--out", folder / "out", "--robot", "cassie"
    assert "passive joints" in refusal(capsys, *words)
    assert "cannot read" in refusal(capsys, "compare", folder / "none.csv", "--out", folder / "out")


def test_derivatives_of_polynomials_are_exact():
    rng = np.random.default_rng(0)
    time_s = np.cumsum(rng.uniform(0.015, 0.035, 60))
    polynomial = np.polynomial.Polynomial([0.3, -1.0, 2.0, 0.5, -0.7])
    at_s = np.linspace(time_s[0], time_s[-1], 200)
    found = smoothed(time_s, polynomial(time_s)[:, None], at_s)
    for degree, values in enumerate(found):
        expected = polynomial.deriv(degree)(at_s) if degree else polynomial(at_s)
        assert values[:, 0] == pytest.approx(expected, abs=1e-6)


def test_turning_by_hand():
    half = 0.05
    quat = np.array([[1, 0, 0, 0], [math.cos(half), 0, 0, math.sin(half)], [-1, 0, 0, 0]])
    rates = turning(np.array([0.0, 0.1, 0.2]), quat)
    assert rates == pytest.approx(np.array([[0, 0, 1.0], [0, 0, -1.0]]))


@pytest.mark.slow
def test_a_recorded_walk_is_that_of_the_model(folder, capsys):
    pytest.importorskip("mcap", reason="the extra record is not installed")
    walk = ["navigate", "--map", "maps/room.png", "--goal", "0.4,-0.5,-0.4", "--out", str(folder)]
    assert main([*walk, "--record", str(folder / "walk.mcap")]) == 0
    joints = compared(folder / "walk.mcap", capsys=capsys)["joints"]
    # A few steps: one leg swings too seldom.
    known = [row for row in joints if row["verdict"] != "too little in the log"]
    assert len(known) >= 6
    for row in known:
        assert row["verdict"] == "as the model"
        assert row["kp_nm_rad"]["fitted"] == pytest.approx(row["kp_nm_rad"]["model"], rel=0.05)
        assert row["model_rms_rad"] < math.radians(0.05)
