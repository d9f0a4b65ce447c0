"""The figures of an evaluation, drawn from its document alone."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from app.evaluation.comparison import both_rows
from app.evaluation.parts import (
    JOINT_NOISE_WITHSTOOD_DEG,
    TITLE,
    TREAD_NOISE_WITHSTOOD_M,
    Document,
)
from app.evaluation.report_text import plain_joint
from app.output import replacing

LEFT, RIGHT, GREY = "#1f77b4", "#d62728", "#8a8f98"
UP, DOWN = THIS, OTHER = "#0b7a75", "#c8553d"


def write_figures(document: Document, folder: Path) -> None:
    """Draw every figure whose section was measured."""
    for name, (section, size, draw) in FIGURES.items():
        if document.get(section):
            figure = Figure(figsize=size, layout="constrained")
            draw(document, figure)
            with replacing(folder / name) as temporary:
                figure.savefig(temporary, dpi=120)


def draw_limits(document: Document, figure: Figure) -> None:
    """A column for each turn per step: success above, foot error below, over forward and sideways.

    The frame is the cut through the limits in force, where that turn lies within them.
    """
    limits = document["limits"]
    in_force = limits["measured"]["limits"] if limits["measured"] else None
    kinds = limits["map"]["kinds"]
    turns = sorted({kind["yaw_rad"] for kind in kinds})
    figure.set_size_inches(2.1 * len(turns) + 1.2, 4.6)
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


def _frame(axes: Axes, limits: Document | None, turn: float) -> None:
    """The limits' cut at a turn."""
    if limits is None or not limits["yaw_rad"][0] - 1e-9 <= turn <= limits["yaw_rad"][1] + 1e-9:
        return
    (x0, x1), (y0, y1) = (100 * np.array(limits[name]) for name in ("x_m", "y_m"))
    axes.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, fill=False, linewidth=1.5))


def draw_beside(document: Document, figure: Figure) -> None:
    """95th percentiles of both policies' errors in place and heading, for all modes with steps."""
    both = [pair for pair in both_rows(document) if all(row["landings"] for row in pair)]
    places = np.arange(len(both))
    panels = figure.subplots(1, 2, sharey=True)
    errors = (
        ("error_m_p95", 100.0, "foot error, 95th percentile, cm"),
        ("heading_deg_p95", 1.0, "heading error, 95th percentile, degrees"),
    )
    for axes, (key, scale, label) in zip(panels, errors, strict=True):
        for offset, which, colour, name in ((-0.2, 0, THIS, "this"), (0.2, 1, OTHER, "other")):
            values = [scale * pair[which][key] for pair in both]
            axes.barh(places + offset, values, 0.38, color=colour, label=name)
        axes.set(xlabel=label, xlim=(0, None))
        axes.grid(alpha=0.25, axis="x")
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].set_yticks(places, [mine["mode"] for mine, _ in both])
    panels[0].invert_yaxis()
    panels[1].legend(frameon=False)


def _plain(axes: Axes, **settings: Any) -> None:
    """Labels and limits, and no frame where there is nothing to frame."""
    axes.set(**settings)
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)


def draw_errors(document: Document, figure: Figure) -> None:
    """Cumulative distribution of the foot error of every mode that takes steps."""
    axes = figure.subplots()
    largest_cm = 1.0
    for row in document["modes"]:
        if row["error_m_quantiles"]:
            error_cm = 100 * np.array(row["error_m_quantiles"])
            largest_cm = max(largest_cm, error_cm[-2])
            style = "-" if row["mode"] != "mixed" else "k--"
            axes.plot(error_cm, np.linspace(0, 1, len(error_cm)), style, label=row["mode"])
    _plain(
        axes,
        xlabel="distance of a resting foot from its step, cm",
        ylabel="share of steps",
        xlim=(0, 1.05 * largest_cm),
        ylim=(0, 1),
    )
    axes.legend(frameon=False, fontsize=8)


