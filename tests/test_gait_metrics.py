"""Numbers of an evaluation's gait sections, each on a record small enough to work by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

from controller.evaluation.gait_metrics import (
    WalkRecord,
    asymmetry,
    contact_agreement,
    cost_of_transport,
    distance_m,
    duration_s,
    gait_cycle_curves,
    joint_jerk_rad_s3,
    joint_loads,
    mechanical_work_j,
    peak_weights,
    repeat_step,
    swing_lags,
    walk_and_stand,
)
from controller.evaluation.gait_summary import (
    GaitRecorder,
    summary_of,
    swing_apex_m,
    touchdown_speed_m_s,
)
from controller.evaluation.push_recovery import DIRECTIONS, Push
from controller.gait import CONTROL_PERIOD_S, GaitTicks
from controller.policy import load_policy
from controller.step_cursor import StepCursor, StepSequence
from planner.robot_model import Side
from sim.batch import SimBatch
from sim.robots import get_robot
from sim.scene import build_scene

ROBOT = get_robot("jvrc1")
WEIGHT_N = ROBOT.mass_kg * 9.81


def record(ticks: int, substeps: int = 5, robots: int = 1, **arrays: np.ndarray) -> WalkRecord:
    """Robots at rest, without ground under them, but for the arrays that are given."""
    steps, joints = ticks * substeps, len(ROBOT.joints)
    values = {
        "torque_nm": np.zeros((robots, steps, joints)),
        "joint_speed_rad_s": np.zeros((robots, steps, joints)),
        "ground_force_n": np.zeros((robots, steps, 2)),
        "indicator": np.zeros((robots, ticks, 2)),
        "cycle_tick": np.full((robots, ticks), -1),
        "pelvis_xy_world": np.zeros((robots, ticks, 2)),
        "upright": np.ones(robots, dtype=bool),
    }
    return WalkRecord(timestep_s=0.001, **(values | arrays))


def test_peaks_are_of_either_sign_and_over_all_robots():
    torque, speed = np.zeros((2, 4, 12)), np.zeros((2, 4, 12))
    torque[0, :, 0], torque[1, :, 0] = [3, -5, 1, 1], [3, 5, -1, 1]
    speed[1, 2, 0] = -2.0
    first, second = joint_loads(record(4, 1, 2, torque_nm=torque, joint_speed_rad_s=speed), ROBOT)[
        :2
    ]
    assert first["joint"] == ROBOT.joints[0].name
    assert first["peak_torque_nm"] == 5.0
    assert first["rms_torque_nm"] == pytest.approx(3.0)
    assert first["peak_speed_rad_s"] == 2.0
    assert first["torque_limit_nm"] == ROBOT.joints[0].torque_limit_nm
    assert second["peak_torque_nm"] == second["rms_speed_rad_s"] == 0.0


def test_jerk_is_of_the_mean_speeds_over_control_steps():
    speed = np.zeros((1, 6, 12))
    # One joint of twelve, two physics steps a control step: its mean speeds are 0, 1, 0 rad/s.
    speed[0, :, 4] = 3.0, -3.0, 0.0, 2.0, 1.0, -1.0
    assert joint_jerk_rad_s3(record(3, 2)) == 0.0
    moved = record(3, 2, joint_speed_rad_s=speed)
    assert joint_jerk_rad_s3(moved) == pytest.approx(2 / 0.025**2 / np.sqrt(12))


def test_robots_that_walk_and_stand_come_to_rest():
    summary = walk_and_stand(
        ROBOT, load_policy(ROBOT), (0.2, 0.2, 0.0), count=2, seconds=5.0, rest_s=1.0, seed=3
    )
    assert summary is not None
    # Two feet of 20 cm steps, the first and the last of half the way.
    assert summary.speed_m_s == pytest.approx(0.2 / ROBOT.gait.step_s, rel=0.3)
    for height_m in summary.pelvis_height_m.values():
        assert height_m is not None
        assert ROBOT.fallen_height_m < height_m < ROBOT.pelvis_height_m + 0.05


def test_asymmetry_by_hand():
    assert asymmetry(3.0, 1.0) == asymmetry(1.0, 3.0) == 1.0
    assert asymmetry(2.0, 2.0) == asymmetry(0.0, 0.0) == 0.0
    assert asymmetry(0.0, 7.0) == 2.0


def test_work_counts_braking_and_cost_is_work_per_weight_and_way():
    torque, speed = np.zeros((1, 100, 12)), np.zeros((1, 100, 12))
    torque[..., 3], speed[..., 3] = 10.0, -2.0  # brakes at 20 W
    torque[..., 8], speed[..., 8] = 5.0, 1.0  # drives at 5 W
    way = np.zeros((1, 20, 2))
    way[0, 1:] = [[3.0, 4.0]] * 19
    walk = record(20, torque_nm=torque, joint_speed_rad_s=speed, pelvis_xy_world=way)
    # 25 W from the end of the first tick to that of the last, 19 ticks of 5 ms.
    assert mechanical_work_j(walk) == pytest.approx([25 * 0.095])
    assert distance_m(walk) == pytest.approx([5.0])
    assert duration_s(walk) == pytest.approx(19 * CONTROL_PERIOD_S)
    assert cost_of_transport(np.array([981.0]), 50.0, np.array([4.0])) == pytest.approx([0.5])


def test_force_is_told_in_weights():
    force = np.zeros((1, 5, 2))
    force[0, 3] = 1.5 * WEIGHT_N, 0.25 * WEIGHT_N
    assert peak_weights(record(1, ground_force_n=force), ROBOT.mass_kg) == pytest.approx(
        [1.5, 0.25]
    )


def test_values_are_gathered_by_phase():
    """Two cycles of 4 ticks, whose values are 10 and 20 in the first half, 0 in the second."""
    ticks = GaitTicks(swing=1, double_support=1)
    phase = np.array([[-1, 0, 1, 2, 3, 0, 1, 2, 3]])
    values = np.zeros((1, 18, 2))
    values[0, 0:2] = 99.0  # standing: does not count
    values[0, 2:6, 0], values[0, 10:14, 0] = 10.0, 20.0
    values[0, 2:, 1] = 7.0
    cycle = gait_cycle_curves(record(9, 2, cycle_tick=phase), values, ticks, bins=2)
    assert cycle.mean.tolist() == [[15.0, 7.0], [0.0, 7.0]]
    assert cycle.low[0, 0] == pytest.approx(10.5)
    assert cycle.high[0, 0] == pytest.approx(19.5)
    assert cycle.time_s == pytest.approx([0.025, 0.075])


def test_contact_is_compared_where_the_indicator_is_settled():
    indicator = np.array([[[1.0, -1.0], [1.0, 0.5], [-1.0, 1.0]]])
    force = np.zeros((1, 15, 2))
    force[0, :10, 0] = WEIGHT_N  # left bears in the first two ticks, right nowhere
    walk = record(3, indicator=indicator, ground_force_n=force)
    # Settled are left 3 ticks and right 2; only the right foot's last tick is not as asked.
    assert contact_agreement(walk, ROBOT.mass_kg) == pytest.approx(4 / 5)
    assert np.isnan(contact_agreement(record(3), ROBOT.mass_kg))


def test_lags_of_a_swing_worked_by_hand():
    """Swing of 4 ticks of 5 ms: lifts 2 ms late, touches down 2 ms early."""
    ticks = GaitTicks(swing=4, double_support=2)
    phase = np.array([list(range(12))])
    force = np.full((1, 60, 2), WEIGHT_N)
    force[0, 2:18, 1] = 0.0  # right
    force[0, 30 + 2 : 30 + 18, 0] = 0.0  # left
    walk = record(12, cycle_tick=phase, ground_force_n=force)
    lift_s, touch_s = swing_lags(walk, ROBOT.mass_kg, ticks)
    assert (lift_s, touch_s) == pytest.approx((0.002, -0.002))
    assert np.isnan(swing_lags(record(12), ROBOT.mass_kg, ticks)).all()


def test_fallen_robots_are_left_out():
    walk = record(4, 5, 3, upright=np.array([True, False, True]))
    assert walk.substeps == 5
    assert walk.of_upright().torque_nm.shape == (2, 20, 12)


def test_steady_walks_begin_and_end_at_the_same_moment_of_the_gait():
    """Steps of 2 ticks, cycles of 4: of 17 ticks the first 6 go, then come 2 cycles and a tick."""
    way = np.zeros((1, 17, 2))
    way[0, :, 0] = range(17)
    ticks = GaitTicks(swing=1, double_support=1)
    steady = record(17, 2, pelvis_xy_world=way).steady(ticks)
    assert steady.pelvis_xy_world[0, :, 0].tolist() == list(range(6, 15))
    assert steady.torque_nm.shape == (1, 18, 12)
    assert distance_m(steady) == pytest.approx([8.0])


def test_feet_take_turns_where_a_walk_leads_sideways():
    assert repeat_step((0.3, 0.2, 0.0), 0.2, 2).tolist() == [[0.3, 0.2, 0.0]] * 2
    assert repeat_step((0.0, 0.3, 0.0), 0.2, 3).tolist() == [
        [0.0, 0.3, 0.0],
        [0.0, 0.2, 0.0],
        [0.0, 0.3, 0.0],
    ]


def test_a_push_gives_the_momentum_that_it_is_told_to():
    push = Push(impulse_ns=12.0, direction=DIRECTIONS["from the right"], begins_tick=1)
    assert [push.acts(tick) for tick in range(7)] == [False, *[True] * 4, False, False]
    scene = build_scene(ROBOT, timestep_s=0.001)
    sim = SimBatch(scene, count=1, control_period_s=CONTROL_PERIOD_S)
    sim.qpos[0, 2] += 2.0  # in the air, where nothing else pushes sideways
    for tick in range(7):
        sim.push(np.array([push.force_world_n if push.acts(tick) else (0.0, 0.0, 0.0)]))
        sim.step(ROBOT.half_sitting_rad[None])
    data = mujoco.MjData(scene.model)
    data.qpos[:], data.qvel[:] = sim.qpos[0], sim.qvel[0]
    mujoco.mj_forward(scene.model, data)
    mujoco.mj_subtreeVel(scene.model, data)
    momentum = ROBOT.mass_kg * data.body("pelvis").subtree_linvel
    # The integrator is implicit in the joints' damping: that costs some per mille.
    assert momentum[:2] == pytest.approx([0.0, 12.0], abs=0.1)


def test_stances_before_and_after_each_step_and_next():
    ticks = GaitTicks(swing=1, double_support=1)
    cursor = StepCursor(ticks, 1, 4)
    poses = np.zeros((5, 4))
    poses[:, 0] = range(5)
    cursor.follow(0, StepSequence(side=np.array([0, 1, 0, 1, 0]), pose_world=poses))
    seen = []
    while not cursor.arrived[0]:
        seen.append(cursor.stances[0, :, :, 0].astype(int).tolist())
        cursor.advance()
    first, second, third, last = [0, 1], [1, 2], [2, 3], [3, 4]
    waiting, shifting = [first, first, first], [first, first, second]
    assert seen == [
        *(waiting, shifting),
        *[[first, second, third]] * 2,
        *[[second, third, last]] * 2,
        *[[third, last, last]] * 2,
    ]
    assert cursor.stances[0, :, :, 0].tolist() == [last] * 3


# The gait figures of one walk.


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


def made_up_walker(count: int = 1) -> Any:
    """Ten physics steps in a control step, one joint, a robot of 50 kg; sensors filled in later."""
    sensors = SimpleNamespace(
        pelvis_pos_world=np.arange(3),
        sole_pos_world=np.array([[3, 4, 5], [6, 7, 8]]),
        sole_linvel_world=np.array([[9, 10, 11], [12, 13, 14]]),
        ground_force_world=np.array([[15, 16, 17], [18, 19, 20]]),
        joint_torque=np.array([21]),
    )
    sim = SimpleNamespace(
        sensors=np.zeros((count, 10, 22)), recorded={"qvel": np.zeros((count, 10, 7))}
    )
    return SimpleNamespace(
        robot=SimpleNamespace(weight_n=50.0 * 9.81),
        scene=SimpleNamespace(sensors=sensors, joint_qvel=np.array([6])),
        cursor=SimpleNamespace(entry=np.full(count, 2)),
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


def stepping(recorder: GaitRecorder, walker: Any, row: int, *, lift_m: float, steps: int) -> None:
    """Each foot goes 0.4 m a step, of 0.125 s; the pelvis at 0.8 m sways by as much sideways."""
    read = walker.sim.sensors[row]
    read[:, 2] = 0.8
    for step in range(steps):
        side = Side(step % 2)
        for height_m in (0.0, lift_m, lift_m, 0.0):
            read[:, 3 + 3 * side] += 0.1
            read[:, 1] += 0.1 * (1 - 2 * side)
            read[:, 3 + 3 * side + 2] = height_m
            read[:, 15 + 3 * side + 2] = 0.0 if height_m else 500.0
            recorder.ticked(walker, side, walking=True, landed=False)
        recorder.ticked(walker, side, walking=True, landed=True)
    read[:, 2] = 0.8 + lift_m
    recorder.ticked(walker, Side.LEFT, walking=False, landed=False)


def test_several_walks_are_summed_up_as_one_each_by_its_own_robot():
    walker = made_up_walker(3)
    recorders = [GaitRecorder(walker, row) for row in range(3)]
    for row, (lift_m, steps) in enumerate(((0.04, 3), (0.06, 4), (0.10, 3))):
        stepping(recorders[row], walker, row, lift_m=lift_m, steps=steps)
    assert recorders[0].summary() is None  # three steps alone are no gait
    gait = summary_of(recorders)
    assert gait is not None
    # Ten apexes: three of 4 cm, four of 6 and three of 10.
    assert gait.swing_apex_m == pytest.approx({"median": 0.06, "p95": 0.10})
    assert gait.pelvis_height_m["at_rest"] == pytest.approx(0.86)
    # Seven of the steps have one before them, and bring the feet's middle on by 0.2 m each.
    assert gait.speed_m_s == pytest.approx(7 * 0.2 / (10 * 0.125))
    assert summary_of([recorders[1]]) == recorders[1].summary()
    assert summary_of([]) is None
