from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("mink")

import mink

from app.cli import main
from app.controllers import load_controlled
from app.navigation.report import NavigationReport
from app.options import RobotOptions
from app.output import InputError
from controller.lipm.admittance import FootAdmittance, sole_wrench, upward_wrenches
from controller.lipm.controller import LipmController
from controller.lipm.height import HeightGenerator
from controller.lipm.pattern import (
    SAMPLE_S,
    SAMPLES,
    PatternGenerator,
    Pendulum,
    phases_of,
)
from controller.lipm.servos import joint_targets, stiff
from controller.lipm.stabilizer import (
    PROPORTIONAL_HZ,
    DcmFeedback,
    ForceDistribution,
    VelocityFilter,
)
from controller.lipm.swing_foot import has_landed, swing_over
from controller.lipm.whole_body import LegReach
from controller.step_cursor import StepSequence, UpcomingSteps
from controller.walker import Walker
from sim.robots import get_robot, robot_names
from sim.scene import build_scene
from tests.lipm_step import FEET, HALF_SOLE_M, OMEGA, STEP
from tests.programs import ROOM, refusal


def walked_pattern(feet, steps):
    """The pendulum at the samples of the pattern, from rest midway between the feet."""
    pendulum = Pendulum(com=np.zeros(2), velocity=np.zeros(2), acceleration=np.zeros(2))
    states = []
    jerks = PatternGenerator(0.8, HALF_SOLE_M).solve(pendulum, phases_of(feet, steps))
    assert jerks is not None
    for jerk in jerks:
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
    # With both feet down it stays on the soles and between them.
    before, after = time_s < 0.3, time_s >= 0.9
    assert before.sum() + after.sum() == len(com) - 12
    assert (np.abs(zmp[before, 0]) <= HALF_SOLE_M[0] + 1e-9).all()
    assert (np.abs(zmp[before, 1]) <= 0.1 + HALF_SOLE_M[1]).all()
    # From the left foot at 0, 0.1 to the right one at 0.2, -0.1, two corners of each on the edges.
    off = (zmp[after] - [0.1, 0.0]) @ np.array([1, 1])
    assert (np.abs(off) <= HALF_SOLE_M.sum() + 1e-9).all()
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


def test_the_velocity_of_the_body_is_found_in_noise_and_without_delay():
    """A pendulum over the left sole, its velocity read with an error of 2 cm/s."""
    rng, filtered = np.random.default_rng(0), VelocityFilter(omega=float(OMEGA))
    com, velocity, pressure = np.array([-0.1, 0.06]), np.array([0.4, -0.1]), np.array([0.02, 0.08])
    filtered.velocity = velocity.copy()
    soles, errors = FEET.copy(), []
    soles[0, 3] = 0.5
    turn = np.array([[np.cos(0.5), np.sin(0.5)], [-np.sin(0.5), np.cos(0.5)]])
    borne = upward_wrenches(
        np.array([600.0, 0]), np.array([turn @ (pressure - FEET[0, :2]), [0, 0]])
    )
    for _ in range(100):
        pull = OMEGA**2 * (com - pressure)
        com, velocity = com + 0.005 * velocity, velocity + 0.005 * pull
        read = velocity + rng.normal(0.0, 0.02, 2)
        found = filtered.update(com, read, soles, borne, 0.005)
        errors.append(found - velocity)
    assert np.std(errors) < 0.01
    assert np.abs(np.mean(errors, axis=0)).max() < 0.005
    assert np.linalg.norm(velocity - [0.4, -0.1]) > 0.3


def test_what_a_sole_bears_by_its_pressure_is_what_it_bears_by_its_force():
    pressure_m = np.array([0.03, -0.02])
    bears = upward_wrenches(np.array([500.0, 0.0]), np.array([pressure_m, [0, 0]]))
    force, point = np.array([0, 0, 500.0]), np.array([*pressure_m, 0])
    np.testing.assert_allclose(bears[0], sole_wrench(force, point, np.zeros(3), np.eye(3)))
    assert not bears[1].any()


def test_the_body_is_as_low_as_the_leg_that_reaches_farthest_needs():
    reach = LegReach(hip_m=np.zeros((2, 3)), ankle_m=np.zeros((2, 3)), longest_m=0.5)
    feet = np.array([[0.3, 0.0, 0.1, 0.0], [0.0, 0.0, 0.0, 0.0]])
    # Triangles of sides 3, 4 and 5.
    assert reach.most_com_z_m(np.zeros(2), feet, 0) == pytest.approx(0.5)
    assert reach.most_com_z_m(np.array([0.3, 0.0]), feet, 1) == pytest.approx(0.4)
    aside = replace(
        reach, hip_m=np.array([[0, 0.1, -0.05]] * 2), ankle_m=np.array([[0, 0, 0.2]] * 2)
    )
    assert aside.most_com_z_m(np.array([0.3, -0.1]), feet, 1) == pytest.approx(0.65)


