"""Refinement of a plan off the lattice: its steps move to where they cost less, and get fewer.

The steps are moved within their limits and clear of obstacles to the least cost (`interior_point`).
A straighter path needs fewer steps: it is resampled with fewer and longer ones and relaxed again,
as long as that is valid and cheaper. The last two feet stay those of the goal.

Where turning is cheap, walking straight with both feet turned out would be cheapest, because the
line from foot to foot crosses over less. No robot should walk like that, so a radian costs at least
_LEAST_TURN_COST_M during refinement. The plan is taken only if it is cheaper by its own cost too.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.compiled import njit_no_refcount
from planner.lattice.frame import poses_from_grid, poses_to_grid
from planner.lattice.lattice import Lattice
from planner.lattice.steps import MICRO
from planner.refinement.constraints import new_workspace
from planner.refinement.cost import (
    NOT_ALLOWED,
    RefinementProblem,
    foot_height_um,
    plan_cost_um,
    refinement_problem,
    turn_between,
)
from planner.refinement.interior_point import relax
from planner.robot_model import StepModel
from planner.search.problem import Request, Result
from planner.time_limit import is_late

FloatArray = NDArray[np.float64]
_ITERATIONS = 12  # of one attempt; nearly all that succeed need fewer
_LAST_ITERATIONS = 20
_LEAST_TURN_COST_M = 0.2
_PARTS = 10  # at first one step in so many is left out


class _FootPath(NamedTuple):
    """Poses (N + 1, 3) as in `cost.py`, the sign of the first step's side, and the cost."""

    poses: FloatArray
    outward: float
    cost_um: int


def refine(request: Request, result: Result) -> Result:
    """The result of a search with its steps moved, and perhaps fewer, at a lower cost.

    The same result where nothing cheaper is found. Ends early where a limit on the time passes.
    """
    lattice, model = request.lattice, request.model
    if len(result.side) <= 2:
        return result
    feet = poses_to_grid(lattice.frame, request.feet_lattice)
    problem = refinement_problem(lattice, model, feet, request.feet_um, request.pair_margin_m)
    outward = 1.0 - 2.0 * result.side[0]
    poses = np.vstack([request.feet_lattice[1 - result.side[0]], result.pose_lattice])
    poses = poses_to_grid(lattice.frame, poses)
    turn = max(problem.weights.turn, _LEAST_TURN_COST_M)
    straight = problem._replace(weights=problem.weights._replace(turn=turn))
    before_um = plan_cost_um(straight, poses, outward)
    if before_um == NOT_ALLOWED:
        return result
    swaps = (False,) if request.first_side is not None else (False, True)
    found, outward, _ = _shorten(straight, _FootPath(poses, outward, before_um), swaps)
    found_um = plan_cost_um(problem, found, outward)
    if not 0 <= found_um < round(result.cost_m * MICRO):
        return result
    first = 0 if outward > 0 else 1
    side = ((np.arange(len(found) - 1) + first) % 2).astype(np.int8)
    pose_lattice = poses_from_grid(lattice.frame, found[1:])
    # The goal feet are the same to the bit.
    goals = {int(s): p for s, p in zip(result.side[-2:], result.pose_lattice[-2:], strict=True)}
    pose_lattice[-2:] = [goals[int(s)] for s in side[-2:]]
    height_um = np.zeros(len(side))
    if not lattice.terrain.is_flat:
        height_um[:] = [foot_height_um(lattice, pose) for pose in found[1:]]
    return replace(
        result,
        side=side,
        pose_lattice=pose_lattice,
        z_m=height_um / MICRO,
        cost_m=found_um / MICRO,
    )


def compile_refinement(lattice: Lattice, model: StepModel) -> None:
    """Compiles all that `refine` calls, on a path that need not be valid."""
    path = np.zeros((5, 3))
    path[:, 0] = np.linspace(0.0, 1.0, 5)
    problem = refinement_problem(lattice, model, path[:2].copy(), np.zeros(2, np.int64), 0.0)
    plan_cost_um(problem, path, 1.0)
    _relaxed(problem, _FootPath(path, 1.0, 0), 4, False, 2, 0)
    foot_height_um(lattice, path[0])


# Not compiled: it makes few calls, and would take long to compile.
def _shorten(problem: RefinementProblem, found: _FootPath, swaps: tuple[bool, ...]) -> _FootPath:
    """The cheapest path found, with as many steps as the given one or fewer.

    swaps: whether the other foot may go first, or both.
    """
    best = _relaxed(problem, found, len(found.poses) - 1, False, _ITERATIONS, 0)
    fewer = max(1, len(found.poses) // _PARTS)
    while fewer > 0:
        before, steps = best, len(best.poses) - 1 - fewer
        for swap in swaps:
            if steps >= 2 and best is before and not is_late():
                best = _relaxed(problem, before, steps, swap, _ITERATIONS, before.cost_um)
        if best is before:
            fewer = 1 if fewer > 1 else 0
    for swap in swaps:
        if not is_late():
            best = _relaxed(problem, best, len(best.poses) - 1, swap, _LAST_ITERATIONS, 0)
    return best


def _relaxed(
    problem: RefinementProblem,
    path: _FootPath,
    steps: int,
    swap: bool,
    iterations: int,
    enough_um: int,
) -> _FootPath:
    """A path with so many steps along another one, relaxed; the other one if it is no cheaper.

    swap: the other foot goes first. iterations, enough_um: as in `relax`.
    """
    trial = np.empty((steps + 1, 3))
    _resample(problem.feet, path.poses, path.outward, swap, trial)
    outward = -path.outward if swap else path.outward
    best = np.empty_like(trial)
    workspace = new_workspace(problem.lattice, steps, len(problem.reach))
    cost_um = relax(problem, workspace, trial, outward, iterations, enough_um, best)
    if cost_um == NOT_ALLOWED or cost_um >= path.cost_um:
        return path
    return _FootPath(best, outward, cost_um)


@njit_no_refcount
def _resample(
    feet: FloatArray, poses: FloatArray, outward: float, swap: bool, path: FloatArray
) -> None:
    """Fills a path (steps + 1, 3) along another (N + 1, 3) that begins at feet (2, 3).

    Left and right feet each follow the line through their places in the old path, at equal times.
    swap: the other foot goes first.
    """
    old, steps = len(poses) - 1, len(path) - 1
    for i in range(steps + 1):
        # Even numbers of the old path are the first support foot's.
        parity = (i + 1) % 2 if swap else i % 2
        at = i * old / steps
        before = 2 * math.floor((at - parity) / 2.0) + parity
        if i >= steps - 1 or before + 2 > old:
            last = poses[old if old % 2 == parity else old - 1]
            path[i, 0], path[i, 1], path[i, 2] = last[0], last[1], last[2]
            continue
        # The foot that went first in the old path stood at the start until then.
        first = feet[0 if outward > 0 else 1] if before < 0 else poses[before]
        part = (at - before) / 2.0
        turn = turn_between(first[2], poses[before + 2, 2])
        path[i, 0] = first[0] + part * (poses[before + 2, 0] - first[0])
        path[i, 1] = first[1] + part * (poses[before + 2, 1] - first[1])
        path[i, 2] = first[2] + part * turn
    begin = feet[0 if outward > 0 else 1] if swap else poses[0]
    path[0, 0], path[0, 1], path[0, 2] = begin[0], begin[1], begin[2]
