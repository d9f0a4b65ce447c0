"""Pictures of plans with a legend: as walked (path.png), the search, what refinement does."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.output import replacing
from app.pictures.canvas import (
    BODY,
    INK,
    LEFT,
    PAPER,
    PATH,
    PLANNED,
    RIGHT,
    Canvas,
    Colour,
    FloatArray,
    Picture,
    height_colour,
    height_range,
    hex_of,
    plan_canvas,
    put_text,
    sole_corners,
    surroundings,
)
from maps.grid import OccupancyGrid
from planner.plan import FootstepPlan
from planner.robot_model import Side, StepModel
from planner.search.search_record import SearchRecord

_PALE, _OUTLINE = 230, (170, 170, 170)  # paler swatches than this get an outline
LEAST_WIDTH_PX = 640
LINE_HEIGHT_PX = 26
_GAP_PX = 16
_KEY_PX = 260  # room for scale and axes
FEET = {Side.LEFT: hex_of(LEFT), Side.RIGHT: hex_of(RIGHT)}
GROUND = ("#ffffff", "#3c3f45", "#c9ccd1")  # free, occupied, unknown


@dataclass(frozen=True, kw_only=True)
class Swatch:
    """One entry of the legend; filled or as an outline. Colours are blue, green, red."""

    colour: Colour
    text: str
    filled: bool = True


_PLAN_LEGEND = [
    Swatch(colour=LEFT, text="left foot"),
    Swatch(colour=RIGHT, text="right foot"),
    Swatch(colour=PATH, text="midway between the feet"),
]


def with_legend(
    picture: Picture, title: str, legend: Sequence[Swatch], *, canvas: Canvas | None = None
) -> Picture:
    """The picture (H, W, 3) with title and legend below; narrow ones get paper to the right.

    Of a canvas its scale and the axes of the map are shown too. On large pictures all is larger.
    """
    width_px = max(LEAST_WIDTH_PX, picture.shape[1])
    unit = 1.0 if canvas is None else max(1.0, width_px / 1000)
    key_px = 0 if canvas is None else round(_KEY_PX * unit)
    lines = textwrap.wrap(title, int((width_px - key_px) / (10 * unit)))
    rows = _rows(legend, int((width_px - key_px) / unit))
    line_px, height_px = round(LINE_HEIGHT_PX * unit), picture.shape[0]
    count = max(len(lines) + len(rows), 0 if canvas is None else 2)
    whole = np.full((height_px + count * line_px + 12, width_px, 3), PAPER, np.uint8)
    whole[:height_px, : picture.shape[1]] = picture
    for number, line in enumerate(lines):
        base_px = height_px + (number + 1) * line_px - round(4 * unit)
        put_text(whole, line, 12, base_px, size=0.5 * unit)
    for number, row in enumerate(rows, start=len(lines)):
        top_px = height_px + number * line_px + round(7 * unit)
        for left, swatch in row:
            left_px, (w, h) = round(left * unit), (round(22 * unit), round(11 * unit))
            corners = (left_px, top_px), (left_px + w, top_px + h)
            cv2.rectangle(whole, *corners, swatch.colour, -1 if swatch.filled else 2, cv2.LINE_AA)
            if swatch.filled and min(swatch.colour) > _PALE:
                cv2.rectangle(whole, *corners, _OUTLINE, 1, cv2.LINE_AA)
            text_px = left_px + round(30 * unit)
            put_text(whole, swatch.text, text_px, top_px + h + 1, size=0.5 * unit)
    if canvas is not None:
        _draw_key(whole, canvas, (width_px - key_px, height_px), unit)
    return whole


def _draw_key(whole: Picture, canvas: Canvas, at_px: tuple[int, int], unit: float) -> None:
    """Scale bar and the directions of x and y of the map's frame, from a corner at_px."""
    left, top = at_px
    # The longest round length that fits.
    fits_m = (_KEY_PX - 110) * unit / canvas.px_per_m
    lengths_m = [m * 10.0**k for k in range(-3, 4) for m in (1, 2, 5)]
    bar_m = max([m for m in lengths_m if m <= fits_m], default=lengths_m[0])
    bar_px, base, tick = round(bar_m * canvas.px_per_m), top + round(36 * unit), round(5 * unit)
    thick = max(2, round(2 * unit))
    for begin, end in (
        ((left, base), (left + bar_px, base)),
        ((left, base - tick), (left, base + tick)),
        ((left + bar_px, base - tick), (left + bar_px, base + tick)),
    ):
        cv2.line(whole, begin, end, INK, thick)
    text = f"{bar_m:g} m; grid {canvas.grid_m:g} m"
    put_text(whole, text, left, base - round(10 * unit), size=0.5 * unit)
    centre = np.array([whole.shape[1] - round(48 * unit), top + round(38 * unit)])
    axes = canvas.pixels(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])).astype(float)
    for name, axis in zip("xy", axes[1:] - axes[0], strict=True):
        along = axis / np.linalg.norm(axis)
        tip = np.rint(centre + along * 20 * unit).astype(int)
        tail = np.rint(centre - 8 * unit * along).astype(int)
        cv2.arrowedLine(whole, tuple(tail), tuple(tip), INK, thick, cv2.LINE_AA, tipLength=0.3)
        (text_w, text_h), _ = cv2.getTextSize(name, cv2.FONT_HERSHEY_SIMPLEX, 0.5 * unit, 1)
        at = np.rint(centre + along * 32 * unit + (-text_w / 2, text_h / 2)).astype(int)
        put_text(whole, name, int(at[0]), int(at[1]), size=0.5 * unit)


