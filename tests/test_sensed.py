"""A robot that knows what it measures: odometry of its legs, localization, walks on the map."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from app.cli import main
from app.navigation.localization import (
    Fix,
    LocalizationConfig,
    PoseFilter,
    SimulatedLocalization,
    frame_difference,
)
from app.navigation.navigator import Navigator, NavigatorConfig
from app.navigation.report import NavigationReport, Outcome
from app.navigation.sensed import SensingConfig, in_frame, in_map
from controller.gait import GaitTicks
from controller.leg_odometry import LegOdometry
from controller.step_cursor import StepCursor, StepSequence
from sim.onboard_sensors import EXACT, OnboardSensors, SensorErrors, SensorReadings
from sim.scene import build_scene
from tests.scenes import HALL, POLICY, ROBOT

SCENE = build_scene(ROBOT, timestep_s=0.001)
LEFT_KNEE = [joint.name for joint in ROBOT.joints].index("L_KNEE")


def readings_at(qpos: np.ndarray, *, force_n=(300.0, 0.0), pressure_m=((0.0, 0.0), (0.0, 0.0))):
    return SensorReadings(
        joint_pos_rad=qpos[SCENE.joint_qpos],
        joint_vel_rad_s=np.zeros(len(SCENE.joint_qpos)),
        pelvis_wxyz=qpos[3:7].copy(),
        rate_rad_s=np.zeros(3),
        force_n=np.array(force_n),
        pressure_sole_m=np.array(pressure_m),
    )


def point_of_left_sole(qpos: np.ndarray, point_m: np.ndarray) -> np.ndarray:
    data = mujoco.MjData(SCENE.model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(SCENE.model, data)
    site = data.site("left_sole")
    return site.xpos + site.xmat.reshape(3, 3)[:, :2] @ point_m


@pytest.mark.parametrize("point_m", [(0.0, 0.0), (-0.1, 0.02)], ids=["middle", "heel"])
def test_the_point_that_bears_stays_where_it_is(point_m):
    """The pelvis moves and turns over a point of the left foot, whatever the foot itself does."""
    rng, point_m = np.random.default_rng(3), np.array(point_m)
    pressure_m = (point_m, (0.0, 0.0))
    qpos = SCENE.standing_qpos.copy()
    odometry = LegOdometry(SCENE, qpos, readings_at(qpos, pressure_m=pressure_m))
    stays = point_of_left_sole(qpos, point_m)
    for _ in range(20):
        qpos[SCENE.joint_qpos] += rng.uniform(-0.05, 0.05, len(SCENE.joint_qpos))
        turn = np.zeros(4)
        mujoco.mju_axisAngle2Quat(turn, np.array([0.0, 0.6, 0.8]), rng.uniform(-0.1, 0.1))
        mujoco.mju_mulQuat(qpos[3:7], turn, qpos[3:7].copy())
        qpos[:3] += stays - point_of_left_sole(qpos, point_m)
        odometry.update(readings_at(qpos, pressure_m=pressure_m))
    np.testing.assert_allclose(odometry.state.qpos[0], qpos, atol=1e-12)
    assert np.linalg.norm(qpos[:3] - SCENE.standing_qpos[:3]) > 0.02


def test_a_foot_in_the_air_does_not_count():
    qpos = SCENE.standing_qpos.copy()
    odometry = LegOdometry(SCENE, qpos, readings_at(qpos, force_n=(0.0, 300.0)))
    qpos[SCENE.joint_qpos[LEFT_KNEE]] += 0.3
    odometry.update(readings_at(qpos, force_n=(0.0, 300.0)))
    np.testing.assert_allclose(odometry.state.qpos[0, :3], SCENE.standing_qpos[:3], atol=1e-12)


def test_velocity_is_that_of_a_leg_that_swings_about_its_foot():
    """A pelvis at rest over a foot, turned at 0.5 rad/s about the sole's y axis with stiff legs."""
    qpos = SCENE.standing_qpos.copy()
    rate = np.array([0.0, 0.5, 0.0])  # about the pelvis's own y axis, which the pitch leaves alone
    before = readings_at(qpos)
    turning = SensorReadings(**{**vars(before), "rate_rad_s": rate})
    odometry = LegOdometry(SCENE, qpos, before)
    odometry.update(turning)
    arm = qpos[:3] - point_of_left_sole(qpos, np.zeros(2))
    np.testing.assert_allclose(odometry.state.qvel[0, :3], np.cross(rate, arm), atol=1e-9)
    com = odometry.state.com_pos_world[0] - point_of_left_sole(qpos, np.zeros(2))
    np.testing.assert_allclose(odometry.state.com_linvel_world[0], np.cross(rate, com), atol=1e-9)


