"""The figures of an evaluation, drawn from its document alone."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from app.evaluation.beside import beside_rows, has, joint_peaks, names
from app.evaluation.parts import (
    JOINT_NOISE_WITHSTOOD_DEG,
    TITLE,
    TREAD_NOISE_WITHSTOOD_M,
    Document,
)
from app.evaluation.tables import plain_joint
from app.output import replacing
from app.pictures import canvas
from app.pictures.canvas import hex_of

LEFT, RIGHT, GREY = hex_of(canvas.LEFT), hex_of(canvas.RIGHT), "#8a8f98"
UP, DOWN = THIS, OTHER = "#0b7a75", "#c8553d"
_LEGEND_COLUMNS = 6
CYCLE_TIME = "time in the gait cycle from the right foot's lift-off, s"


def write_figures(document: Document, folder: Path) -> None:
    """Draw every figure whose section was measured, those with `beside` where both have it."""
    beside = document.get("beside") or {}
    for name, (section, *_) in FIGURES.items():
        if has(document, section) and (has(beside, section) or not name.startswith("beside")):
            with replacing(folder / name) as temporary:
                drawn(document, name).savefig(temporary, dpi=120)


def drawn(document: Document, name: str) -> Figure:
    """The figure of this name in FIGURES; its section must have been measured."""
    _, size, draw = FIGURES[name]
    figure = Figure(figsize=size, layout="constrained")
    draw(document, figure)
    _add_legend(figure)
    return figure


def _add_legend(figure: Figure) -> None:
    """One legend for all panels, above them, where it can cover no curve."""
    named: dict[str, Any] = {}
    for axes in figure.axes:
        handles, labels = axes.get_legend_handles_labels()
        named |= dict(zip(labels, handles, strict=True))
    if named:
        rows = math.ceil(len(named) / _LEGEND_COLUMNS)
        figure.legend(
            list(named.values()),
            list(named),
            loc="outside upper center",
            ncols=math.ceil(len(named) / rows),
            fontsize=8,
            frameon=False,
        )


def draw_limits(document: Document, figure: Figure) -> None:
    """A column for each turn per step: success above, foot error below, over forward and sideways.

    The frame is the cut through the limits in force, where that turn lies within them.
    """
    limits = document["limits"]
    kinds = limits["map"]["kinds"]
    turns = sorted({kind["yaw_rad"] for kind in kinds})
    figure.set_size_inches(2.1 * len(turns) + 1.2, 4.6)
    panels = figure.subplots(2, len(turns), sharex=True, sharey=True, squeeze=False)
    errors_cm = [100 * kind["error_m_p95"] for kind in kinds if kind["error_m_p95"] is not None]
    success = {"cmap": "RdYlGn", "vmin": 80.0, "vmax": 100.0}
    error = {"cmap": "viridis_r", "vmin": 0.0, "vmax": max([1.0, *errors_cm])}
    for row, key, form, colours, label in (
        (panels[0], "success", "{:.0f}", success, "success, %"),
        (panels[1], "error_m_p95", "{:.1f}", error, "foot error, p95, cm"),
    ):
        for axes, turn in zip(row, turns, strict=True):
            here = [kind for kind in kinds if kind["yaw_rad"] == turn and kind[key] is not None]
            x_cm, y_cm, values = ([100 * kind[of] for kind in here] for of in ("x_m", "y_m", key))
            image = axes.scatter(x_cm, y_cm, c=values, s=150, marker="s", linewidth=0, **colours)
            for *place, value in zip(x_cm, y_cm, values, strict=True):
                red, green, blue, _ = image.to_rgba(value)
                axes.annotate(
                    form.format(value),
                    place,
                    ha="center",
                    va="center",
                    fontsize=6,
                    color="white" if 0.3 * red + 0.6 * green + 0.1 * blue < 0.5 else "black",
                    zorder=5,
                )
            axes.tick_params(labelsize=8)
            axes.margins(0.14)
            axes.spines[["top", "right"]].set_visible(False)
            if limits["measured"]:
                _frame(axes, limits["measured"]["limits"], turn)
        bar = figure.colorbar(image, ax=row.tolist(), label=label, pad=0.01)
        bar.ax.tick_params(labelsize=8)
        row[0].set_ylabel("sideways, cm")
    for column, turn in enumerate(turns):
        panels[0, column].set_title(f"turn {math.degrees(turn):.0f}°", fontsize=9)
        panels[1, column].set_xlabel("forward, cm")


def _frame(axes: Axes, limits: Document, turn: float) -> None:
    """The limits' cut at a turn."""
    if limits["yaw_rad"][0] - 1e-9 <= turn <= limits["yaw_rad"][1] + 1e-9:
        (x0, x1), (y0, y1) = (100 * np.array(limits[name]) for name in ("x_m", "y_m"))
        axes.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, fill=False, linewidth=1.5))


