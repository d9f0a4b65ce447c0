from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("mink")

import mink

from app.controllers import load_controlled
from app.options import RobotOptions
from app.output import InputError
from controller.lipm.admittance import FootAdmittance, sole_wrench
from controller.lipm.controller import Lag, LipmController
from controller.lipm.pattern import SAMPLE_S, PatternGenerator, Pendulum, phases_of
from controller.lipm.servos import joint_targets, stiff
from controller.lipm.stabilizer import PROPORTIONAL_HZ, DcmFeedback, ForceDistribution
from controller.lipm.swing_foot import has_landed, swing_over
from controller.step_cursor import StepSequence, UpcomingSteps
from controller.walker import Walker
from sim.robots import get_robot, robot_names
from sim.scene import build_scene
from tests.programs import ROOM, refusal

HALF_SOLE_M = np.array([0.10, 0.05])
FEET = np.array([[0.0, 0.1, 0.0, 0.0], [0.0, -0.1, 0.0, 0.0]])
OMEGA = np.sqrt(9.81 / 0.8)
STEP = UpcomingSteps(
    side=np.array([1]),
    pose_world=np.array([[0.2, -0.1, 0.0, 0.0]]),
    lift_off_s=np.array([0.3]),
    touch_down_s=np.array([0.9]),
)


def walked_pattern(feet, steps):
    """The pendulum at the samples of the pattern, from rest midway between the feet."""
    pendulum = Pendulum(com=np.zeros(2), velocity=np.zeros(2), acceleration=np.zeros(2))
    states = []
    for jerk in PatternGenerator(0.8, HALF_SOLE_M).solve(pendulum, phases_of(feet, steps)):
        pendulum.advance(jerk, SAMPLE_S)
        states.append((pendulum.com, pendulum.velocity, pendulum.acceleration))
    return [np.array(part) for part in zip(*states, strict=True)]


def test_the_zmp_of_the_pattern_stays_in_the_sole_and_the_pendulum_ends_captured():
    com, velocity, acceleration = walked_pattern(FEET, STEP)
    zmp = com - acceleration / OMEGA**2
    time_s = SAMPLE_S * (1 + np.arange(len(com)))
    single = (time_s >= 0.3) & (time_s < 0.9)
    assert single.sum() == 12
    assert (np.abs(zmp[single] - FEET[0, :2]) <= HALF_SOLE_M).all()
    # With both feet down it stays between them, on a strip as wide as a sole.
    before, after = time_s < 0.3, time_s >= 0.9
    assert before.sum() + after.sum() == len(com) - 12
    assert (np.abs(zmp[before, 0]) <= HALF_SOLE_M[1] + 1e-9).all()
    assert (np.abs(zmp[before, 1]) <= 0.1 + HALF_SOLE_M[1]).all()
    # From the left foot at 0, 0.1 to the right one at 0.2, -0.1.
    off = (zmp[after] - [0.1, 0.0]) @ np.array([1, 1]) / np.sqrt(2)
    assert (np.abs(off) <= HALF_SOLE_M[1] + 1e-9).all()
    middle = [0.1, 0.0]
    np.testing.assert_allclose(com[-1] + velocity[-1] / OMEGA, middle, atol=1e-6)
    np.testing.assert_allclose(zmp[-1], middle, atol=1e-6)


def test_the_mirrored_pattern_is_the_pattern_of_the_mirrored_steps():
    sign = np.array([1, -1, 1, -1])
    mirrored = UpcomingSteps(
        side=1 - STEP.side,
        pose_world=STEP.pose_world * sign,
        lift_off_s=STEP.lift_off_s,
        touch_down_s=STEP.touch_down_s,
    )
    there, here = walked_pattern((FEET * sign)[::-1], mirrored)[0], walked_pattern(FEET, STEP)[0]
    np.testing.assert_allclose(there, here * [1, -1], atol=1e-7)


def test_a_dcm_error_decays_with_the_set_gain():
    feedback = DcmFeedback(omega=float(OMEGA))
    com, velocity, still = np.array([0.01, 0.0]), np.zeros(2), (np.zeros(2),) * 3
    for _ in range(200):
        pull = feedback.acceleration(still, com, velocity, 0.001)
        com, velocity = com + 0.001 * velocity, velocity + 0.001 * pull
    dcm = com + velocity / OMEGA
    # The integrator, which sees the error for 0.2 s only, changes this by little.
    assert dcm[0] == pytest.approx(0.01 * np.exp(-0.2 * PROPORTIONAL_HZ), rel=0.05)


