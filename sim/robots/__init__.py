"""The registry of robots: every module in this folder that defines `ROBOT`; others by file."""

from __future__ import annotations

import importlib
import importlib.util
import pkgutil

from sim.robot import Robot
from sim.robot_file import is_robot_file, read_robot


def robot_names() -> tuple[str, ...]:
    """Names of the robots that can be built here, in alphabetical order.

    Those whose model is in a package that is not installed are left out.
    """
    return tuple(name for name in _all_names() if _is_installed(_robot(name)))


def get_robot(name: str) -> Robot:
    """The robot of that name, or of the robot file in the folder of that name.

    Raises:
        ValueError: there is no such robot, its model is not installed, or its file is wrong; the
            message lists those there are, says what to install, or names the key.
    """
    if name not in _all_names():
        if is_robot_file(name):
            return read_robot(name)
        raise ValueError(
            f"no robot {name!r}: choose one of {', '.join(robot_names())}, or name the folder of a "
            "robot file, such as robots/talos"
        )
    robot = _robot(name)
    if robot.needs is not None and not _is_installed(robot):
        raise ValueError(
            f"robot {name!r} needs a package that is not installed: "
            f"python -m pip install -e '.[{robot.needs[1]}]'"
        )
    return robot


def _all_names() -> tuple[str, ...]:
    return tuple(sorted(module.name.replace("_", "-") for module in pkgutil.iter_modules(__path__)))


def _robot(name: str) -> Robot:
    robot: Robot = importlib.import_module(f"{__name__}.{name.replace('-', '_')}").ROBOT
    return robot


def _is_installed(robot: Robot) -> bool:
    return robot.needs is None or importlib.util.find_spec(robot.needs[0]) is not None
