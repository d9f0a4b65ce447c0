"""The picture of a comparison: each joint's targets, measured and replayed angles."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from app.comparison.report import Document
from app.output import replacing
from app.pictures import canvas
from app.pictures.canvas import hex_of
from sim.identification.robot_log import RobotLog
from sim.identification.servo_fit import ServoFit

_SHOWN_S = 6.0
_TARGET, _MEASURED, _MODEL, _FITTED = "#b8bcc4", hex_of(canvas.INK), "#c8553d", "#0b7a75"


def write_comparison(path: Path, document: Document, log: RobotLog, fit: ServoFit) -> None:
    """Draws a panel for each joint, left leg left: the seconds in which the model fits worst.

    Raises:
        InputError: The file cannot be written.
    """
    joints = document["joints"]
    rows = len(joints) // 2
    figure = Figure(figsize=(13, 2.1 * rows + 0.6), layout="constrained")
    panels = figure.subplots(rows, 2, squeeze=False)
    for j, row in enumerate(joints):
        axes = panels[j % rows][j // rows]
        _draw(axes, log, fit, j)
        axes.set_title(f"{row['name']}: {row['verdict']}", fontsize=8, loc="left")
        axes.tick_params(labelsize=7)
    for axes in panels[-1]:
        axes.set_xlabel("time in the log, s", fontsize=8)
    for axes in panels[:, 0]:
        axes.set_ylabel("deg", fontsize=8)
    handles, labels = panels[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4, fontsize=8, frameon=False)
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=110)


def _draw(axes: Axes, log: RobotLog, fit: ServoFit, j: int) -> None:
    at_s, window, by_model, by_fitted = fit.replayed[j]
    middle_s = (log.time_s[0] + log.time_s[-1]) / 2
    if len(at_s):
        measured = np.interp(at_s, log.time_s, log.joint_pos_rad[:, j])
        off = np.abs(by_model - measured)
        per_window = np.bincount(window.astype(int), off**2)
        middle_s = float(at_s[window == per_window.argmax()].mean())
    low_s = min(max(middle_s - _SHOWN_S / 2, log.time_s[0]), log.time_s[-1] - _SHOWN_S)
    low_s = max(low_s, log.time_s[0])
    shown = (log.time_s >= low_s) & (log.time_s <= low_s + _SHOWN_S)
    sent = (log.sent_s >= low_s) & (log.sent_s <= low_s + _SHOWN_S)
    degrees = np.degrees
    axes.step(
        *(log.sent_s[sent], degrees(log.target_rad[sent, j])),
        where="post",
        color=_TARGET,
        lw=1,
        label="target",
    )
    axes.plot(
        log.time_s[shown], degrees(log.joint_pos_rad[shown, j]), color=_MEASURED, lw=2, label="log"
    )
    for angles, colour, name in (
        (by_model, _MODEL, "replayed by the model"),
        (by_fitted, _FITTED, "replayed as fitted"),
    ):
        seen = (at_s >= low_s) & (at_s <= low_s + _SHOWN_S)
        # A gap between the windows, lest a line joins them.
        ends = np.flatnonzero(np.diff(window[seen]) > 0) + 1
        times = np.insert(at_s[seen], ends, np.nan)
        axes.plot(
            *(times, degrees(np.insert(angles[seen], ends, np.nan))),
            color=colour,
            lw=1.2,
            ls="-" if colour == _MODEL else "--",
            label=name,
        )
    axes.set_xlim(low_s, low_s + _SHOWN_S)
    axes.grid(color="#e8e8e8", lw=0.6)
