"""What the model-based controller does about a push: in its pattern, in steps, and in walks."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("mink")

from controller.evaluation.rollouts import chained
from controller.gait import GaitTicks
from controller.lipm.controller import Lag, LipmController
from controller.lipm.pattern import (
    CAUTIOUS_SHARE,
    FIRST_SAMPLES,
    SAMPLE_S,
    SOLE_SHARE,
    PatternGenerator,
    Pendulum,
    phases_of,
)
from controller.lipm.servos import stiff
from controller.recovery import change_steps, step_change
from controller.step_cursor import StepCursor, StepSequence
from controller.walker import Walker
from planner.robot_model import Side
from sim.robots import get_robot
from sim.scene import build_scene
from tests.lipm_step import FEET, HALF_SOLE_M, OMEGA, STEP


def pendulum_at(dcm: np.ndarray) -> Pendulum:
    """At rest there, with the ZMP in the same place."""
    return Pendulum(com=np.array(dcm), velocity=np.zeros(2), acceleration=np.zeros(2))


def test_a_pattern_that_cannot_stay_in_the_sole_is_relaxed_and_counted():
    pattern = PatternGenerator(0.8, HALF_SOLE_M)
    pendulum = Pendulum(com=np.zeros(2), velocity=np.array([0.0, 3.0]), acceleration=np.zeros(2))
    on_one_foot = replace(STEP, lift_off_s=np.array([-0.1]), touch_down_s=np.array([5.0]))
    phases = phases_of(FEET, on_one_foot)
    assert pattern.solve(pendulum, phases) is None
    assert pattern.relaxed == 0
    jerk = pattern.solve_open_ended(pendulum, phases)
    assert pattern.relaxed == 1
    zmp = []
    for each in jerk:
        pendulum.advance(each, SAMPLE_S)
        zmp.append(pendulum.com - pendulum.acceleration / OMEGA**2)
    # It does what it can: the ZMP goes to the outer edge of the foot, and stays there.
    outer_m = FEET[0, 1] + SOLE_SHARE * HALF_SOLE_M[1]
    np.testing.assert_allclose(np.array(zmp)[:16], [[0.0, outer_m]] * 16, atol=0.01)


def test_the_soles_bear_a_zmp_within_their_hull():
    """Two soles of 20 by 10 cm, the right one 20 cm ahead and turned by a quarter."""
    feet = np.array([[0.0, 0.1, 0.0, 0.0], [0.2, -0.1, 0.0, np.pi / 2]])
    both = phases_of(feet, replace(STEP, lift_off_s=np.array([5.0]), touch_down_s=np.array([6.0])))

    def bears(phase: Any, *point: float) -> bool:
        normals, offsets = phase.hull(HALF_SOLE_M)
        return bool((normals @ np.array(point) <= offsets + 1e-6).all())

    within = [(-0.1, 0.15), (0.1, 0.15), (0.25, -0.2), (0.15, -0.2), (0.25, 0.0), (0.0, 0.0)]
    beyond = [(-0.1, 0.16), (0.26, -0.1), (0.14, -0.2), (0.2, 0.1), (-0.05, -0.01)]
    assert [bears(both[0], *point) for point in within] == [True] * 6
    assert [bears(both[0], *point) for point in beyond] == [False] * 5
    assert len(both[0].hull(HALF_SOLE_M)[0]) == 6
    alone = replace(both[0], standing=(False, True))
    assert bears(alone, 0.25, -0.2)
    assert not bears(alone, 0.14, -0.1)


def test_the_zmp_keeps_away_from_the_edges_where_it_can():
    """From a DCM near the left sole's outer edge, before the right foot is lifted."""
    pattern, phases = PatternGenerator(0.8, HALF_SOLE_M), phases_of(FEET, STEP)
    edge_m = {}
    for share in (CAUTIOUS_SHARE, SOLE_SHARE):
        pendulum, zmp = pendulum_at(np.array([0.0, 0.135])), []
        jerks = pattern.solve(pendulum, phases, share)
        assert jerks is not None
        for jerk in jerks:
            pendulum.advance(jerk, SAMPLE_S)
            zmp.append(pendulum.com - pendulum.acceleration / OMEGA**2)
        edge_m[share] = np.array(zmp)[FIRST_SAMPLES:18, 1].max() - FEET[0, 1]
    assert edge_m[CAUTIOUS_SHARE] <= CAUTIOUS_SHARE * HALF_SOLE_M[1] + 1e-6
    assert edge_m[SOLE_SHARE] > edge_m[CAUTIOUS_SHARE] + 1e-3


