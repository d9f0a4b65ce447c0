"""A plan before and after refinement, side by side over the same part of the map."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from app.output import write_picture
from app.pictures.canvas import LEFT, PATH, RIGHT, draw_plan
from app.pictures.legend import PAPER, Picture, Swatch, with_legend
from maps.grid import OccupancyGrid
from planner.plan import FootstepPlan
from planner.robot_model import StepModel

_GAP_PX = 16


def write_refinement_picture(
    path: Path, grid: OccupancyGrid, model: StepModel, before: FootstepPlan, after: FootstepPlan
) -> None:
    """Draws the plan of the search on the left and what refinement made of it on the right.

    Raises:
        InputError: The file cannot be written.
    """
    write_picture(path, refinement_picture(grid, model, before, after))


def refinement_picture(
    grid: OccupancyGrid, model: StepModel, before: FootstepPlan, after: FootstepPlan
) -> Picture:
    """The two plans, (H, W, 3)."""
    shown_world = np.vstack(
        [after.start_feet_world[:, :2], before.pose_world[:, :2], after.pose_world[:, :2]]
    )
    legend = [
        Swatch(colour=LEFT, text="left foot"),
        Swatch(colour=RIGHT, text="right foot"),
        Swatch(colour=PATH, text="midway between the feet"),
    ]
    panels = [
        with_legend(
            draw_plan(plan, grid, model, shown_world=shown_world),
            f"{when}: {len(plan)} steps, cost {plan.cost_m:.2f} m",
            legend,
        )
        for when, plan in (("before", before), ("after", after))
    ]
    # The same part of the map, but a long title may take two lines.
    height_px = max(panel.shape[0] for panel in panels)
    width_px = sum(panel.shape[1] for panel in panels) + _GAP_PX
    whole = np.full((height_px, width_px, 3), PAPER, np.uint8)
    left, right = panels
    whole[: left.shape[0], : left.shape[1]] = left
    whole[: right.shape[0], width_px - right.shape[1] :] = right
    return whole