def draw_beside(document: Document, figure: Figure) -> None:
    """95th percentiles of both controllers' errors in place and heading, of modes with steps."""
    rows = beside_rows(document, "modes", "mode")
    both = [row for row in rows if row["this"]["landings"] and row["other"]["landings"]]
    places = np.arange(len(both))
    panels = figure.subplots(1, 2, sharey=True)
    errors = (
        ("error_m_p95", 100.0, "foot error, 95th percentile, cm"),
        ("heading_deg_p95", 1.0, "heading error, 95th percentile, degrees"),
    )
    for axes, (key, scale, label) in zip(panels, errors, strict=True):
        for offset, which, colour, name in _two(document):
            values = [scale * row[which][key] for row in both]
            axes.barh(places + offset, values, 0.38, color=colour, label=name)
        _plain(axes, "x", xlabel=label, xlim=(0, None))
    panels[0].set_yticks(places, [row["this"]["mode"] for row in both])
    panels[0].invert_yaxis()


def _two(document: Document) -> Iterator[tuple[float, str, str, str]]:
    """Of this and the other evaluation: place of its bar, key, colour and name."""
    yield from zip((-0.2, 0.2), ("this", "other"), (THIS, OTHER), names(document), strict=True)


def draw_side_by_side(
    draw: Callable[[Any, Axes], None], section: str
) -> Callable[[Document, Figure], None]:
    """Draws a section of both evaluations in panels with the same axes."""

    def drawn(document: Document, figure: Figure) -> None:
        panels = figure.subplots(1, 2, sharex=True, sharey=True)
        both = (document, document["beside"])
        for axes, of, name in zip(panels, both, names(document), strict=True):
            draw(of[section], axes)
            axes.set_title(name)
        panels[1].set_ylabel("")

    return drawn


def draw_beside_loads(document: Document, figure: Figure) -> None:
    """Peak torque and speed of each joint, the greater of both legs, as shares of the limits."""
    peaks = {"this": document["gait"], "other": document["beside"]["gait"]}
    joints = {which: joint_peaks(gait["joints"]) for which, gait in peaks.items()}
    places = np.arange(len(joints["this"]))
    panels = figure.subplots(1, 2)
    quantities = (("torque", "torque{}_nm"), ("speed", "speed{}_rad_s"))
    for axes, (title, quantity) in zip(panels, quantities, strict=True):
        for offset, which, colour, name in _two(document):
            peak, limit = "peak_" + quantity.format(""), quantity.format("_limit")
            share = [100 * row[peak] / row[limit] for row in joints[which]]
            axes.bar(places + offset, share, 0.38, color=colour, label=name)
        axes.axhline(100, color=GREY, linestyle=":", linewidth=1)
        _plain(axes, "y", ylabel=f"peak {title}, % of its limit", ylim=(0, 108))
        labels = [plain_joint(row["joint"]) for row in joints["this"]]
        axes.set_xticks(places, labels, rotation=30, ha="right")


def draw_beside_noise(document: Document, figure: Figure) -> None:
    """Success on stairs of both over the noise on treads and on joints, up and down together."""
    rows = beside_rows(document, "stairs", "rise_m", "way", "noise_kind", "noise")
    rise_m = min(row["this"]["rise_m"] for row in rows) if rows else 0.1
    panels = figure.subplots(1, 2, sharey=True)
    kinds = (
        ("tread", 100.0, "noise on tread height, ± cm"),
        ("joint", 1.0, "on joints, ± degrees"),
    )
    for axes, (kind, scale, label) in zip(panels, kinds, strict=True):
        here = [r for r in rows if r["this"]["noise_kind"] in ("none", kind)]
        here = [row for row in here if row["this"]["rise_m"] == rise_m]
        for _, which, colour, name in _two(document):
            for way, style in (("up", "o-"), ("down", "s--")):
                of = [row[which] for row in here if row[which]["way"] == way]
                noise, success = (
                    [k * r[key] for r in of] for k, key in ((scale, "noise"), (100, "success"))
                )
                axes.plot(noise, success, style, color=colour, label=f"{name}, {way}")
        _plain(axes, xlabel=label, ylim=(0, 104))
    panels[0].set_ylabel(f"success on {100 * rise_m:g} cm stairs, %")


def _plain(axes: Axes, grid: Literal["x", "y", "both"] = "both", **settings: Any) -> None:
    """Labels and limits, and no frame where there is nothing to frame."""
    axes.set(**settings)
    axes.grid(alpha=0.25, axis=grid)
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


