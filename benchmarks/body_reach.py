"""How far a walking robot reaches beyond the body boxes that its plan was checked with.

    python -m benchmarks.body_reach [--robot jvrc1] [--walks 20]

The planner keeps a box around each pair of feet off the walls, grown by `body_margin_m`. The body
sways beyond that box; the margin must cover how far. Printed for every collision shape above the
feet: the distance by which it leaves both boxes, that of the stance before the step under way and
that of the stance after it, at the 99th percentile and at most, over walks on an empty map.
"""

from __future__ import annotations

import argparse
import math
from collections import defaultdict

import mujoco
import numpy as np

from app.navigator import Navigator
from controller.policy import load_policy
from maps.grid import OccupancyGrid
from planner.model import BodyShape
from planner.plan import pair_pose
from sim.robots import get_robot


def main() -> None:
    """Print the reach of every shape, the farthest last."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot", default="jvrc1")
    parser.add_argument("--walks", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    robot = get_robot(options.robot)
    policy = load_policy(robot)
    rng = np.random.default_rng(options.seed)
    cells = np.zeros((160, 160), np.uint8)
    grid = OccupancyGrid(cells=cells, resolution_m=0.05, origin=(-4.0, -4.0, 0.0))
    beyond: dict[str, list[float]] = defaultdict(list)
    for _ in range(options.walks):
        goal = rng.uniform((-1.5, -1.5, -math.pi), (1.5, 1.5, math.pi))
        walker = Navigator(grid, robot, policy, start=(0, 0, 0), goal=goal.tolist())
        walker.plan()
        while walker.outcome is None:
            stances = _stances(walker)
            walker.tick()
            if len(walker.qpos) % 2:
                _measure(walker, stances, robot.step_model.body, beyond)
    for name, reach in sorted(beyond.items(), key=lambda item: max(item[1])):
        p99 = np.percentile(reach, 99)
        print(f"{name:<18} p99 {100 * p99:5.1f} cm   at most {100 * max(reach):5.1f} cm")


def _stances(walker: Navigator) -> list[np.ndarray]:
    """Pair poses (3,) of the stances before and after the step under way, or of the one stand."""
    cursor = walker.walker.cursor
    entry = int(cursor.entry[0])
    poses = cursor._pose[0]
    after = pair_pose(poses[[entry, entry + 1] if cursor.standing[0] else [entry - 1, entry]])
    return [after] if entry < 2 else [pair_pose(poses[[entry - 2, entry - 1]]), after]


def _measure(
    walker: Navigator, stances: list[np.ndarray], body: BodyShape, beyond: dict[str, list[float]]
) -> None:
    """Add how far each capsule leaves the nearer of the stances' boxes; negative is within."""
    model = walker.scene.model
    data = mujoco.MjData(model)
    data.qpos[:] = walker.qpos[-1]
    mujoco.mj_kinematics(model, data)
    for geom in np.flatnonzero(model.geom_type == int(mujoco.mjtGeom.mjGEOM_CAPSULE)):
        axis = data.geom_xmat[geom].reshape(3, 3)[:, 2] * model.geom_size[geom, 1]
        for end in (data.geom_xpos[geom] + axis, data.geom_xpos[geom] - axis):
            reach = min(_beyond(end[:2], stance, body) for stance in stances)
            beyond[model.geom(geom).name].append(reach + model.geom_size[geom, 0])


def _beyond(point: np.ndarray, stance: np.ndarray, body: BodyShape) -> float:
    """How far a point (2,) is outside the box at a pair pose, along its farther axis."""
    cos, sin = math.cos(stance[2]), math.sin(stance[2])
    dx, dy = point - stance[:2]
    return max(
        abs(cos * dx + sin * dy) - body.length_m / 2, abs(cos * dy - sin * dx) - body.width_m / 2
    )


if __name__ == "__main__":
    main()
