"""Interior-point method that moves the steps of a path to lower their cost, compiled.

Newton's method on the barrier problem with slack variables (Nocedal and Wright, "Numerical
Optimization", 2006, section 19.3): minimise f(z) - mu sum log s subject to c(z) = s, s > 0, with
the constraints c(z) linearised in every iteration. With slacks it may begin where constraints are
violated. The matrix is banded, so an iteration takes time proportional to the number of steps.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planner.compiled import njit_inner, njit_no_refcount
from planner.lattice.steps import MICRO
from planner.refinement.constraints import (
    MARGIN_M,
    Workspace,
    add_block,
    evaluate_constraints,
)
from planner.refinement.cost import (
    NOT_ALLOWED,
    RefinementProblem,
    add,
    add_clearance_cost,
    add_step_cost,
    plan_cost_um,
)

FloatArray = NDArray[np.float64]
_MOST_M, _MOST_RAD = 0.06, 0.15  # that a pose moves in one iteration
_DAMP_POSITION, _DAMP_YAW = 0.3, 0.1
_FIRST_MU, _LAST_MU = 1e-2, 1e-5
_LEAST_SLACK_M = 0.01
_TO_BOUNDARY = 0.95  # of the way to the boundary, at most, in one iteration


@njit_no_refcount
def relax(
    problem: RefinementProblem,
    workspace: Workspace,
    poses: FloatArray,
    first_outward: float,
    iterations: int,
    enough_um: int,
    best: FloatArray,
) -> int:
    """Moves the free poses of a path (N + 1, 3) to lower its cost.

    workspace: for N steps, of zeros. Ends after so many iterations, or when a valid path costs less
    than enough_um. best (N + 1, 3): receives the cheapest valid path. Returns its cost in
    micrometres, NOT_ALLOWED if there is none.
    """
    if len(poses) <= 3:
        _copy(poses, best)
        return plan_cost_um(problem, poses, first_outward)
    is_flat = len(problem.lattice.node_um) == 0
    mu, least_m = _FIRST_MU, math.inf
    for iteration in range(iterations):
        worst, cost_m = _build(problem, workspace, poses, first_outward, mu)
        # The constraints cover everything but the heights of stairs.
        cheaper = worst < MARGIN_M and cost_m < least_m
        if cheaper and (is_flat or plan_cost_um(problem, poses, first_outward) != NOT_ALLOWED):
            least_m = cost_m
            _copy(poses, best)
            if least_m * MICRO < enough_um:
                break
        if iteration == iterations - 1 or not solve_banded(workspace.matrix, workspace.right):
            break
        mu = min(mu, max(_LAST_MU, 0.3 * _advance(workspace, poses, mu)))
    if least_m == math.inf:
        return NOT_ALLOWED
    return plan_cost_um(problem, best, first_outward)


@njit_inner
def _copy(poses: FloatArray, to: FloatArray) -> None:
    # Assigned as a whole they would bring along, compiled, the text of an error on their shapes.
    for i in range(len(poses)):
        to[i, 0], to[i, 1], to[i, 2] = poses[i, 0], poses[i, 1], poses[i, 2]


@njit_inner
def _build(
    problem: RefinementProblem,
    workspace: Workspace,
    poses: FloatArray,
    first_outward: float,
    mu: float,
) -> tuple[float, float]:
    """Builds the system at the poses; returns the worst violation, and the cost."""
    value, gradient = workspace.value, workspace.gradient
    slack, multiplier = workspace.slack, workspace.multiplier
    active, step = workspace.active, workspace.step
    matrix, right = workspace.matrix, workspace.right
    block, along, weights = workspace.block, workspace.along, problem.weights
    terrain, clearance = problem.lattice.terrain, problem.lattice.clearance
    matrix[:] = 0.0
    right[:] = 0.0
    for k in range(len(right)):
        matrix[k, 0] = _DAMP_YAW if k % 3 == 2 else _DAMP_POSITION
    was = workspace.was_active
    for i in range(len(value)):
        for row in range(value.shape[1]):
            was[i, row] = active[i, row]
    evaluate_constraints(problem, workspace, poses, first_outward)
    # The last step, from one foot of the goal to the other, has no constraints and a fixed cost.
    worst, cost_m = 0.0, weights[0] + weights[1]
    for i in range(len(value)):
        block[:] = 0.0
        cost_m += add_step_cost(weights, i, step, along, block)
        if clearance[2] > 0.0:
            cost_m += add_clearance_cost(terrain, clearance, poses, i, along, block)
        for row in range(value.shape[1]):
            if not active[i, row]:
                continue
            worst = max(worst, -value[i, row])
            if not was[i, row]:
                slack[i, row] = max(value[i, row], _LEAST_SLACK_M)
                multiplier[i, row] = mu / slack[i, row]
            curvature = multiplier[i, row] / slack[i, row]
            pull = mu / slack[i, row] - curvature * (value[i, row] - slack[i, row])
            add(block, curvature, gradient[i, row], pull)
        add_block(block, i, matrix, right)
    return worst, cost_m


@njit_inner
def solve_banded(matrix: FloatArray, right: FloatArray) -> bool:
    """Solves the banded system in place by Cholesky's method; False if it is not definite."""
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


@njit_inner
def _advance(workspace: Workspace, poses: FloatArray, mu: float) -> float:
    """Takes the Newton step as far as allowed; returns the mean of slack times multiplier.

    Slacks move by ds = A dz + c - s, multipliers by dl = mu / s - l - l / s ds.
    """
    value, gradient = workspace.value, workspace.gradient
    slack, multiplier = workspace.slack, workspace.multiplier
    active, newton, right = workspace.active, workspace.newton, workspace.right
    part, dual = 1.0, 1.0
    for k in range(len(right)):
        most = _MOST_RAD if k % 3 == 2 else _MOST_M
        part = min(part, most / max(abs(right[k]), most))
    for i in range(len(value)):
        base = 3 * (i - 1)
        for row in range(value.shape[1]):
            if not active[i, row]:
                continue
            s, f = slack[i, row], multiplier[i, row]
            d_slack = value[i, row] - s
            for a in range(max(0, -base), min(6, len(right) - base)):
                d_slack += gradient[i, row, a] * right[base + a]
            d_multiplier = mu / s - f - f / s * d_slack
            newton[i, row, 0], newton[i, row, 1] = d_slack, d_multiplier
            if part * d_slack < -_TO_BOUNDARY * s:
                part = -_TO_BOUNDARY * s / d_slack
            if dual * d_multiplier < -_TO_BOUNDARY * f:
                dual = -_TO_BOUNDARY * f / d_multiplier
    total, number = 0.0, 0
    for i in range(len(value)):
        for row in range(value.shape[1]):
            if active[i, row]:
                slack[i, row] += part * newton[i, row, 0]
                multiplier[i, row] += dual * newton[i, row, 1]
                total += slack[i, row] * multiplier[i, row]
                number += 1
    for k in range(len(right)):
        poses[1 + k // 3, k % 3] += part * right[k]
    return total / number
