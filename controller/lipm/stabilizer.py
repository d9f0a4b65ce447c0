"""Feedback of the divergent component of motion (DCM), and the force that each foot shall exert.

The DCM c + cd / omega is the part of the pendulum that runs away from the ZMP. Proportional and
integral feedback on it asks for a net wrench, and a quadratic program shares that out between the
feet that stand: Caron, Kheddar, Tempier 2019, sec. III and IV. The cone of wrenches of a
rectangular sole is that of Caron, Pham, Nakamura 2015, "Stability of surface contacts for humanoid
robots: closed-form formulae of the contact wrench cone for rectangular support areas", eq. 16 to
22.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import daqp
import numpy as np

from controller.lipm.pattern import OPTIMAL, StageFailed
from sim.robot import GRAVITY_M_S2

# Feedback, 1/s and 1/s2; the mean error is taken over this time and clipped.
PROPORTIONAL_HZ, INTEGRAL_HZ2 = 5.0, 10.0
MEAN_OVER_S, MEAN_LIMIT_M = 10.0, 0.05
# Readings of the velocity are averaged over this time where joint rates are noisy.
VELOCITY_FILTER_S = 0.03
# Weights of squares: net wrench missed, moment about the sole's middle, share of the feet.
WRENCH_WEIGHT, MOMENT_WEIGHT, SHARE_WEIGHT = 10000.0, 100.0, 1.0
FRICTION = 0.7
LEAST_FORCE_N = 15.0
# The pressure keeps to this share of a sole: on its very edge the foot would roll.
PRESSURE_SHARE = 0.96


@dataclass
class DcmFeedback:
    """Acceleration of the centre of mass that brings the DCM back with the set gains."""

    omega: float
    mean_error_m: np.ndarray = field(default_factory=lambda: np.zeros(2))

    def acceleration(
        self,
        reference: tuple[np.ndarray, np.ndarray, np.ndarray],
        com: np.ndarray,
        velocity: np.ndarray,
        time_s: float,
    ) -> np.ndarray:
        """The acceleration (2,) asked for, after `time_s` more.

        With the reference's own acceleration a, its DCM error e then obeys de/dt = -kp e - ki
        mean(e): the pendulum's dynamics are cancelled.

        Args:
            reference: position, velocity and acceleration (2,) of the pattern.
            com: the centre of mass (2,) as it is.
            velocity: its velocity (2,).
            time_s: since the last call.
        """
        com_d, velocity_d, acceleration_d = reference
        lag = velocity_d - velocity
        error = com_d - com + lag / self.omega
        self.mean_error_m = self.mean_error_m + time_s / MEAN_OVER_S * (error - self.mean_error_m)
        self.mean_error_m = np.clip(self.mean_error_m, -MEAN_LIMIT_M, MEAN_LIMIT_M)
        pull = PROPORTIONAL_HZ * error + INTEGRAL_HZ2 * self.mean_error_m + lag
        return acceleration_d + self.omega * pull


@dataclass
class VelocityFilter:
    """Velocity of the centre of mass (2,) of a robot that goes by noisy joint rates.

    Between readings it is integrated with the acceleration that the pressure under the soles says,
    omega^2 (c - p), so the filter delays nothing but a push.
    """

    omega: float
    velocity: np.ndarray = field(default_factory=lambda: np.zeros(2))

    def update(
        self, com: np.ndarray, measured: np.ndarray, soles: np.ndarray, borne: np.ndarray,
        time_s: float,
    ) -> np.ndarray:  # fmt: skip
        """The velocity (2,) now, `time_s` after the last reading.

        Args:
            com: the centre of mass (2,).
            measured: its velocity (2,) by the joints.
            soles: poses of the soles (2, 4) x, y, z, yaw.
            borne: wrenches (2, 6) that they bear, about their middles and in their axes.
            time_s: since the last call.
        """
        force_n = borne[:, 2].sum()
        predicted = self.velocity
        if force_n > LEAST_FORCE_N:
            cos, sin = np.cos(soles[:, 3]), np.sin(soles[:, 3])
            along, across = -borne[:, 4], borne[:, 3]
            shift = np.column_stack([cos * along - sin * across, sin * along + cos * across])
            pressure = (soles[:, :2] * borne[:, 2:3] + shift).sum(axis=0) / force_n
            predicted = predicted + time_s * self.omega**2 * (com - pressure)
        trust = min(time_s / VELOCITY_FILTER_S, 1.0)
        self.velocity = predicted + trust * (measured - predicted)
        return self.velocity


def wrench_cone(half_sole_m: np.ndarray) -> np.ndarray:
    """Rows (16, 6): `rows @ wrench <= 0` for what a sole can bear.

    The wrench is force, then moment about the sole's middle, in the sole's axes.
    """
    x, y = half_sole_m
    mu, rows = FRICTION, []
    pyramid = mu / np.sqrt(2)
    for sign in (-1, 1):
        rows += [
            [sign, 0, -pyramid, 0, 0, 0],
            [0, sign, -pyramid, 0, 0, 0],
            [0, 0, -y, sign, 0, 0],
            [0, 0, -x, 0, sign, 0],
        ]
    for turn in (-1, 1):
        for a in (-1, 1):
            for b in (-1, 1):
                # turn * mz <= mu (x + y) fz - |y fx + turn mu mx| - |x fy + turn mu my|
                rows.append([a * y, b * x, -mu * (x + y), a * turn * mu, b * turn * mu, turn])
    return np.array(rows, dtype=float)


class ForceDistribution:
    """Shares a net wrench out between the soles that stand."""

    def __init__(self, half_sole_m: np.ndarray):
        cone = np.vstack([wrench_cone(PRESSURE_SHARE * half_sole_m), [0, 0, -1, 0, 0, 0]])
        bound = np.array([*np.zeros(len(cone) - 1), -LEAST_FORCE_N])
        # Of two feet; one has the first half of each.
        self._bounds = np.kron(np.eye(2), cone)
        self._upper = np.tile(bound, 2)
        moments = np.array([0, 0, 0, MOMENT_WEIGHT, MOMENT_WEIGHT, 0])
        self._least_cost = np.diag(np.tile(moments + 1e-3, 2))
        self.relaxed = 0

    def share(
        self,
        mass_kg: float,
        com: np.ndarray,
        acceleration: np.ndarray,
        soles: np.ndarray,
        rotations: np.ndarray,
        load: np.ndarray,
    ) -> np.ndarray:
        """Wrench (2, 6) of the ground on each sole: force, moment about its middle, world axes.

        Args:
            mass_kg: of the robot.
            com: its centre of mass (3,).
            acceleration: wanted of it (3,).
            soles: middles of the soles (2, 3).
            rotations: of the soles in the world (2, 3, 3).
            load: share (2,) of the weight that each foot shall bear, of sum 1; 0 in the air.

        Raises:
            StageFailed: there is no solution, even without cones.
        """
        feet = np.flatnonzero(load > 0)
        force = mass_kg * (acceleration + np.array([0, 0, GRAVITY_M_S2]))
        wanted = np.concatenate([force, np.zeros(3)])
        count = len(feet)
        # Of wrenches in the axes of the soles: what they come to about the centre of mass.
        balance, row = np.zeros((6, 6 * count)), np.zeros(6 * count)
        for k, foot in enumerate(feet):
            rotation = rotations[foot]
            forces, moments = slice(6 * k, 6 * k + 3), slice(6 * k + 3, 6 * k + 6)
            balance[:3, forces] = balance[3:, moments] = rotation
            balance[3:, forces] = cross_matrix(soles[foot] - com) @ rotation
            row[forces] = (1 - load[foot]) * (1 if k else -1) * rotation[2]
        cost = WRENCH_WEIGHT * balance.T @ balance + self._least_cost[: 6 * count, : 6 * count]
        if count == 2:
            cost += SHARE_WEIGHT * np.outer(row, row)
        slope = -WRENCH_WEIGHT * balance.T @ wanted
        rows = len(self._upper) // 2 * count
        bounds, upper = self._bounds[:rows, : 6 * count], self._upper[:rows]
        found = _minimum(cost, slope, bounds, upper)
        if found is None:
            self.relaxed += 1
            found = _minimum(cost, slope, bounds[:0], upper[:0])
        if found is None:
            raise StageFailed("the distribution of forces has no solution")
        wrenches = np.zeros((2, 6))
        for k, foot in enumerate(feet):
            wrenches[foot] = (found[6 * k : 6 * k + 6].reshape(2, 3) @ rotations[foot].T).ravel()
        return wrenches


def _minimum(
    cost: np.ndarray, slope: np.ndarray, bounds: np.ndarray, upper: np.ndarray
) -> np.ndarray | None:
    found, _, flag, _ = daqp.solve(
        cost,
        slope,
        np.ascontiguousarray(bounds),
        upper,
        np.full(len(upper), -1e30),
        np.zeros(len(upper), np.int32),
    )
    return np.asarray(found) if flag == OPTIMAL and np.isfinite(found).all() else None


def cross_matrix(arm: np.ndarray) -> np.ndarray:
    """The matrix (3, 3) that multiplies a vector as `arm x vector`."""
    x, y, z = arm
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