def draw_stairs(document: Document, figure: Figure) -> None:
    """Success and episode length over the two kinds of noise, up and down."""
    panels = figure.subplots(2, 2, sharex="col", sharey="row")
    kinds = (
        ("tread", 100.0, "noise on tread height, ± cm", 100 * TREAD_NOISE_WITHSTOOD_M),
        ("joint", 1.0, "noise on joint positions, ± degrees", JOINT_NOISE_WITHSTOOD_DEG),
    )
    rise_m = min((row["rise_m"] for row in document["stairs"]), default=0.1)
    level = [row for row in document["stairs"] if row["rise_m"] == rise_m]
    for (above, below), (kind, scale, label, withstood) in zip(panels.T, kinds, strict=True):
        for way, colour in (("up", UP), ("down", DOWN)):
            rows = [r for r in level if r["way"] == way and r["noise_kind"] in ("none", kind)]
            noise = [scale * row["noise"] for row in rows]
            above.plot(noise, [100 * row["success"] for row in rows], "o-", color=colour, label=way)
            below.plot(noise, [row["length_s_mean"] for row in rows], "o-", color=colour, label=way)
        for panel in (above, below):
            panel.axvline(withstood, color=GREY, linestyle=":", linewidth=1)
        above.annotate(
            f"{TITLE}:\nwithstood to here",
            (withstood, 4),
            xytext=(4, 0),
            textcoords="offset points",
            fontsize=7,
            color=GREY,
        )
        _plain(below, xlabel=label, ylim=(0, 10.5))
        _plain(above, ylim=(0, 104))
    panels[0, 0].set_ylabel(f"success on {100 * rise_m:g} cm stairs, %")
    panels[1, 0].set_ylabel("episode length, s")


def draw_loads(document: Document, figure: Figure) -> None:
    """Peak torque and speed of each joint, left beside right, as shares of the limits."""
    joints = document["gait"].get("joints", [])
    half = len(joints) // 2
    names = [plain_joint(row["joint"]) for row in joints[:half]]
    for axes, (title, quantity, unit) in zip(
        figure.subplots(1, 2),
        (("torque", "torque{}_nm", "N m"), ("speed", "speed{}_rad_s", "rad/s")),
        strict=True,
    ):
        peak, limit = "peak_" + quantity.format(""), quantity.format("_limit")
        for offset, rows, colour, label in (
            (-0.2, joints[:half], LEFT, "left"),
            (0.2, joints[half:], RIGHT, "right"),
        ):
            share = [100 * row[peak] / row[limit] for row in rows]
            places = np.arange(half) + offset
            axes.bar(places, share, 0.38, color=colour, label=label)
            for place, height, row in zip(places, share, rows, strict=True):
                axes.annotate(
                    f"{row[peak]:.0f}" if row[peak] >= 10 else f"{row[peak]:.1f}",
                    (place, height),
                    xytext=(0, 2),
                    textcoords="offset points",
                    ha="center",
                    fontsize=7,
                )
        axes.axhline(100, color=GREY, linestyle=":", linewidth=1)
        _plain(axes, "y", ylabel=f"peak {title}, % of its limit", ylim=(0, 108))
        axes.set_title(f"numbers: {unit}", fontsize=8, color=GREY, loc="right")
        axes.set_xticks(np.arange(half), names, rotation=30, ha="right")


def draw_forces(document: Document, figure: Figure) -> None:
    """Vertical ground force of both feet over a gait cycle, in robot weights."""
    _forces(document["gait"], figure.subplots())


def _forces(gait: Document, axes: Axes) -> None:
    time_s = gait["cycle_time_s"]
    for side, (name, colour) in enumerate((("left", LEFT), ("right", RIGHT))):
        mean, low, high = (
            np.array(gait[f"force_{kind}"][side], float) for kind in ("mean", "low", "high")
        )
        axes.fill_between(time_s, low, high, color=colour, alpha=0.2, linewidth=0)
        axes.plot(time_s, mean, color=colour, label=name)
    axes.axhline(1.0, color=GREY, linestyle=":", linewidth=1)
    label = "vertical force / weight"
    _plain(axes, xlabel=CYCLE_TIME, ylabel=label, xlim=(0, time_s[-1]), ylim=(0, None))


def draw_contact(document: Document, figure: Figure) -> None:
    """The phase indicator of each foot against its measured contact."""
    gait = document["gait"]
    panels = figure.subplots(2, 1, sharex=True)
    time_s = gait["cycle_time_s"]
    for side, (axes, name, colour) in enumerate(
        zip(panels, ("left", "right"), (LEFT, RIGHT), strict=True)
    ):
        share = np.array(gait["contact_mean"][side], float)
        axes.fill_between(time_s, share, color=colour, alpha=0.3, linewidth=0, label="contact")
        asked = (1 + np.array(gait["indicator_mean"][side], float)) / 2
        axes.plot(time_s, asked, color="black", linewidth=1.2, label="phase indicator")
        _plain(axes, ylabel=f"{name} foot", ylim=(-0.05, 1.1), xlim=(0, time_s[-1]))
        axes.set_yticks([0, 1], ["swing", "support"])
    panels[1].set_xlabel(CYCLE_TIME)