def test_exact_sensors_tell_the_truth_and_errors_are_of_their_size():
    rng = np.random.default_rng(0)
    qpos, qvel = SCENE.standing_qpos.copy(), rng.normal(size=SCENE.model.nv)
    sensors = rng.uniform(1, 2, SCENE.model.nsensordata)
    exact = OnboardSensors(SCENE, EXACT, seed=0).read(qpos, qvel, sensors, 3.0)
    np.testing.assert_allclose(exact.pelvis_wxyz, qpos[3:7], atol=1e-15)
    np.testing.assert_array_equal(exact.joint_pos_rad, qpos[SCENE.joint_qpos])
    np.testing.assert_array_equal(exact.rate_rad_s, qvel[3:6])
    drifting = SensorErrors(**{**vars(EXACT), "heading_drift_bias_rad_s": 0.01})
    headings = []
    for seed in range(400):
        w, _, _, z = (
            OnboardSensors(SCENE, drifting, seed=seed)
            .read(SCENE.qpos_at(np.zeros(3)), qvel, sensors, 3.0)
            .pelvis_wxyz
        )
        headings.append(2 * math.atan2(z, w))
    assert np.std(headings) == pytest.approx(0.03, rel=0.1)
    with pytest.raises(ValueError, match="force_n -1"):
        SensorErrors(force_n=-1)


def test_frames_carry_poses_there_and_back():
    rng = np.random.default_rng(1)
    poses, frame = rng.uniform(-2, 2, (7, 4)), np.array([1.0, -0.5, 2.0])
    np.testing.assert_allclose(in_map(in_frame(poses, frame), frame), poses, atol=1e-12)
    quarter = np.array([1.0, 2.0, math.pi / 2])
    np.testing.assert_allclose(
        in_map(np.array([[3.0, 0.0, 0.7, 0.25]]), quarter), [[1.0, 5.0, 0.7, math.pi / 2 + 0.25]]
    )


def test_how_far_a_frame_has_moved_is_seen_where_the_robot_is():
    moved_m, turned_rad = frame_difference((0, 0, 0), (0, 0, 0.1), np.array([3.0, 4.0]))
    assert moved_m == pytest.approx(2 * 5 * math.sin(0.05))
    assert turned_rad == pytest.approx(0.1)


def told(odom_in_map, *, seconds=20.0, seed=0, **config) -> tuple[PoseFilter, np.ndarray]:
    """A filter after a walk of 0.2 m/s along a circle, and the last pose in the odometry."""
    settings = LocalizationConfig(**config)
    found, source = PoseFilter(config=settings), SimulatedLocalization(settings, seed=seed)
    pose = np.zeros(3)
    for tick in range(1, round(seconds / 0.025)):
        time_s = tick * 0.025
        pose = np.array([2 * math.sin(0.1 * time_s), 2 - 2 * math.cos(0.1 * time_s), 0.1 * time_s])
        found.predict(pose, time_s)
        true = in_map(np.array([[pose[0], pose[1], 0.0, pose[2]]]), np.array(odom_in_map))[0]
        for fix in source.fixes(true[[0, 1, 3]], time_s):
            found.correct(fix)
    return found, pose


