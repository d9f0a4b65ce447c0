"""Footsteps along a path of the body, by dynamic programming. Compiled.

Feet stand on either side of poses of the path, so a plan is a sequence of points of the path,
alternately left and right. The cheapest sequence is a shortest path in a small graph without
cycles: from each point steps within the limits lead to the next few dozen. Limits, boxes and costs
are those of the search. Where no step leads further, `PathFootsteps.end` is the last point reached.

All poses are x_m, y_m, yaw_rad in the grid frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.collision import NO_GROUND_UM, box_free, point_clearance
from planner.compiled import njit_inner, njit_no_refcount
from planner.lattice.lattice import (
    Int64s,
    Lattice,
    clearance_cost,
    feet_climb,
    foot_at,
    level_height_um,
)
from planner.lattice.steps import MICRO, allowed, step_cost_um
from planner.plan import relative_steps, wrap_angle
from planner.robot_model import RoundedBox, Side, StepModel, rounded_box

FloatArray = NDArray[np.float64]

NO_COST = 1 << 60
START, UNREACHED = -1, -2  # instead of the point stepped from
_SPACING_M, _SPACING_RAD = 0.025, 0.05
_POINTS_AHEAD = 32  # to which a step may lead


@dataclass(frozen=True, kw_only=True)
class Stance:
    """Where both feet are: feet (2, 3), left and right, and which foot must step first, if any.

    feet_m (2,): how high. pair_margin_m: the body's margin in the first step.
    """

    feet: FloatArray
    feet_m: FloatArray
    first_side: Side | None
    pair_margin_m: float


@dataclass(frozen=True, kw_only=True)
class Footsteps:
    """Steps in order: side (k,), pose (k, 3) and height of the ground z_m (k,)."""

    side: NDArray[np.int8]
    pose: FloatArray
    z_m: FloatArray

    def __len__(self) -> int:
        return len(self.side)

    def then(self, other: Footsteps) -> Footsteps:
        """These steps and after them others."""
        return Footsteps(
            side=np.concatenate([self.side, other.side]),
            pose=np.concatenate([self.pose, other.pose]),
            z_m=np.concatenate([self.z_m, other.z_m]),
        )

    def stance_after(self, stance: Stance, margin_m: float) -> Stance:
        """Where the feet are after these steps from a stance; the other foot is next."""
        if not len(self):
            return stance
        feet, feet_m = stance.feet.copy(), stance.feet_m.copy()
        feet[self.side[-2:]], feet_m[self.side[-2:]] = self.pose[-2:], self.z_m[-2:]
        last = Side(int(self.side[-1]))
        return Stance(feet=feet, feet_m=feet_m, first_side=last.other, pair_margin_m=margin_m)


NO_STEPS = Footsteps(side=np.zeros(0, np.int8), pose=np.zeros((0, 3)), z_m=np.zeros(0))


def step_costs(
    support: FloatArray, swing: FloatArray, out: Int64s | int, model: StepModel
) -> Int64s:
    """Costs (...) of steps from support (..., 3) to swing (..., 3); 0 where limits forbid them.

    out (...): `Side.outward` of the swing foot.
    """
    steps = relative_steps(support, swing, out)
    return np.where(allowed(steps, model), step_cost_um(steps, model), 0)


def cost_of(lattice: Lattice, model: StepModel, stance: Stance, steps: Footsteps) -> int:
    """Cost in micrometres of steps from a stance to a goal, as the searches count it.

    The last step, beside the other foot at the goal, costs no clearance.
    """
    first = stance.feet[Side(int(steps.side[0])).other]
    support = np.concatenate([first[None], steps.pose[:-1]])
    total = int(step_costs(support, steps.pose, 1 - 2 * steps.side.astype(int), model).sum())
    for x, y in (support + steps.pose)[:-1, :2] / 2:
        total += int(clearance_cost(lattice, point_clearance(lattice.terrain, x, y)))
    return total


@njit_no_refcount
def check_feet(
    lattice: Lattice, path: FloatArray, feet: FloatArray, ok: NDArray[np.bool_], height_um: Int64s
) -> None:
    """Fills ok (n, 2), whether foot and body are free at each point, and the ground's height."""
    for i in range(len(path)):
        cos, sin = math.cos(path[i, 2]), math.sin(path[i, 2])
        x, y = path[i, 0], path[i, 1]
        if not box_free(lattice.terrain, x, y, cos, sin, lattice.body):
            continue
        for side in range(2):
            x, y = feet[side, i, 0], feet[side, i, 1]
            ok[i, side] = box_free(lattice.terrain, x, y, cos, sin, lattice.foot)
            if ok[i, side] and len(lattice.node_um) > 0:
                height_um[i, side] = level_height_um(lattice, (x, y, cos, sin))
                ok[i, side] = height_um[i, side] != NO_GROUND_UM


