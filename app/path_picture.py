"""path.png: the map, the planned feet, the feet as they came down, and the path of the body."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from app.map_canvas import Colour, MapCanvas, Picture, Swatch
from app.output import write_picture
from maps.grid import OccupancyGrid
from planner.model import FootShape, Side, StepModel
from planner.plan import FootstepPlan

FloatArray = NDArray[np.float64]

FOOT_COLOURS: dict[Side, Colour] = {Side.LEFT: (38, 110, 200), Side.RIGHT: (214, 72, 52)}
BODY: Colour = (112, 60, 150)
START: Colour = (120, 126, 134)
GOAL: Colour = (22, 140, 84)
POSE_ARROW_M = 0.32


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
    picture = path_picture(
        grid,
        model,
        plan,
        placed_side=placed_side,
        placed_world=placed_world,
        body_xy_world=body_xy_world,
    )
    write_picture(path, picture)


def path_picture(
    grid: OccupancyGrid,
    model: StepModel,
    plan: FootstepPlan,
    *,
    placed_side: NDArray[np.integer] | None = None,
    placed_world: FloatArray | None = None,
    body_xy_world: FloatArray | None = None,
) -> Picture:
    """The picture (H, W, 3) that `write_path_picture` writes."""
    canvas = MapCanvas(grid)
    walked = placed_world is not None
    canvas.arrow(plan.start, POSE_ARROW_M, START, 2)
    canvas.arrow(plan.goal, POSE_ARROW_M, GOAL, 3)
    for side in Side:
        stands = plan.start_feet_world[side : side + 1]
        canvas.outline(foot_boxes(stands, model.foot), START, 2)
        planned = foot_boxes(plan.pose_world[plan.side == side], model.foot)
        canvas.fill(planned, FOOT_COLOURS[side], alpha=0.0 if walked else 0.35)
        canvas.outline(planned, FOOT_COLOURS[side], 1 if walked else 2)
        if placed_world is not None and placed_side is not None:
            placed = foot_boxes(placed_world[placed_side == side], model.foot)
            canvas.fill(placed, FOOT_COLOURS[side], alpha=0.45)
    if body_xy_world is not None and len(body_xy_world) > 1:
        canvas.line(body_xy_world, BODY, 2)
    return canvas.finished(_title(plan), _legend(walked, body_xy_world is not None))


def foot_boxes(poses_world: FloatArray, foot: FootShape) -> list[FloatArray]:
    """Corners (4, 2) of the sole at each pose x_m, y_m, z_m, yaw_rad of (N, 4)."""
    x, y = foot.length_m / 2, foot.width_m / 2
    corners = np.array([[x, y], [-x, y], [-x, -y], [x, -y]])
    boxes = []
    for x_m, y_m, _, yaw_rad in poses_world:
        cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
        boxes.append(corners @ np.array([[cos, sin], [-sin, cos]]) + np.array([x_m, y_m]))
    return boxes


def _title(plan: FootstepPlan) -> str:
    if not plan.found:
        return f"no plan: {plan.status}: {plan.reason}"
    return f"{plan.robot} on {plan.map}: {len(plan)} steps planned, cost {plan.cost_m:.2f} m"


def _legend(walked: bool, has_body: bool) -> list[Swatch]:
    left, right = FOOT_COLOURS[Side.LEFT], FOOT_COLOURS[Side.RIGHT]
    legend = [Swatch(colour=left, text="left foot"), Swatch(colour=right, text="right foot")]
    if walked:
        legend.append(Swatch(colour=left, text="planned: outline", filled=False))
        legend.append(Swatch(colour=left, text="placed: filled"))
    if has_body:
        legend.append(Swatch(colour=BODY, text="body"))
    legend.append(Swatch(colour=START, text="start", filled=False))
    legend.append(Swatch(colour=GOAL, text="goal", filled=False))
    return legend
