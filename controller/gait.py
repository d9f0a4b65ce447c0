"""The gait clock: when each foot swings, and the support indicator.

Time is counted in control ticks. A step period begins with one foot's swing (single support)
and ends with both feet down (double support); a cycle is a period of each foot.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from planner.plan import FootstepPlan, wrap_angle
from planner.robot_model import Side
from sim.robot import GaitTiming

CONTROL_PERIOD_S = 0.025

PACES = ("slow", "normal", "fast")
# Greatest turn, sideways distance and climb of a step at the fast pace.
FAST_TURN_RAD, FAST_ASIDE_M, FAST_CLIMB_M = 0.15, 0.06, 0.01

# Half the time over which a foot's role changes between swing and support.
RAMP_HALF_S = 0.05


@dataclass(frozen=True, kw_only=True)
class GaitTicks:
    """Durations in control ticks, of a gait or (B,) of the present steps of B robots."""

    swing: Any
    double_support: Any

    @classmethod
    def of(cls, gait: GaitTiming) -> GaitTicks:
        """The durations rounded to whole control ticks."""
        return cls(
            swing=round(gait.single_support_s / CONTROL_PERIOD_S),
            double_support=round(gait.double_support_s / CONTROL_PERIOD_S),
        )

    @property
    def step(self) -> Any:
        """Ticks of a step period."""
        return self.swing + self.double_support

    def for_durations(self, step_s: np.ndarray) -> GaitTicks:
        """Steps (N,) of these durations in seconds, with the same share of swing as this gait."""
        step = np.rint(step_s / CONTROL_PERIOD_S).astype(np.int64)
        swing = np.rint(step * (self.swing / self.step)).astype(np.int64)
        return GaitTicks(swing=swing, double_support=step - swing)


def step_durations_s(
    plan: FootstepPlan, gait: GaitTiming, pace: str, fastest_s: float, slowest_s: float
) -> np.ndarray | None:
    """Duration of each step of a plan (N,) at a pace of `PACES`; None at `normal`.

    At `fast` straight and level steps take `fastest_s`; steps that turn, go sideways or climb take
    as long as the robot's gait.
    """
    if pace == "normal" or not len(plan):
        return None
    if pace == "slow":
        return np.full(len(plan), slowest_s)
    feet = plan.start_feet_world.copy()
    durations = np.full(len(plan), gait.step_s)
    for k, (side, pose) in enumerate(zip(plan.side, plan.pose_world, strict=True)):
        support, lift_off = feet[1 - side], feet[side]
        turn_rad = np.abs(wrap_angle([pose[3] - support[3], pose[3] - lift_off[3]])).max()
        away = pose[:2] - lift_off[:2]
        aside_m = abs(np.cos(pose[3]) * away[1] - np.sin(pose[3]) * away[0])
        climb_m = np.abs(pose[2] - feet[:, 2]).max()
        if turn_rad <= FAST_TURN_RAD and aside_m <= FAST_ASIDE_M and climb_m <= FAST_CLIMB_M:
            durations[k] = min(fastest_s, gait.step_s)
        feet[side] = pose
    return durations


def clock(ticks: GaitTicks, side: np.ndarray, tick: np.ndarray, standing: np.ndarray) -> np.ndarray:
    """Sine and cosine (B, 2) of the gait's phase; both 0 while standing.

    The phase runs from 0 to pi over a right step's period and from pi to 2 pi over a left
    one's, so that the mirrored robot sees the clock with its sign changed.

    Args:
        ticks: the gait's durations.
        side: the swing foot of the present step (B,).
        tick: control ticks since its swing began (B,).
        standing: robots that do not step at all (B,).
    """
    phase = np.pi * (tick / ticks.step + (side == Side.LEFT))
    return np.where(standing[:, None], 0.0, np.stack([np.sin(phase), np.cos(phase)], axis=1))


def support_indicator(
    ticks: GaitTicks, side: np.ndarray, tick: np.ndarray, standing: np.ndarray
) -> np.ndarray:
    """Desired role of each foot (B, 2): +1 support, -1 swing.

    This is the phase indicator of Singh et al. 2022, sec. IV-C, with linear ramps at lift-off
    and touch-down, the same for force and (negated) for speed.
    """
    ramp = RAMP_HALF_S / CONTROL_PERIOD_S
    # Signed ticks to the foot's nearest change of role, negative within its swing.
    swing_foot = np.where(
        tick <= ticks.swing, -np.minimum(tick, ticks.swing - tick), tick - ticks.swing
    )
    next_swing_foot = ticks.step - tick
    rows = np.arange(len(side))
    indicator = np.empty((len(side), 2))
    indicator[rows, side] = swing_foot
    indicator[rows, 1 - side] = next_swing_foot
    return np.where(standing[:, None], 1.0, np.clip(indicator / ramp, -1.0, 1.0))
