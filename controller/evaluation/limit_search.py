"""Step limits that a policy keeps to: the widest box of steps in which its walks succeed.

The search begins with the limits trained on. Where too many walks fall, the corner of the box at
which most do is cut back a little, on the side where planning loses least, and so on.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from planner.robot_model import StepLimits, StepModel

AXES = ("x_m", "y_m", "yaw_rad")
CUT = {"x_m": 0.02, "y_m": 0.01, "yaw_rad": 0.03}
MOST_CUTS = 30


@dataclass(frozen=True, kw_only=True)
class Trial:
    """How walks within some limits went: `fell` (8,) of `walked` (8,) that touched each corner.

    Corners are in the order of `corners_of`.
    """

    limits: StepLimits
    success: float
    walked: np.ndarray
    fell: np.ndarray

    @property
    def worst_corner(self) -> int:
        """The corner with the greatest share of falls."""
        return int(np.argmax(self.fell / np.maximum(self.walked, 1)))


def corners_of(limits: StepLimits) -> np.ndarray:
    """The corners (8, 3) of the limits; low before high, the last axis changes fastest."""
    return np.array(list(itertools.product(limits.x_m, limits.y_m, limits.yaw_rad)))


def search_limits(
    model: StepModel, widest: StepLimits, walk: Callable[[StepLimits], Trial], *, success: float
) -> list[Trial]:
    """All trials, the last with at least so much success unless nothing is left to cut.

    Args:
        model: whose step set planning would rather keep, and whose stance stays inside.
        widest: where to begin.
        walk: lets robots walk within limits.
        success: the share of walks without a fall that is enough.
    """
    trials = [walk(widest)]
    while trials[-1].success < success and len(trials) <= MOST_CUTS:
        narrower = cut_back(trials[-1].limits, trials[-1].worst_corner, model)
        if narrower is None:
            break
        trials.append(walk(narrower))
    return trials


def cut_back(limits: StepLimits, corner: int, model: StepModel) -> StepLimits | None:
    """The limits with one side of a corner moved inwards; None where the corner is the stance.

    That side is chosen which loses the fewest steps of the set, then the smallest part of its
    range.
    """
    stance = (0.0, model.stance_width_m, 0.0)
    options: list[tuple[int, float, StepLimits]] = []
    for axis, name in enumerate(AXES):
        ends = list(getattr(limits, name))
        high = corner >> (2 - axis) & 1
        room = abs(ends[high] - stance[axis])
        if room < 1e-9:
            continue
        cut = min(CUT[name], room)
        span = ends[1] - ends[0]
        ends[high] = round(ends[high] + (-cut if high else cut), 3)
        narrower = replace(limits, **{name: (ends[0], ends[1])})
        lost = sum(limits.contain(step) and not narrower.contain(step) for step in model.steps)
        if any(narrower.contain(step) for step in model.steps):
            options.append((int(lost), cut / span, narrower))
    return min(options, key=lambda option: option[:2])[2] if options else None
