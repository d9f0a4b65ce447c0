"""The figure of all kinds of steps: how well each is walked, and which limits follow from it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle


def draw_limits(document: Mapping[str, Any]) -> Figure:
    """A column for each turn per step: success above, foot error below, over forward and sideways.

    The frame is the cut through the limits in force, where that turn lies within them.
    """
    limits = document["limits"]
    in_force = limits["measured"]["limits"] if limits["measured"] else None
    kinds = limits["map"]["kinds"]
    turns = sorted({kind["yaw_rad"] for kind in kinds})
    figure = Figure(figsize=(2.1 * len(turns) + 1.2, 4.6), layout="constrained")
    panels = figure.subplots(2, len(turns), sharex=True, sharey=True, squeeze=False)
    errors = [100 * kind["error_m_p95"] for kind in kinds if kind["error_m_p95"] is not None]
    rows = (
        ("success", 100.0, "RdYlGn", (80.0, 100.0), "success, %"),
        ("error_m_p95", 100.0, "viridis_r", (0.0, max([1.0, *errors])), "foot error, p95, cm"),
    )
    for row, (key, scale, colours, ends, label) in enumerate(rows):
        for column, turn in enumerate(turns):
            here = [kind for kind in kinds if kind["yaw_rad"] == turn]
            axes = panels[row, column]
            image = _squares(axes, here, key, scale, colours, ends)
            _frame(axes, in_force, turn)
        bar = figure.colorbar(image, ax=panels[row].tolist(), label=label, pad=0.01)
        bar.ax.tick_params(labelsize=8)
        panels[row, 0].set_ylabel("sideways, cm")
    for column, turn in enumerate(turns):
        panels[0, column].set_title(f"turn {math.degrees(turn):.0f}°", fontsize=9)
        panels[1, column].set_xlabel("forward, cm")
    return figure


def _squares(
    axes: Axes,
    kinds: Sequence[Mapping[str, Any]],
    key: str,
    scale: float,
    colours: str,
    ends: tuple[float, float],
) -> Any:
    """A coloured mark for each kind of step with its number in it."""
    known = [kind for kind in kinds if kind[key] is not None]
    values = [scale * kind[key] for kind in known]
    image = axes.scatter(
        [100 * kind["x_m"] for kind in known],
        [100 * kind["y_m"] for kind in known],
        c=values,
        cmap=colours,
        vmin=ends[0],
        vmax=ends[1],
        s=150,
        marker="s",
        linewidth=0,
    )
    for kind, value in zip(known, values, strict=True):
        red, green, blue, _ = image.to_rgba(value)
        dark = 0.3 * red + 0.6 * green + 0.1 * blue < 0.5
        axes.annotate(
            f"{value:.0f}" if key == "success" else f"{value:.1f}",
            (100 * kind["x_m"], 100 * kind["y_m"]),
            ha="center",
            va="center",
            fontsize=6,
            color="white" if dark else "black",
            zorder=5,
        )
    axes.tick_params(labelsize=8)
    axes.margins(0.14)
    axes.spines[["top", "right"]].set_visible(False)
    return image


def _frame(axes: Axes, limits: Mapping[str, Any] | None, turn: float) -> None:
    """The limits' cut at a turn."""
    if limits is None or not limits["yaw_rad"][0] - 1e-9 <= turn <= limits["yaw_rad"][1] + 1e-9:
        return
    (x0, x1), (y0, y1) = (100 * np.array(limits[name]) for name in ("x_m", "y_m"))
    axes.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, fill=False, linewidth=1.5))
