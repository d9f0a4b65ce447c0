"""Interior-point method that moves the steps of a chain to where they cost least, compiled.

Newton's method on the barrier problem with slack variables (Nocedal and Wright, "Numerical
Optimization", 2006, section 19.3): minimise f(z) - mu sum log s subject to c(z) = s, s > 0, with
the distances c(z) made linear anew in every iteration. Slacks let it begin where rules are broken.
The matrix is banded (`barrier.py`), so an iteration takes time proportional to the number of steps.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planner.compiled import njit_arrays, njit_no_refcount
from planner.lattice.steps import MICRO
from planner.refinement.constraints import (
    SPARE_M,
    Work,
    add,
    new_work,
    note_clearance,
    note_costs,
    note_rules,
    take_block,
)
from planner.refinement.cost import NOT_ALLOWED, Rules, chain_cost_um

FloatArray = NDArray[np.float64]
_MOST_M, _MOST_RAD = 0.06, 0.15  # that a pose moves in one iteration
_DAMP_POSITION, _DAMP_YAW = 0.3, 0.1
_FIRST_MU, _LAST_MU = 1e-2, 1e-5
_LEAST_SLACK_M = 0.01
_TO_EDGE = 0.95  # part of the way to the edge of what is allowed that one iteration goes at most


@njit_arrays
def relax(
    rules: Rules,
    poses: FloatArray,
    first_outward: float,
    iterations: int,
    enough_um: int,
    best: FloatArray,
) -> int:
    """Moves the free poses of a chain (N + 1, 3) to lower its cost.

    Ends after so many iterations, or when a chain that breaks no rule costs less than enough_um.
    best (N + 1, 3): gets the cheapest such chain on the way. Returns its cost in micrometres, or
    NOT_ALLOWED if there was none.
    """
    if len(poses) <= 3:
        best[:] = poses
        return chain_cost_um(rules, poses, first_outward)
    work = new_work(rules.lattice, len(poses) - 1, len(rules.reach))
    is_flat = len(rules.lattice.node_um) == 0
    mu, least_m = _FIRST_MU, math.inf
    for iteration in range(iterations):
        worst, cost_m = _build(rules, work, poses, first_outward, mu)
        # The rules are all there is but for the heights of stairs.
        cheaper = worst < SPARE_M and cost_m < least_m
        if cheaper and (is_flat or chain_cost_um(rules, poses, first_outward) != NOT_ALLOWED):
            least_m = cost_m
            best[:] = poses
            if least_m * MICRO < enough_um:
                break
        if iteration == iterations - 1 or not _solve(work.matrix, work.right):
            break
        mu = min(mu, max(_LAST_MU, 0.3 * _advance(work, poses, mu)))
    if least_m == math.inf:
        return NOT_ALLOWED
    return chain_cost_um(rules, best, first_outward)


@njit_arrays
def _build(
    rules: Rules, work: Work, poses: FloatArray, first_outward: float, mu: float
) -> tuple[float, float]:
    """Builds the system at the poses; returns how far a rule is broken at worst, and the cost."""
    value, slope, slack, force = work.value, work.slope, work.slack, work.force
    active, matrix, right, step = work.active, work.matrix, work.right, work.step
    block, along, weights = work.block, work.along, rules.weights
    terrain, clearance = rules.lattice.terrain, rules.lattice.clearance
    matrix[:] = 0.0
    right[:] = 0.0
    for k in range(len(right)):
        matrix[k, 0] = _DAMP_YAW if k % 3 == 2 else _DAMP_POSITION
    was = active.copy()
    note_rules(rules, work, poses, first_outward)
    # The last step, from one foot of the goal to the other, has no rules and one cost.
    worst, cost_m = 0.0, weights[0] + weights[1]
    for i in range(len(value)):
        block[:] = 0.0
        cost_m += note_costs(weights, i, step, along, block)
        if clearance[2] > 0.0:
            cost_m += note_clearance(terrain, clearance, poses, i, along, block)
        for row in range(value.shape[1]):
            if not active[i, row]:
                continue
            worst = max(worst, -value[i, row])
            if not was[i, row]:
                slack[i, row] = max(value[i, row], _LEAST_SLACK_M)
                force[i, row] = mu / slack[i, row]
            curve = force[i, row] / slack[i, row]
            pull = mu / slack[i, row] - curve * (value[i, row] - slack[i, row])
            add(block, curve, slope, i, row, pull)
        take_block(block, i, matrix, right)
    return worst, cost_m


@njit_no_refcount
def _solve(matrix: FloatArray, right: FloatArray) -> bool:
    """Solves the banded system in place by Cholesky's method; whether it could be."""
    size, band = matrix.shape
    for row in range(size):
        low = max(0, row - band + 1)
        for column in range(low, row + 1):
            total = matrix[row, row - column]
            for k in range(max(low, column - band + 1), column):
                total -= matrix[row, row - k] * matrix[column, column - k]
            if column < row:
                matrix[row, row - column] = total / matrix[column, 0]
            elif total > 1e-12:
                matrix[row, 0] = math.sqrt(total)
            else:
                return False
        for k in range(low, row):
            right[row] -= matrix[row, row - k] * right[k]
        right[row] /= matrix[row, 0]
    for row in range(size - 1, -1, -1):
        for k in range(row + 1, min(size, row + band)):
            right[row] -= matrix[k, k - row] * right[k]
        right[row] /= matrix[row, 0]
    return True


@njit_no_refcount
def _advance(work: Work, poses: FloatArray, mu: float) -> float:
    """Goes along the solution as far as it may; returns the mean of slack times force.

    Slacks move by ds = A dz + c - s, forces by dl = mu / s - l - l / s ds.
    """
    value, slope, slack, force = work.value, work.slope, work.slack, work.force
    active, toward, right = work.active, work.toward, work.right
    part, dual = 1.0, 1.0
    for k in range(len(right)):
        most = _MOST_RAD if k % 3 == 2 else _MOST_M
        part = min(part, most / max(abs(right[k]), most))
    for i in range(len(value)):
        base = 3 * (i - 1)
        for row in range(value.shape[1]):
            if not active[i, row]:
                continue
            s, f = slack[i, row], force[i, row]
            d_slack = value[i, row] - s
            for a in range(max(0, -base), min(6, len(right) - base)):
                d_slack += slope[i, row, a] * right[base + a]
            d_force = mu / s - f - f / s * d_slack
            toward[i, row, 0], toward[i, row, 1] = d_slack, d_force
            if part * d_slack < -_TO_EDGE * s:
                part = -_TO_EDGE * s / d_slack
            if dual * d_force < -_TO_EDGE * f:
                dual = -_TO_EDGE * f / d_force
    total, number = 0.0, 0
    for i in range(len(value)):
        for row in range(value.shape[1]):
            if active[i, row]:
                slack[i, row] += part * toward[i, row, 0]
                force[i, row] += dual * toward[i, row, 1]
                total += slack[i, row] * force[i, row]
                number += 1
    for k in range(len(right)):
        poses[1 + k // 3, k % 3] += part * right[k]
    return total / number