def _rows(legend: Sequence[Swatch], width_px: int) -> list[list[tuple[int, Swatch]]]:
    """The entries in rows that fit the width, each with where it begins."""
    rows: list[list[tuple[int, Swatch]]] = [[]]
    left_px = 12
    for swatch in legend:
        needed_px = 50 + 9 * len(swatch.text)
        if rows[-1] and left_px + needed_px > width_px:
            rows.append([])
            left_px = 12
        rows[-1].append((left_px, swatch))
        left_px += needed_px
    return rows


def plan_picture(grid: OccupancyGrid, model: StepModel, plan: FootstepPlan) -> Picture:
    """The plan alone, (H, W, 3)."""
    canvas = plan_canvas(plan, grid, model)
    legend = _PLAN_LEGEND + _heights(grid)
    return with_legend(canvas.image, _title(plan), legend, canvas=canvas)


def walk_picture(
    grid: OccupancyGrid,
    model: StepModel,
    plan: FootstepPlan,
    *,
    placed_side: NDArray[np.integer],
    placed_world: FloatArray,
    body_xy_world: FloatArray,
) -> Picture:
    """The plan and what became of it, (H, W, 3).

    placed_side (N,) and placed_world (N, 4): the feet as they came down, in order. body_xy_world
    (T, 2): where the body was.
    """
    points = np.vstack([plan.pose_world[:, :2], body_xy_world, [plan.start[:2], plan.goal[:2]]])
    canvas = Canvas(grid, around_world=surroundings(grid, points), margin_m=1.5)
    for side in Side:
        canvas.foot(plan.start_feet_world[side], side, model, 0.12)
    for placed, pose_world in zip(placed_side, placed_world, strict=True):
        canvas.foot(pose_world, Side(int(placed)), model, 0.45)
    for pose_world in plan.pose_world:
        canvas.polygon(sole_corners(pose_world, model.foot), PLANNED, width_m=0.008)
    if len(body_xy_world) > 1:
        canvas.line(body_xy_world, BODY, 0.02)
    canvas.ends(plan.start, plan.goal, plan.waypoints)
    legend = [
        Swatch(colour=LEFT, text="left foot as placed"),
        Swatch(colour=RIGHT, text="right foot as placed"),
        Swatch(colour=PLANNED, text="feet as planned", filled=False),
        Swatch(colour=BODY, text="body"),
    ]
    return with_legend(canvas.image, _title(plan), legend + _heights(grid), canvas=canvas)


def _heights(grid: OccupancyGrid) -> list[Swatch]:
    """What the colours of the floor mean; nothing where it is flat."""
    extremes_m = height_range(grid)
    if extremes_m[0] == extremes_m[1]:
        return []
    return [
        Swatch(colour=height_colour(height_m, extremes_m), text=f"floor at {height_m:g} m")
        for height_m in extremes_m
    ]