def test_only_a_foot_that_is_lifted_later_lets_a_late_centre_of_mass_come_to_rest():
    """Its DCM still over the right foot, which is the one to be lifted."""
    pattern, pendulum = PatternGenerator(0.8, HALF_SOLE_M), pendulum_at(np.array([0.0, -0.1]))
    solved = []
    for wait_s in (0.0, 0.6):
        lift_off_s, touch_down_s = np.array([0.1 + wait_s]), np.array([0.7 + wait_s])
        steps = replace(STEP, lift_off_s=lift_off_s, touch_down_s=touch_down_s)
        solved.append(pattern.solve(pendulum, phases_of(FEET, steps)) is not None)
    assert solved == [False, True]


def test_a_foot_is_lifted_later_by_as_much_as_it_is_postponed():
    """A weight shift of 2 ticks after a wait of 3, swings of 4 ticks and double supports of 2."""
    sequence = StepSequence.of(FEET, np.array([1, 0]), FEET[[1, 0]])
    lift_offs = []
    for postponed_at in (None, 1, 4, 10):
        cursor = StepCursor(GaitTicks(swing=4, double_support=2), 1, 4)
        cursor.follow(0, sequence, wait_ticks=3)
        swinging = []
        for tick in range(25):
            if tick == postponed_at:
                assert not cursor.swinging[0]
                cursor.postpone(0, 5)
            cursor.advance()
            swinging.append(bool(cursor.swinging[0]))
        lift_offs.append(np.flatnonzero(np.diff(np.array(swinging, dtype=int)) == 1))
    first, second = lift_offs[0]
    np.testing.assert_array_equal(lift_offs[1], [first + 5, second + 5])
    np.testing.assert_array_equal(lift_offs[2], [first + 5, second + 5])
    np.testing.assert_array_equal(lift_offs[3], [first, second + 5])


def test_the_posture_catches_up_with_a_pattern_that_began_anew():
    lag = Lag(com=np.array([0.05, 0.0]), velocity=np.array([0.0, 0.2]))
    for _ in range(200):
        lag.advance(0.005)
    np.testing.assert_allclose(lag.com, 0.0, atol=1e-3)
    np.testing.assert_allclose(lag.velocity, 0.0, atol=1e-2)


@pytest.mark.slow
def test_pushed_from_the_left_it_moves_as_the_mirror_image_of_pushed_from_the_right():
    robot = stiff(get_robot("jvrc1"))
    scene = build_scene(robot, timestep_s=0.001)
    walker = Walker(scene, count=2)
    feet = scene.soles_at(scene.standing_qpos)
    for row, first in enumerate((Side.LEFT, Side.RIGHT)):
        walker.place(row, scene.standing_qpos)
        steps = np.tile((0.2, robot.step_model.stance_width_m, 0.0), (5, 1))
        walker.follow(row, chained(feet, first, steps), wait_ticks=4)
    tick, disturbed = LipmController().start(walker), np.zeros(2, dtype=bool)
    # Outward over the foot that has just begun to stand alone: 12.5 N s.
    force_n = np.array([[0.0, 125.0, 0.0], [0.0, -125.0, 0.0]])
    for number in range(120):
        walker.sim.push(force_n * (70 <= number < 74))
        tick()
        change_steps(walker, step_change(walker))
        disturbed |= walker.disturbed
        soles = walker.soles_world()[..., :3]
        np.testing.assert_allclose(soles[1], soles[0, ::-1] * [1, -1, 1], atol=1e-2)
    assert disturbed.all()
    assert not walker.fallen().any()
    assert soles[0, :, 0].min() > 0.3
