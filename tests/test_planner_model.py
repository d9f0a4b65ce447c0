"""Step models: what of a robot the planner is told, and what it refuses to be told."""

from __future__ import annotations

import pytest

from planner.lattice.steps import build_step_table
from planner.robot_model import BodyShape, FootShape, Side, StepLimits
from tests.planner_oracle import small_model


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"steps": ()}, "steps is empty"),
        ({"steps": ((0.5, 0.2, 0.0),)}, r"step \(0.5, 0.2, 0.0\) lies outside"),
        ({"stance_width_m": 0.5}, "stance_width_m 0.5: the step limits"),
        ({"stance_width_m": 0.0}, "stance_width_m 0.0 must be"),
        ({"cell_m": 0.5}, "cell_m 0.5 must be from"),
        ({"headings": 4}, "headings 4 must be"),
        ({"headings": 30}, "headings 30 must be a multiple of 4"),
        ({"foot_margin_m": -0.1}, "foot_margin_m -0.1"),
        ({"turn_cost_m": -1.0}, "turn_cost_m -1.0"),
        ({"foot": FootShape(length_m=0.2, width_m=0.2)}, "or the feet overlap"),
    ],
)
def test_a_step_model_that_cannot_walk_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        small_model(**change)


def test_limits_with_low_above_high_are_refused():
    with pytest.raises(ValueError, match="y_m"):
        StepLimits(x_m=(0.0, 0.1), y_m=(0.3, 0.2), yaw_rad=(0.0, 0.1))


def test_limits_that_no_node_meets_are_refused():
    tight = StepLimits(x_m=(-0.001, 0.3), y_m=(0.199, 0.201), yaw_rad=(0.0, 0.0))
    with pytest.raises(ValueError, match="take a smaller cell_m"):
        build_step_table(small_model(limits=tight, steps=((0.21, 0.2, 0.0),)))


def test_sides():
    assert (Side.LEFT.other, Side.RIGHT.other) == (Side.RIGHT, Side.LEFT)
    assert (Side.LEFT.outward, Side.RIGHT.outward) == (1, -1)


def test_body_shape_must_have_a_size():
    with pytest.raises(ValueError, match="body width_m 0"):
        BodyShape(length_m=0.1, width_m=0)