def draw_push(document: Document, figure: Figure) -> None:
    """Success against impulse, in four directions."""
    _push(document["push"], figure.subplots())


def _push(rows: Sequence[Document], axes: Axes) -> None:
    for row, colour in zip(rows, (UP, DOWN, LEFT, RIGHT), strict=False):
        success = [100 * share for share in row["success"]]
        axes.plot(
            row["impulses_ns"], success, "o-", color=colour, label=f"pushed {row['direction']}"
        )
    _plain(axes, xlabel="impulse, N s", ylabel="success, %", ylim=(0, 104), xlim=(0, None))


def draw_energy(document: Document, figure: Figure) -> None:
    """Cost of transport over walking speed, a line for each kind of walk."""
    _energy(document["energy"], figure.subplots())


def _energy(walks: Sequence[Document], axes: Axes) -> None:
    marks = {"forward": ("o-", UP), "backward": ("s-", DOWN), "sideways": ("^-", LEFT)}
    for kind, (mark, colour) in marks.items():
        rows = [row for row in walks if row["kind"] == kind and row["speed_m_s"]]
        speed = [row["speed_m_s"] for row in rows]
        cost = [row["cost_of_transport"] for row in rows]
        axes.plot(speed, cost, mark, color=colour, label=kind)
    label = "cost of transport E / (m g d)"
    _plain(axes, xlabel="walking speed, m/s", ylabel=label, xlim=(0, None), ylim=(0, None))


def draw_pace(document: Document, figure: Figure) -> None:
    """Speed and share of walks without a fall over the duration of a step."""
    _pace([(document["pace"], UP, "")], figure)


def draw_beside_pace(document: Document, figure: Figure) -> None:
    """The same of both."""
    this, other = names(document)
    both = [(document["pace"], THIS, this), (document["beside"]["pace"], OTHER, other)]
    _pace(both, figure)


def _pace(walks: Sequence[tuple[Sequence[Document], str, str]], figure: Figure) -> None:
    falls, speeds = figure.subplots(1, 2, sharex=True)
    for rows, colour, name in walks:
        step_s = [row["step_s"] for row in rows]
        stayed = [100 * (1 - row["falls"] / row["walks"]) for row in rows]
        falls.plot(step_s, stayed, "o-", color=colour, label=name or None)
        moved = [row for row in rows if row["speed_m_s"] is not None]
        x, y = ([row[key] for row in moved] for key in ("step_s", "speed_m_s"))
        speeds.plot(x, y, "o-", color=colour)
    _plain(falls, xlabel="a step takes, s", ylabel="walks without a fall, %", ylim=(0, 104))
    _plain(speeds, xlabel="a step takes, s", ylabel="speed, m/s", ylim=(0, None))


def draw_hardware(document: Document, figure: Figure) -> None:
    """A panel for each thing that differs: walks without a fall, and the feet's error."""
    rows = document["hardware"]
    kinds = list(dict.fromkeys(row["what"] for row in rows))
    panels = figure.subplots(math.ceil(len(kinds) / 4), 4, sharey=True, squeeze=False).ravel()
    for axes, what in zip(panels, kinds, strict=False):
        here = [row for row in rows if row["what"] == what]
        values = [row["value"] for row in here]
        stayed = [100 * (1 - row["falls"] / row["walks"]) for row in here]
        axes.plot(values, stayed, "o-", color=UP, label="walks without a fall, %")
        seen = [row for row in here if row["error_m_p95"] is not None]
        x, y = [row["value"] for row in seen], [1000 * row["error_m_p95"] for row in seen]
        axes.plot(x, y, "s--", color=DOWN, label="foot error, 95th percentile, mm", markersize=4)
        _plain(axes, xlabel=textwrap.fill(here[0]["unit"], 26), ylim=(0, 104))
        axes.set_title(what, fontsize=9)
        axes.xaxis.label.set_fontsize(8)
    for axes in panels[len(kinds) :]:
        axes.set_visible(False)


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
    "pace.png": ("pace", (7, 3.4), draw_pace),
    "hardware.png": ("hardware", (11, 7.5), draw_hardware),
    "beside.png": ("modes", (9, 4), draw_beside),
    "beside_forces.png": ("gait", (9, 3.4), draw_side_by_side(_forces, "gait")),
    "beside_loads.png": ("gait", (9, 3.8), draw_beside_loads),
    "beside_noise.png": ("stairs", (9, 3.6), draw_beside_noise),
    "beside_push.png": ("push", (9, 3.6), draw_side_by_side(_push, "push")),
    "beside_energy.png": ("energy", (9, 3.6), draw_side_by_side(_energy, "energy")),
    "beside_pace.png": ("pace", (7, 3.4), draw_beside_pace),
}
