"""Where the feet stand and the steps that they take, at any poses, apart from the lattice.

All poses are x_m, y_m, yaw_rad in the grid frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.collision import point_clearance
from planner.lattice.lattice import Lattice, clearance_cost
from planner.lattice.steps import allowed, step_cost_um
from planner.plan import wrap_angle
from planner.robot_model import Side, StepModel

FloatArray = NDArray[np.float64]
Int64s = NDArray[np.int64]


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
    dx, dy = swing[..., 0] - support[..., 0], swing[..., 1] - support[..., 1]
    cos, sin = np.cos(support[..., 2]), np.sin(support[..., 2])
    turn = wrap_angle(swing[..., 2] - support[..., 2])
    steps = np.stack([cos * dx + sin * dy, out * (cos * dy - sin * dx), out * turn], axis=-1)
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
