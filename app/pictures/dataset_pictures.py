"""Pictures of a corpus: a sheet of some of its plans, and histograms of all its steps."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from app.output import write_picture
from app.pictures.canvas import (
    GOAL,
    LEFT,
    PAPER,
    PATH,
    RIGHT,
    START,
    Canvas,
    FloatArray,
    Picture,
    body_path,
    put_text,
)
from app.pictures.plan_pictures import Swatch, with_legend
from maps.boxes import with_boxes
from maps.grid import OccupancyGrid
from planner.corpus.check import plan_of
from planner.corpus.corpus import Corpus
from planner.plan import FootstepPlan
from planner.robot_model import Side, StepModel

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHEET_PLANS = 25
_TILE_PX, _CAPTION_PX, _GAP_PX = 360, 26, 10
_MARGIN_M = 0.6
_LEGEND = (
    Swatch(colour=LEFT, text="left foot"),
    Swatch(colour=RIGHT, text="right foot"),
    Swatch(colour=PATH, text="body"),
    Swatch(colour=START, text="start"),
    Swatch(colour=GOAL, text="goal"),
)


def write_contact_sheet(
    path: Path, corpus: Corpus, grid: OccupancyGrid, model: StepModel, *, one_scale: bool
) -> None:
    """Pictures of up to 25 plans in rows and columns, evenly chosen from first to last.

    one_scale: all show the same part of the floor, else each the surroundings of its plan.

    Raises:
        InputError: The file cannot be written.
    """
    count = min(SHEET_PLANS, len(corpus))
    chosen = np.unique(np.linspace(0, len(corpus) - 1, count).round().astype(int))
    plans = [plan_of(corpus, int(i), model.stance_width_m) for i in chosen]
    points = [np.vstack([p.start_feet_world, p.pose_world])[:, :2] for p in plans]
    if one_scale:
        points = [np.vstack(points)] * len(plans)
    tiles = [
        _tile(plan, with_boxes(grid, corpus.box[i]), model, around, f"plan {i}: ")
        for i, plan, around in zip(chosen, plans, points, strict=True)
    ]
    cols = math.ceil(math.sqrt(len(tiles)))
    rows = math.ceil(len(tiles) / cols)
    height = max(tile.shape[0] for tile in tiles) + _GAP_PX
    width = _TILE_PX + _GAP_PX
    sheet: Picture = np.full((rows * height, cols * width + _GAP_PX, 3), PAPER, np.uint8)
    for k, tile in enumerate(tiles):
        row, col = k // cols * height, _GAP_PX + k % cols * width
        sheet[row : row + tile.shape[0], col : col + tile.shape[1]] = tile
    title = f"{len(tiles)} of {len(corpus)} plans of {corpus.robot}"
    write_picture(path, with_legend(sheet, title, _LEGEND))


def _tile(
    plan: FootstepPlan, grid: OccupancyGrid, model: StepModel, around: FloatArray, caption: str
) -> Picture:
    """One plan over its floor, as wide or as high as a tile, with a caption above."""
    canvas = Canvas(grid, around_world=around, margin_m=_MARGIN_M)
    # Below the feet: in so small a picture they would hide the first and last steps.
    canvas.arrow(plan.start, START)
    canvas.arrow(plan.goal, GOAL)
    canvas.line(body_path(plan)[:, :2], PATH, 0.02)
    canvas.feet(plan, model, 0.5)
    scale = _TILE_PX / max(canvas.image.shape[:2])
    size = tuple(max(1, round(v * scale)) for v in canvas.image.shape[1::-1])
    image = cv2.resize(canvas.image, size, interpolation=cv2.INTER_AREA)
    tile: Picture = np.full((_CAPTION_PX + image.shape[0], _TILE_PX, 3), PAPER, np.uint8)
    tile[_CAPTION_PX:, : image.shape[1]] = image
    put_text(tile, f"{caption}{len(plan)} steps, cost {plan.cost_m:.2f} m", 2, 18)
    return tile


def write_histograms(path: Path, corpus: Corpus, model: StepModel) -> None:
    """How often steps of each length, width and turn are taken, per side, between their limits.

    Raises:
        InputError: The file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 9.0), layout="constrained")
    axes = figure.subplots(2, 3)
    steps = corpus.relative_steps(model.stance_width_m)
    limits = model.limits
    for k, (name, unit, limit, factor) in enumerate(
        (
            ("ahead of the other foot (x)", "m", limits.x_m, 1.0),
            ("outward from the other foot (y)", "m", limits.y_m, 1.0),
            ("turned outward (yaw)", "degrees", limits.yaw_rad, 180 / math.pi),
        )
    ):
        low, high = (factor * v for v in limit)
        for side in Side:
            _histogram(axes[0, k], factor * steps[corpus.side == side, k], side, (low, high))
        axes[0, k].set_xlabel(f"{name} [{unit}]")
    axes[0, 0].set_ylabel("steps")
    axes[0, 1].legend(frameon=False, loc="center", bbox_to_anchor=(0.65, 0.75))
    _lengths_and_goals(axes[1], corpus)
    figure.suptitle(
        f"{len(corpus)} plans of {corpus.robot}, {len(corpus.side)} steps; dotted: the step limits"
    )
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    rgba = np.asarray(canvas.buffer_rgba())
    write_picture(path, np.ascontiguousarray(rgba[..., 2::-1]))


def _histogram(axis: Axes, values: NDArray[Any], side: Side, limits: tuple[float, float]) -> None:
    """Steps of one side, and dotted lines at the limits."""
    span = limits[1] - limits[0] or 1.0
    bins = np.linspace(limits[0] - 0.02 * span, limits[1] + 0.02 * span, 41)
    # The colour of the foot in the other pictures, which are written blue, green, red.
    blue, green, red = (value / 255 for value in (LEFT if side == Side.LEFT else RIGHT))
    label = f"{side.name.lower()} foot"
    axis.hist(values, bins.tolist(), histtype="stepfilled", color=(red, green, blue, 0.3),
              edgecolor=(red, green, blue), linewidth=1.2, label=label)  # fmt: skip
    for limit in limits:
        axis.axvline(limit, color="0.4", linestyle=":", linewidth=1.0)
    axis.spines[["top", "right"]].set_visible(False)


def _lengths_and_goals(axes: NDArray[Any], corpus: Corpus) -> None:
    """How many steps plans have, where their goals lie, and how their headings spread."""
    lengths = np.diff(corpus.offsets)
    bins = np.arange(lengths.min(), lengths.max() + 2) - 0.5
    axes[0].hist(lengths, bins.tolist(), color="0.6")
    axes[0].set_xlabel("steps in a plan")
    axes[0].set_ylabel("plans")
    x, y, yaw = corpus.goal.T
    axes[1].scatter(x, y, s=4, color="0.35", linewidths=0)
    axes[1].set_xlabel("goal x [m]")
    axes[1].set_ylabel("goal y [m]")
    axes[1].set_aspect("equal", adjustable="datalim")
    axes[2].hist(np.degrees(yaw), 36, color="0.6")
    axes[2].set_xlabel("goal yaw [degrees]")
    axes[2].set_ylabel("plans")
    for axis in axes:
        axis.spines[["top", "right"]].set_visible(False)
