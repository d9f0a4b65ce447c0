"""The figure of two policies of the same robot, one beside the other."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from app.evaluation.beside import both_rows

THIS, OTHER = "#0b7a75", "#c8553d"


def draw_beside(document: Mapping[str, Any]) -> Figure:
    """Falls and 95th percentile of the foot error of both policies, mode by mode."""
    both = list(both_rows(document))
    places = np.arange(len(both))
    figure = Figure(figsize=(9, 4), layout="constrained")
    falls, errors = figure.subplots(1, 2, sharey=True)
    for offset, which, colour, label in ((-0.2, 0, THIS, "this"), (0.2, 1, OTHER, "other")):
        rows = [pair_of_rows[which] for pair_of_rows in both]
        share = [100 * row["falls"] / row["episodes"] for row in rows]
        falls.barh(places + offset, share, 0.38, color=colour, label=label)
        error_cm = [100 * (row["error_m_p95"] or 0.0) for row in rows]
        errors.barh(places + offset, error_cm, 0.38, color=colour)
    falls.set(xlabel="episodes that end in a fall, %", xlim=(0, None))
    errors.set(xlabel="foot error, 95th percentile, cm")
    falls.set_yticks(places, [mine["mode"] for mine, _ in both])
    falls.invert_yaxis()
    falls.legend(frameon=False)
    for axes in (falls, errors):
        axes.grid(alpha=0.25, axis="x")
        axes.spines[["top", "right"]].set_visible(False)
    return figure