def test_the_feet_together_bear_the_wrench_that_moves_the_centre_of_mass():
    soles = np.array([[0.0, 0.1, 0.0], [0.1, -0.1, 0.0]])
    com, pull = np.array([0.04, 0.01, 0.8]), np.array([0.3, -0.2, 0.0])
    load = np.array([0.6, 0.4])
    wrenches = ForceDistribution(HALF_SOLE_M).share(
        60.0, com, pull, soles, np.stack([np.eye(3)] * 2), load
    )
    force = 60 * (pull + np.array([0, 0, 9.81]))
    np.testing.assert_allclose(wrenches[:, :3].sum(axis=0), force, atol=1.0)
    about_com = wrenches[:, 3:] + np.cross(soles - com, wrenches[:, :3])
    np.testing.assert_allclose(about_com.sum(axis=0), 0.0, atol=1.0)
    pressure_m = np.abs(wrenches[:, [4, 3]] / wrenches[:, 2:3])
    assert (pressure_m <= HALF_SOLE_M).all()


def test_a_sole_turns_away_from_the_moment_that_it_bears_in_excess():
    bears = sole_wrench(np.array([0, 0, 500.0]), np.array([0.02, 0, 0]), np.zeros(3), np.eye(3))
    np.testing.assert_allclose(bears, [0, 0, 500, 0, -10, 0])
    feet = FootAdmittance()
    feet.follow(np.zeros((2, 6)), np.stack([bears, np.zeros(6)]), np.array([True, False]), 0.005)
    # 0.01 rad/s per N m over 5 ms; toes up, which brings the pressure back.
    np.testing.assert_allclose(feet.tilt_rad, np.array([[0, -0.0005], [0, 0]]))
    # In the air it goes back by and by: a jump would reach the ground through the other leg.
    feet.follow(np.zeros((2, 6)), np.zeros((2, 6)), np.array([False, True]), 0.005)
    np.testing.assert_allclose(feet.tilt_rad[0], [0, -0.000475])


def test_the_swing_foot_leaves_and_reaches_its_places_and_lands_by_force_alone():
    target = np.array([0.3, 0.1, 0.1, 0.2])
    swing = swing_over(np.array([0.0, 0.1, 0.0, 0.0]), target, -np.inf)
    np.testing.assert_allclose(swing.pose(target, 0.0, 0.75), [0, 0.1, 0, 0])
    np.testing.assert_allclose(swing.pose(target, 0.75, 0.75), target)
    assert max(swing.pose(target, t, 0.75)[2] for t in np.linspace(0, 0.75, 76)) > 0.149
    assert not has_landed(0.1, 0.1, 0.75, 0.75, force_n=10.0)
    assert has_landed(0.11, 0.1, 0.6, 0.75, force_n=100.0)
    assert not has_landed(0.11, 0.1, 0.2, 0.75, force_n=100.0)


def test_servos_at_their_targets_exert_the_torques_asked_for():
    robot = stiff(get_robot("jvrc1"))
    angle, speed, torque = np.full(12, 0.2), np.full(12, 0.5), np.arange(12.0)
    targets = joint_targets(robot, angle, speed, torque)
    exerted: list[float] = [
        j.kp * (t - q) - j.kd * dq
        for j, t, q, dq in zip(robot.joints, targets, angle, speed, strict=True)
    ]
    np.testing.assert_allclose(exerted, torque, atol=1e-9)
    assert {j.kp for j in robot.joints} == {5000.0, 6000.0, 3000.0}


def test_what_it_cannot_walk_is_one_line():
    with pytest.raises(InputError, match="--pace normal"):
        load_controlled(RobotOptions(), "lipm", "fast")


