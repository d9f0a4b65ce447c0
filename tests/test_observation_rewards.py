"""Observation: hand-worked numbers and the law of the mirror; reward terms worked by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from controller import reward_inputs as ri
from controller import rewards as r
from controller.env import WalkTask
from controller.observation import (
    critic_fields,
    mirror_map,
    pelvis_yaw_rad,
    policy_fields,
    roll_pitch_rad,
    rotate_xy,
    steps_in_heading_frame,
)
from controller.step_cursor import STANCE, StepSequence
from controller.step_sequences import draw_sequence
from controller.walker import Walker
from sim.posture import mirrored_qpos, mirrored_qvel
from sim.robots import get_robot, robot_names
from sim.scene import build_scene


def quaternion(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """w, x, y, z of yaw, then pitch, then roll, by three half-angle products."""
    cr, sr = np.cos(roll / 2), np.sin(roll / 2)
    cp, sp = np.cos(pitch / 2), np.sin(pitch / 2)
    cy, sy = np.cos(yaw / 2), np.sin(yaw / 2)
    return np.array(
        [
            cy * cp * cr + sy * sp * sr,
            cy * cp * sr - sy * sp * cr,
            cy * sp * cr + sy * cp * sr,
            sy * cp * cr - cy * sp * sr,
        ]
    )


def test_vectors_rotate_counterclockwise():
    """3 cm ahead and 1 cm left of a heading along +y is 1 cm toward -x and 3 cm toward +y."""
    rotated = rotate_xy(np.array([[0.03, 0.01, 5.0]]), np.array([np.pi / 2]))
    assert rotated[0] == pytest.approx([-0.01, 0.03, 5.0])


def test_angles_come_back_from_the_quaternion():
    qpos = np.zeros((1, 19))
    qpos[0, 3:7] = quaternion(0.2, -0.3, 2.0)
    assert roll_pitch_rad(qpos)[0] == pytest.approx([0.2, -0.3])
    assert pelvis_yaw_rad(qpos)[0] == pytest.approx(2.0)


def test_step_one_metre_to_the_left_of_a_robot_that_faces_plus_y():
    robot = get_robot("jvrc1")
    qpos = np.zeros((1, 19))
    qpos[0, :3] = [1.0, 2.0, robot.pelvis_height_m + 0.05]
    qpos[0, 3:7] = quaternion(0.1, 0.1, np.pi / 2)
    steps = np.array([[[0.0, 2.0, 0.1, np.pi / 2 + 0.3], [1.0, 2.5, 0.0, -3.0]]])
    seen = steps_in_heading_frame(robot, qpos, steps)[0]
    assert seen[0] == pytest.approx([0, 1, 0.05, 0.3], abs=1e-9)
    assert seen[1] == pytest.approx([0.5, 0, -0.05, 2 * np.pi - 3 - np.pi / 2], abs=1e-9)


@pytest.mark.parametrize("name", robot_names())
def test_mirror_maps_are_their_own_inverse(name):
    robot = get_robot(name)
    fields = policy_fields(robot) + critic_fields()
    index, sign = mirror_map(fields)
    values = np.random.default_rng(0).normal(size=len(sign))
    once = sign * values[index]
    assert not np.allclose(once, values)
    assert sign * once[index] == pytest.approx(values)


def mirrored_track(sequence: StepSequence) -> StepSequence:
    pose = sequence.pose_world * np.array([1, -1, 1, -1])
    return replace(sequence, side=1 - sequence.side, pose_world=pose)


@pytest.mark.parametrize("name", robot_names())
def test_mirrored_robot_sees_the_mirrored_observation(name):
    """observe(mirror(state)) == mirror(observe(state)), with steps, clock and all."""
    robot = get_robot(name)
    walker = Walker(build_scene(robot, timestep_s=0.005), count=2)
    scene, rng = walker.scene, np.random.default_rng(5)
    index, sign = mirror_map(policy_fields(robot))
    start = scene.soles_at(scene.standing_qpos)
    for trial in range(20):
        qpos = rng.normal(size=scene.model.nq)
        qpos[3:7] = quaternion(*rng.uniform(-0.5, 0.5, size=3))
        qvel = rng.normal(size=scene.model.nv)
        walker.place(0, qpos, qvel)
        walker.place(1, mirrored_qpos(scene, qpos), mirrored_qvel(scene, qvel))
        sequence = draw_sequence(rng, robot.step_model, start, mode=None, steps=6)
        sequence = replace(sequence, step_s=rng.uniform(0.7, 1.4, len(sequence.side) - STANCE))
        walker.follow(0, sequence)
        walker.follow(1, mirrored_track(sequence))
        for _ in range(17 * trial):
            walker.cursor.advance()
        seen = walker.observe()
        assert seen[1] == pytest.approx(sign * seen[0][index], abs=1e-12)


@pytest.mark.parametrize(("height_m", "tolerance"), [(0.3, 1e-3), (0.0, 0.1)])
@pytest.mark.parametrize("name", robot_names())
def test_critic_sees_the_mirror_image_too(name, height_m, tolerance):
    """After one step under mirrored actions.

    In the air the image is exact; on the ground the contact solver treats left and right a
    little differently, but the two feet's forces must not be mixed up.
    """
    robot = get_robot(name)
    task = WalkTask(robot, count=2, seed=0)
    scene, rng = task.walker.scene, np.random.default_rng(6)
    qpos, qvel = scene.standing_qpos.copy(), np.zeros(scene.model.nv)
    qpos[2] += height_m
    qpos[3:7] = quaternion(0.05, 0.05, 0.1)
    qvel[:3] = [0.1, 0.2, 0.0]
    sequence = draw_sequence(
        rng, robot.step_model, scene.soles_at(scene.standing_qpos), mode="curved", steps=5
    )
    task.walker.place(0, qpos, qvel)
    task.walker.place(1, mirrored_qpos(scene, qpos), mirrored_qvel(scene, qvel))
    task.walker.follow(0, sequence, walking=True)
    task.walker.follow(1, mirrored_track(sequence), walking=True)
    joint_index, joint_sign = robot.mirror_joints
    action = 0.1 * rng.normal(size=len(robot.joints))
    seen = task.step(np.stack([action, joint_sign * action[joint_index]])).critic_observation
    index, sign = mirror_map(policy_fields(robot) + critic_fields())
    assert seen[1] == pytest.approx(sign * seen[0][index], abs=tolerance)
    assert not np.allclose(seen[0], seen[1], atol=0.2)


# Reward terms: hand-worked cases of each, and the paper's weights.

PERFECT = ri.RewardInputs(
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
    joint_acceleration_rad_s2=np.zeros(1),
    foot_path_error_m=np.zeros((1, 2)),
    swing_height_error_m=np.zeros(1),
    climb_m=np.zeros(1),
    step_s=np.array([1.0]),
    pelvis_speed_z_m_s=np.zeros(1),
    power_w_kg=np.zeros(1),
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
        ("foot_path", {"foot_path_error_m": np.array([[0.0, 9.0]])}, 0.3),
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
        ("swing_profile", {"swing_height_error_m": np.array([-0.03])}, 0.5),
        ("swing_profile", {"swing_height_error_m": np.array([0.09])}, -0.5),
        ("swing_profile", {"swing_height_error_m": np.array([0.3])}, -1.0),
        ("joint_acceleration", {"joint_acceleration_rad_s2": np.array([50.0])}, np.exp(-2)),
        ("pelvis_height", {"height_error_m": np.array([-0.04])}, np.exp(-1)),
        ("pelvis_height", {"height_error_m": np.array([-0.1]), "climb_m": np.array([0.1])}, 1.0),
        ("pelvis_speed", {"pelvis_speed_z_m_s": np.array([-0.2])}, np.exp(-2)),
        (
            "pelvis_speed",
            {"pelvis_speed_z_m_s": np.array([0.25]), "climb_m": np.array([0.1])},
            np.exp(-1),
        ),
        ("power", {"power_w_kg": np.array([4.8])}, np.exp(-2)),
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


@pytest.mark.parametrize("climb_m", [0.0, 0.15])
def test_a_swing_foot_leaves_and_lands_slowly_and_clears_a_sill(climb_m):
    """Its speed at the ground is the one allowed there, and grows with the height."""
    time_s = np.linspace(0.0, 0.375, 3751)
    height_m = ri.swing_height_profile_m(time_s, np.full(len(time_s), climb_m))
    speed_m_s = np.diff(height_m) / np.diff(time_s)
    assert height_m[0] == 0.0
    assert speed_m_s[0] == pytest.approx(ri.TOUCHDOWN_M_S, rel=0.01)
    assert (speed_m_s >= 0).all()
    allowed = ri.TOUCHDOWN_M_S + ri.FASTER_PER_S * height_m[1:]
    assert (speed_m_s <= 1.01 * allowed).all()
    # No jolt: it is braked by less than gravity.
    assert np.diff(speed_m_s).min() / time_s[1] > -9.81
    assert height_m.max() == pytest.approx(ri.SWING_APEX_M + 0.3 * climb_m, rel=0.02)
    # Over the sills of 5 cm that plans step over, for nearly half of the swing.
    assert np.mean(height_m > 0.05) > 0.47


def test_a_swing_foot_goes_its_way_by_minimum_jerk():
    """At rest at both ends, halfway at half time, where it is 15/8 as fast as on average."""
    time = np.linspace(0.0, 1.0, 1001)
    way = ri.swing_way_gone(time)
    speed = np.diff(way) / np.diff(time)
    assert way[[0, 500, 1000]] == pytest.approx([0.0, 0.5, 1.0])
    assert speed[[0, -1]] == pytest.approx([0.0, 0.0], abs=1e-4)
    assert speed.max() == pytest.approx(15 / 8, rel=1e-4)
    assert way + way[::-1] == pytest.approx(np.ones(1001))


@pytest.mark.parametrize(
    ("rise_m", "x_m", "expected_m"),
    [
        (0.0, 1.3, 0.0),
        (0.0, 1.0, 0.3),
        (0.1, 1.0, 0.2),
        # Ahead of time: at 2/3 of it, so 64 / 81 of the way are gone and 6.63 cm forgiven.
        (-0.1, 1.3, 0.6 * 64 / 81 - 0.3 - 0.4 * 64 / 81 * 17 / 81),
        (-0.1, 1.5, 0.0),
    ],
)
def test_a_climbing_foot_may_be_off_its_way_by_the_rise(rise_m, x_m, expected_m):
    """Half its time over, on the way from x = 1 to x = 1.6; a foot that steps down is ahead."""
    sole, start = np.array([[x_m, 0.0, 0.0, 0.0]]), np.array([[1.0, 0.0, 0.0, 0.0]])
    target = np.array([[1.6, 0.0, rise_m, 0.0]])
    error_m = ri.swing_path_error_m(sole, start, target, np.array([0.5]))
    assert error_m == pytest.approx([expected_m])


def test_landing_speed_is_seen_between_two_control_steps():
    """Dropped by h, soles meet the ground at sqrt(2 g h), wherever in a control step that is."""
    robot, drop_m = get_robot("jvrc1"), 0.03
    task = WalkTask(robot, count=1, seed=0)
    walker, scene = task.walker, task.walker.scene
    sequence = draw_sequence(
        np.random.default_rng(0),
        robot.training_model,
        scene.soles_at(scene.standing_qpos),
        mode="in_place",
        steps=4,
    )
    qpos = scene.standing_qpos.copy()
    qpos[2] += drop_m
    walker.place(0, qpos)
    walker.follow(0, sequence, wait_ticks=20)
    overspeed_m_s = []
    for _ in range(6):
        step = ri.StepTargets.of(walker)
        walker.act(np.zeros((1, len(robot.joints))))
        inputs = ri.reward_inputs(walker, step, walker.joint_torque_nm())
        overspeed_m_s.append(inputs.landing_overspeed_m_s.max())
    fallen_m_s = np.sqrt(2 * 9.81 * drop_m)
    assert max(overspeed_m_s) == pytest.approx(fallen_m_s - ri.TOUCHDOWN_M_S, abs=0.1)


def test_a_schedule_goes_from_one_reward_to_the_other_while_the_robot_walks():
    schedule = r.RewardSchedule(
        first={"height": 1.0}, last={"height": 0.5, "power": 0.5}, blend_share=0.2
    )
    assert schedule.at(0.0) == {"height": 1.0}
    assert schedule.at(0.5) == pytest.approx({"height": 0.75, "power": 0.25})
    assert schedule.at(1.0) == {"height": 0.5, "power": 0.5}

    def after(blended, success, error_m):
        walks = schedule.walks(success=success, error_m=error_m)
        return schedule.after(blended, share=0.05, walks=walks)

    for success, error_m in ((0.94, 0.01), (1.0, 0.03), (1.0, math.nan)):  # not yet
        assert after(0.0, success, error_m) == 0.0
    assert after(0.0, 0.95, 0.02) == pytest.approx(0.25)
    assert after(0.9, 1.0, 0.01) == 1.0
    # What costs the robot its walk or its precision is taken back.
    assert after(1.0, 0.94, 0.01) == after(1.0, 1.0, 0.03) == pytest.approx(0.75)


def test_a_schedule_of_one_reward_stays_there():
    schedule = r.RewardSchedule(first=r.PAPER, last=dict(r.PAPER))
    assert schedule.after(1.0, share=0.1, walks=False) == 1.0
    assert schedule.at(1.0) == r.PAPER


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_weights_sum_to_1_all_the_way(share):
    schedule = r.RewardSchedule(first=r.PRECISE, last=r.QUIET)
    assert sum(schedule.at(share).values()) == pytest.approx(1.0)


def test_unknown_term_is_an_error():
    with pytest.raises(KeyError, match="lift"):
        r.reward(PERFECT, {"lift": 1.0})