def test_the_body_sinks_before_it_steps_down_and_not_faster_than_it_must():
    reach = LegReach(hip_m=np.zeros((2, 3)), ankle_m=np.zeros((2, 3)), longest_m=0.5)
    height = HeightGenerator(height_m=0.47, reach=reach, state=np.array([0.458, 0.0, 0.0]))
    down = replace(STEP, pose_world=np.array([[0.2, -0.1, -0.1, 0.0]]))
    heights, rates = [], []
    for k in range(40):
        now_s = SAMPLE_S * k
        steps = replace(
            down, lift_off_s=down.lift_off_s - now_s, touch_down_s=down.touch_down_s - now_s
        )
        com = np.tile([0.0, 0.1], (SAMPLES, 1))
        feet = FEET if now_s < 0.9 else np.array([FEET[0], down.pose_world[0]])
        height.solve(com, phases_of(feet, steps))
        height.advance(SAMPLE_S)
        heights.append(height.state[0])
        rates.append(height.state[2])
    # At first 0.2 m aside of the right foot, at last 0.28 m and on a stair 10 cm lower.
    lowest_m = np.sqrt(0.5**2 - 0.08) - 0.1
    assert heights[0] == pytest.approx(np.sqrt(0.5**2 - 0.2**2), abs=0.005)
    assert heights[18] < lowest_m + 0.005
    assert heights[-1] == pytest.approx(lowest_m, abs=0.005)
    assert 1.0 < np.abs(rates).max() < 2.0


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
    np.testing.assert_allclose(swing.move(target, 0.0, 0.75), [0, 0.1, 0, 0])
    path = [swing.move(target, time_s, 0.75) for time_s in np.linspace(0, 0.75, 151)]
    np.testing.assert_allclose(path[-1], target)
    assert max(pose[2] for pose in path) == pytest.approx(0.15, abs=1e-4)
    # Over ground that is lower than planned it goes on down, 3 cm at most.
    assert swing.move(target, 0.85, 0.75)[2] == pytest.approx(0.09)
    assert swing.move(target, 9.0, 0.75)[2] == pytest.approx(0.07)
    assert not has_landed(0.1, 0.1, 0.75, 0.75, force_n=10.0)
    assert has_landed(0.11, 0.1, 0.6, 0.75, force_n=100.0)
    assert not has_landed(0.11, 0.1, 0.2, 0.75, force_n=100.0)


@pytest.mark.parametrize("climb_m", [0.1, 0.2, -0.1, -0.2])
def test_no_toe_or_heel_touches_the_edge_of_a_stair(climb_m):
    """One or two stairs of 10 cm and 27 cm; each edge is 2.5 cm from the soles on either side."""
    stairs = round(abs(climb_m) / 0.1)
    target = np.array([0.27 * stairs, 0.0, climb_m, 0.0])
    swing = swing_over(np.zeros(4), target, -np.inf)
    over = 0
    for time_s in np.linspace(0, 0.75, 301):
        x_m, _, z_m, _ = swing.move(target, time_s, 0.75)
        for stair in range(stairs):
            edge_m = 0.135 + 0.27 * stair
            upper_m = np.sign(climb_m) * 0.1 * (stair + (climb_m > 0))
            # The sole is 22 cm long: some of it is before the edge, and some beyond it.
            if x_m - 0.11 < edge_m < x_m + 0.11:
                over += 1
                assert z_m > upper_m + 0.005
    assert over > 20


def test_a_swing_that_is_moved_and_hastened_goes_on_from_the_motion_it_has():
    target, sooner = np.array([0.3, 0.1, 0.0, 0.2]), np.array([0.3, 0.2, 0.0, 0.2])
    swing = swing_over(np.array([0.0, 0.1, 0.0, 0.0]), target, -np.inf)
    times = np.arange(0.0, 0.5, 0.005)
    poses = np.array(
        [swing.move(target, t, 0.75) if t < 0.25 else swing.move(sooner, t, 0.4) for t in times]
    )
    np.testing.assert_allclose(poses[times > 0.401, :2], sooner[None, :2].repeat(19, 0), atol=1e-9)
    assert np.abs(np.diff(poses[:, :3], axis=0)).max() < 0.02  # 4 m/s; at once it would be 17 cm
    # One that is told of a change in its last moment takes its time.
    swing = swing_over(np.array([0.0, 0.1, 0.0, 0.0]), target, -np.inf)
    last = [swing.move(target, 0.70, 0.75), swing.move(sooner, 0.705, 0.75)]
    assert np.abs(np.diff(last, axis=0)).max() < 0.005


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
def test_it_walks_by_what_it_measures(tmp_path):
    words = [
        "--map",
        ROOM,
        "--goal",
        "0.45,0.1,0.3",
        "--localization",
        "10",
        "--out",
        str(tmp_path),
    ]
    assert main(["navigate", "--controller", "lipm", "--sensed", *words]) == 0
    report = NavigationReport.from_json((tmp_path / "report.json").read_text())
    assert report.controller is not None
    assert report.controller["state"].startswith("joints, inertial unit")
    assert report.controller["relaxed"]["distribution"] == 0
    assert report.recovery_steps == report.replans == 0
    assert report.foot_error_m is not None
    assert report.foot_error_m.median < 0.02
    assert report.sensed is not None
    assert 0 < report.sensed.drift_m < 0.02
    assert report.sensed.fixes > 50


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