@njit_inner
def _extra_cost(
    lattice: Lattice,
    support: FloatArray,
    swing: FloatArray,
    side: int,
    heights_um: tuple[int, int],
    body: RoundedBox,
) -> int:
    """Clearance cost of a step between two feet (3,); -1 if it hits an obstacle or climbs too far.

    side: of the swing foot. heights_um: of the ground under support and swing foot.
    """
    x, y = 0.5 * (support[0] + swing[0]), 0.5 * (support[1] + swing[1])
    turn = (swing[2] - support[2] + math.pi) % (2 * math.pi) - math.pi
    yaw = support[2] + 0.5 * turn
    if not box_free(lattice.terrain, x, y, math.cos(yaw), math.sin(yaw), body):
        return -1
    if len(lattice.node_um) > 0 and not feet_climb(
        lattice, foot_at(support), foot_at(swing), heights_um[0], heights_um[1], side
    ):
        return -1
    return clearance_cost(lattice, point_clearance(lattice.terrain, x, y))


@njit_no_refcount
def check_seeds(
    lattice: Lattice,
    standing: FloatArray,
    standing_um: Int64s,
    feet: FloatArray,
    height_um: Int64s,
    ok: NDArray[np.bool_],
    body: RoundedBox,
    seeds_um: Int64s,
) -> None:
    """Adds clearance to the costs (m, 2) of first steps; 0 for those that are not valid."""
    for i in range(len(seeds_um)):
        for side in range(2):
            if seeds_um[i, side] == 0:
                continue
            extra = -1
            if ok[i, side]:
                heights = standing_um[1 - side], height_um[i, side]
                support = standing[1 - side]
                extra = _extra_cost(lattice, support, feet[side, i], side, heights, body)
            seeds_um[i, side] = seeds_um[i, side] + extra if extra >= 0 else 0


@njit_no_refcount
def cheapest_steps(
    lattice: Lattice,
    feet: FloatArray,
    height_um: Int64s,
    ok: NDArray[np.bool_],
    cost_um: Int64s,
    seeds_um: Int64s,
    best_um: Int64s,
    before: Int64s,
) -> None:
    """Fills the least costs (n, 2) and the points stepped from, point by point."""
    for i in range(len(seeds_um)):
        for side in range(2):
            if seeds_um[i, side] > 0:
                best_um[i, side], before[i, side] = seeds_um[i, side], START
    for i in range(len(best_um)):
        # The cheaper foot first: the other may come beside it.
        first = 0 if best_um[i, 0] <= best_um[i, 1] else 1
        for support in (first, 1 - first):
            if best_um[i, support] == NO_COST:
                continue
            swing = 1 - support
            for ahead in range(cost_um.shape[1]):
                step = cost_um[i, ahead, swing]
                if step == 0 or not ok[i + ahead, swing]:
                    continue
                to, there = i + ahead, best_um[i, support] + step
                if there >= best_um[to, swing]:
                    continue
                heights = height_um[i, support], height_um[to, swing]
                stands, lands = feet[support, i], feet[swing, to]
                extra = _extra_cost(lattice, stands, lands, swing, heights, lattice.body)
                if extra >= 0 and there + extra < best_um[to, swing]:
                    best_um[to, swing], before[to, swing] = there + extra, i


def feet_beside(poses: FloatArray, model: StepModel) -> FloatArray:
    """Feet (2, n, 3) of a robot that stands at poses (n, 3)."""
    away = np.stack([-np.sin(poses[:, 2]), np.cos(poses[:, 2]), np.zeros(len(poses))], axis=1)
    half_m = model.stance_width_m / 2
    return np.stack([poses + side.outward * half_m * away for side in Side])


