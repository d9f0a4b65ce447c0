"""Gait clock, sequences and the step cursor: hand-worked numbers and laws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from controller.gait import GaitTicks, clock, step_durations_s, support_indicator
from controller.step_cursor import STANCE, StepCursor, StepSequence
from planner.plan import FootstepPlan
from planner.robot_model import Side
from sim.robots import get_robot, robot_names

TICKS = GaitTicks(swing=30, double_support=14)
FEET = np.array([[0.0, 0.1, 0.0, 0.0], [0.0, -0.1, 0.0, 0.0]])


def one(value, kind=int):
    return np.array([value], dtype=kind)


def sequence(sides: list[Side]) -> StepSequence:
    """Steps that each go 0.2 m on; the x of a step is 0.2 times its number, from 1."""
    poses = np.array([[0.2 * (k + 1), 0.1 * s.outward, 0, 0] for k, s in enumerate(sides)])
    return StepSequence.of(FEET, np.array(sides, dtype=int), poses.reshape(-1, 4))


def test_durations_of_every_robot_are_whole_ticks():
    for name in robot_names():
        gait = get_robot(name).gait
        ticks = GaitTicks.of(gait)
        assert ticks.step * 0.025 == pytest.approx(gait.step_s)
        assert ticks.swing * 0.025 == pytest.approx(gait.single_support_s)


@pytest.mark.parametrize(
    ("side", "tick", "expected"),
    [
        (Side.RIGHT, 0, (0, 1)),
        (Side.RIGHT, 22, (1, 0)),
        (Side.LEFT, 0, (0, -1)),
        (Side.LEFT, 22, (-1, 0)),
        (Side.RIGHT, 11, (np.sqrt(0.5), np.sqrt(0.5))),
    ],
)
def test_clock_at_known_phases(side, tick, expected):
    assert clock(TICKS, one(side), one(tick), one(False, bool))[0] == pytest.approx(expected)


def test_clock_is_continuous_over_the_change_of_feet_and_dark_while_standing():
    last = clock(TICKS, one(Side.RIGHT), one(44), one(False, bool))
    first = clock(TICKS, one(Side.LEFT), one(0), one(False, bool))
    assert last == pytest.approx(first)
    assert clock(TICKS, one(Side.LEFT), one(7), one(True, bool)).tolist() == [[0, 0]]


def test_indicator_over_a_step_of_the_right_foot():
    def at(tick):
        return support_indicator(TICKS, one(Side.RIGHT), one(tick), one(False, bool))[0].tolist()

    # (left, right): ramps of two ticks about lift-off (0), touch-down (30) and the left's lift-off.
    assert at(0) == [1, 0]
    assert at(1) == [1, -0.5]
    assert at(15) == [1, -1]
    assert at(29) == [1, -0.5]
    assert at(30) == [1, 0]
    assert at(37) == [1, 1]
    assert at(43) == [0.5, 1]
    standing = support_indicator(TICKS, one(Side.RIGHT), one(15), one(True, bool))
    assert standing.tolist() == [[1, 1]]


def test_track_puts_the_stance_in_front_in_the_order_of_the_steps():
    path = sequence([Side.RIGHT, Side.LEFT])
    assert path.side.tolist() == [Side.RIGHT, Side.LEFT, Side.RIGHT, Side.LEFT]
    assert path.pose_world[0].tolist() == FEET[1].tolist()
    assert path.pose_world[1].tolist() == FEET[0].tolist()


def test_track_refuses_steps_that_do_not_alternate():
    with pytest.raises(ValueError, match="alternate"):
        StepSequence.of(FEET, np.array([0, 0]), np.zeros((2, 4)))


def walk_through(cursor: StepCursor, ticks: int):
    """What the cursor shows at every tick before the robot is done."""
    rows = []
    for _ in range(ticks):
        rows.append(
            (
                int(cursor.entry[0]),
                int(cursor.tick[0]),
                bool(cursor.standing[0]),
                cursor.window[0, :, 0].tolist(),
                cursor.foot_targets[0, :, 0].tolist(),
            )
        )
        cursor.advance()
    return rows


def test_cursor_waits_shifts_weight_walks_and_stands():
    cursor = StepCursor(TICKS, 1, 4)
    cursor.follow(0, sequence([Side.RIGHT, Side.LEFT, Side.RIGHT]), wait_ticks=5)
    rows = walk_through(cursor, 6 + 14 + 3 * 44 + 10)
    # Five ticks of waiting and the one in which the wait runs out.
    assert [row[2] for row in rows[:6]] == [True] * 6
    assert rows[6][:2] == (STANCE - 1, 30)
    assert all(not row[2] for row in rows[6 : 20 + 132])
    assert rows[20][:2] == (STANCE, 0)
    assert rows[20][3] == pytest.approx([0.2, 0.4])
    assert rows[20][4] == pytest.approx([0.0, 0.2])  # left stays, right goes to step 1
    assert rows[64][3] == pytest.approx([0.4, 0.6])
    assert rows[64][4] == pytest.approx([0.4, 0.2])
    assert rows[108][3] == pytest.approx([0.6, 0.4])  # after the last step: where the left stands
    assert rows[152][2]
    assert rows[152][4] == pytest.approx([0.4, 0.6])
    assert bool(cursor.arrived[0])
    assert cursor.advance().tolist() == [False]


def test_steps_take_as_long_as_the_track_says():
    """0.7 s are 28 ticks, 19 of them swing; 1.4 s are 56, 38 of them."""
    cursor = StepCursor(TICKS, 2, 2)
    paced = replace(sequence([Side.LEFT, Side.RIGHT, Side.LEFT]), step_s=np.array([0.7, 1.4, 1.1]))
    cursor.follow(1, paced, walking=True)
    assert cursor.step_s[1] == pytest.approx([0.7, 1.4])
    assert cursor.step_s[0] == pytest.approx([1.1, 1.1])  # stands: its gait's own
    rows, ended = [], []
    for tick in range(28 + 56 + 44):
        rows.append((bool(cursor.swinging[1]), cursor.clock[1].tolist()))
        ended += [tick + 1] if cursor.advance()[1] else []
    assert ended == [28, 84, 128]
    swinging = [swinging for swinging, _ in rows]
    assert np.flatnonzero(np.diff(swinging)).tolist() == [18, 27, 65, 83, 113]
    # A left step's phase goes from pi to 2 pi, evenly over its own duration.
    assert rows[14][1] == pytest.approx([-1, 0], abs=1e-9)
    assert rows[28 + 28][1] == pytest.approx([1, 0], abs=1e-9)
    assert bool(cursor.arrived[1])
    assert cursor.step_s[1] == pytest.approx([1.1, 1.1])


def test_a_foot_that_must_clear_something_is_shown_a_higher_step_until_it_is_past():
    cursor = StepCursor(TICKS, 2, 3)
    steps = sequence([Side.RIGHT, Side.LEFT, Side.RIGHT])
    over_z_m = np.array([-np.inf, 0.05, -0.1])  # nothing, a sill, and what is lower than the step
    cursor.follow(0, replace(steps, swing_over_z_m=over_z_m), walking=True)
    cursor.follow(1, steps, walking=True)
    raised = []
    for _ in range(3 * TICKS.step):
        shown = cursor.shown_window
        assert np.array_equal(shown[1], cursor.window[1])
        assert np.array_equal(shown[0, 1], cursor.window[0, 1])
        assert np.array_equal(shown[0, 0, [0, 1, 3]], cursor.window[0, 0, [0, 1, 3]])
        raised.append(shown[0, 0, 2] - cursor.window[0, 0, 2])
        cursor.advance()
    # Until 0.7 of the 30 ticks of the second swing, 3 cm above the sill.
    assert np.flatnonzero(raised).tolist() == list(range(44, 44 + 21))
    assert np.max(raised) == pytest.approx(0.05 + 0.03)
    cursor.follow(0, steps, walking=True)
    assert np.array_equal(cursor.shown_window, cursor.window)


def test_the_weight_shift_is_as_quick_as_the_first_step():
    cursor = StepCursor(TICKS, 1, 2)
    cursor.follow(0, replace(sequence([Side.LEFT]), step_s=np.array([0.7])))
    ticks = 0
    while not cursor.swinging[0]:
        cursor.advance()
        ticks += 1
    assert ticks == 1 + 9


def test_weight_shift_before_the_first_step_does_not_count_as_a_step():
    cursor = StepCursor(TICKS, 1, 4)
    cursor.follow(0, sequence([Side.RIGHT, Side.LEFT]), wait_ticks=3)
    ended = [bool(cursor.advance()[0]) for _ in range(120)]
    # 4 ticks until the weight shift begins, 14 of it, then 44 a step.
    assert np.flatnonzero(ended).tolist() == [4 + 14 + 44 - 1, 4 + 14 + 88 - 1]


def test_side_of_the_step_and_phase_of_the_gait_agree_all_along():
    cursor = StepCursor(TICKS, 2, 4)
    cursor.follow(0, sequence([Side.RIGHT, Side.LEFT, Side.RIGHT]))
    cursor.follow(1, sequence([Side.LEFT, Side.RIGHT]), walking=True)
    looked_at = 0
    for _ in range(200):
        swinging = cursor.swinging
        for row in np.flatnonzero(swinging):
            swing_side = int(cursor.side[row])
            assert cursor.support_indicator[row, 1 - swing_side] == 1
            assert (cursor.clock[row, 0] >= -1e-12) == (swing_side == Side.RIGHT) or (
                cursor.tick[row] == 0
            )
            looked_at += 1
        cursor.advance()
    assert looked_at == 5 * 30


def test_robot_without_steps_stands_where_it_is():
    cursor = StepCursor(TICKS, 1, 4)
    cursor.follow(0, sequence([]))
    for _ in range(100):
        assert not cursor.advance()[0]
    assert bool(cursor.arrived[0])
    assert cursor.foot_targets[0] == pytest.approx(FEET)


def test_track_longer_than_the_first_capacity_is_taken_whole():
    sides = [Side(k % 2) for k in range(40)]
    cursor = StepCursor(TICKS, 1, 4)
    cursor.follow(0, sequence(sides), walking=True)
    for _ in range(39 * 44):
        cursor.advance()
    assert cursor.window[0, :, 0] == pytest.approx([8.0, 7.8])


def test_only_straight_level_steps_are_taken_fast():
    """Forward, a turn, sideways, up onto a tread and onto it with the other foot, and on."""
    gait = get_robot("jvrc1").gait
    sides = np.array([Side.LEFT, Side.RIGHT] * 3)
    poses = np.array(
        [
            [0.3, 0.1, 0.0, 0.0],
            [0.6, -0.1, 0.0, -0.2],
            [0.6, 0.17, 0.0, -0.2],
            [0.9, -0.15, 0.1, -0.2],
            [0.92, 0.1, 0.1, -0.2],
            [1.15, -0.2, 0.1, -0.2],
        ]
    )
    plan = FootstepPlan(
        start_feet_world=FEET, start=(0, 0, 0), goal=(1, 0, 0), side=sides, pose_world=poses
    )
    assert step_durations_s(plan, gait, "normal", 0.7, 1.4) is None
    for pace, expected in (("slow", [1.4] * 6), ("fast", [0.7, 1.1, 1.1, 1.1, 1.1, 0.7])):
        durations = step_durations_s(plan, gait, pace, 0.7, 1.4)
        assert durations is not None
        assert durations.tolist() == expected