def errors_of(found: PoseFilter, odom_in_map, pose: np.ndarray) -> tuple[float, float]:
    place = in_map(np.array([[pose[0], pose[1], 0.0, pose[2]]]), np.array(odom_in_map))[0, :2]
    return frame_difference(odom_in_map, found.odom_in_map, place)


def test_the_filter_finds_the_frame_better_than_any_fix():
    frame = (0.05, -0.04, math.radians(2))
    runs = [told(frame, seed=seed) for seed in range(20)]
    errors = np.array([errors_of(found, frame, pose) for found, pose in runs])
    assert np.sqrt((errors[:, 0] ** 2).mean()) < 0.015  # a fix is off by 4.2 cm
    assert np.sqrt((errors[:, 1] ** 2).mean()) < math.radians(0.8)
    assert all(found.jumps == 0 and found.fixes >= 190 for found, _ in runs)


def test_outliers_are_left_out():
    frame = (0.0, 0.0, 0.0)
    found, pose = told(frame, outliers=0.3, seconds=40.0)
    assert 0.2 < found.rejected / found.fixes < 0.4
    assert errors_of(found, frame, pose)[0] < 0.03
    assert found.jumps == 0


def test_a_fix_counts_for_when_it_was_taken():
    """A robot at 1 m/s whose fixes are right and late by half a second: 0.5 m if taken for now."""
    found = PoseFilter(config=LocalizationConfig(delay_s=0.5))
    for tick in range(80):
        found.predict(np.array([tick * 0.025, 0.0, 0.0]), tick * 0.025)
    found.correct(Fix(time_s=1.475, pose_map=np.array([1.475, 0.0, 0.0])))
    np.testing.assert_allclose(found.odom_in_map, 0.0, atol=1e-12)


def test_a_frame_that_moves_is_noticed_once():
    frame = (0.0, 0.0, 0.0)
    found, pose = told(frame, jump_at_s=5.0, jump_m=1.0, seconds=20.0)
    assert found.jumps == 1
    assert errors_of(found, frame, pose)[0] == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
    "wrong", [{"rate_hz": 0}, {"noise_m": 0}, {"delay_s": -1}, {"outliers": 1}, {"rate_hz": 50}]
)
def test_localization_that_cannot_be(wrong):
    with pytest.raises(ValueError, match=r"rate|noise|outliers"):
        LocalizationConfig(**wrong)


def test_later_steps_move_and_those_under_way_stay():
    feet = np.array([[0.0, 0.1, 0.0, 0.0], [0.0, -0.1, 0.0, 0.0]])
    side, steps = np.array([0, 1, 0]), np.arange(12.0).reshape(3, 4)
    cursor = StepCursor(GaitTicks.of(ROBOT.gait), 1, 4)
    cursor.follow(0, StepSequence.of(feet, side, steps))
    cursor.move_steps(0, 1, steps[1:] + 100)
    found = cursor.upcoming(0).pose_world
    np.testing.assert_array_equal(found, steps + np.array([[0], [100], [100]]))
    while not cursor.arrived[0]:
        cursor.advance()
    np.testing.assert_array_equal(cursor.window[0], steps[1:] + 100)


def sensed_walk(goal=(0.8, 0.2, 0.4), *, seed=0, **config) -> Navigator:
    sensing = SensingConfig(**config)
    navigator = Navigator(
        HALL, ROBOT, POLICY, start=(0, 0, 0), goal=goal, seed=seed,
        config=NavigatorConfig(sensing=sensing),
    )  # fmt: skip
    navigator.plan()
    while navigator.outcome is None:
        navigator.tick()
    return navigator


@pytest.fixture(scope="module")
def by_legs() -> Navigator:
    return sensed_walk()


def test_a_robot_finds_its_goal_by_its_legs(by_legs):
    report = by_legs.report()
    assert report.outcome is Outcome.REACHED
    assert report.replans == report.recovery_steps == 0
    sensed = report.sensed
    assert sensed is not None
    assert 0 < sensed.drift_m < 0.02 * max(sensed.walked_m, 1.0)
    assert sensed.walked_m > 0.7
    assert sensed.fixes == 0
    assert "odometry off by" in report.summary()
    assert NavigationReport.from_json(report.to_json()).sensed == sensed


