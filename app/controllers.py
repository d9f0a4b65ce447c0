"""Which controller walks: the option of the commands, and what it loads."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from app.options import RobotOptions, choice, find_robot, load_walker
from app.output import InputError, as_bad_input
from controller.lipm.servos import ControllerError, stiff
from sim.robot import Robot

if TYPE_CHECKING:
    from controller.walker import Controller

CONTROLLERS = ("policy", "lipm")
ControllerOption = Annotated[str, choice(*CONTROLLERS)]


def load_controlled(options: RobotOptions, controller: str, pace: str) -> tuple[Robot, Controller]:
    """The robot that the options name, with what moves it: `policy`, or `lipm` by a model.

    The model-based controller plans with the limits of the robot's file.

    Raises:
        InputError: There is no such robot or policy, or it cannot be walked so.
    """
    if controller == "policy":
        return load_walker(options.robot, options.policy, pace)
    if options.policy is not None:
        raise InputError("--policy goes with --controller policy: lipm needs none")
    if pace != "normal":
        raise InputError(f"--pace {pace}: --controller lipm walks at --pace normal")
    with as_bad_input(ControllerError):
        robot = stiff(find_robot(options.robot))
    from controller.lipm.controller import LipmController

    return robot, LipmController()
