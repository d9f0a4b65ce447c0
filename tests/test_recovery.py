"""Recovery from a push: what the present step needs, by the pendulum, and in walks."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from app.navigation.navigator import Navigator
from controller.evaluation import push_recovery as pushed
from controller.evaluation.push_recovery import DIRECTIONS, PUSH_S, push_recovery
from controller.evaluation.rollouts import start_walks
from controller.gait import CONTROL_PERIOD_S
from controller.policy import load_policy
from controller.recovery import (
    CAPTURE_SHARE,
    LEAST_M,
    PRESSURE_SHARE,
    SHORTEST_SWING_S,
    change_steps,
    moved_within,
    step_change,
)
from controller.step_cursor import StepSequence
from controller.walker import Walker
from maps.grid import Cell, OccupancyGrid
from planner.endpoints import Footing
from planner.robot_model import Side, StepLimits
from sim.robot import GRAVITY_M_S2
from sim.robots import get_robot
from sim.scene import build_scene

ROBOT = get_robot("jvrc1")
LIMITS = ROBOT.training_model.limits
HALF_M = np.array([ROBOT.step_model.foot.length_m, ROBOT.step_model.foot.width_m]) / 2
HEIGHT_M = 0.8
OMEGA = math.sqrt(GRAVITY_M_S2 / HEIGHT_M)
STEP = np.array([0.1, 0.2])  # outward


def swinging(
    capture: np.ndarray, *, side: Side, tick: int, at=(0.0, 0.0, 0.0), speed_m_s=(0.0, 0.0)
) -> Walker:
    """A walker whose sensors tell of this capture point, in the frame of the support foot.

    The support foot stands at `at` x, y, yaw; y of all vectors is outward. Its present step is
    `STEP` from there, `tick` control steps after lift-off.
    """
    walker = Walker(build_scene(ROBOT, timestep_s=0.005), threads=1)
    turn = np.array([[math.cos(at[2]), -math.sin(at[2])], [math.sin(at[2]), math.cos(at[2])]])

    def world(vector) -> np.ndarray:
        return turn @ (np.array(vector) * (1.0, side.outward))

    feet = np.empty((2, 4))
    feet[side.other] = [*at[:2], 0.0, at[2]]
    feet[side] = [*(world((-0.1, 0.2)) + at[:2]), 0.0, at[2]]
    steps = np.array([[*(world(STEP) + at[:2]), 0.0, at[2]], feet[side.other]])
    walker.follow(0, StepSequence.of(feet, np.array([side, side.other]), steps), walking=True)
    walker.cursor.tick[0] = tick
    sensors, read = walker.scene.sensors, walker.sim.sensors[0, -1]
    for foot in Side:
        read[sensors.sole_pos_world[foot]] = feet[foot, :3]
        read[sensors.sole_x_axis_world[foot]] = [*turn[:, 0], 0.0]
    com = np.array(capture) - np.array(speed_m_s) / OMEGA
    read[sensors.com_pos_world] = [*(world(com) + at[:2]), HEIGHT_M]
    read[sensors.com_linvel_world] = [*world(speed_m_s), 0.0]
    return walker


def pendulum(capture, pressure, seconds: float, *, speed_m_s) -> np.ndarray:
    """The capture point after so long, by small steps of the pendulum over a point of pressure."""
    position, speed, dt = np.array(capture) - np.array(speed_m_s) / OMEGA, np.array(speed_m_s), 1e-5
    for _ in range(round(seconds / dt)):
        speed = speed + OMEGA**2 * (position - pressure) * dt
        position = position + speed * dt
    return position + speed / OMEGA


@pytest.mark.parametrize("side", Side)
@pytest.mark.parametrize("at", [(0.0, 0.0, 0.0), (1.0, -2.0, 2.5)])
def test_a_step_moves_by_what_the_pendulum_misses_it_by(side, at):
    """Pushed ahead and outward late in the swing, within reach: hand-integrated, in every frame."""
    capture, speed, tick = np.array([0.17, 0.15]), np.array([0.3, 0.2]), 22
    walker = swinging(capture, side=side, tick=tick, at=at, speed_m_s=speed)
    change = step_change(walker)
    swing_ticks = int(walker.cursor.ticks.swing[0])
    rest_s = (swing_ticks - tick) * CONTROL_PERIOD_S
    landing = pendulum(capture, PRESSURE_SHARE * HALF_M, rest_s, speed_m_s=speed)
    expected = np.maximum(landing - STEP - CAPTURE_SHARE * HALF_M, 0.0)
    assert np.all(expected > LEAST_M)
    cos, sin = math.cos(-at[2]), math.sin(-at[2])
    offset = np.array([[cos, -sin], [sin, cos]]) @ change.offset_world_m[0] * (1, side.outward)
    assert change.needed[0]
    assert change.swing_ticks[0] == swing_ticks
    assert offset == pytest.approx(expected, abs=1e-3)


def test_a_foot_that_bears_the_weight_later_lands_where_that_captures():
    """Four control steps after touch-down: hand-integrated until then."""
    capture, tick = np.array([0.17, 0.15]), 22
    walker = swinging(capture, side=Side.LEFT, tick=tick)
    walker.loading_ticks = 4
    rest_s = (int(walker.cursor.ticks.swing[0]) + 4 - tick) * CONTROL_PERIOD_S
    borne = pendulum(capture, PRESSURE_SHARE * HALF_M, rest_s, speed_m_s=np.zeros(2))
    change = step_change(walker)
    assert change.swing_ticks[0] == walker.cursor.ticks.swing[0]
    expected = borne - STEP - CAPTURE_SHARE * HALF_M
    assert change.offset_world_m[0, 0] == pytest.approx(expected[0], abs=1e-3)


@pytest.mark.parametrize("tick", [0, 10, 20, 29])
def test_a_capture_point_over_the_sole_needs_nothing_however_long_the_swing(tick):
    walker = swinging(np.array([0.0, 0.0]), side=Side.LEFT, tick=tick)
    change = step_change(walker)
    assert not change.needed[0]
    assert not change.offset_world_m.any()
    assert change.swing_ticks[0] == walker.cursor.ticks.swing[0]


def test_out_of_the_limits_a_step_goes_to_them_and_lands_as_soon_as_that_captures():
    capture, tick = np.array([0.16, 0.0]), 12
    walker = swinging(capture, side=Side.RIGHT, tick=tick)
    change = step_change(walker)
    before = int(walker.cursor.ticks.swing[0])
    assert change.needed[0]
    assert before > change.swing_ticks[0] >= round(SHORTEST_SWING_S / CONTROL_PERIOD_S)

    def farthest_m(swing_ticks: int) -> float:
        growth = math.exp(OMEGA * (swing_ticks - tick) * CONTROL_PERIOD_S)
        pressure_m = PRESSURE_SHARE * HALF_M[0]
        return (capture[0] - pressure_m) * growth + pressure_m - CAPTURE_SHARE * HALF_M[0]

    assert farthest_m(int(change.swing_ticks[0])) <= LIMITS.x_m[1]
    assert farthest_m(int(change.swing_ticks[0]) + 1) > LIMITS.x_m[1]
    moved_m = STEP[0] + change.offset_world_m[0, 0]
    assert moved_m == pytest.approx(max(STEP[0], farthest_m(int(change.swing_ticks[0]))), abs=1e-6)


def test_a_push_inward_lands_the_foot_sooner_where_it_was_to_land():
    walker = swinging(np.array([0.0, -0.08]), side=Side.LEFT, tick=10)
    change = step_change(walker)
    assert change.needed[0]
    assert not change.offset_world_m.any()
    assert change.swing_ticks[0] == round(SHORTEST_SWING_S / CONTROL_PERIOD_S)
    ticks_before = int(walker.cursor.ticks.double_support[0])
    change_steps(walker, change)
    share = change.swing_ticks[0] / round(ROBOT.gait.single_support_s / CONTROL_PERIOD_S)
    assert walker.cursor.ticks.swing[0] == change.swing_ticks[0]
    assert walker.cursor.ticks.double_support[0] == round(ticks_before * share)


def test_steps_move_no_farther_than_box_and_polygon_let_them():
    limits = StepLimits(
        x_m=(-0.2, 0.3),
        y_m=(0.15, 0.35),
        yaw_rad=(0.0, 0.1),
        reach_m=((-0.2, 0.1), (0.3, 0.1), (0.3, 0.2), (0.1, 0.4), (-0.2, 0.4)),
    )
    steps = np.array([[0.1, 0.2], [0.1, 0.2], [0.2, 0.3], [0.32, 0.2], [0.1, 0.2]])
    moves = np.array([[0.05, -0.02], [0.9, 0.0], [0.1, 0.05], [0.1, 0.0], [0.1, 0.3]])
    # Free; to the box; on the polygon's edge already; beyond the box already; to the edge, where
    # the box has cut the move to 0.1, 0.15 and the edge x + y = 0.5 takes 0.2 of its 0.25.
    expected = [[0.05, -0.02], [0.2, 0.0], [0.0, 0.0], [0.0, 0.0], [0.08, 0.12]]
    assert moved_within(limits, steps, moves) == pytest.approx(np.array(expected))


def test_walks_pushed_from_the_left_are_mirror_images_of_those_pushed_from_the_right(monkeypatch):
    walkers: list[Walker] = []

    def noted(*words: Any, **options: Any) -> Walker:
        walkers.append(start_walks(*words, **options))
        return walkers[-1]

    monkeypatch.setattr(pushed, "start_walks", noted)
    monkeypatch.setattr(pushed, "walk", lambda *_: iter(()))
    for direction in ("from the right", "from the left"):
        push_recovery(ROBOT, load_policy(ROBOT), direction, [10.0], count=8, seed=1)
    right, left = walkers
    index, sign = ROBOT.mirror_joints
    at = right.scene.joint_qpos
    np.testing.assert_array_equal(left.sim.qpos[:, at], sign * right.sim.qpos[:, at][:, index])
    assert np.ptp(right.sim.qpos[:, at], axis=0).min() > 0.01
    firsts = set()
    for row in range(8):
        here, there = right.cursor.upcoming(row), left.cursor.upcoming(row)
        np.testing.assert_array_equal(there.side, 1 - here.side)
        np.testing.assert_allclose(there.pose_world, here.pose_world * [1, -1, 1, -1], atol=1e-12)
        np.testing.assert_array_equal(there.lift_off_s, here.lift_off_s)
        firsts.add(int(here.side[0]))
    assert firsts == {0, 1}


@pytest.mark.slow
def test_robots_that_a_push_fells_stay_up_when_their_steps_change():
    policy, pushes = load_policy(ROBOT), [18.7]
    alone, moved = (
        push_recovery(
            ROBOT, policy, "from behind", pushes, count=8, seed=3, threads=2, moves_steps=moves
        )[0]
        for moves in (False, True)
    )
    assert moved > alone + 0.3


@pytest.mark.slow
@pytest.mark.parametrize("wall_m", [0.6, 3.0])
def test_a_pushed_robot_steps_aside_but_never_onto_an_obstacle_and_still_arrives(wall_m):
    """Walls on both sides; pushed to the left while the left foot swings."""
    cells = np.zeros((160, 160), np.uint8)
    grid = OccupancyGrid(cells=cells, resolution_m=0.05, origin=(-2.0, -4.0, 0.0))
    (row, _), (other, _) = grid.world_to_cell([(0.0, wall_m), (0.0, -wall_m)])
    cells[row, :], cells[other, :] = Cell.OCCUPIED, Cell.OCCUPIED
    walker = Navigator(
        grid, ROBOT, load_policy(ROBOT), start=(0.0, 0.0, 0.0), goal=(2.5, 0.0, 0.0), seed=1
    )
    walker.plan()
    footing = Footing(grid, ROBOT.step_model, False)
    x, y = DIRECTIONS["from the right"]
    force_n, pushed = np.array([[x, y, 0.0]]) * 12.5 / PUSH_S, 0
    while walker.outcome is None:
        cursor = walker.walker.cursor
        late = walker.time_s > 3.0 and cursor.swinging[0] and cursor.side[0] == Side.LEFT
        pushed += bool(late or 0 < pushed < 4)
        walker.walker.sim.push(force_n * (0 < pushed <= 4))
        walker.tick()
        feet = cursor.foot_targets[0]
        assert footing.may_stand(feet) or not cursor.swinging[0] or walker.time_s < 2
    report = walker.report()
    assert report.outcome == "reached", report.reason
    assert report.recovery_steps >= 1
    assert report.replans >= 1
