"""What the benchmarks of reliability count by: intervals, whole files, feet on boxes."""

from __future__ import annotations

import json
import random
import signal

import cv2
import numpy as np
import pytest

from app.viewer.obstacles import Obstacle
from benchmarks.copies import until_interrupted
from benchmarks.faults import contents, half_written, timeless
from benchmarks.hostile import refusals
from benchmarks.soak import outline, sole_polygon
from benchmarks.walks import badness, line, map_files, wilson
from planner.robot_model import FootShape


@pytest.mark.parametrize(
    ("successes", "tries", "low", "high"),
    [
        # With none, or all, of n the interval ends at z^2 / (n + z^2): 3.8415 / 13.8415.
        (0, 10, 0.0, 0.27753),
        (10, 10, 0.72247, 1.0),
        # Agresti and Coull, Approximate is Better than "Exact", 1998: 0.404 to 0.596.
        (50, 100, 0.40383, 0.59617),
        (0, 0, 0.0, 1.0),
    ],
)
def test_intervals_of_shares(successes, tries, low, high):
    assert wilson(successes, tries) == pytest.approx((low, high), abs=1e-5)


def walk(outcome, *, joined=True, errors_m=(0.01,), clearance_m=0.2):
    return {
        "outcome": outcome,
        "joined": joined,
        "foot_errors_m": list(errors_m),
        "min_clearance_m": clearance_m,
        "reason": "",
    }


def test_walks_between_parts_that_nothing_joins_count_apart_and_falls_come_first():
    walks = [
        walk("reached", errors_m=(0.01, 0.03)),
        walk("no_path", joined=False, errors_m=(), clearance_m=None),
        walk("fell", errors_m=(0.02,), clearance_m=0.1),
    ]
    told = line("room", walks)
    assert "1 of 2" in told
    assert "others: 1 fell; 1 pairs not joined" in told
    assert "feet 2.0 / 2.9 / 3.0 cm; nearest obstacle 10.0 cm" in told
    assert [w["outcome"] for w in sorted(walks, key=badness, reverse=True)] == [
        "fell",
        "reached",
        "no_path",
    ]
    assert line("none", []).startswith("none")


def test_maps_of_a_folder_are_its_yaml_files(tmp_path):
    for name in ("b.yaml", "a.yml", "a.png"):
        (tmp_path / name).touch()
    assert map_files([tmp_path, tmp_path / "a.png"]) == [
        tmp_path / "a.yml",
        tmp_path / "b.yaml",
        tmp_path / "a.png",
    ]


def test_foreign_requests_are_refused():
    assert refusals(random.Random(1), 20) == {
        "foreign Origin": 20,
        "foreign Host": 20,
        "no key": 20,
    }


def test_ctrl_c_ends_the_numbers_after_the_one_that_is_at_work():
    before, done = signal.getsignal(signal.SIGINT), []
    for number in until_interrupted(range(10)):
        if number == 2:
            signal.raise_signal(signal.SIGINT)
        done.append(number)
    assert done == [0, 1, 2]
    assert signal.getsignal(signal.SIGINT) == before


def test_half_written_files_are_seen_and_times_are_not_compared(tmp_path):
    cv2.imwrite(str(tmp_path / "whole.png"), np.zeros((40, 40), np.uint8))
    (tmp_path / "cut.png").write_bytes((tmp_path / "whole.png").read_bytes()[:-20])
    (tmp_path / "cut.npz").write_bytes(b"PK\3\4")
    (tmp_path / "cut.json").write_text('{"a": ')
    (tmp_path / ".cut-1-2.json").write_text('{"a": ')
    (tmp_path / "empty.md").touch()
    (tmp_path / "whole.html").write_text("<html></html>\n")
    assert sorted(half_written(tmp_path)) == ["cut.json", "cut.npz", "cut.png", "empty.md"]
    one, other = (
        timeless(json.dumps({"a": [{"b": 1, "time_s": t}], "wall_time_s": t}).encode())
        for t in (1.0, 2.0)
    )
    assert one == other == b'{"a": [{"b": 1}]}'
    for path in tmp_path.glob("*cut*"):
        path.unlink()
    (tmp_path / ".left").touch()
    assert set(contents(tmp_path)) == {".left", "empty.md", "whole.html", "whole.png"}


def test_a_sole_is_on_a_box_where_they_overlap():
    foot = FootShape(length_m=0.2, width_m=0.1)
    turned = sole_polygon(foot, 1.0, 2.0, np.pi / 2)
    assert turned.bounds == pytest.approx((0.95, 1.9, 1.05, 2.1))
    below = outline(Obstacle(number=0, x_m=1.1, y_m=2.0, size_x_m=0.2, size_y_m=0.1))
    assert below.bounds == pytest.approx((1.0, 1.95, 1.2, 2.05))
    assert turned.intersection(below).area == pytest.approx(0.05 * 0.1)