def resample(corners: FloatArray) -> FloatArray:
    """Poses (n, 3) along straight motions between corners (m, 3), evenly spaced.

    Headings turn the shorter way and are not wrapped.
    """
    moves = np.diff(corners, axis=0)
    moves[:, 2] = wrap_angle(moves[:, 2])
    far = np.maximum(
        np.hypot(moves[:, 0], moves[:, 1]) / _SPACING_M, np.abs(moves[:, 2]) / _SPACING_RAD
    )
    counts = np.ceil(far - 1e-9).astype(np.int64)
    move = np.repeat(np.arange(len(moves)), counts)
    part = np.arange(len(move)) - (np.cumsum(counts) - counts)[move] + 1
    begins = corners[0] + np.concatenate([np.zeros((1, 3)), np.cumsum(moves, axis=0)])
    path = begins[move] + (part / counts[move])[:, None] * moves[move]
    return np.concatenate([corners[:1], path])


class PathFootsteps:
    """The cheapest steps along a path (n, 3) from a stance to every point that they reach.

    end: the last point reached, START for none.
    """

    def __init__(
        self, lattice: Lattice, model: StepModel, path: FloatArray, stance: Stance
    ) -> None:
        self._feet = feet_beside(path, model)
        number = len(path)
        ok = np.zeros((number, 2), np.bool_)
        self._height_um = np.zeros((number, 2), np.int64)
        check_feet(lattice, path, self._feet, ok, self._height_um)
        after = np.minimum(np.arange(number)[:, None] + np.arange(_POINTS_AHEAD), number - 1)
        beyond = np.arange(number)[:, None] + np.arange(_POINTS_AHEAD) >= number
        cost_um = np.zeros((number, _POINTS_AHEAD, 2), np.int64)
        seeds_um = np.zeros((min(_POINTS_AHEAD, number), 2), np.int64)
        for side in Side:
            support, swing = self._feet[side.other], self._feet[side]
            cost_um[:, :, side] = step_costs(support[:, None], swing[after], side.outward, model)
            cost_um[beyond, side] = 0
            if stance.first_side in (None, side):
                standing = stance.feet[side.other]
                seeds_um[:, side] = step_costs(
                    standing, swing[: len(seeds_um)], side.outward, model
                )
        body = rounded_box(model.body, stance.pair_margin_m)
        standing_um = np.rint(stance.feet_m * MICRO).astype(np.int64)
        ground = self._feet, self._height_um, ok
        check_seeds(lattice, stance.feet, standing_um, *ground, body, seeds_um)
        self._cost_um = np.full((number, 2), NO_COST)
        self._before = np.full((number, 2), UNREACHED)
        cheapest_steps(lattice, *ground, cost_um, seeds_um, self._cost_um, self._before)
        reached = np.nonzero(self._cost_um.min(axis=1) < NO_COST)[0]
        self.end = int(reached[-1]) if len(reached) else START
        self._arrives = self.end == number - 1 and bool(ok[-1].all())

    def to_end(self) -> Footsteps | None:
        """Steps to both feet beside the path's last pose; None if that is not reached."""
        if not self._arrives:
            return None
        last = len(self._before) - 1
        side = Side(int(np.argmin(self._cost_um[last])))
        return self._trace(last, side).then(self._steps([side.other], [last]))

    def to_point(self, point: int) -> tuple[int, Footsteps]:
        """The last point reached up to a given one, and the steps to it."""
        costs = self._cost_um[: max(point, 0) + 1]
        reached = np.nonzero(costs.min(axis=1, initial=NO_COST) < NO_COST)[0]
        if point < 0 or not len(reached):
            return START, NO_STEPS
        last = int(reached[-1])
        return last, self._trace(last, Side(int(np.argmin(costs[last]))))

    def _trace(self, point: int, side: Side) -> Footsteps:
        sides: list[Side] = []
        points: list[int] = []
        while point != START:
            sides.append(side)
            points.append(point)
            point, side = int(self._before[point, side]), side.other
        sides.reverse()
        points.reverse()
        return self._steps(sides, points)

    def _steps(self, sides: list[Side], points: list[int]) -> Footsteps:
        return Footsteps(
            side=np.array(sides, np.int8),
            pose=self._feet[sides, points],
            z_m=self._height_um[points, sides] / MICRO,
        )
