"""Reward terms: hand-worked cases of each, and the paper's weights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from controller import rewards as r

PERFECT = r.RewardInputs(
    support_indicator=np.array([[1.0, -1.0]]),
    ground_force_weights=np.array([[1.0, 0.0]]),
    sole_speed_m_s=np.array([[0.0, 2.0]]),
    sole_height_m=np.array([[0.0, 0.07]]),
    foot_error_m=np.zeros((1, 2)),
    foot_heading_error_rad=np.zeros((1, 2)),
    target_distance_m=np.zeros(1),
    root_distance_m=np.zeros(1),
    swing_share=np.array([[0.3, 0.7]]),
    tilt_rad=np.zeros(1),
    heading_error_rad=np.zeros(1),
    tilt_cos=np.ones(1),
    height_error_m=np.zeros(1),
    head_offset_m=np.zeros(1),
    action_change_rad=np.zeros(1),
    torque_change_nm=np.zeros(1),
    swing_height_error_m=np.zeros(1),
    climb_m=np.zeros(1),
    step_s=np.array([1.0]),
    pelvis_speed_z_m_s=np.zeros(1),
    power_w=np.zeros(1),
    posture_error_rad=np.zeros(1),
    standing=np.array([False]),
    peak_force_weights=np.ones(1),
    landing_overspeed_m_s=np.zeros((1, 2)),
)


@pytest.mark.parametrize("term", r.TERMS)
def test_every_term_is_1_at_its_best(term):
    assert r.TERMS[term](PERFECT) == pytest.approx([1.0])


@pytest.mark.parametrize("preset", r.PRESETS)
def test_weights_sum_to_1(preset):
    assert sum(r.PRESETS[preset].values()) == pytest.approx(1.0)
    total, terms = r.reward(PERFECT, r.PRESETS[preset])
    assert total == pytest.approx([1.0])
    assert set(terms) == set(r.PRESETS[preset])


@pytest.mark.parametrize(
    ("term", "change", "expected"),
    [
        # a foot that swings under half the weight and more: -1 for it, 1 for the other
        ("ground_force", {"ground_force_weights": np.array([[0.5, 0.6]])}, 0.0),
        ("ground_force", {"ground_force_weights": np.array([[0.25, 0.0]])}, 0.5),
        ("ground_force", {"support_indicator": np.zeros((1, 2))}, 0.0),
        ("foot_speed", {"sole_speed_m_s": np.array([[0.4, 0.4]])}, 0.0),
        ("foot_speed", {"sole_speed_m_s": np.array([[0.0, 0.2]])}, 0.5),
        ("any_foot_step", {"target_distance_m": np.array([0.1])}, 0.8 * np.exp(-0.4) + 0.2),
        ("any_foot_step", {"target_distance_m": np.array([0.21])}, 0.2),
        ("any_foot_step", {"root_distance_m": np.array([2.0])}, 0.8 + 0.2 / np.e),
        ("named_foot_step", {"foot_error_m": np.array([[9.0, 0.0]])}, 0.7),
        ("named_foot_heading", {"foot_heading_error_rad": np.array([[0.0, 9.0]])}, 0.3),
        ("swing_clearance", {"sole_height_m": np.array([[0.0, 0.03]])}, 0.5),
        ("swing_clearance", {"sole_height_m": np.array([[0.0, -0.01]])}, 0.0),
        ("swing_clearance", {"sole_height_m": np.array([[0.0, 0.10]])}, 1.0),
        ("swing_clearance", {"sole_height_m": np.array([[0.0, 0.15]])}, 0.5),
        ("swing_clearance", {"sole_height_m": np.array([[0.0, 0.27]])}, 0.0),
        ("swing_clearance", {"support_indicator": np.array([[1.0, -0.9]])}, 1.0),
        ("orientation", {"tilt_cos": np.array([np.cos(0.1)])}, np.exp(-10 * np.sin(0.1) ** 2)),
        ("upright", {"tilt_rad": np.array([0.1])}, np.exp(-1)),
        ("facing", {"heading_error_rad": np.array([-0.2])}, np.exp(-1)),
        ("height", {"height_error_m": np.array([-0.1])}, np.exp(-0.4)),
        ("standing_height", {"height_error_m": np.array([-0.1])}, np.exp(-1)),
        ("upper_body", {"head_offset_m": np.array([0.2])}, np.exp(-0.4)),
        ("action_smoothness", {"action_change_rad": np.array([0.2])}, np.exp(-1)),
        ("torque_smoothness", {"torque_change_nm": np.array([4.0])}, np.exp(-1)),
        # the swing foot may be as fast as it likes, the other not; both count on the way between
        ("stance_at_rest", {"sole_speed_m_s": np.array([[0.1, 9.0]])}, np.exp(-1)),
        (
            "stance_at_rest",
            {"support_indicator": np.zeros((1, 2)), "sole_speed_m_s": np.array([[0.0, 0.2]])},
            (1 + np.exp(-2)) / 2,
        ),
        (
            "swing_profile",
            {"swing_height_error_m": np.array([-0.03])},
            np.exp(-0.6) / 2 + np.exp(-2) / 2,
        ),
        ("pelvis_height", {"height_error_m": np.array([-0.04])}, np.exp(-1)),
        ("pelvis_height", {"height_error_m": np.array([-0.1]), "climb_m": np.array([0.1])}, 1.0),
        ("pelvis_speed", {"pelvis_speed_z_m_s": np.array([-0.2])}, np.exp(-2)),
        (
            "pelvis_speed",
            {"pelvis_speed_z_m_s": np.array([0.25]), "climb_m": np.array([0.1])},
            np.exp(-1),
        ),
        ("power", {"power_w": np.array([300.0])}, np.exp(-2)),
        ("standing_posture", {"posture_error_rad": np.array([0.1])}, 1.0),
        (
            "standing_posture",
            {"posture_error_rad": np.array([0.1]), "standing": np.array([True])},
            np.exp(-2),
        ),
        ("peak_force", {"peak_force_weights": np.array([1.3])}, np.exp(-1)),
        ("peak_force", {"peak_force_weights": np.array([0.7])}, 1.0),
        ("soft_landing", {"landing_overspeed_m_s": np.array([[0.0, 0.15]])}, np.exp(-1)),
    ],
)
def test_hand_worked_values(term, change, expected):
    assert r.TERMS[term](replace(PERFECT, **change)) == pytest.approx([expected])


def test_the_papers_weights():
    weights = dict(r.PAPER)
    assert (weights.pop("ground_force"), weights.pop("foot_speed")) == (0.15, 0.15)
    assert weights.pop("any_foot_step") == 0.45
    assert set(weights.values()) == {0.05}


def test_a_swing_foot_leaves_and_lands_slowly_and_clears_a_sill():
    """Its speed at the ground is the one allowed there, and grows with the height."""
    time_s = np.linspace(0.0, 0.375, 3751)
    height_m = r.swing_height_profile_m(time_s)
    speed_m_s = np.diff(height_m) / np.diff(time_s)
    assert height_m[0] == 0.0
    assert speed_m_s[0] == pytest.approx(r.TOUCHDOWN_M_S, rel=0.01)
    rising = height_m[1:] < r.SWING_APEX_M
    allowed = r.TOUCHDOWN_M_S + r.FASTER_PER_S * height_m[1:]
    assert speed_m_s[rising] == pytest.approx(allowed[rising], rel=0.01)
    assert height_m.max() == r.SWING_APEX_M
    # Over the sills of 5 cm that plans step over, for more than half of the slowest swing.
    assert np.mean(height_m > 0.05) > 0.5


def test_a_schedule_goes_from_one_reward_to_the_other():
    schedule = r.RewardSchedule(
        first={"height": 1.0}, last={"height": 0.5, "power": 0.5}, blend=(0.2, 0.4)
    )
    assert schedule.at(0.0) == schedule.at(0.2) == {"height": 1.0}
    assert schedule.at(0.3) == pytest.approx({"height": 0.75, "power": 0.25})
    assert schedule.at(0.4) == schedule.at(1.0) == {"height": 0.5, "power": 0.5}
    assert [schedule.progress(share) for share in (0.1, 0.25, 0.9)] == pytest.approx([0, 0.25, 1])


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_weights_sum_to_1_all_the_way(share):
    schedule = r.RewardSchedule(first=r.PRECISE, last=r.QUIET)
    assert sum(schedule.at(share).values()) == pytest.approx(1.0)


def test_unknown_term_is_an_error():
    with pytest.raises(KeyError, match="lift"):
        r.reward(PERFECT, {"lift": 1.0})