def test_a_pattern_that_cannot_stay_in_the_sole_is_relaxed_and_counted():
    pattern = PatternGenerator(0.8, HALF_SOLE_M)
    pendulum = Pendulum(com=np.zeros(2), velocity=np.array([0.0, 3.0]), acceleration=np.zeros(2))
    on_one_foot = replace(STEP, lift_off_s=np.array([-0.1]), touch_down_s=np.array([5.0]))
    jerk = pattern.solve(pendulum, phases_of(FEET, on_one_foot))
    assert pattern.relaxed == 1
    for each in jerk:
        pendulum.advance(each, SAMPLE_S)
    # It still comes to rest over the foot that it stands on.
    np.testing.assert_allclose(pendulum.com + pendulum.velocity / OMEGA, FEET[0, :2], atol=1e-6)


def test_the_posture_catches_up_with_a_pattern_that_began_anew():
    lag = Lag(com=np.array([0.05, 0.0]), velocity=np.array([0.0, 0.2]))
    for _ in range(200):
        lag.advance(0.005)
    np.testing.assert_allclose(lag.com, 0.0, atol=1e-3)
    np.testing.assert_allclose(lag.velocity, 0.0, atol=1e-2)


@pytest.mark.parametrize("broken", ["", "limits"])
def test_a_stage_without_a_solution_is_counted_and_ends_the_walk(monkeypatch, broken):
    robot = stiff(get_robot("jvrc1"))
    scene = build_scene(robot, timestep_s=0.001)
    walker = Walker(scene)
    walker.place(0, scene.standing_qpos)
    tick = LipmController().start(walker)
    tick()
    assert walker.relaxed == [{"pattern": 0, "distribution": 0, "inverse_kinematics": 0}]
    solve: Any = mink.solve_ik

    def without_solution(*words: Any, limits: Any) -> Any:
        if limits or not broken:
            raise mink.NoSolutionFound("daqp")
        return solve(*words, limits=limits)

    monkeypatch.setattr(mink, "solve_ik", without_solution)
    tick()
    count = walker.relaxed[0]["inverse_kinematics"]
    if broken:
        assert (count, walker.failures, walker.fallen()[0]) == (5, [""], False)
    else:
        told = ["the inverse kinematics have no solution"]
        assert (count, walker.failures, walker.fallen()[0]) == (1, told, True)
    walker.place(0, scene.standing_qpos)
    assert (walker.failures, walker.relaxed) == ([""], [{}])


@pytest.mark.parametrize(
    ("words", "told"),
    [
        pytest.param(
            ["--robot", "h1"],
            "legs of 6 joints with an ankle that rolls, and those of h1 have 5",
            marks=pytest.mark.skipif(
                "h1" not in robot_names(), reason="its model comes with the extra `unitree`"
            ),
        ),
        (["--policy", "own.safetensors"], "--policy goes with --controller policy"),
    ],
)
@pytest.mark.parametrize("command", ["serve", "evaluate", "trials"])
def test_what_it_cannot_walk_is_refused_by_every_command(capsys, tmp_path, command, words, told):
    needed = {"serve": [], "evaluate": ["--out", tmp_path], "trials": ["--map", ROOM]}[command]
    assert told in refusal(capsys, command, "--controller", "lipm", *words, *needed)


@pytest.mark.slow
def test_it_takes_two_steps_and_stands_the_same_way_every_time():
    robot = stiff(get_robot("jvrc1"))
    scene = build_scene(robot, timestep_s=0.001)
    ends = []
    for enters in (False, False, True):
        walker = Walker(scene)
        walker.place(0, scene.standing_qpos)
        feet = scene.soles_at(scene.standing_qpos)
        steps = np.array([[0.2, -0.1, 0, 0], [0.2, 0.1, 0, 0]])
        walker.follow(0, StepSequence.of(feet, np.array([1, 0]), steps), wait_ticks=20)
        tick = LipmController().start(walker)
        for number in range(160):
            if enters and number == 55:
                assert walker.cursor.swinging[0]
                walker.enter(build_scene(robot, timestep_s=0.001))
            tick()
        assert not walker.fallen()[0]
        assert walker.cursor.arrived[0]
        np.testing.assert_allclose(walker.soles_world()[0, ::-1], steps, atol=0.02)
        ends.append(walker.sim.qpos.copy())
    np.testing.assert_array_equal(ends[0], ends[1])
    # The solver of the physics begins anew in another scene, and nothing else does.
    np.testing.assert_allclose(ends[2], ends[0], atol=1e-3)
