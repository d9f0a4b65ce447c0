"""Step model and training limits of a draft, by leg length and as far as its legs reach."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from planner.robot_model import BodyShape, FootShape, Step, StepLimits, StepModel
from sim.posture import SPARE_RAD, PostureError, planned_steps, step_spare_rad
from sim.robot import RobotStepModel
from sim.scene import Scene

# Of a leg's length: as far as robots that learned to walk here do.
_FORWARD, _BACKWARD, _OUTWARD, _INWARD = 0.36, 0.18, 0.14, 0.05
_TURN_RAD = (-0.15, 0.30)
_MARGIN = 0.13  # of the body, of a leg's length
_SHARES = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4)
_MORE_SPARE_RAD = np.radians(0.5)
_LATTICE_M = 0.05


def stance_width_m(natural_m: float, foot: FootShape) -> float:
    """How far apart the feet are at a pose: as they hang, if they then have room."""
    return round(max(natural_m, foot.width_m + 0.05), 2)


def step_model_of(
    *, leg_m: float, stance_m: float, foot: FootShape, body: BodyShape, share: float, inward: float
) -> StepModel:
    """The step model whose steps are `share` of what suits the leg's length."""
    forward, backward, outward = (
        round(share * part * leg_m, 2) for part in (_FORWARD, _BACKWARD, _OUTWARD)
    )
    turn = tuple(round(share * angle, 2) for angle in _TURN_RAD)
    limits = StepLimits(
        x_m=(-backward, forward),
        y_m=(round(stance_m - inward, 3), round(stance_m + max(outward, 0.05), 3)),
        yaw_rad=(turn[0], turn[1]),
    )
    return RobotStepModel(
        foot=foot,
        body=body,
        limits=limits,
        steps=_step_set(limits, stance_m),
        stance_width_m=stance_m,
        body_margin_m=round(_MARGIN * leg_m, 2),
    )


def _step_set(limits: StepLimits, stance_m: float) -> tuple[Step, ...]:
    """Steps of the search: straight, sideways and turning, on multiples of the lattice's cells."""
    ends = [math.trunc(x / _LATTICE_M + 1e-9 * math.copysign(1, x)) for x in limits.x_m]
    cells = list(range(ends[0], ends[1] + 1))
    if len(cells) > 7:
        cells = sorted({ends[0], *(c for c in cells if c % 2 == 0), ends[1]})
    ahead = [round(c * _LATTICE_M, 3) for c in cells]
    some = [x for x in ahead if x in {ahead[0], 0.0} or x == ahead[len(ahead) * 2 // 3]]
    turning = [x for x in ahead if x > ahead[0]]
    wide_m = stance_m + (0.10 if limits.y_m[1] >= stance_m + 0.10 else 0.05)
    turned_m = min(stance_m + 0.02, limits.y_m[1])
    inward, outward = limits.yaw_rad
    steps = [
        *((x, stance_m, 0.0) for x in ahead),
        *((x, wide_m, 0.0) for x in some),
        *((x, turned_m, outward) for x in turning),
        *((x, turned_m, outward / 2) for x in turning[1::2]),
        *((x, stance_m, inward) for x in turning[1::2]),
    ]
    rounded = ((round(x, 3), round(y, 3), round(yaw, 3)) for x, y, yaw in steps)
    return tuple(dict.fromkeys(step for step in rounded if limits.contain(step)))


def reachable_steps(
    scene: Scene, *, leg_m: float, stance_m: float, foot: FootShape, body: BodyShape
) -> tuple[StepModel, float]:
    """The longest steps that the legs reach with some room, and their share of what was wished.

    The last ones tried, if they reach none.
    """
    least_in = max(foot.width_m + 0.015, stance_m - _INWARD * leg_m)
    inward = stance_m - least_in
    model, share = scene.robot.step_model, _SHARES[-1]
    for share in _SHARES:
        for part in (1.0, 0.6, 0.3, 0.0):
            model = step_model_of(
                leg_m=leg_m,
                stance_m=stance_m,
                foot=foot,
                body=body,
                share=share,
                inward=part * inward,
            )
            if _reaches(replace(scene, robot=replace(scene.robot, step_model=model))):
                return model, share
    return model, share


def _reaches(scene: Scene) -> bool:
    # The corners are the farthest: they come first.
    for step in reversed(planned_steps(scene)):
        try:
            if step_spare_rad(scene, step, 0)[0] < SPARE_RAD + _MORE_SPARE_RAD:
                return False
        except PostureError:
            return False
    return True


def training_limits_of(limits: StepLimits, leg_m: float, foot: FootShape) -> StepLimits:
    """The limits to train on: wider than those of plans by a few centimetres."""
    wider_m = round(0.05 * leg_m, 2)
    least_m = min(limits.y_m[0], foot.width_m + 0.015)
    return replace(
        limits,
        x_m=(round(limits.x_m[0] - wider_m, 3), round(limits.x_m[1] + wider_m, 3)),
        y_m=(
            round(max(limits.y_m[0] - wider_m / 4, least_m), 3),
            round(limits.y_m[1] + wider_m, 3),
        ),
        yaw_rad=(round(limits.yaw_rad[0] - 0.04, 3), round(limits.yaw_rad[1] + 0.08, 3)),
    )
