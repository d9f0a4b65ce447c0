"""Heights of the ground under boxes, soles and swinging feet, by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from planner.collision import (
    NO_GROUND_UM,
    box_heights,
    heights_below,
    highest_between,
    resting_heights,
    terrain_of,
)
from tests.planner_treads import CLIMBER, floor

# Heights by hand: a floor of 4 x 4 m in cells of 0.1 m, 0.3 m high from x = 2 on, a post 1 m high
# on the cell [1, 1.1) x [1, 1.1), a blocked cell beside it.
HAND = floor(
    (0, 20, 40, 40, 0.3), (10, 10, 11, 11, 1.0), rows=40, cols=40, boxes=((10, 11, 11, 12),)
)


@pytest.mark.parametrize(
    ("x", "y", "yaw", "half_l", "half_w", "expected_m"),
    [
        (1.5, 3.0, 0.0, 0.3, 0.2, (0.0, 0.0)),
        (2.5, 3.0, 0.0, 0.3, 0.2, (0.3, 0.3)),
        (1.95, 3.0, 0.0, 0.3, 0.2, (0.0, 0.3)),
        (1.79, 3.0, 0.0, 0.2, 0.1, (0.0, 0.0)),  # ends at 1.99
        (1.81, 3.0, 0.0, 0.2, 0.1, (0.0, 0.3)),  # ends at 2.01
        (1.81, 3.0, math.pi / 2, 0.2, 0.1, (0.0, 0.0)),  # turned it ends at 1.91
        (1.84, 3.0, math.pi / 4, 0.2, 0.01, (0.0, 0.0)),  # 0.21 cos 45 = 0.149: ends at 1.989
        (1.86, 3.0, math.pi / 4, 0.2, 0.01, (0.0, 0.3)),
        (1.05, 1.05, 0.0, 0.04, 0.04, (1.0, 1.0)),
        (1.05, 1.05, 0.0, 0.06, 0.04, (0.0, 1.0)),
        (1.13, 1.05, 0.0, 0.02, 0.04, None),  # blocked ground only
        (0.1, 0.1, 0.3, 0.5, 0.5, (0.0, 0.0)),  # partly off the map
        (-9.0, 0.1, 0.0, 0.5, 0.5, None),
    ],
)
def test_heights_under_a_box_by_hand(x, y, yaw, half_l, half_w, expected_m):
    box = x, y, math.cos(yaw), math.sin(yaw), half_l, half_w
    expected = (NO_GROUND_UM,) * 2 if expected_m is None else tuple(1e6 * v for v in expected_m)
    assert box_heights(terrain_of(HAND, False), *box) == expected


@pytest.mark.parametrize(
    ("start", "end", "yaw", "expected_m"),
    [
        # A sole of 0.2 x 0.1 m, walking along x past the post at y 1.0 to 1.1.
        ((0.5, 1.17), (1.5, 1.17), 0.0, 0.0),  # its side is at 1.12
        ((0.5, 1.14), (1.5, 1.14), 0.0, 1.0),  # at 1.09
        ((0.5, 1.19), (1.5, 1.19), math.pi / 2, 1.0),  # walking sideways, its toes are at 1.09
        ((0.5, 1.05), (0.95, 1.05), 0.0, 0.0),  # the strip ends at the foot's centre
        ((1.5, 3.0), (1.95, 3.0), 0.0, 0.0),
        ((1.5, 3.0), (2.05, 3.0), 0.0, 0.3),
        ((1.05, 1.05), (1.05, 1.05), 0.0, None),  # no way at all
    ],
)
def test_ground_on_the_way_of_a_foot_by_hand(start, end, yaw, expected_m):
    top = highest_between(
        terrain_of(HAND, False), start, end, math.cos(yaw), math.sin(yaw), (0.1, 0.05)
    )
    assert top == (NO_GROUND_UM if expected_m is None else expected_m * 1e6)


def test_a_measured_foot_rests_on_what_is_nearest_to_its_own_height():
    terrain = terrain_of(HAND, False)
    # Soles of 0.2 x 0.1 m: on the floor, on the step, across its edge, and beside the map.
    feet = np.array(
        [
            [1.0, 3.0, 0.02, 0.0],
            [2.5, 3.0, 0.28, 0.0],
            [2.05, 3.0, 0.29, 0.0],
            [1.95, 3.0, 0.01, 0.0],
            [-5.0, 3.0, 0.7, 0.0],
        ]
    )
    rests = resting_heights(HAND, terrain, CLIMBER, feet)
    assert rests.tolist() == [0.0, 0.3, 0.3, 0.0, 0.7]
    assert heights_below(HAND, terrain, CLIMBER, feet)[2].tolist() == [0.0, 0.3]
