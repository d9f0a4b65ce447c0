"""What the policy sees: hand-worked numbers, and the law of the mirror."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

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
from sim.robots import get_robot, robot_names
from sim.scene import build_scene
from tests.test_sim import mirrored_qpos, mirrored_qvel


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
