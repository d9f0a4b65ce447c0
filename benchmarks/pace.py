"""How fast a robot walks at each pace, and how it stands afterwards.

    python -m benchmarks.pace [--robot jvrc1] [--minutes 10]

On an empty floor of 13 x 6 m it walks to five goals 6 to 9 m away at each pace. At the last goal
it then stands for so many minutes: how far its feet creep, and what the knees hold.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import footfall
from app.navigation.navigator import Navigator
from controller.gait import CONTROL_PERIOD_S, PACES
from controller.policy import load_policy
from maps.grid import OccupancyGrid

FLOOR = OccupancyGrid(
    cells=np.zeros((120, 260), np.uint8), resolution_m=0.05, origin=(-2.0, -3.0, 0.0)
)
START = (0.0, 0.0, 0.0)
GOALS = (
    (6.0, 0.0, 0.0),
    (7.0, 1.5, 0.5),
    (8.0, -1.5, -0.5),
    (9.0, 1.0, 0.0),
    (6.5, -2.0, -1.57),
)


def main() -> None:
    """Prints a line for each pace, and one for the stand."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot", default="jvrc1")
    parser.add_argument("--policy", type=Path)
    parser.add_argument("--minutes", type=float, default=10.0)
    options = parser.parse_args()
    robot = footfall.load_robot(options.robot)
    policy = load_policy(robot, options.policy)
    for pace in PACES:
        walks = [
            footfall.navigate(FLOOR, robot, START, goal, policy=policy, pace=pace, seed=seed)
            for seed, goal in enumerate(GOALS)
        ]
        reports = [walk.report() for walk in walks]
        reached = sum(report.outcome == "reached" for report in reports)
        speeds = [report.gait.speed_m_s for report in reports if report.gait is not None]
        errors_cm = 100 * np.array([placed.error_m for walk in walks for placed in walk.placed])
        median, p95 = np.percentile(errors_cm, [50, 95])
        print(
            f"{pace}: {reached} of {len(walks)} reached, {min(speeds):.2f} to {max(speeds):.2f} "
            f"m/s, feet {median:.1f} / {p95:.1f} / {errors_cm.max():.1f} cm from their steps "
            "(median, p95, most)",
            flush=True,
        )
    print(stand(walks[-1], options.minutes))


def stand(walk: Navigator, minutes: float) -> str:
    """Goes on standing after a walk; how far the feet creep, and the torque of the knees."""
    walker = walk.walker
    first = walker.soles_world()[0]
    knees = [k for k, joint in enumerate(walk.robot.joints) if "knee" in joint.name.lower()]
    knees = knees or [3, 9]  # HRP-5P's joints are named by letters; a leg's fourth is its knee
    crept_m, torques_nm = 0.0, []
    for _ in range(round(60 * minutes / CONTROL_PERIOD_S)):
        walker.act(walk.policy.act(walker.observe()))
        crept_m = max(crept_m, float(np.abs(walker.soles_world()[0] - first)[:, :2].max()))
        torques_nm.append(np.abs(walker.joint_torque_nm()[0, knees]).max())
    upright = "fell" if walker.fallen()[0] else "still stands"
    height_m = walker.sim.qpos[0, 2] - walker.soles_world()[0, :, 2].min()
    return (
        f"after {minutes:g} minutes it {upright}: feet crept by {100 * crept_m:.1f} cm at most, "
        f"pelvis {height_m:.3f} m over the soles (half-sitting {walk.robot.pelvis_height_m:.3f}), "
        f"knees held {np.median(torques_nm):.1f} N m"
    )


if __name__ == "__main__":
    main()
