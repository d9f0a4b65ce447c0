"""The figures of one walk's gait: hand-worked paths and forces, and a walk made up by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from controller.evaluation.gait_summary import (
    GaitRecorder,
    swing_apex_m,
    touchdown_speed_m_s,
)
from planner.robot_model import Side


def test_the_apex_is_above_the_line_between_the_two_places():
    up = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.12], [0.2, 0.0, 0.15], [0.4, 0.0, 0.1]])
    # The line is at 0.025 m after a quarter of the way, at 0.05 m after half of it.
    assert swing_apex_m(up) == pytest.approx(0.10)
    assert swing_apex_m(up[::-1]) == pytest.approx(0.10)
    assert swing_apex_m(up * [0, 1, 1]) == pytest.approx(0.05)  # on the spot: above the higher end
    level = np.array([[0.0, 0.0, 0.3], [0.0, 0.1, 0.37], [0.0, 0.2, 0.3]])
    assert swing_apex_m(level) == pytest.approx(0.07)


def test_touch_down_is_the_end_of_the_longest_flight():
    contact = np.array([1, 0, 1, 1, 0, 0, 0, 0, 1, 0, 1], dtype=bool)
    down = np.array([9.0, 9, 9, 9, 0.4, 0.3, 0.2, 0.1, 9, 9, 9])
    assert touchdown_speed_m_s(down, contact, 2) == pytest.approx(0.15)
    assert touchdown_speed_m_s(down, contact, 4) == pytest.approx(0.25)
    assert touchdown_speed_m_s(down, contact, 5) is None  # no flight is so long
    assert touchdown_speed_m_s(down[:8], contact[:8], 2) is None  # it never came back
    assert touchdown_speed_m_s(down, np.ones(11, bool), 2) is None  # it never left


def made_up_walker() -> Any:
    """Ten physics steps in a control step, one joint, a robot of 50 kg; sensors filled in later."""
    sensors = SimpleNamespace(
        pelvis_pos_world=np.arange(3),
        sole_pos_world=np.array([[3, 4, 5], [6, 7, 8]]),
        sole_linvel_world=np.array([[9, 10, 11], [12, 13, 14]]),
        ground_force_world=np.array([[15, 16, 17], [18, 19, 20]]),
        joint_torque=np.array([21]),
    )
    sim = SimpleNamespace(sensors=np.zeros((1, 10, 22)), recorded={"qvel": np.zeros((1, 10, 7))})
    return SimpleNamespace(
        robot=SimpleNamespace(mass_kg=50.0),
        scene=SimpleNamespace(sensors=sensors, joint_qvel=np.array([6])),
        cursor=SimpleNamespace(entry=np.array([2])),
        sim=sim,
    )


def test_a_walk_made_up_by_hand():
    """Each step 0.2 m in 0.1 s: the pelvis at 0.80, 0.83, 0.81, 0.80 m, the foot up by 6 cm."""
    walker = made_up_walker()
    recorder, read = GaitRecorder(walker), walker.sim.sensors[0]
    walker.sim.recorded["qvel"][0, :, 6] = -2.0
    read[:, 21] = 30.0  # 60 W, whichever way the joint turns
    x_m = 0.0
    for step in range(5):
        side = Side(step % 2)
        other = side.other
        for tick in range(4):
            x_m += 0.05
            read[:, 0], read[:, 2] = x_m, (0.80, 0.83, 0.81, 0.80)[tick]
            read[:, 15 + 3 * other + 2] = 600.0
            in_flight = tick in (1, 2)
            read[:, 15 + 3 * side + 2] = 0.0 if in_flight else 400.0
            read[:, 3 + 3 * side] = x_m
            read[:, 3 + 3 * side + 2] = (0.0, 0.06, 0.02, 0.0)[tick]
            read[:, 9 + 3 * side + 2] = -0.2 if tick == 2 else 0.0
            recorder.ticked(walker, side, walking=True, landed=tick == 3)
    walking = recorder.summary()
    assert walking is not None
    assert walking.pelvis_height_m["at_rest"] is None
    for height_m in np.linspace(0.9, 0.8, 30):
        read[:, 2] = height_m
        recorder.ticked(walker, Side.LEFT, walking=False, landed=False)
    gait = recorder.summary()
    assert gait is not None
    assert gait.pelvis_height_m["median"] == pytest.approx(0.805)
    assert gait.pelvis_height_m["least"] == pytest.approx(0.80)
    assert gait.pelvis_height_m["at_rest"] == pytest.approx(np.linspace(0.9, 0.8, 30)[-10:].mean())
    assert gait.pelvis_bob_m == pytest.approx(0.03)
    assert gait.swing_apex_m == pytest.approx({"median": 0.06, "p95": 0.06})
    assert gait.touchdown_speed_m_s == pytest.approx({"median": 0.2, "p95": 0.2})
    assert gait.peak_force_weights == pytest.approx(600 / (50 * 9.81))
    # Four steps of 0.2 m from the end of the first; the work of all twenty control steps.
    assert gait.cost_of_transport == pytest.approx(60 * 0.5 / (50 * 9.81 * 0.8))
    assert gait.speed_m_s == pytest.approx(0.8 / 0.5)


def test_too_few_steps_are_no_gait():
    walker = made_up_walker()
    recorder = GaitRecorder(walker)
    assert recorder.summary() is None
    for _ in range(3):
        recorder.ticked(walker, Side.LEFT, walking=True, landed=True)
    assert recorder.summary() is None
