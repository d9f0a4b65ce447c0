"""Footfall's public interface: read a map, plan footsteps, walk them in MuJoCo, train.

    import footfall

    grid = footfall.read_map("maps/room.png")
    robot = footfall.load_robot("jvrc1")
    plan = footfall.plan(grid, robot, (0, 0, 0), (2, 1, 1.57))
    walk = footfall.navigate(grid, robot, (0, 0, 0), (2, 1, 1.57))

Poses are x_m, y_m, yaw_rad in the frame of the map, yaw counter-clockwise. Defaults are those of
the command line. What is heavy (numba, MuJoCo, Gymnasium) is imported by what needs it.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from controller.policy import Policy, PolicyError, load_policy
from controller.tracking_limits import with_tracking_limits
from maps.grid import Cell, OccupancyGrid
from maps.map_files import MapError, load_map
from planner.options import PlannerOptions
from planner.plan import FootstepPlan, PlanStatus, Pose
from planner.robot_model import BodyShape, FootShape, Side, StepLimits, StepModel
from sim.robot import Robot
from sim.robots import get_robot, robot_names

if TYPE_CHECKING:
    from app.navigation.navigator import Navigator, NavigatorConfig
    from app.navigation.report import NavigationReport
    from planner.planner import Planner

__all__ = [
    "BodyShape",
    "Cell",
    "FootShape",
    "FootstepPlan",
    "MapError",
    "NavigationReport",
    "Navigator",
    "NavigatorConfig",
    "OccupancyGrid",
    "PlanStatus",
    "Planner",
    "PlannerOptions",
    "Policy",
    "PolicyError",
    "Robot",
    "Side",
    "StepLimits",
    "StepModel",
    "draw",
    "load_policy",
    "load_robot",
    "make_env",
    "navigate",
    "plan",
    "read_map",
    "robot_names",
]

_LOADED_WHEN_ASKED_FOR = {
    "NavigationReport": "app.navigation.report",
    "Navigator": "app.navigation.navigator",
    "NavigatorConfig": "app.navigation.navigator",
    "Planner": "planner.planner",
}


def __getattr__(name: str) -> Any:
    if name not in _LOADED_WHEN_ASKED_FOR:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_LOADED_WHEN_ASKED_FOR[name]), name)


def read_map(
    path: str | Path,
    *,
    resolution_m: float | None = None,
    origin: Pose | None = None,
) -> OccupancyGrid:
    """The occupancy grid of a map: an image with its ROS YAML beside it, or the YAML.

    Args:
        path: Of the image or the YAML. A path such as "maps/room.png" that does not exist here is
            taken from the maps that come along.
        resolution_m: Metres per pixel; needed for an image without a YAML, else wins over it.
        origin: Pose of the lower-left corner of the map; wins over the YAML's.

    Raises:
        MapError: The map cannot be read; the message says what would be right.
    """
    return load_map(Path(path), resolution_m=resolution_m, origin=origin)


def load_robot(name: str = "jvrc1", policy: str | Path | None = None) -> Robot:
    """The robot of that name, with the step limits and margins measured of its policy.

    Args:
        name: One of `robot_names()`, or the folder of a robot file.
        policy: Who walks, if not the robot's own policy.

    Raises:
        ValueError: There is no such robot, its file is wrong, or what was measured cannot be read.
    """
    return with_tracking_limits(get_robot(name), None if policy is None else Path(policy))


def plan(
    grid: OccupancyGrid,
    robot: Robot,
    start: Sequence[float],
    goal: Sequence[float],
    *,
    via: Sequence[Sequence[float]] = (),
    options: PlannerOptions | None = None,
) -> FootstepPlan:
    """A footstep plan from start to goal, both pair poses; "no plan" is a status, not an error.

    Args:
        grid: Where.
        robot: Whose steps, from `load_robot`.
        start: Where the robot stands at first.
        goal: Where it stands in the end.
        via: Poses to be on with both feet on the way.
        options: How to search; the defaults are those of the command `plan`.
    """
    from dataclasses import replace

    from planner.planner import Planner, plan_through

    planner = Planner(grid, robot.step_model, options)
    return replace(plan_through(planner, start=start, poses=[*via, goal]), robot=robot.name)


def navigate(
    grid: OccupancyGrid,
    robot: Robot,
    start: Sequence[float],
    goal: Sequence[float],
    *,
    policy: Policy | None = None,
    options: PlannerOptions | None = None,
    pace: str = "normal",
    seed: int = 0,
) -> Navigator:
    """Plans, walks the plan in MuJoCo and plans again where needed, until the walk has ended.

    Args:
        grid: Where.
        robot: Who walks, from `load_robot`.
        start: Pair pose at which the robot stands at first.
        goal: Pair pose at which it is to stand.
        policy: Its controller; None for the robot's own.
        options: How plans are searched for.
        pace: "slow", "normal" or "fast".
        seed: Of the posture in which it starts.

    Returns:
        The finished walk, with its report.

    Raises:
        PolicyError: There is no policy for this robot, or it cannot walk at this pace.
    """
    from app.navigation.navigator import Navigator, NavigatorConfig

    config = NavigatorConfig(planner=options or PlannerOptions(seed=seed), pace=pace)
    walk = Navigator(
        grid,
        robot,
        policy or load_policy(robot),
        start=start,
        goal=goal,
        seed=seed,
        config=config,
    )
    walk.plan()
    while walk.outcome is None:
        walk.tick()
    return walk


def draw(path: str | Path, grid: OccupancyGrid, robot: Robot, plan: FootstepPlan) -> None:
    """Draws a plan over its map into an image file (PNG, JPEG or BMP).

    Raises:
        app.output.InputError: The file cannot be written.
    """
    from app.output import write_picture
    from app.pictures.plan_pictures import plan_picture

    write_picture(Path(path), plan_picture(grid, robot.step_model, plan))


def make_env(robot: str = "jvrc1", *, num_envs: int | None = None, **options: Any) -> Any:
    """The walking task as a Gymnasium environment, or with `num_envs` as a vector environment.

    docs/gymnasium.md tells of observation, action and the `options`.
    """
    import gymnasium

    from controller.gym_env import environment_id, register

    register(robot)
    name = environment_id(robot)
    if num_envs is None:
        return gymnasium.make(name, **options)
    return gymnasium.make_vec(name, num_envs=num_envs, **options)


def main() -> int:
    """The command line, for the console script `footfall`."""
    import sys

    from app.cli import main as run

    return run(sys.argv[1:], program="footfall")
