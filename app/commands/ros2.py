"""The command `ros2`: a simulated robot as a ROS 2 node, with or without ROS installed."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Annotated

from app.controllers import load_walker
from app.options import (
    ABOUT_MAP,
    OptionalFile,
    PlanningOptions,
    Pose,
    PoseOption,
    read_grid,
    text,
    whole_number,
)
from app.output import ExitCode, InputError, as_bad_input, refuse_given, say
from app.workers import compile_planner

_MOST_DOMAIN = 232


@dataclass(frozen=True, kw_only=True)
class Ros2Options(PlanningOptions):
    """Be a ROS 2 node: a robot that walks on the topic map to where goal_pose says.

    Needs no ROS. It speaks to this machine alone unless --network is given. Ctrl-C ends it.
    """

    map: OptionalFile = None  # type: ignore[assignment]
    """The map at first, such as maps/room.png; without it the topic map gives the first one."""

    start: PoseOption = Pose(0.0, 0.0, 0.0)
    """Where the robot stands at first, such as -1,2,0; initialpose puts it elsewhere."""

    domain: Annotated[int, whole_number(at_least=0, metavar="ID")] = 0
    """DDS domain, such as 7; that of ROS_DOMAIN_ID in other nodes."""

    network: bool = False
    """Speak to other machines too, and not to this one alone."""

    interface: Annotated[str | None, text("NAME")] = None
    """The one network interface to use, such as eth0; goes with the switch network."""

    sim_time: bool = False
    """Stamp messages with simulated time, and publish it as clock."""


def run(options: Ros2Options) -> int:
    """Carries the command out: lives until Ctrl-C."""
    if options.interface is not None and not options.network:
        raise InputError("--interface names how to reach other machines: give --network too")
    if options.domain > _MOST_DOMAIN:
        raise InputError(f"--domain {options.domain} must be from 0 to {_MOST_DOMAIN}")
    if options.map is None:
        refuse_given(options, ABOUT_MAP, "is about a map: give --map too")
    grid = read_grid(options) if options.map is not None else None
    robot, policy = load_walker(options.robot, options.policy)
    # Here and not above: it loads MuJoCo, and help and bad input need not wait for that.
    from app.ros.node import FootstepNode
    from app.ros.transport import open_transport

    transport = open_transport(
        domain=options.domain, network=options.network, interface=options.interface
    )
    compile_planner(robot.step_model, options.planner_options())
    with as_bad_input(ValueError):
        node = FootstepNode(
            transport,
            robot,
            policy,
            grid=grid,
            start=options.start,
            options=options.planner_options(),
            seed=options.seed,
            sim_time=options.sim_time,
        )
    with contextlib.closing(node):
        while not node.is_ready(wait_s=0.2):
            pass
        reach = "the network" if options.network else "this machine alone"
        say(f"a ROS 2 node in domain {options.domain}, for {reach}; Ctrl-C ends it")
        while True:
            node.step()
    return ExitCode.DONE
