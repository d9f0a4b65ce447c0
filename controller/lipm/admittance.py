"""Admittance of the feet: soles give way until the ground's wrenches are those asked for.

The joints are stiff, so a sole that turns or sinks by little changes the wrench by much. Foot
damping turns a sole with the moment that it bears in excess, and the difference of the feet's
forces raises one and lowers the other: Kajita et al. 2010, "Biped walking stabilization based on
linear inverted pendulum tracking"; gains as in Caron, Kheddar, Tempier 2019, sec. V.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from controller.lipm.stabilizer import cross_matrix

# rad/s per N m of moment and m/s per N of difference of forces, with their limits.
DAMPING, DAMPING_LIMIT_RAD_S = 0.01, 0.2
DIFFERENCE, DIFFERENCE_LIMIT_M_S = 1e-4, 0.05
# Both go back to nothing within about this time, and never farther than that.
RETURN_S, IN_THE_AIR_S = 1.0, 0.1
TILT_LIMIT_RAD, HEIGHT_LIMIT_M = 0.12, 0.02


@dataclass
class FootAdmittance:
    """How each sole is turned and raised: `tilt_rad` (2, 2) roll, pitch; `height_m` (2,)."""

    tilt_rad: np.ndarray = field(default_factory=lambda: np.zeros((2, 2)))
    height_m: np.ndarray = field(default_factory=lambda: np.zeros(2))

    def follow(
        self,
        wanted: np.ndarray,
        measured: np.ndarray,
        standing: np.ndarray,
        time_s: float,
    ) -> None:
        """Give way for a time under wrenches (2, 6) of the ground, in the axes of the soles.

        Moments are about the soles' middles. A sole that is not `standing` (2,) goes back to how it
        would be without admittance; the difference of forces counts where both are.
        """
        return_s = np.where(standing, RETURN_S, IN_THE_AIR_S)
        excess = np.where(standing[:, None], measured[:, 3:5] - wanted[:, 3:5], 0.0)
        rate = np.clip(DAMPING * excess, -DAMPING_LIMIT_RAD_S, DAMPING_LIMIT_RAD_S)
        rate = rate - self.tilt_rad / return_s[:, None]
        self.tilt_rad = np.clip(self.tilt_rad + time_s * rate, -TILT_LIMIT_RAD, TILT_LIMIT_RAD)
        rise = 0.0
        if standing.all():
            left, right = measured[:, 2] - wanted[:, 2]
            rise = float(
                np.clip(DIFFERENCE * (left - right), -DIFFERENCE_LIMIT_M_S, DIFFERENCE_LIMIT_M_S)
            )
        rates = np.array([rise, -rise]) / 2 - self.height_m / return_s
        self.height_m = np.clip(self.height_m + time_s * rates, -HEIGHT_LIMIT_M, HEIGHT_LIMIT_M)


def sole_wrench(
    force_world: np.ndarray, pressure_world: np.ndarray, sole: np.ndarray, rotation: np.ndarray
) -> np.ndarray:
    """Wrench (6,) about a sole's middle (3,), in its axes (3, 3), of a force at a point."""
    moment = cross_matrix(pressure_world - sole) @ force_world
    return np.concatenate([rotation.T @ force_world, rotation.T @ moment])


def upward_wrenches(force_n: np.ndarray, pressure_sole_m: np.ndarray) -> np.ndarray:
    """Wrenches (2, 6) about the soles' middles, in their axes, of what force sensors tell.

    Upward forces (2,) at centres of pressure x, y (2, 2) in the soles' axes; forces along the sole
    have no moment about its x and y.
    """
    wrenches = np.zeros((2, 6))
    wrenches[:, 2] = force_n
    wrenches[:, 3] = pressure_sole_m[:, 1] * force_n
    wrenches[:, 4] = -pressure_sole_m[:, 0] * force_n
    return wrenches


def tilted(yaw_rad: float, tilt_rad: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) of a sole of this heading, rolled and pitched (2,) in its own axes."""
    roll, pitch = tilt_rad
    cy, sy = np.cos(yaw_rad), np.sin(yaw_rad)
    cp, sp, cr, sr = np.cos(pitch), np.sin(pitch), np.cos(roll), np.sin(roll)
    heading = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    pitched = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    rolled = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    return heading @ pitched @ rolled
