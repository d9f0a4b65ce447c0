"""How a search went: the poses that it looked at, and its plan's cost over time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.figure import Figure

from app.output import replacing
from maps.grid import OccupancyGrid
from planner.plan import FootstepPlan
from planner.robot_model import Side
from planner.search.problem import SearchRecord

FEET = {Side.LEFT: "#1f77b4", Side.RIGHT: "#d62728"}
GROUND = ("#ffffff", "#3c3f45", "#c9ccd1")  # free, occupied, unknown


def write_search_picture(
    path: Path, grid: OccupancyGrid, plan: FootstepPlan, record: SearchRecord, cell_m: float
) -> None:
    """Draws a search over the map of its plan, and its cost over time, into an image file."""
    figure = Figure(figsize=(11, 5), layout="constrained")
    on_map, over_time = figure.subplots(1, 2, width_ratios=(3, 2))
    _draw_expanded(figure, on_map, grid, plan, record, cell_m)
    _draw_cost(over_time, plan, record)
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=120, format=path.suffix.lstrip(".").lower())


def _draw_expanded(
    figure: Figure,
    axes: Axes,
    grid: OccupancyGrid,
    plan: FootstepPlan,
    record: SearchRecord,
    cell_m: float,
) -> None:
    rows, cols = grid.cells.shape
    corners = np.stack(np.meshgrid(np.arange(cols + 1), np.arange(rows + 1)), axis=-1)
    x_m, y_m = grid.grid_to_world(corners * grid.resolution_m).transpose(2, 0, 1)
    axes.pcolormesh(x_m, y_m, grid.cells, cmap=ListedColormap(GROUND), vmin=0, vmax=2)
    if len(record.expanded):
        x, y, states = record.expanded.T
        order = np.argsort(states)
        norm = LogNorm(1, max(2.0, float(states.max())))
        points_per_m = 72 * figure.get_size_inches()[0] * 0.5 / max(grid.size_m)
        size = max(0.5, (cell_m * points_per_m) ** 2)
        seen = axes.scatter(
            x[order], y[order], s=size, c=states[order], norm=norm, cmap="YlGnBu", marker="s", lw=0
        )
        figure.colorbar(seen, ax=axes, label="states expanded in a cell of the lattice")
    for side, colour in FEET.items():
        feet = plan.pose_world[plan.side == side]
        axes.plot(feet[:, 0], feet[:, 1], "o", ms=3, color=colour, label=side.name.lower())
    axes.set(aspect="equal", xlabel="x, m", ylabel="y, m", title="where it looked")
    axes.legend(fontsize=8, loc="upper right")


def _draw_cost(axes: Axes, plan: FootstepPlan, record: SearchRecord) -> None:
    time_ms = 1e3 * record.time_s
    found = np.isfinite(record.cost_m)
    axes.step(time_ms[found], record.cost_m[found], where="post", label="cost of the best plan")
    bound_m = np.maximum.accumulate(record.least_m) if len(record.least_m) else record.least_m
    axes.step(time_ms, bound_m, where="post", label="any plan costs at least")
    if plan.cost_before_refinement_m is not None:
        label = "the same, refined off the lattice"
        axes.plot(1e3 * plan.time_s, plan.cost_m, "k*", ms=9, label=label)
    axes.set(xlabel="time since the request, ms", ylabel="cost, m", title="cost over time")
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=8, loc="lower right")