def draw_stairs(document: Document, figure: Figure) -> None:
    """Success and episode length over the two kinds of noise, up and down."""
    panels = figure.subplots(2, 2, sharex="col", sharey="row")
    kinds = (
        ("tread", 100.0, "noise on tread height, ± cm", 100 * TREAD_NOISE_WITHSTOOD_M),
        ("joint", 1.0, "noise on joint positions, ± degrees", JOINT_NOISE_WITHSTOOD_DEG),
    )
    rise_m = min((row["rise_m"] for row in document["stairs"]), default=0.1)
    for column, (kind, scale, label, withstood) in enumerate(kinds):
        for way, colour in (("up", UP), ("down", DOWN)):
            rows = [
                row
                for row in document["stairs"]
                if row["way"] == way
                and row["rise_m"] == rise_m
                and row["noise_kind"] in ("none", kind)
            ]
            noise = [scale * row["noise"] for row in rows]
            success = [100 * row["success"] for row in rows]
            length_s = [row["length_s_mean"] for row in rows]
            panels[0, column].plot(noise, success, "o-", color=colour, label=way)
            panels[1, column].plot(noise, length_s, "o-", color=colour, label=way)
        for panel in panels[:, column]:
            panel.axvline(withstood, color=GREY, linestyle=":", linewidth=1)
        panels[0, column].annotate(
            f"{TITLE}:\nwithstood to here",
            (withstood, 4),
            xytext=(4, 0),
            textcoords="offset points",
            fontsize=7,
            color=GREY,
        )
        _plain(panels[1, column], xlabel=label, ylim=(0, 10.5))
        _plain(panels[0, column], ylim=(0, 104))
    panels[0, 0].set_ylabel("success, %")
    panels[1, 0].set_ylabel("episode length, s")
    panels[0, 0].legend(frameon=False, title=f"{100 * rise_m:g} cm stairs", loc="lower left")


def draw_loads(document: Document, figure: Figure) -> None:
    """Peak torque and speed of each joint, left beside right, as shares of the limits."""
    joints = document["gait"].get("joints", [])
    half = len(joints) // 2
    names = [plain_joint(row["joint"]) for row in joints[:half]]
    quantities = (
        ("torque", "peak_torque_nm", "torque_limit_nm", "N m"),
        ("speed", "peak_speed_rad_s", "speed_limit_rad_s", "rad/s"),
    )
    for axes, (title, peak, limit, unit) in zip(figure.subplots(1, 2), quantities, strict=True):
        for offset, rows, colour, label in (
            (-0.2, joints[:half], LEFT, "left"),
            (0.2, joints[half:], RIGHT, "right"),
        ):
            share = [100 * row[peak] / row[limit] for row in rows]
            places = np.arange(half) + offset
            axes.bar(places, share, 0.38, color=colour, label=label)
            for place, height, row in zip(places, share, rows, strict=True):
                axes.annotate(
                    f"{row[peak]:.0f}" if row[peak] >= 10 else f"{row[peak]:.2f}",
                    (place, height),
                    xytext=(0, 2),
                    textcoords="offset points",
                    ha="center",
                    fontsize=7,
                )
        axes.axhline(100, color=GREY, linestyle=":", linewidth=1)
        _plain(axes, ylabel=f"peak {title}, % of its limit", ylim=(0, 108))
        axes.set_title(f"numbers: {unit}", fontsize=8, color=GREY, loc="right")
        axes.set_xticks(np.arange(half), names, rotation=30, ha="right")
        axes.grid(visible=False, axis="x")
    axes.legend(frameon=False)


