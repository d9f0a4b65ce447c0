"""How narrow a passage a robot walks through facing ahead, and how much room it needs to stand.

    python -m benchmarks.passage [--robot jvrc1] [--long-m 0.3] [--walks 5]

On a map with cells of 1 cm a wall as thick as --long-m parts a hall, with one passage straight
ahead of the robot. It gets narrower by 1 cm at a time until no plan leads through. A plan leads
through facing ahead where no pair pose whose body may reach the passage is turned by more than 15
degrees. The narrowest passage for that, and the narrowest of all, are walked a few times.

Room to stand is the least radius of a round pit in which the robot can have a goal of any heading.
"""

from __future__ import annotations

import argparse
import itertools
import math

import numpy as np

import footfall
from maps.grid import OccupancyGrid
from planner.collision import terrain_of
from planner.endpoints import what_blocks
from planner.plan import FootstepPlan, Pose, feet_at, pair_pose
from planner.robot_model import Side, StepModel

CELL_M = 0.01
HALL_M, WIDEST_M = 4.0, 1.2
AHEAD_RAD = math.radians(15.0)
HEADINGS = 64


def main() -> None:
    """Prints widths, clearances and the radius."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot", default="jvrc1")
    parser.add_argument("--long-m", type=float, default=0.3)
    parser.add_argument("--walks", type=int, default=5)
    options = parser.parse_args()
    robot = footfall.load_robot(options.robot)
    model = robot.step_model
    print(
        f"{robot.name}: body {model.body.length_m:g} x {model.body.width_m:g} m, margin "
        f"{100 * model.body_margin_m:.1f} cm; room to stand {room_to_stand_m(model):.2f} m"
    )
    ahead_m, any_m = narrowest_m(robot, options.long_m)
    for how, width_m in (("facing ahead", ahead_m), ("in any way", any_m)):
        if width_m is None:
            print(f"{how}: none")
            continue
        walks = [walk(robot, options.long_m, width_m, seed) for seed in range(options.walks)]
        reached = sum(report.outcome == "reached" for report in walks)
        kept_m = [r.min_clearance_m for r in walks if r.min_clearance_m is not None]
        kept = f", walls no nearer than {100 * min(kept_m):.1f} cm" if kept_m else ""
        print(f"{how}: {width_m:.2f} m wide; {reached} of {len(walks)} walks reach{kept}")


def hall(long_m: float, width_m: float) -> tuple[OccupancyGrid, Pose, Pose]:
    """A hall with a passage, and the poses on either side of it."""
    size = round(HALL_M / CELL_M)
    cells = np.zeros((size, size), np.uint8)
    first = (size - round(long_m / CELL_M)) // 2
    wide = round(width_m / CELL_M)
    low = (size - wide) // 2
    cells[:, first : first + round(long_m / CELL_M)] = 1
    cells[low : low + wide, first : first + round(long_m / CELL_M)] = 0
    middle_m = (low + wide / 2) * CELL_M
    grid = OccupancyGrid(cells=cells, resolution_m=CELL_M)
    return grid, (0.8, middle_m, 0.0), (HALL_M - 0.8, middle_m, 0.0)


def narrowest_m(robot: footfall.Robot, long_m: float) -> tuple[float | None, float | None]:
    """Widths of the narrowest passage for a plan that faces ahead, and for any plan."""
    ahead_m = any_m = None
    for number in itertools.count():
        width_m = round(WIDEST_M - number * CELL_M, 2)
        grid, start, goal = hall(long_m, width_m)
        plan = footfall.plan(grid, robot, start, goal)
        if not plan.found:
            return ahead_m, any_m
        any_m = width_m
        if faces_ahead(plan, robot.step_model, long_m):
            ahead_m = width_m
    raise AssertionError("a passage of no width lets nobody through")


def faces_ahead(plan: FootstepPlan, model: StepModel, long_m: float) -> bool:
    """Whether the body is never turned where it may be in the passage."""
    feet = plan.start_feet_world.copy()
    reach_m = long_m / 2 + math.hypot(model.body.length_m, model.body.width_m) / 2
    for side, pose in zip(plan.side, plan.pose_world, strict=True):
        feet[Side(int(side))] = pose
        x_m, _, yaw_rad = pair_pose(feet)
        if abs(x_m - HALL_M / 2) < reach_m and abs(yaw_rad) > AHEAD_RAD:
            return False
    return True


def walk(
    robot: footfall.Robot, long_m: float, width_m: float, seed: int
) -> footfall.NavigationReport:
    """One walk through a passage."""
    grid, start, goal = hall(long_m, width_m)
    return footfall.navigate(grid, robot, start, goal, seed=seed).report()


def room_to_stand_m(model: StepModel) -> float:
    """Least radius of a round pit in which the robot can stand with any heading."""
    size = round(HALL_M / CELL_M)
    middle_m = size // 2 * CELL_M
    near_m = np.abs(np.arange(size + 1) * CELL_M - middle_m)
    # The nearest corner of each cell.
    near_m = np.minimum(near_m[1:], near_m[:-1])
    from_middle_m = np.hypot(near_m[:, None], near_m)
    for number in itertools.count(1):
        radius_m = round(number * CELL_M, 2)
        cells = (from_middle_m >= radius_m - 1e-9).astype(np.uint8)
        grid = OccupancyGrid(cells=cells, resolution_m=CELL_M)
        terrain = terrain_of(grid, unknown_is_free=False)
        feet = (
            feet_at((middle_m, middle_m, yaw_rad), model.stance_width_m)
            for yaw_rad in np.arange(HEADINGS) * (2 * math.pi / HEADINGS)
        )
        if not any(what_blocks(grid, terrain, model, at) for at in feet):
            return radius_m
    raise AssertionError("there is room enough in a pit that is large enough")


if __name__ == "__main__":
    main()
