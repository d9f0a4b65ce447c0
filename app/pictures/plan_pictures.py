"""path.png: the map, the planned feet, the feet as they came down, and the path of the body."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from app.output import write_picture
from app.pictures.canvas import GOAL, LEFT, PATH, RIGHT, START, Canvas, Colour, draw_plan
from app.pictures.legend import Picture, Swatch, with_legend
from app.pictures.relief import height_colour, height_range
from maps.grid import OccupancyGrid
from planner.plan import FootstepPlan
from planner.robot_model import FootShape, Side, StepModel

FloatArray = NDArray[np.float64]

# Blue, green, red.
BODY: Colour = (150, 60, 112)
PLANNED: Colour = (50, 50, 50)
LARGE_MAP_M = 12.0


def write_path_picture(
    path: Path,
    grid: OccupancyGrid,
    model: StepModel,
    plan: FootstepPlan,
    *,
    placed_side: NDArray[np.integer] | None = None,
    placed_world: FloatArray | None = None,
    body_xy_world: FloatArray | None = None,
) -> None:
    """Draws a plan and, if it was walked, what became of it, into an image file.

    placed_side (N,) and placed_world (N, 4): the feet as they came down, in order.
    body_xy_world (T, 2): where the body was. Without placed_world the picture shows the plan alone.

    Raises:
        InputError: The file cannot be written.
    """
    if placed_side is None or placed_world is None or body_xy_world is None:
        picture = plan_picture(grid, model, plan)
    else:
        picture = walk_picture(
            grid,
            model,
            plan,
            placed_side=placed_side,
            placed_world=placed_world,
            body_xy_world=body_xy_world,
        )
    write_picture(path, picture)


def plan_picture(grid: OccupancyGrid, model: StepModel, plan: FootstepPlan) -> Picture:
    """The plan alone, (H, W, 3)."""
    legend = [
        Swatch(colour=LEFT, text="left foot"),
        Swatch(colour=RIGHT, text="right foot"),
        Swatch(colour=PATH, text="midway between the feet"),
    ]
    return with_legend(draw_plan(plan, grid, model), _title(plan), legend + _heights(grid))


def walk_picture(
    grid: OccupancyGrid,
    model: StepModel,
    plan: FootstepPlan,
    *,
    placed_side: NDArray[np.integer],
    placed_world: FloatArray,
    body_xy_world: FloatArray,
) -> Picture:
    """The plan and what became of it, (H, W, 3); arrays as in `write_path_picture`."""
    canvas = Canvas(grid, around_world=_surroundings(grid, plan, body_xy_world), margin_m=1.5)
    for side in Side:
        canvas.foot(plan.start_feet_world[side], side, model, 0.12)
    for placed, pose_world in zip(placed_side, placed_world, strict=True):
        canvas.foot(pose_world, Side(int(placed)), model, 0.45)
    for box in foot_boxes(plan.pose_world, model.foot):
        canvas.polygon(box, PLANNED, width_m=0.008)
    if len(body_xy_world) > 1:
        canvas.line(body_xy_world, BODY, 0.02)
    canvas.arrow(plan.start, START, "start")
    canvas.arrow(plan.goal, GOAL, "goal")
    legend = [
        Swatch(colour=LEFT, text="left foot as placed"),
        Swatch(colour=RIGHT, text="right foot as placed"),
        Swatch(colour=PLANNED, text="feet as planned", filled=False),
        Swatch(colour=BODY, text="body"),
    ]
    return with_legend(canvas.image, _title(plan), legend + _heights(grid))


def _heights(grid: OccupancyGrid) -> list[Swatch]:
    """What the colours of the floor mean; nothing where it is flat."""
    extremes_m = height_range(grid)
    if extremes_m[0] == extremes_m[1]:
        return []
    return [
        Swatch(colour=height_colour(height_m, extremes_m), text=f"floor at {height_m:g} m")
        for height_m in extremes_m
    ]


def foot_boxes(poses_world: FloatArray, foot: FootShape) -> list[FloatArray]:
    """Corners (4, 2) of the sole at each pose x_m, y_m, z_m, yaw_rad of (N, 4)."""
    x, y = foot.length_m / 2, foot.width_m / 2
    corners = np.array([[x, y], [-x, y], [-x, -y], [x, -y]])
    boxes = []
    for x_m, y_m, _, yaw_rad in poses_world:
        cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
        boxes.append(corners @ np.array([[cos, sin], [-sin, cos]]) + np.array([x_m, y_m]))
    return boxes


def _surroundings(
    grid: OccupancyGrid, plan: FootstepPlan, body_xy_world: FloatArray
) -> FloatArray | None:
    """Points (n, 2) on the map that the picture of a large map is cut to; None shows it whole."""
    points = np.vstack([plan.pose_world[:, :2], body_xy_world, [plan.start[:2], plan.goal[:2]]])
    points = points[grid.contains(points)]
    return points if max(grid.size_m) > LARGE_MAP_M and len(points) else None


def _title(plan: FootstepPlan) -> str:
    if not plan.found:
        return f"no plan: {plan.status}: {plan.reason}"
    return f"{plan.robot} on {plan.map}: {len(plan)} steps planned, cost {plan.cost_m:.2f} m"