def draw_forces(document: Document, figure: Figure) -> None:
    """Vertical ground force of both feet over a gait cycle, in robot weights."""
    gait = document["gait"]
    axes = figure.subplots()
    for side, (name, colour) in enumerate((("left", LEFT), ("right", RIGHT))):
        mean, low, high = (_curve(gait[f"force_{kind}"][side]) for kind in ("mean", "low", "high"))
        axes.fill_between(gait["cycle_time_s"], low, high, color=colour, alpha=0.2, linewidth=0)
        axes.plot(gait["cycle_time_s"], mean, color=colour, label=name)
    axes.axhline(1.0, color=GREY, linestyle=":", linewidth=1)
    _plain(
        axes,
        xlabel="time in the gait cycle from the right foot's lift-off, s",
        ylabel="vertical force / weight",
        xlim=(0, gait["cycle_time_s"][-1]),
        ylim=(0, None),
    )
    axes.legend(frameon=False, ncols=2, loc="upper right")


def draw_contact(document: Document, figure: Figure) -> None:
    """The phase indicator of each foot against its measured contact."""
    gait = document["gait"]
    panels = figure.subplots(2, 1, sharex=True)
    for side, (name, colour) in enumerate((("left", LEFT), ("right", RIGHT))):
        axes = panels[side]
        time_s = gait["cycle_time_s"]
        share = _curve(gait["contact_mean"][side])
        axes.fill_between(time_s, share, color=colour, alpha=0.3, linewidth=0, label="contact")
        asked = (1 + _curve(gait["indicator_mean"][side])) / 2
        axes.plot(time_s, asked, color="black", linewidth=1.2, label="phase indicator")
        _plain(axes, ylabel=f"{name} foot", ylim=(-0.05, 1.1), xlim=(0, time_s[-1]))
        axes.set_yticks([0, 1], ["swing", "support"])
    panels[0].legend(frameon=False, ncols=2, fontsize=8, loc="lower left")
    panels[1].set_xlabel("time in the gait cycle from the right foot's lift-off, s")


def draw_push(document: Document, figure: Figure) -> None:
    """Success against impulse, in four directions."""
    axes = figure.subplots()
    colours = (UP, DOWN, LEFT, RIGHT)
    for row, colour in zip(document["push"], colours, strict=False):
        success = [100 * share for share in row["success"]]
        axes.plot(row["impulses_ns"], success, "o-", color=colour, label=row["direction"])
    _plain(axes, xlabel="impulse, N s", ylabel="success, %", ylim=(0, 104), xlim=(0, None))
    axes.legend(frameon=False, title="pushed")


def draw_energy(document: Document, figure: Figure) -> None:
    """Cost of transport over walking speed, a line for each kind of walk."""
    axes = figure.subplots()
    marks = {"forward": ("o-", UP), "backward": ("s-", DOWN), "sideways": ("^-", LEFT)}
    for kind, (mark, colour) in marks.items():
        rows = [row for row in document["energy"] if row["kind"] == kind and row["speed_m_s"]]
        speed = [row["speed_m_s"] for row in rows]
        cost = [row["cost_of_transport"] for row in rows]
        axes.plot(speed, cost, mark, color=colour, label=kind)
    _plain(
        axes,
        xlabel="walking speed, m/s",
        ylabel="cost of transport E / (m g d)",
        xlim=(0, None),
        ylim=(0, None),
    )
    axes.legend(frameon=False)


def _curve(values: Sequence[float | None]) -> np.ndarray:
    """Numbers with gaps where there are none."""
    return np.array([np.nan if value is None else value for value in values], dtype=float)


# File name: the section that it shows, width and height, and who draws it.
FIGURES: Mapping[str, tuple[str, tuple[float, float], Callable[[Document, Figure], None]]] = {
    "errors.png": ("modes", (7, 4), draw_errors),
    "stairs.png": ("stairs", (9, 5), draw_stairs),
    "loads.png": ("gait", (9, 3.8), draw_loads),
    "forces.png": ("gait", (7, 3.4), draw_forces),
    "contact.png": ("gait", (7, 4), draw_contact),
    "push.png": ("push", (7, 3.6), draw_push),
    "energy.png": ("energy", (7, 3.6), draw_energy),
    "limits.png": ("limits", (9, 4.6), draw_limits),
    "beside.png": ("beside", (9, 4), draw_beside),
}
