"""Flights that training draws, against an oracle of polygons that knows nothing of how."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest
from shapely.geometry import Polygon
from shapely.ops import unary_union

from controller.stairs import STAIR_MODES, draw_stairs
from controller.step_cursor import STANCE
from planner.plan import feet_at, relative_step
from planner.robot_model import Side
from sim.robots import get_robot, robot_names
from sim.terrain import (
    LANDING_DEPTH_M,
    LANDING_WIDTH_M,
    LANDINGS,
    TREAD_DEPTH_M,
    TREAD_WIDTH_M,
    TREADS,
)

START = (0.4, -0.3, 2.0)
RISE_M = 0.07
STRAIGHT = [mode for mode in STAIR_MODES if mode != "stairs_curved"]


@functools.cache
def flights(name, mode, count=40, error_m=0.0):
    """So many flights of a robot: pairs of sequence and ground."""
    model = get_robot(name).training_model
    feet = feet_at(START, model.stance_width_m)
    rng = np.random.default_rng(7)
    return [
        draw_stairs(
            rng,
            model,
            feet,
            mode=mode,
            rise_m=RISE_M,
            steps=int(rng.integers(4, 13)),
            tread_error_m=error_m,
        )
        for _ in range(count)
    ]


def box(pose, length_m, width_m) -> Polygon:
    x, y, _, yaw = pose
    cos, sin = math.cos(yaw), math.sin(yaw)
    corners = [(1, 1), (-1, 1), (-1, -1), (1, -1)]
    local = [(a * length_m / 2, b * width_m / 2) for a, b in corners]
    return Polygon([(x + cos * a - sin * b, y + sin * a + cos * b) for a, b in local])


def blocks(ground) -> list[tuple[float, Polygon]]:
    """Height and outline of every tread and landing."""
    return [(p[2], box(p, TREAD_DEPTH_M, TREAD_WIDTH_M)) for p in ground.treads] + [
        (p[2], box(p, LANDING_DEPTH_M, LANDING_WIDTH_M)) for p in ground.landings
    ]


@pytest.mark.parametrize("mode", ["stairs_up", "stairs_down", "stairs_over", "stairs_curved"])
@pytest.mark.parametrize("name", robot_names())
def test_every_foot_stands_wholly_on_ground_of_its_own_height(name, mode):
    foot, feet = get_robot(name).step_model.foot, 0
    for sequence, ground in flights(name, mode):
        assert len(ground.treads) <= TREADS
        assert len(ground.landings) <= LANDINGS
        for pose in sequence.pose_world:
            sole = box(pose, foot.length_m, foot.width_m)
            own = unary_union([b for z, b in blocks(ground) if abs(z - pose[2]) < 1e-9])
            higher = unary_union([b for z, b in blocks(ground) if z > pose[2] + 1e-9])
            on_floor = abs(pose[2] - ground.floor_z_m) < 1e-9
            assert on_floor or sole.difference(own).area < 1e-9, pose
            assert sole.intersection(higher).area < 1e-9, pose
            feet += 1
    assert feet > 300


@pytest.mark.parametrize("mode", STAIR_MODES)
@pytest.mark.parametrize("name", robot_names())
def test_every_step_keeps_the_limits_and_rises_as_asked(name, mode):
    limits = get_robot(name).training_model.limits
    for sequence, _ in flights(name, mode):
        assert np.all(sequence.side[1:] != sequence.side[:-1])
        for k in range(STANCE, len(sequence.side)):
            support, swing = sequence.pose_world[k - 1], sequence.pose_world[k]
            relative = relative_step(support, swing, Side(int(sequence.side[k])))
            assert limits.contain(relative, tolerance=1e-6), relative
        change = np.diff(sequence.pose_world[STANCE - 1 :, 2]) / RISE_M
        assert change == pytest.approx(np.round(change), abs=1e-9)
        assert np.abs(change).max() == pytest.approx(1)
        # The last step brings the feet side by side, on one place.
        assert sequence.pose_world[-1, 2] == sequence.pose_world[-2, 2]


def test_each_kind_goes_where_its_name_says():
    def changes(mode):
        return [
            np.diff(sequence.pose_world[STANCE - 1 :, 2]) for sequence, _ in flights("jvrc1", mode)
        ]

    assert all((c >= 0).all() for c in changes("stairs_up"))
    assert all((c <= 0).all() for c in changes("stairs_down"))
    over = [c for c in changes("stairs_over") if (c < 0).any()]
    assert len(over) > 10
    for c in over:  # up first, then down, to the height it began at
        assert np.flatnonzero(c > 0).max() < np.flatnonzero(c < 0).min()
        assert c.sum() == pytest.approx(0)
    curved = changes("stairs_curved")
    assert any((c > 0).any() for c in curved)
    assert any((c < 0).any() for c in curved)
    ends = [
        sequence.pose_world[-1, 3] - START[2] for sequence, _ in flights("jvrc1", "stairs_curved")
    ]
    assert min(ends) < -0.2
    assert max(ends) > 0.2
    for mode in STRAIGHT[:3]:
        for sequence, _ in flights("jvrc1", mode):
            assert np.ptp(sequence.pose_world[STANCE:, 3]) < 1e-9


def test_flights_are_walked_with_one_foot_and_with_both_on_each_tread():
    """Never two rises in a row with both feet, always but for level places with one."""
    both, single = 0, 0
    for sequence, _ in flights("jvrc1", "stairs_up"):
        rises = np.diff(sequence.pose_world[STANCE - 1 :, 2]) > 0
        in_a_row = (rises[1:] & rises[:-1]).any()
        single += in_a_row
        both += not in_a_row and rises.sum() > 1
    assert both >= 8
    assert single >= 12


def test_wide_stances_still_turn_on_curved_flights():
    """The turn gives way to the stance, but not the curve to the straight."""
    for name in {"jvrc1", "hrp5p", "h1"} & set(robot_names()):
        turns = [
            np.abs(np.diff(sequence.pose_world[STANCE:, 3])).max()
            for sequence, _ in flights(name, "stairs_curved")
        ]
        assert np.mean(np.array(turns) > 0.025) > 0.9, name


def test_treads_are_off_by_no_more_than_asked_and_apart_from_their_steps():
    """The steps are as without an error: what is off is the ground."""
    model, off = get_robot("jvrc1").training_model, []
    pairs = zip(flights("jvrc1", "stairs"), flights("jvrc1", "stairs", error_m=0.02), strict=True)
    for (plain, level), (sequence, ground) in pairs:
        assert np.array_equal(plain.pose_world, sequence.pose_world)
        assert np.array_equal(level.treads[:, [0, 1, 3]], ground.treads[:, [0, 1, 3]])
        off += [*(ground.treads - level.treads)[:, 2], *(ground.landings - level.landings)[:, 2]]
        # Feet that are side by side on the level stand on one slab.
        for k in np.flatnonzero(np.diff(sequence.pose_world[:, 2]) == 0):
            under = [
                z
                for z, b in blocks(ground)
                for pose in sequence.pose_world[k : k + 2]
                if abs(z - pose[2]) < 0.0201
                and b.contains(box(pose, model.foot.length_m, model.foot.width_m))
            ]
            assert len({round(z, 9) for z in under}) <= 1
    assert max(np.abs(off)) <= 0.02
    assert max(off) > 0.015
    assert min(off) < -0.015


def test_treads_are_never_off_by_more_than_half_the_rise():
    for (_, level), (_, ground) in zip(
        flights("jvrc1", "stairs"), flights("jvrc1", "stairs", error_m=0.5), strict=True
    ):
        assert np.abs(ground.treads - level.treads).max(initial=0.0) <= RISE_M / 2 + 1e-12


def test_same_seed_same_flight():
    first, again = flights("jvrc1", "stairs"), flights.__wrapped__("jvrc1", "stairs")
    for (sequence, ground), (other, same) in zip(first, again, strict=True):
        assert np.array_equal(sequence.pose_world, other.pose_world)
        assert np.array_equal(ground.treads, same.treads)
