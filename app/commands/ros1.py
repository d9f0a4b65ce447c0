"""The command `ros1`: the old package's footstep_planner as a ROS 1 node."""

from __future__ import annotations

import os
import socket
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import urlsplit

import tyro

from app.options import (
    ABOUT_MAP,
    OptionalFile,
    PlanningOptions,
    find_robot_with_limits,
    read_grid,
    text,
)
from app.output import ExitCode, InputError, as_bad_input, refuse_given, say
from app.workers import compile_planner
from planner.robot_model import StepModel
from planner.step_model_file import StepModelError, is_old, load_step_model, read_old

_LOOK_EVERY_S = 0.2


@dataclass(frozen=True, kw_only=True)
class Ros1Options(PlanningOptions):
    """Be the node footstep_planner of humanoid_navigation: services and topics that plan.

    Needs rospy and a ROS master (ROS_MASTER_URI). Its parameters are read from the master, and
    from the step model's file if that is one of the old package. Ctrl-C ends it.
    """

    remap: Annotated[
        tuple[Annotated[str, text("NAME:=OTHER")], ...],
        tyro.conf.Positional,
        tyro.conf.arg(help_behavior_hint="(default: none)"),
    ] = ()
    """Other names, as rosrun takes them, such as goal:=/my_goal or __name:=planner."""

    map: OptionalFile = None  # type: ignore[assignment]
    """The map at first, such as maps/room.png; without it the topic map gives the first one."""

    step_model: OptionalFile = None
    """Plan for the feet, limits and costs in this file, such as planning_params_nao.yaml."""

    network: bool = False
    """Be reachable from other machines too, and not from this one alone."""


def run(options: Ros1Options) -> int:
    """Carries the command out: lives until Ctrl-C, or until ROS ends it."""
    for word in options.remap:
        if not all(word.partition(":=")):
            raise InputError(f"{word!r} is no remapping; write NAME:=OTHER, such as goal:=/my_goal")
    if options.map is None:
        refuse_given(options, ABOUT_MAP, "is about a map: give --map too")
    grid = read_grid(options) if options.map is not None else None
    model, document, file = _step_model(options)
    # Here and not above: help and bad input need not wait for what these load.
    from app.ros.ros1_messages import require_ros1

    require_ros1()
    import rosgraph
    import rospy

    from app.ros.ros1_node import NODE, FootstepPlannerNode
    from app.ros.ros1_parameters import read_parameters

    master = urlsplit(rosgraph.get_master_uri())
    if not master.hostname:
        raise InputError(f"ROS_MASTER_URI {master.geturl()!r} must be like http://localhost:11311")
    if not options.network:
        _stay_on_this_machine(master.hostname)
    if not rosgraph.is_master_online():
        raise InputError(f"no ROS master at {master.geturl()}: start roscore or rosmaster first")
    with as_bad_input(rospy.ROSInitException, ValueError):
        rospy.init_node(NODE, argv=["", *options.remap], disable_signals=True)
    try:
        name = Path(rospy.get_name())
        told = rospy.get_param("~", {})
        with as_bad_input(StepModelError):
            parameters = read_parameters(
                _merged(document, told),
                name if told else file or name,
                model,
                options.planner_options(),
            )
        compile_planner(parameters.model, parameters.options)
        FootstepPlannerNode(parameters, grid=grid)
        reach = "the network" if options.network else "this machine alone"
        say(f"the ROS 1 node {rospy.get_name()}, for {reach}; Ctrl-C ends it")
        while not rospy.is_shutdown():
            time.sleep(_LOOK_EVERY_S)
    finally:
        rospy.signal_shutdown("ended")
    return ExitCode.DONE


def _step_model(options: Ros1Options) -> tuple[StepModel, dict[str, Any], Path | None]:
    """Whom to plan for, and the parameters of the old package's files, if it is one of those."""
    file = options.step_model
    if file is None:
        robot = find_robot_with_limits(options.robot, options.policy)
        return robot.step_model, {}, None
    refuse_given(
        options, ("robot", "policy"), "goes without --step-model: that file says for whom to plan"
    )
    with as_bad_input(StepModelError):
        _, model, _ = load_step_model(file)
        return model, read_old(file) if is_old(file) else {}, file


def _merged(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """Both trees of parameters as one; what is in `above` holds where both have it."""
    both = {**below, **above}
    for key in below.keys() & above.keys():
        if isinstance(below[key], dict) and isinstance(above[key], dict):
            both[key] = _merged(below[key], above[key])
    return both


def _stay_on_this_machine(master: str) -> None:
    """Has rospy bind to loopback alone.

    Raises:
        InputError: The master is on another machine.
    """
    if not (master in ("localhost", "::1", socket.gethostname()) or master.startswith("127.")):
        raise InputError(f"the ROS master is on {master}: give --network to reach it")
    os.environ.pop("ROS_HOSTNAME", None)
    os.environ["ROS_IP"] = "127.0.0.1"
