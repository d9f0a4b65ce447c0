"""Recovery from a push: where and when the present step must land so that it can be captured.

The robot is a linear inverted pendulum. Its capture point, p + v / omega with omega =
sqrt(g / height) of its centre of mass, moves away from the centre of pressure as exp(omega t)
(Pratt et al. 2006, "Capture point: a step toward humanoid push recovery"). So it is known between
which points the ankles can bring it by touch-down. A step that leaves all of these outside the two
feet is moved by what is missing; where its limits do not allow as much, it also lands sooner, as in
Khadiv et al. 2020, "Walking control based on step timing adaptation". A foot cannot step across
the other one, so against a push inward there is only landing sooner.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controller.gait import CONTROL_PERIOD_S
from controller.observation import rotate_xy
from controller.walker import Walker
from planner.robot_model import Side, StepLimits
from sim.robot import GRAVITY_M_S2

# In shares of half a sole: how far out the ankles are asked to bring the centre of pressure where a
# step changes, and how far out on a foot the capture point may lie at touch-down. Just after
# lift-off the pressure still moves from one foot to the other.
PRESSURE_SHARE = 0.75
CAPTURE_SHARE = 0.5
FIRST_MOMENTS_S = 0.05
# A step that misses by less is left alone.
LEAST_M = 0.02
# Shortest swing, and shortest rest of one that is under way.
SHORTEST_SWING_S = 0.35
SHORTEST_REST_S = 0.1


@dataclass(frozen=True, kw_only=True)
class StepChange:
    """What the present steps of the robots `rows` (n,) need against a push.

    `needed` (n,): whether anything. `offset_world_m` (n, 2): the move of the step. `swing_ticks`
    (n,): control ticks of its swing. Of a robot that needs nothing these are 0 and as they are.
    """

    rows: np.ndarray
    needed: np.ndarray
    offset_world_m: np.ndarray
    swing_ticks: np.ndarray


def moved_within(limits: StepLimits, step: np.ndarray, move_m: np.ndarray) -> np.ndarray:
    """How far (n, 2) steps x, y (n, 2), y outward, follow moves (n, 2) within the limits.

    Each axis up to its limit, then both as far as the polygon goes; never back from where it is.
    """
    low, high = np.transpose([limits.x_m, limits.y_m])
    move = np.clip(step + move_m, np.minimum(low, step), np.maximum(high, step)) - step
    for n_x, n_y, c in limits.half_planes:
        normal = np.array([n_x, n_y])
        beyond, room = move @ normal, np.maximum(c - step @ normal, 0.0)
        move *= np.where(beyond > room, room / np.maximum(beyond, 1e-12), 1.0)[:, None]
    return np.asarray(move)


def step_change(walker: Walker, rows: np.ndarray | None = None) -> StepChange:
    """What the present steps of a walker's robots `rows` (n,) need, by centre of mass and soles.

    By default all robots. A step captures from `loading_ticks` after touch-down on.
    """
    robot, cursor = walker.robot, walker.cursor
    limits, foot = robot.training_model.limits, robot.step_model.foot
    rows = np.arange(walker.sim.count) if rows is None else rows
    side, tick = cursor.side[rows], cursor.tick[rows]
    outward = np.where(side == Side.LEFT, 1.0, -1.0)
    state = walker.state
    support = state.soles_world[rows, 1 - side]

    def in_support_frame(point_world: np.ndarray) -> np.ndarray:
        point = rotate_xy(point_world[:, :2] - support[:, :2], -support[:, 3])
        return np.column_stack([point[:, 0], outward * point[:, 1]])

    com, velocity = state.com_pos_world[rows], state.com_linvel_world[rows]
    omega = np.sqrt(GRAVITY_M_S2 / np.maximum(com[:, 2] - support[:, 2], 0.1))
    capture = in_support_frame(com + velocity / omega[:, None])
    target = cursor.foot_targets[rows, side]
    step = in_support_frame(target)
    half_m = np.array([foot.length_m, foot.width_m]) / 2

    swing_ticks = cursor.ticks.swing[rows]
    loading = walker.loading_ticks
    growth = np.exp(omega * (swing_ticks + loading - tick) * CONTROL_PERIOD_S)
    missing = _missing_m(capture, step, growth, half_m, robot.steady_pressure_share)
    needed = cursor.swinging[rows] & (tick >= round(FIRST_MOMENTS_S / CONTROL_PERIOD_S))
    needed &= walker.disturbed[rows] & (np.abs(missing).max(axis=1) > LEAST_M)
    most_growth = _most_growth(capture, limits, half_m)
    latest_tick = tick + np.floor(np.log(most_growth) / omega / CONTROL_PERIOD_S) - loading
    first_tick = np.maximum(
        tick + round(SHORTEST_REST_S / CONTROL_PERIOD_S),
        round(SHORTEST_SWING_S / CONTROL_PERIOD_S),
    )
    sooner = np.clip(latest_tick, np.minimum(first_tick, swing_ticks), swing_ticks)
    sooner = np.where(needed, sooner, swing_ticks).astype(np.int64)
    growth = np.exp(omega * (sooner + loading - tick) * CONTROL_PERIOD_S)
    missing = _missing_m(capture, step, growth, half_m, PRESSURE_SHARE)
    missing[:, 1] = np.maximum(missing[:, 1], 0.0)
    move = moved_within(limits, step, missing * needed[:, None])
    move[:, 1] *= outward
    return StepChange(
        rows=rows,
        needed=needed,
        offset_world_m=rotate_xy(move, support[:, 3]),
        swing_ticks=sooner,
    )


def change_steps(walker: Walker, change: StepChange) -> None:
    """Move the present steps, and with them all later ones, and end their swings as they need."""
    rows, needed = change.rows[change.needed], change.needed
    walker.cursor.shift(rows, change.offset_world_m[needed])
    walker.cursor.hasten(rows, change.swing_ticks[needed])


def _missing_m(
    capture: np.ndarray, step: np.ndarray, growth: np.ndarray, half_m: np.ndarray, share: float
) -> np.ndarray:
    """By how far (B, 2) the capture point must miss both feet at touch-down, in support frames.

    With the centre of pressure within this share of half a sole. Positive ahead or outward of the
    step, negative behind both feet or inward of the support foot.
    """
    pressure, edge = share * half_m, CAPTURE_SHARE * half_m
    least = (capture - pressure) * growth[:, None] + pressure
    most = (capture + pressure) * growth[:, None] - pressure
    ahead = np.maximum(least - (np.maximum(step, 0.0) + edge), 0.0)
    behind = np.minimum(most - (np.minimum(step, 0.0) - edge), 0.0)
    return np.asarray(ahead + behind)


def _most_growth(capture: np.ndarray, limits: StepLimits, half_m: np.ndarray) -> np.ndarray:
    """Greatest growth (B,) up to touch-down after which some step within the limits captures.

    It is at least 1: the swing has no less than no time left.
    """
    edge = (CAPTURE_SHARE - PRESSURE_SHARE) * half_m
    farthest = np.array([limits.x_m[1], limits.y_m[1]])
    nearest = np.array([max(-limits.x_m[0], 0.0), 0.0])

    def growth(reach_m: np.ndarray, beyond_m: np.ndarray) -> np.ndarray:
        """Of capture points that far beyond the centre of pressure; no end where they are not."""
        within = np.full(beyond_m.shape, np.inf)
        return np.divide(reach_m + edge, beyond_m, out=within, where=beyond_m > 0).min(axis=1)

    pressure = PRESSURE_SHARE * half_m
    most = np.minimum(growth(farthest, capture - pressure), growth(nearest, -capture - pressure))
    return np.asarray(np.maximum(most, 1.0))
