"""Footprints on the floor of films and strips: where feet are to stand, and where they did."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from app.pictures.canvas import LEFT, RIGHT
from planner.plan import FootstepPlan
from planner.robot_model import FootShape, Side

if TYPE_CHECKING:
    import mujoco

    from app.navigation.navigator import Placed

FloatArray = NDArray[np.float64]

_PLANNED_ALPHA, _PLACED_ALPHA = 0.35, 0.9
# Above one another, so that no two fight for the same pixels.
_PLANNED_THICKNESS_M, _PLACED_THICKNESS_M = 0.004, 0.007


@dataclass(frozen=True, kw_only=True)
class Footmarks:
    """Plates on the ground, each shown for a while.

    pose_world (N, 4) x, y, z, yaw of the ground below; rgba (N, 4) from 0 to 1; thickness_m (N,);
    each is shown from from_s (N,) until before until_s (N,).
    """

    foot: FootShape
    pose_world: FloatArray
    rgba: FloatArray
    thickness_m: FloatArray
    from_s: FloatArray
    until_s: FloatArray

    def add_to(self, scene: mujoco.MjvScene, time_s: float) -> None:
        """Adds those that are shown at this time to a scene that is about to be drawn."""
        import mujoco

        for number in np.flatnonzero((self.from_s <= time_s) & (time_s < self.until_s)):
            if scene.ngeom >= scene.maxgeom:
                return
            x_m, y_m, z_m, yaw_rad = self.pose_world[number]
            cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
            half_m = self.thickness_m[number] / 2
            mujoco.mjv_initGeom(
                scene.geoms[scene.ngeom],
                mujoco.mjtGeom.mjGEOM_BOX.value,
                np.array([self.foot.length_m / 2, self.foot.width_m / 2, half_m]),
                np.array([x_m, y_m, z_m + half_m]),
                np.array([cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0]),
                self.rgba[number].astype(np.float32),
            )
            scene.ngeom += 1


def footmarks_of(
    foot: FootShape,
    followed: Sequence[tuple[float, FootstepPlan]],
    placed: Sequence[Placed],
) -> Footmarks:
    """The marks of a walk: pale ones for steps that lie ahead, full ones where feet came to rest.

    followed: the plans with the times at which they were taken up, in order.
    """
    poses: list[FloatArray] = []
    rows: list[tuple[Side, bool, float, float]] = []
    ends = [*(begun_s for begun_s, _ in followed[1:]), np.inf]
    for (begun_s, plan), end_s in zip(followed, ends, strict=False):
        taken = [step.time_s for step in placed if begun_s < step.time_s <= end_s]
        # A step whose foot has come down gives way to the print of it.
        until = [*taken, *[end_s] * len(plan)]
        for side, pose, until_s in zip(plan.side, plan.pose_world, until, strict=False):
            poses.append(pose)
            rows.append((Side(int(side)), False, begun_s, until_s))
    for step in placed:
        poses.append(step.placed_world)
        rows.append((step.side, True, step.time_s, np.inf))
    return Footmarks(
        foot=foot,
        pose_world=np.array(poses, dtype=np.float64).reshape(-1, 4),
        rgba=np.array([_rgba(side, done) for side, done, _, _ in rows]).reshape(-1, 4),
        thickness_m=np.where(
            [done for _, done, _, _ in rows], _PLACED_THICKNESS_M, _PLANNED_THICKNESS_M
        ),
        from_s=np.array([from_s for _, _, from_s, _ in rows]),
        until_s=np.array([until_s for _, _, _, until_s in rows]),
    )


def _rgba(side: Side, is_placed: bool) -> list[float]:
    """The colours of plans' pictures, which are written blue, green, red there."""
    colour = LEFT if side is Side.LEFT else RIGHT
    alpha = _PLACED_ALPHA if is_placed else _PLANNED_ALPHA
    return [*(value / 255 for value in colour[::-1]), alpha]
