"""Interior-point method that moves the steps of a chain to where they cost least, compiled.

Newton's method on the barrier problem with slack variables (Nocedal and Wright, "Numerical
Optimization", 2006, section 19.3): minimise f(z) - mu sum log s subject to c(z) = s, s > 0, with
the distances c(z) made linear anew in every iteration. Slacks let it begin where rules are broken.
The matrix is banded (`barrier.py`), so an iteration takes time proportional to the number of steps.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planner.barrier import Work, add, new_work, note_costs, note_rules, take_block
from planner.chain import NOT_ALLOWED, Rules, chain_cost_um
from planner.keep_off import SPARE_M

FloatArray = NDArray[np.float64]
_MOST_M, _MOST_RAD = 0.06, 0.15  # that a pose moves in one iteration
_DAMP_POSITION, _DAMP_YAW = 0.3, 0.1
_FIRST_MU, _LAST_MU = 1e-2, 3e-6
_LEAST_SLACK_M = 0.01
_TO_EDGE = 0.95  # part of the way to the edge of what is allowed that one iteration goes at most


@njit(cache=True)
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
    work = new_work(rules.space, len(poses) - 1)
    mu, least = _FIRST_MU, NOT_ALLOWED
    for iteration in range(iterations):
        worst = _build(rules, work, poses, first_outward, mu)
        if worst < SPARE_M:
            cost = chain_cost_um(rules, poses, first_outward)
            if cost != NOT_ALLOWED and (least == NOT_ALLOWED or cost < least):
                least = cost
                best[:] = poses
                if least < enough_um:
                    break
        if iteration == iterations - 1 or not _solve(work.matrix, work.right):
            break
        mu = min(mu, max(_LAST_MU, 0.3 * _advance(work, poses, mu)))
    return least


@njit(cache=True)
def _build(rules: Rules, work: Work, poses: FloatArray, first_outward: float, mu: float) -> float:
    """Builds the system at the poses; returns by how much the worst rule is broken."""
    work.matrix[:] = 0.0
    work.right[:] = 0.0
    for k in range(len(work.right)):
        work.matrix[k, 0] = _DAMP_YAW if k % 3 == 2 else _DAMP_POSITION
    worst, outward = 0.0, first_outward
    was = np.empty(work.active.shape[1], np.bool_)
    for i in range(len(work.value)):
        was[:] = work.active[i]
        note_rules(rules, work, poses, i, outward)
        work.block[:] = 0.0
        note_costs(rules, work, poses, i)
        for row in range(len(was)):
            if not work.active[i, row]:
                continue
            value = work.value[i, row]
            worst = max(worst, -value)
            if not was[row]:
                work.slack[i, row] = max(value, _LEAST_SLACK_M)
                work.force[i, row] = mu / work.slack[i, row]
            slack, force = work.slack[i, row], work.force[i, row]
            curve = force / slack
            add(work.block, curve, work.slope[i, row], mu / slack - curve * (value - slack))
        take_block(work, i)
        outward = -outward
    return worst


@njit(cache=True)
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


@njit(cache=True)
def _advance(work: Work, poses: FloatArray, mu: float) -> float:
    """Goes along the solution as far as it may; returns the mean of slack times force.

    Slacks move by ds = A dz + c - s, forces by dl = mu / s - l - l / s ds.
    """
    part, dual = 1.0, 1.0
    for k in range(len(work.right)):
        most = _MOST_RAD if k % 3 == 2 else _MOST_M
        part = min(part, most / max(abs(work.right[k]), most))
    for i in range(len(work.value)):
        base = 3 * (i - 1)
        for row in range(work.value.shape[1]):
            if not work.active[i, row]:
                continue
            slack, force = work.slack[i, row], work.force[i, row]
            d_slack = work.value[i, row] - slack
            for a in range(max(0, -base), min(6, len(work.right) - base)):
                d_slack += work.slope[i, row, a] * work.right[base + a]
            d_force = mu / slack - force - force / slack * d_slack
            work.toward[i, row, 0], work.toward[i, row, 1] = d_slack, d_force
            if part * d_slack < -_TO_EDGE * slack:
                part = -_TO_EDGE * slack / d_slack
            if dual * d_force < -_TO_EDGE * force:
                dual = -_TO_EDGE * force / d_force
    total, number = 0.0, 0
    for i in range(len(work.value)):
        for row in range(work.value.shape[1]):
            if work.active[i, row]:
                work.slack[i, row] += part * work.toward[i, row, 0]
                work.force[i, row] += dual * work.toward[i, row, 1]
                total += work.slack[i, row] * work.force[i, row]
                number += 1
    for k in range(len(work.right)):
        poses[1 + k // 3, k % 3] += part * work.right[k]
    return total / number
