"""A walk as its navigator knows it, for pictures: path.png, what is recorded, how it ended."""

from __future__ import annotations

import math

import numpy as np

from app.navigation.navigator import Navigator
from app.pictures.canvas import Picture
from app.pictures.plan_pictures import walk_picture
from app.pictures.rendering import Recording
from controller.gait import CONTROL_PERIOD_S
from planner.plan import FootstepPlan


def path_picture(navigator: Navigator, plan: FootstepPlan) -> Picture:
    """Map, feet as planned and as placed so far, and the path of the body, (H, W, 3)."""
    placed = navigator.placed
    return walk_picture(
        navigator.grid,
        navigator.robot.step_model,
        plan,
        placed_side=np.array([int(step.side) for step in placed], dtype=np.int8),
        placed_world=np.array([step.placed_world for step in placed]).reshape(-1, 4),
        body_xy_world=np.array(navigator.qpos)[:, :2],
    )


def recording_of(navigator: Navigator) -> Recording:
    """The walk so far, at each control step."""
    qpos = np.array(navigator.qpos)
    return Recording(
        qpos=qpos,
        time_s=np.arange(len(qpos)) * CONTROL_PERIOD_S,
        ground_m=navigator.grid.height_m(qpos[:, :2]),
    )


def outcome_of(navigator: Navigator) -> str:
    """How a walk, which must have ended, did so, in one line."""
    assert navigator.outcome is not None
    if navigator.reason:
        return f"{navigator.outcome}: {navigator.reason}"
    distance_m, angle_rad = navigator.goal_error
    degrees = math.degrees(angle_rad)
    return f"{navigator.outcome}, {100 * distance_m:.1f} cm and {degrees:.1f}° from the goal"
