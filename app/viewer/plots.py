"""Plots of the walk: how far each foot came down from its step, and what the feet carry."""

from __future__ import annotations

import numpy as np
import viser
from viser import uplot

from app.viewer.markers import SIDE_RGB
from planner.robot_model import Side

_HEIGHT_PX = 170
# The latest steps are what one wants to see.
_STEPS_SHOWN = 60
_GREY = "#8a8f98"


class Plots:
    """Two plots in the container that is open when it is made."""

    def __init__(self, gui: viser.GuiApi) -> None:
        nothing = np.zeros(1)
        self._latest_s = 0.0
        left, right = (_css(SIDE_RGB[side]) for side in Side)
        self._errors = gui.add_uplot(
            (nothing, nothing, nothing),
            (
                uplot.Series(label="step"),
                uplot.Series(label="left cm", stroke=left, width=1, points={"show": True}),
                uplot.Series(label="right cm", stroke=right, width=1, points={"show": True}),
            ),
            title="Foot from its step, cm",
            scales={"x": {"time": False}},
            axes=_axes(),
            height=_HEIGHT_PX,
        )
        self._forces = gui.add_uplot(
            (nothing, nothing, nothing),
            (
                uplot.Series(label="s"),
                uplot.Series(label="left N", stroke=left, width=2),
                uplot.Series(label="right N", stroke=right, width=2),
            ),
            title="Ground force, N",
            scales={"x": {"time": False}},
            axes=_axes(),
            height=_HEIGHT_PX,
        )

    def show_errors(self, side: np.ndarray, error_m: np.ndarray) -> None:
        """Errors (N,) of the steps of each side, in the order of the walk."""
        if len(side) == 0:
            side, error_m = np.array([Side.LEFT]), np.zeros(1)
        number = np.arange(1, len(side) + 1)
        shown = slice(-_STEPS_SHOWN, None)
        # A foot's line stays where it is while the other one steps.
        latest = [np.maximum.accumulate(np.where(side == foot, number, 0)) for foot in Side]
        left, right = (100 * np.append(0.0, error_m)[steps][shown] for steps in latest)
        self._errors.data = (number[shown].astype(float), left, right)

    def show_forces(self, forces: np.ndarray) -> None:
        """Time in s, left and right force in N: (3, T); nothing is sent where time stands still."""
        if forces[0, -1] == self._latest_s:
            return
        self._latest_s = float(forces[0, -1])
        self._forces.data = (forces[0], forces[1], forces[2])


def _axes() -> tuple[uplot.Axis, uplot.Axis]:
    """A grey that can be read on white and on black."""
    axis = uplot.Axis(stroke=_GREY, grid={"stroke": _GREY + "40"}, ticks={"stroke": _GREY})
    return axis, axis


def _css(rgb: tuple[int, int, int]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*rgb)
