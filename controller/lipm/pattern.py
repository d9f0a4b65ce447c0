"""The walking pattern: support phases of the coming steps, and the centre of mass over them.

The centre of mass is that of a linear inverted pendulum, whose zero-tilting moment point (ZMP) is
p = c - (h / g) cdd. A linear model predictive controller chooses its jerk so that the ZMP follows
the support feet: Wieber 2006, "Trajectory free linear model predictive control for stable walking
in the presence of strong perturbations"; with the terminal condition of Caron, Kheddar, Tempier
2019, "Stair climbing stabilization of the HRP-4 humanoid robot using whole-body admittance
control", sec. II.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import daqp
import numpy as np

from controller.step_cursor import UpcomingSteps
from planner.robot_model import Side
from sim.robot import GRAVITY_M_S2

SAMPLE_S, SAMPLES = 0.05, 32
# Weights of squared jerk, of squared distance of ZMP and reference, and of what a ZMP is outside
# its sole by, where it cannot be inside.
JERK_WEIGHT, ZMP_WEIGHT = 1e-3, 1000.0
# The ZMP keeps to this share of a sole, and if it can to a smaller one after the first moments: the
# rest is for the feedback, and for what comes otherwise than planned.
SOLE_SHARE, CAUTIOUS_SHARE, FIRST_SAMPLES = 0.9, 0.7, 5
# Before the first step the weight goes over to its support foot within this time.
SHIFT_S = 0.6
# In single support the ZMP's reference lies inward of the sole's middle by this share of its half
# width: a push outward over the support foot cannot be stepped against, so that side of the sole is
# kept free for it.
INWARD_SHARE = 0.5
# daqp's flags of a solution, and of one that misses soft constraints.
OPTIMAL, SOFT_OPTIMAL = 1, 2
# Its marks of a constraint that is an equation, and of one that may be missed at a price far above
# all weights here.
EQUATION, SOFT = 5, 8
# Weight of what the end is missed by where it cannot be reached.
END_WEIGHT = 1.0


class StageFailed(RuntimeError):
    """A stage of the controller found no solution; the message names the stage."""


@dataclass(frozen=True, kw_only=True)
class Phase:
    """A support phase that ends at `end_s` from now, and its ZMP, which moves evenly over it.

    `feet` (2, 4) are poses x, y, z, yaw, of which `standing` (2,) bear weight.
    """

    begin_s: float
    end_s: float
    zmp_from: np.ndarray
    zmp_to: np.ndarray
    feet: np.ndarray
    standing: tuple[bool, bool] = (True, True)

    @property
    def soles(self) -> np.ndarray:
        """Poses (1 or 2, 4) of the feet that stand."""
        return self.feet[list(self.standing)]

    def hull(self, half_sole_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """All that soles of these half sides (2,) can bear: `normals @ point <= offsets`.

        Their shapes are (m, 2) and (m,).
        """
        cos, sin = np.cos(self.soles[:, 3]), np.sin(self.soles[:, 3])
        turn = np.moveaxis(np.array([[cos, -sin], [sin, cos]]), 2, 0)
        corners = half_sole_m * np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
        points = (self.soles[:, None, :2] + corners @ turn.transpose(0, 2, 1)).reshape(-1, 2)
        side = points[None] - points[:, None]
        length_m = np.linalg.norm(side, axis=2)
        normals = np.stack([side[..., 1], -side[..., 0]], axis=2)
        normals = normals / np.maximum(length_m, 1e-9)[..., None]
        offsets = (normals * points[:, None]).sum(axis=2)
        edges = (normals @ points.T <= offsets[..., None] + 1e-9).all(axis=2) & (length_m > 1e-6)
        return normals[edges], offsets[edges]


def phases_of(feet_world: np.ndarray, steps: UpcomingSteps, inward_m: float = 0.0) -> list[Phase]:
    """Support phases from now on, of feet (2, 4) that stand and steps to come; the last is endless.

    Of the foot that swings, `feet_world` may hold anything. The ZMP in single support is so far
    inward of the sole's middle.
    """
    feet = feet_world.copy()
    middle = feet[:, :2].mean(axis=0)
    if not len(steps.side):
        return [Phase(begin_s=0.0, end_s=np.inf, zmp_from=middle, zmp_to=middle, feet=feet)]
    phases: list[Phase] = []
    begin_s, zmp = steps.lift_off_s[0] - SHIFT_S, middle
    if begin_s > 0:
        phases.append(
            Phase(begin_s=0.0, end_s=begin_s, zmp_from=middle, zmp_to=middle, feet=feet.copy())
        )
    for k, side in enumerate(steps.side):
        stance = inward_of(feet[1 - side], 1 - int(side), inward_m)
        lift_off_s, touch_down_s = steps.lift_off_s[k], steps.touch_down_s[k]
        if lift_off_s > 0:
            phases.append(
                Phase(
                    begin_s=begin_s,
                    end_s=lift_off_s,
                    zmp_from=zmp,
                    zmp_to=stance,
                    feet=feet.copy(),
                )
            )
        if touch_down_s > 0:
            phases.append(
                Phase(
                    begin_s=lift_off_s,
                    end_s=touch_down_s,
                    zmp_from=stance,
                    zmp_to=stance,
                    feet=feet.copy(),
                    standing=(side == 1, side == 0),
                )
            )
            feet[side] = steps.pose_world[k]
        zmp, begin_s = stance, touch_down_s
    middle = feet[:, :2].mean(axis=0)
    still_s = begin_s + SHIFT_S
    last = Phase(begin_s=begin_s, end_s=still_s, zmp_from=zmp, zmp_to=middle, feet=feet)
    return [*phases, last, replace(last, begin_s=still_s, end_s=np.inf, zmp_from=middle)]


def inward_of(foot: np.ndarray, side: int, inward_m: float) -> np.ndarray:
    """The point x, y (2,) so far inward of the middle of a foot (4,)."""
    across_m = -inward_m if side == Side.LEFT else inward_m
    return np.array(foot[:2] + across_m * np.array([-np.sin(foot[3]), np.cos(foot[3])]))


def phase_at(phases: Sequence[Phase], time_s: float) -> Phase:
    """The phase at a time from now."""
    return next(phase for phase in phases if time_s < phase.end_s)


def zmp_reference(phase: Phase, time_s: float) -> np.ndarray:
    """The ZMP x, y of a phase at a time within it."""
    if not np.isfinite(phase.end_s):
        return phase.zmp_to
    share = np.clip((time_s - phase.begin_s) / (phase.end_s - phase.begin_s), 0.0, 1.0)
    return (1 - share) * phase.zmp_from + share * phase.zmp_to


@dataclass
class Pendulum:
    """The centre of mass of the pattern: position, velocity and acceleration (2,) x, y."""

    com: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray

    def advance(self, jerk: np.ndarray, time_s: float) -> None:
        """Integrate over a time with constant jerk (2,)."""
        free, forced = triple_integrator(time_s)
        state = np.stack([self.com, self.velocity, self.acceleration])
        self.com, self.velocity, self.acceleration = free @ state + np.outer(forced, jerk)

    def shift(self, turn: np.ndarray, offset: np.ndarray) -> None:
        """Turn everything by a rotation (2, 2) and move it by an offset (2,)."""
        self.com = turn @ self.com + offset
        self.velocity, self.acceleration = turn @ self.velocity, turn @ self.acceleration


def triple_integrator(time_s: float) -> tuple[np.ndarray, np.ndarray]:
    """What a time of constant jerk does to position, velocity and acceleration.

    They become `free @ state + forced * jerk`, of shapes (3, 3) and (3,).
    """
    t = time_s
    free = np.array([[1, t, t**2 / 2], [0, 1, t], [0, 0, 1]])
    return free, np.array([t**3 / 6, t**2 / 2, t])


def integrated() -> tuple[np.ndarray, np.ndarray]:
    """Position, velocity and acceleration at the samples, by those now and the jerk over them.

    State (3,) after sample k + 1: `free[k] @ state + forced[k] @ jerk`, of shapes (SAMPLES, 3, 3)
    and (SAMPLES, 3, SAMPLES).
    """
    n = SAMPLES
    step, jerked = triple_integrator(SAMPLE_S)
    free, forced = np.zeros((n, 3, 3)), np.zeros((n, 3, n))
    power = np.eye(3)
    for k in range(n):
        power = step @ power
        free[k] = power
        if k:
            forced[k] = step @ forced[k - 1]
        forced[k, :, k] = jerked
    return free, forced


class PatternGenerator:
    """Chooses the jerk (SAMPLES, 2) of a pendulum of this height with this half sole (2,)."""

    def __init__(self, height_m: float, half_sole_m: np.ndarray):
        n = SAMPLES
        self._half_sole_m = half_sole_m
        self.relaxed = 0
        self._omega = np.sqrt(GRAVITY_M_S2 / height_m)
        free, forced = integrated()
        self._com_free, self._com_forced = free[:, 0], forced[:, 0]
        zmp = np.array([1.0, 0.0, -1 / self._omega**2])
        dcm = np.array([1.0, 1 / self._omega, 0.0])
        self._zmp_free, self._zmp_forced = zmp @ free, zmp @ forced
        self._end_free = np.stack([zmp @ free[-1], dcm @ free[-1]])
        self._end_forced = np.stack([zmp @ forced[-1], dcm @ forced[-1]])
        axis = JERK_WEIGHT * np.eye(n) + ZMP_WEIGHT * self._zmp_forced.T @ self._zmp_forced
        self._cost = np.kron(np.eye(2), axis)
        self._equations = np.kron(np.eye(2), self._end_forced)
        self._open_cost = self._cost + END_WEIGHT * self._equations.T @ self._equations

    def solve(
        self, pendulum: Pendulum, phases: Sequence[Phase], share: float = SOLE_SHARE
    ) -> np.ndarray | None:
        """The jerk (SAMPLES, 2) over the horizon; None if no ZMP in the soles leads to a rest.

        After the first moments it keeps to this share of each sole.
        """
        slope, end, rows, upper = self._program(pendulum, phases, share)
        sense = np.zeros(len(end) + len(upper), np.int32)
        sense[: len(end)] = EQUATION
        lower = np.r_[end, np.full(len(upper), -1e30)]
        rows, upper = np.vstack([self._equations, rows]), np.r_[end, upper]
        return _minimum(self._cost, slope, rows, upper, lower, sense)

    def solve_open_ended(self, pendulum: Pendulum, phases: Sequence[Phase]) -> np.ndarray:
        """The jerk (SAMPLES, 2) that goes as far towards a rest as the soles can bear.

        For where none leads to one, such as after a push before a step is moved.

        Raises:
            StageFailed: there is none, even so.
        """
        self.relaxed += 1
        slope, end, rows, upper = self._program(pendulum, phases, SOLE_SHARE)
        slope = slope - END_WEIGHT * self._equations.T @ end
        soft, least = np.full(len(upper), SOFT, np.int32), np.full(len(upper), -1e30)
        jerk = _minimum(self._open_cost, slope, rows, upper, least, soft)
        if jerk is None:
            raise StageFailed("the walking pattern has no solution")
        return jerk

    def _program(
        self, pendulum: Pendulum, phases: Sequence[Phase], share: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Slope of the cost, values of the end's equations, and rows and bounds of the hulls."""
        state = np.stack([pendulum.com, pendulum.velocity, pendulum.acceleration])
        times = SAMPLE_S * (np.arange(SAMPLES) + 1)
        at = [phase_at(phases, time) for time in times]
        reference = np.array([zmp_reference(p, t) for p, t in zip(at, times, strict=True)])
        free_zmp = self._zmp_free @ state
        slope = ZMP_WEIGHT * (self._zmp_forced.T @ (free_zmp - reference)).T.ravel()
        end = np.vstack([reference[-1], reference[-1]]) - self._end_free @ state
        hulls: dict[tuple[int, float], tuple[np.ndarray, np.ndarray]] = {}
        rows, upper = [], []
        for k, phase in enumerate(at):
            kept = SOLE_SHARE if k < FIRST_SAMPLES else share
            if (id(phase), kept) not in hulls:
                hulls[id(phase), kept] = phase.hull(kept * self._half_sole_m)
            normals, offsets = hulls[id(phase), kept]
            rows.append((normals[:, :, None] * self._zmp_forced[k]).reshape(len(normals), -1))
            upper.append(offsets - normals @ free_zmp[k])
        return slope, end.T.ravel(), np.vstack(rows), np.concatenate(upper)

    def path(self, pendulum: Pendulum, jerk: np.ndarray) -> np.ndarray:
        """The centre of mass (SAMPLES, 2) at the samples of a jerk over the horizon."""
        state = np.stack([pendulum.com, pendulum.velocity, pendulum.acceleration])
        return np.asarray(self._com_free @ state + self._com_forced @ jerk)


def _minimum(
    cost: np.ndarray,
    slope: np.ndarray,
    rows: np.ndarray,
    upper: np.ndarray,
    lower: np.ndarray,
    sense: np.ndarray,
) -> np.ndarray | None:
    jerk, _, flag, _ = daqp.solve(cost, slope, np.ascontiguousarray(rows), upper, lower, sense)
    return np.reshape(jerk, (2, SAMPLES)).T if flag in (OPTIMAL, SOFT_OPTIMAL) else None