def _title(plan: FootstepPlan) -> str:
    if not plan.found:
        return f"no plan: {plan.status}: {plan.reason}"
    return f"{plan.robot} on {plan.map}: {len(plan)} steps planned, cost {plan.cost_m:.2f} m"


def write_search_picture(
    path: Path, grid: OccupancyGrid, plan: FootstepPlan, record: SearchRecord, cell_m: float
) -> None:
    """Draws a search over the map of its plan, and its cost over time, into an image file."""
    # Here and not above: the other pictures need not wait for it.
    from matplotlib.colors import ListedColormap, LogNorm
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 5), layout="constrained")
    on_map, over_time = figure.subplots(1, 2, width_ratios=(3, 2))
    rows, cols = grid.cells.shape
    corners = np.stack(np.meshgrid(np.arange(cols + 1), np.arange(rows + 1)), axis=-1)
    x_m, y_m = grid.grid_to_world(corners * grid.resolution_m).transpose(2, 0, 1)
    on_map.pcolormesh(x_m, y_m, grid.cells, cmap=ListedColormap(GROUND), vmin=0, vmax=2)
    if len(record.expanded):
        x, y, states = record.expanded[np.argsort(record.expanded[:, 2])].T
        norm = LogNorm(1, max(2.0, float(states.max())))
        points_per_m = 72 * figure.get_size_inches()[0] * 0.5 / max(grid.size_m)
        size = max(0.5, (cell_m * points_per_m) ** 2)
        seen = on_map.scatter(x, y, s=size, c=states, norm=norm, cmap="YlGnBu", marker="s", lw=0)
        figure.colorbar(seen, ax=on_map, label="states expanded in a cell of the lattice")
    for side, colour in FEET.items():
        feet = plan.pose_world[plan.side == side]
        on_map.plot(feet[:, 0], feet[:, 1], "o", ms=3, color=colour, label=side.name.lower())
    on_map.set(aspect="equal", xlabel="x, m", ylabel="y, m", title="expanded states")
    on_map.legend(fontsize=8, loc="upper right")
    time_ms = 1e3 * record.time_s
    found = np.isfinite(record.cost_m)
    label = "cost of the best plan"
    over_time.step(time_ms[found], record.cost_m[found], where="post", label=label)
    bound_m = np.maximum.accumulate(record.lower_bound_m)
    over_time.step(time_ms, bound_m, where="post", label="lower bound of any plan")
    if plan.cost_before_refinement_m is not None:
        label = "the same, refined off the lattice"
        over_time.plot(1e3 * plan.time_s, plan.cost_m, "k*", ms=9, label=label)
    over_time.set(xlabel="time since the request, ms", ylabel="cost, m", title="cost over time")
    over_time.grid(alpha=0.25)
    over_time.spines[["top", "right"]].set_visible(False)
    over_time.legend(frameon=False, fontsize=8, loc="lower right")
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=120, format=path.suffix.lstrip(".").lower())


def refinement_picture(
    grid: OccupancyGrid, model: StepModel, before: FootstepPlan, after: FootstepPlan
) -> Picture:
    """The two plans, (H, W, 3)."""
    shown_world = np.vstack(
        [after.start_feet_world[:, :2], before.pose_world[:, :2], after.pose_world[:, :2]]
    )
    panels = []
    for when, plan in (("before", before), ("after", after)):
        canvas = plan_canvas(plan, grid, model, shown_world=shown_world)
        title = f"{when}: {len(plan)} steps, cost {plan.cost_m:.2f} m"
        panels.append(with_legend(canvas.image, title, _PLAN_LEGEND, canvas=canvas))
    # The same part of the map, but a long title may take two lines.
    left, right = panels
    width_px = left.shape[1] + _GAP_PX + right.shape[1]
    whole = np.full((max(left.shape[0], right.shape[0]), width_px, 3), PAPER, np.uint8)
    whole[: left.shape[0], : left.shape[1]] = left
    whole[: right.shape[0], width_px - right.shape[1] :] = right
    return whole
