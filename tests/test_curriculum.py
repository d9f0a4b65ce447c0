"""When the task grows harder, worked by hand; and the ground under a swinging foot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from controller.curriculum import FLAT, MEASURED, PAPER, Curriculum, Stage
from controller.rewards import swing_ground_m


def after(curriculum, stage, flat=1.0, stairs=1.0, updates=0):
    return curriculum.after(stage, updates=updates, flat_success=flat, stairs_success=stairs)


def test_run_begins_on_flat_ground_without_disturbances():
    assert {c.first() for c in (MEASURED, PAPER, FLAT)} == {
        Stage(rise_m=0.0, disturbance_level=0.0)
    }


def test_stairs_come_with_success_on_flat_ground_alone():
    assert after(MEASURED, Stage(), flat=0.94) == Stage()
    first = after(MEASURED, Stage(), flat=0.95, stairs=0.0)
    assert (first.rise_m, first.disturbance_level) == pytest.approx((0.015, 0.1))


def test_rise_grows_only_while_flat_and_stairs_both_succeed():
    stage = Stage(rise_m=0.03, disturbance_level=0.2)
    assert after(MEASURED, stage, flat=0.94, stairs=1.0) == stage
    assert after(MEASURED, stage, flat=1.0, stairs=0.89) == stage
    grown = after(MEASURED, stage, flat=0.95, stairs=0.90)
    assert (grown.rise_m, grown.disturbance_level) == pytest.approx((0.045, 0.3))


def test_rise_stops_at_the_top():
    curriculum = replace(MEASURED, top_rise_m=0.04)
    stage, rises = curriculum.first(), []
    for _ in range(4):
        stage = after(curriculum, stage)
        rises.append(stage.rise_m)
    assert rises == pytest.approx([0.015, 0.03, 0.04, 0.04])
    assert stage.disturbance_level == 1.0


@pytest.mark.parametrize(
    ("updates", "rise_m"),
    [(0, 0.0), (3000, 0.0), (7000, 0.05), (9000, 0.075), (11_000, 0.10), (20_000, 0.10)],
)
def test_papers_schedule_is_flat_for_3000_updates_then_linear_over_8000(updates, rise_m):
    """It asks for no success."""
    stage = after(PAPER, Stage(), flat=0.0, stairs=0.0, updates=updates)
    assert stage.rise_m == pytest.approx(rise_m)
    assert stage.disturbance_level == pytest.approx(rise_m / 0.10)


def test_flat_runs_get_the_disturbances_once_they_walk():
    assert after(FLAT, Stage(), flat=0.9) == Stage()
    assert after(FLAT, Stage(), flat=0.96) == Stage(rise_m=0.0, disturbance_level=1.0)


@pytest.mark.parametrize(
    "values",
    [
        {"top_rise_m": -0.1},
        {"top_rise_m": float("nan")},
        {"rise_step_m": 0.0},
        {"flat_success": 1.1},
        {"stairs_success": -0.1},
        {"flat_updates": -1},
        {"growth_updates": 0},
    ],
)
def test_impossible_curriculum_is_refused_by_its_name(values):
    with pytest.raises(ValueError, match=next(iter(values))):
        Curriculum(**values)


def lift(done_x_m, rise_m, y_m=0.0, way_m=0.4):
    """Reference for a foot at x of a way along x, over a start at height 1."""
    sole = np.array([[done_x_m, y_m, 9.0, 0.0]])
    start, target = np.array([[0, 0, 1.0, 0.0]]), np.array([[way_m, 0, 1.0 + rise_m, 0.0]])
    return float(swing_ground_m(sole, start, target)[0])


@pytest.mark.parametrize("x_m", [-0.1, 0.0, 0.13, 0.4, 0.6])
def test_ground_under_a_swing_on_the_level_is_the_level(x_m):
    assert lift(x_m, 0.0) == 1.0
    assert lift(x_m, 0.0, way_m=0.0) == 1.0


@pytest.mark.parametrize(
    ("x_m", "up_m", "down_m"),
    [
        (-0.1, 1.00, 1.00),  # swung back first
        (0.0, 1.00, 1.00),
        (0.1, 1.05, 1.00),  # a quarter of the way
        (0.2, 1.10, 1.00),
        (0.3, 1.10, 0.95),  # three quarters
        (0.4, 1.10, 0.90),
        (0.5, 1.10, 0.90),  # past its target
    ],
)
def test_ground_rises_early_going_up_and_falls_late_going_down(x_m, up_m, down_m):
    assert lift(x_m, 0.10) == pytest.approx(up_m)
    assert lift(x_m, -0.10) == pytest.approx(down_m)
    assert lift(x_m, 0.10, y_m=0.3) == pytest.approx(up_m)  # only the way along counts
