"""Tracking limits: step limits and margins measured on a policy, and the step model they give.

`NAME.measured.json` lies beside `NAME.safetensors` and holds for those weights only; `evaluate`
writes it. Reading it loads neither torch nor MuJoCo.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from controller.policy import PolicyError, own_policy_path
from maps.files import read_json
from planner.robot_model import StepLimits, StepModel
from sim.robot import Robot

FORMAT = "measured-follower/1"


@dataclass(frozen=True, kw_only=True)
class TrackingLimits:
    """Limits within which a robot with its policy tracks steps.

    `limits`: walks of steps within them succeed in at least 99 %. `foot_margin_m` covers the 99th
    percentile of the landing error of any point of a sole, `body_margin_m` the sway of the body
    beyond its box. `evidence` records the measurement.
    """

    robot: str
    policy_sha256: str
    limits: StepLimits
    foot_margin_m: float
    body_margin_m: float
    evidence: dict[str, Any] = field(default_factory=dict)


def tracking_limits_path(path: Path | None, robot: Robot) -> Path:
    """Path of the tracking limits of a policy, by default of the robot's own.

    Those of a robot that walks on the policy of another model of it have a file of their own.
    """
    path = path or own_policy_path(robot)
    name = robot.name if robot.trained_as and path.stem == robot.trained_as else path.stem
    return path.with_name(f"{name}.measured.json")


def tracking_limits_text(measured: TrackingLimits) -> str:
    """The text of the file."""
    return json.dumps({"format": FORMAT, **asdict(measured)}, indent=1) + "\n"


def load_tracking_limits(robot: Robot, policy_path: Path | None = None) -> TrackingLimits | None:
    """The tracking limits of a policy; None without any, or if they are of other weights.

    Raises:
        PolicyError: the file cannot be read or is of another robot.
    """
    path = tracking_limits_path(policy_path, robot)
    about_path = (policy_path or own_policy_path(robot)).with_suffix(".json")
    if not (path.is_file() and about_path.is_file()):
        return None
    try:
        values = read_json(path)
        weights = read_json(about_path)["sha256"]
        if values.pop("format") != FORMAT:
            raise ValueError(f"its format is not {FORMAT}")
        measured = TrackingLimits(limits=limits_from(values.pop("limits")), **values)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise PolicyError(f"{path} cannot be read ({error}): evaluate the policy again") from error
    if measured.robot != robot.name:
        raise PolicyError(f"{path} was measured on {measured.robot}, not on {robot.name}")
    return measured if measured.policy_sha256 == weights else None


def limits_from(document: Mapping[str, Any]) -> StepLimits:
    """Step limits from JSON.

    Raises:
        ValueError, TypeError: the document holds no step limits.
    """
    values = dict(document)
    reach_m = tuple((x_m, y_m) for x_m, y_m in values.pop("reach_m", ()))
    intervals = {name: (low, high) for name, (low, high) in values.items()}
    return StepLimits(**intervals, reach_m=reach_m)


def planning_model(model: StepModel, measured: TrackingLimits) -> StepModel:
    """The step model with measured limits and margins; steps outside the limits are dropped.

    The polygon of the step model stays where it has one.

    Raises:
        ValueError: no step is left, or the stance lies outside the limits.
    """
    reach_m = model.limits.reach_m or measured.limits.reach_m
    limits = replace(measured.limits, reach_m=reach_m)
    steps = tuple(step for step in model.steps if limits.contain(step))
    return replace(
        model,
        limits=limits,
        steps=steps,
        foot_margin_m=measured.foot_margin_m,
        body_margin_m=measured.body_margin_m,
    )


def with_tracking_limits(robot: Robot, policy_path: Path | None = None) -> Robot:
    """The robot with the step model of its policy's tracking limits, if there are any.

    Raises:
        PolicyError: the file cannot be read or used.
    """
    measured = load_tracking_limits(robot, policy_path)
    if measured is None:
        return robot
    try:
        model = planning_model(robot.step_model, measured)
    except ValueError as error:
        path = tracking_limits_path(policy_path, robot)
        raise PolicyError(f"{path} does not fit {robot.name}: {error}") from error
    # Training keeps the limits of the robot's file.
    trained = robot.training_model.limits
    return replace(robot, step_model=model, training_limits=trained)
