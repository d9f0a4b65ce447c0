"""The figure of two policies of the same robot, one beside the other."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from app.evaluation.beside import both_rows

THIS, OTHER = "#0b7a75", "#c8553d"


def draw_beside(document: Mapping[str, Any]) -> Figure:
    """95th percentiles of both policies' errors in place and heading, for all modes with steps."""
    both = [pair for pair in both_rows(document) if all(row["landings"] for row in pair)]
    places = np.arange(len(both))
    figure = Figure(figsize=(9, 4), layout="constrained")
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
    return figure