def test_what_it_believes_is_not_the_truth(by_legs):
    assert by_legs.walker.estimated is not None
    believed, true = by_legs.walker.estimated.qpos[0, :2], by_legs.walker.sim.qpos[0, :2]
    assert 1e-4 < np.linalg.norm(believed - true) < 0.03


def test_the_same_seed_measures_the_same(by_legs):
    np.testing.assert_array_equal(sensed_walk().qpos, by_legs.qpos)
    assert not np.array_equal(sensed_walk(seed=1).qpos[-1], by_legs.qpos[-1])


def test_localization_leads_to_a_goal_that_drifting_legs_miss():
    lost = SensorErrors(heading_drift_bias_rad_s=math.radians(1.5))
    goal = (1.8, 0.0, 0.0)
    alone = sensed_walk(goal, errors=lost, seed=5)
    helped = sensed_walk(goal, errors=lost, seed=5, localization=LocalizationConfig())
    assert alone.outcome is Outcome.TIMED_OUT
    assert "takes itself to be there" in alone.reason
    assert helped.outcome is Outcome.REACHED
    sensed = helped.report().sensed
    assert sensed is not None
    assert sensed.fixes > 50
    assert sensed.drift_rad > math.radians(5)


def test_localization_that_jumps_stops_the_robot_and_plans_again():
    jumping = LocalizationConfig(jump_at_s=3.0, jump_m=0.5, noise_m=0.01, noise_rad=0.01)
    navigator = sensed_walk((1.2, 0.0, 0.0), localization=jumping)
    report = navigator.report()
    assert report.sensed is not None
    assert report.sensed.jumps == 1
    assert report.replans >= 1
    stops = [plan for _, plan in navigator.followed if len(plan) == 1]
    assert len(stops) == 1  # one foot to beside the other one
    assert "localization jumped 1 time" in report.summary()
    # It stands where it takes the goal to be, half a metre off.
    assert "0.5" in report.reason or "0.4" in report.reason


def test_between_the_parts_of_a_control_step_it_measures_anew():
    navigator = Navigator(
        HALL, ROBOT, POLICY, start=(0, 0, 0), goal=(0.5, 0, 0),
        config=NavigatorConfig(sensing=SensingConfig(errors=EXACT)),
    )  # fmt: skip
    walker, seen = navigator.walker, []

    def targets_rad(sensors: np.ndarray) -> np.ndarray:
        assert walker.readings is not None
        assert walker.estimated is not None
        named = walker.scene.sensors.ground_force_world[:, 2]
        np.testing.assert_array_equal(walker.readings.force_n, np.maximum(sensors[0, named], 0))
        # Where it stands still the odometry is exact.
        np.testing.assert_allclose(walker.estimated.qpos, walker.sim.qpos, atol=2e-4)
        seen.append(walker.readings)
        return walker.target_rad

    walker.act_in_parts(5, targets_rad)
    assert len({id(readings) for readings in seen}) == 5
    assert seen[4].force_n.sum() > 0.5 * ROBOT.weight_n


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--localization", "10"], "--localization goes with --sensed"),
        (["--localization-outliers", "0.1"], "-outliers goes with --localization"),
        (["--sensed", "--localization-jump", "5,1"], "-jump goes with --localization"),
        (["--sensed", "--localization", "0"], "'0' is not a number above 0"),
        (["--sensed", "--localization", "9", "--localization-noise", "0,0"], "must be above 0"),
        (["--sensed", "--localization-jump", "1"], "'1' is not a jump"),
        (["--sensed", "--view"], "no --view"),
    ],
)
def test_options_that_do_not_go_together(words, said, capsys):
    assert main(["navigate", "--map", "maps/room.png", "--goal", "1,0,0", *words]) == 2
    assert said in capsys.readouterr().err
