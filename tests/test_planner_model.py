"""Step models, and the step table: rounded to the lattice, within the limits, feet apart."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from shapely import affinity

from planner.lattice.steps import allowed, build_step_table, feet_apart
from planner.plan import wrap_angle
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


def test_body_shape_must_have_a_size():
    with pytest.raises(ValueError, match="body width_m 0"):
        BodyShape(length_m=0.1, width_m=0)


MODELS = {
    "coarse": small_model(),
    "fine": small_model(cell_m=0.03, headings=64),
    "tight": small_model(
        cell_m=0.05,
        headings=32,
        limits=StepLimits(x_m=(-0.15, 0.3), y_m=(0.15, 0.35), yaw_rad=(-0.2, 0.4)),
        steps=((0.3, 0.2, 0.0), (0.0, 0.35, 0.0), (0.2, 0.2, 0.4), (-0.15, 0.15, -0.2)),
        stance_width_m=0.19,
    ),
}


def table_steps(table, model):
    """Steps (H, 2, K, 3) in the support foot's frame, outward positive, as the table has them."""
    bin_rad = 2 * np.pi / model.headings
    yaw_rad = (np.arange(model.headings) * bin_rad)[:, None, None]
    out = np.array([side.other.outward for side in Side])[None, :, None]
    dx_m = table.d_col * model.cell_m
    dy_m = table.d_row * model.cell_m + out * model.stance_width_m
    x_m = np.cos(yaw_rad) * dx_m + np.sin(yaw_rad) * dy_m
    y_m = out * (-np.sin(yaw_rad) * dx_m + np.cos(yaw_rad) * dy_m)
    return np.stack([x_m, y_m, wrap_angle(out * table.d_heading * bin_rad)], axis=-1)


@pytest.mark.parametrize("name", MODELS)
def test_no_rounded_step_breaks_the_limits_or_brings_the_feet_together(name):
    model = MODELS[name]
    table = build_step_table(model)
    real = table.cost_um > 0
    steps = table_steps(table, model)[real]
    assert len(steps) > model.headings
    assert model.limits.contain(steps).all()
    assert feet_apart(steps, model.foot, model.foot_gap_m).all()
    # And it stays near the step that was asked for.
    wanted = np.broadcast_to(np.array(model.steps), (*real.shape, 3))[real]
    assert np.hypot(*(steps - wanted)[:, :2].T).max() < 2.2 * model.cell_m


@pytest.mark.parametrize("name", MODELS)
def test_the_right_foots_steps_mirror_the_lefts(name):
    model = MODELS[name]
    table = build_step_table(model)
    mirrored = -np.arange(model.headings) % model.headings
    for left, right, sign in (
        (table.d_col, table.d_col, 1),
        (table.d_row, table.d_row, -1),
        (table.d_heading, table.d_heading, -1),
        (table.cost_um, table.cost_um, 1),
    ):
        np.testing.assert_array_equal(left[:, 0], sign * right[mirrored, 1])


def test_optional_costs_add_up_by_hand():
    model = small_model(turn_cost_m=0.5, side_cost_m=2.0, back_cost_m=3.0)
    table, steps = build_step_table(model), table_steps(build_step_table(model), model)
    checked = 0
    for k, (x_m, y_m, yaw_rad) in enumerate(steps[0, 0]):
        if table.cost_um[0, 0, k]:
            extra = 0.5 * abs(yaw_rad) + 2.0 * abs(y_m - 0.2) + 3.0 * max(0.0, -x_m)
            by_hand = math.hypot(x_m, y_m) + 0.1 + extra
            assert table.cost_um[0, 0, k] == pytest.approx(by_hand * 1e6, abs=1)
            checked += 1
    assert checked == 5


def test_feet_apart_never_contradicts_polygons():
    rng = np.random.default_rng(1)
    foot = FootShape(length_m=0.2, width_m=0.1)
    steps = rng.uniform((-0.3, 0.0, -0.8), (0.3, 0.4, 0.8), (2000, 3))
    apart = feet_apart(steps, foot, 0.02)
    box = shapely.box(-0.1, -0.05, 0.1, 0.05)
    for (x_m, y_m, yaw_rad), says_apart in zip(steps, apart, strict=True):
        turned = affinity.rotate(box, yaw_rad, origin=(0, 0), use_radians=True)
        distance_m = box.distance(affinity.translate(turned, x_m, y_m))
        if says_apart:
            assert distance_m >= 0.02 - 1e-9
        else:
            # Grown boxes have corners, so the check may ask for more, but not for much.
            assert distance_m <= 0.02 * math.sqrt(2)
    assert 0.2 < apart.mean() < 0.9


def test_a_step_onto_the_other_foot_is_not_allowed():
    model = small_model(limits=StepLimits(x_m=(-0.2, 0.3), y_m=(0.0, 0.4), yaw_rad=(-0.4, 0.8)))
    assert allowed(np.array([[0.0, 0.2, 0.0], [0.0, 0.1, 0.0]]), model).tolist() == [True, False]
