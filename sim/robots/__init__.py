"""The registry of robots: every module in this folder that defines `ROBOT`."""

from __future__ import annotations

import importlib
import pkgutil

from sim.robot import Robot


def robot_names() -> tuple[str, ...]:
    """Names of the robots there are, in alphabetical order."""
    return tuple(sorted(module.name for module in pkgutil.iter_modules(__path__)))


def get_robot(name: str) -> Robot:
    """The robot of that name.

    Raises:
        ValueError: there is no such robot; the message lists those there are.
    """
    if name not in robot_names():
        raise ValueError(f"no robot {name!r}: choose one of {', '.join(robot_names())}")
    robot: Robot = importlib.import_module(f"{__name__}.{name}").ROBOT
    return robot
