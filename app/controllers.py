"""Which controller walks: the option of the commands, and what it loads."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from app.options import RobotOptions, choice, find_robot, find_robot_with_limits
from app.output import InputError, as_bad_input, say
from controller.lipm.servos import ControllerError, stiff
from controller.policy import Policy, PolicyError, load_policy
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


def find_policy(robot: Robot, policy_file: Path | None = None) -> Policy:
    """The policy in that file, by default the robot's own; one of another model of it is told.

    Raises:
        InputError: There is none, or it does not fit.
    """
    with as_bad_input(PolicyError):
        policy = load_policy(robot, policy_file)
    if policy.about["robot"] != robot.name:
        say(
            f"warning: this policy was trained on {policy.about['robot']}, and walks {robot.name}: "
            "it may fall where it does not there"
        )
    return policy


def load_walker(
    name: str, policy_file: Path | None = None, pace: str = "normal"
) -> tuple[Robot, Policy]:
    """The robot as `find_robot_with_limits` gives it, and the policy that walks it at that pace.

    Raises:
        InputError: There is no such robot or policy, or it knows its robot's own gait alone.
    """
    robot = find_robot_with_limits(name, policy_file)
    policy = find_policy(robot, policy_file)
    if pace != "normal" and not policy.is_paced:
        raise InputError(
            f"--pace {pace}: the policy of {robot.name} knows one pace, {robot.gait.step_s:g} s a "
            "step; walk at --pace normal, or give --policy one that `train` made since steps have "
            "durations"
        )
    return robot, policy
