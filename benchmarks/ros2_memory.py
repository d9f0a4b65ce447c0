"""Whether the ROS 2 node grows: its memory over an hour of goals and changes of the map.

    python -m benchmarks.ros2_memory [--minutes 60] [--pace inf]

A second process steers the node over DDS on loopback: a goal, on the way there a changed map, so
that it plans anew, a question on `plan_request`, a message that cannot be used, and the next goal
when the robot has arrived. Minutes are simulated; at a pace of inf the robot walks as fast as the
machine can, with all messages sent. A robot that fell is put back.

Prints what node and planners hold every twelfth of the time, and how much that grew after the first
sixth, which loads what is used. Memory is read from /proc (Linux).
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import json
import math
import multiprocessing
import os
import time
from pathlib import Path

import numpy as np

from app.controllers import load_walker
from app.options import MapOptions, read_grid
from app.ros import messages
from app.ros.messages import Told, decoded, header, new, pose, told_map
from app.ros.node import FootstepNode
from app.ros.transport import Transport, open_transport
from benchmarks.page_memory import megabytes
from maps.grid import Cell, OccupancyGrid

GOALS = ((2.0, 1.0, 1.57), (0.0, 0.0, 3.1))
BOX_FROM, BOX_CELLS = (-1.0, -1.0), 4
ENDS = ("reached", "fell", "collided", "no_path", "timed_out")
ROWS, WARM_UP_ROWS = 12, 2


def main() -> None:
    """Walk and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--map", type=Path, default=Path("maps/room.png"))
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--pace", type=float, default=math.inf)
    options = parser.parse_args()
    grid = read_grid(MapOptions(map=options.map))
    robot, policy = load_walker("jvrc1")
    domain = 100 + os.getpid() % 50
    transport = open_transport(domain=domain, network=False, interface=None)
    warnings: list[str] = []
    node = FootstepNode(
        transport, robot, policy, grid=grid, pace=options.pace, warn=warnings.append
    )
    context = multiprocessing.get_context("spawn")
    peer = context.Process(target=steer, args=(domain, grid), daemon=True)
    with contextlib.closing(node):
        while not node.is_ready(wait_s=0.2):
            pass
        peer.start()
        print("minute  on the wall  warnings  node MB  planners MB", flush=True)
        began_s, held = time.monotonic(), []
        for row in range(1, ROWS + 1):
            while node.time_s < 60 * options.minutes * row / ROWS:
                node.step()
            gc.collect()
            held.append((megabytes("self"), planners_mb(peer.pid)))
            print(
                f"{node.time_s / 60:6.1f} {(time.monotonic() - began_s) / 60:12.1f} "
                f"{len(warnings):9d} {held[-1][0]:8.1f} {held[-1][1]:12.1f}",
                flush=True,
            )
            del warnings[:-1]
        node_mb, planner_mb = (
            last - before for last, before in zip(held[-1], held[WARM_UP_ROWS - 1], strict=True)
        )
        print(f"grown after warm-up: node {node_mb:.1f} MB, planners {planner_mb:.1f} MB")
    peer.terminate()


def planners_mb(peer: int | None) -> float:
    """Resident memory of this process's children but one."""
    children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
    return sum(megabytes(child) for child in children if int(child) != peer)


def steer(domain: int, grid: OccupancyGrid) -> None:
    """Sends a goal, a map on the way, a question and nonsense, and again, until it is ended."""
    transport = open_transport(domain=domain, network=False, interface=None)
    transport.subscribe("plan_events", "std_msgs/msg/String")
    cells = grid.cells.copy()
    row, col = (int(v) for v in grid.world_to_cell(BOX_FROM))
    cells[row : row + BOX_CELLS, col : col + BOX_CELLS] = Cell.OCCUPIED
    boxed = OccupancyGrid(cells=cells, resolution_m=grid.resolution_m, origin=grid.origin)
    for number in range(10**9):
        ended = ""
        while not ended:
            transport.publish(stamped("goal_pose", GOALS[number % 2]))
            # The first goal may be gone before the node is found.
            ended = heard(transport, ("step", *ENDS), 10.0)
        transport.publish(told_map((boxed, grid)[number % 2], time.time_ns()))
        question = {"format": "plan-request/1", "id": str(number), "goal": GOALS[number % 2]}
        text = messages.text(json.dumps(question))
        transport.publish(Told("plan_request", "std_msgs/msg/String", text))
        transport.publish(stamped("goal_pose", (math.nan, 0.0, 0.0)))
        if ended == "step":
            ended = heard(transport, ENDS, 600.0)
        if ended != "reached":
            at = stamped("initialpose", (0.0, 0.0, 0.0))
            transport.publish(at)


def heard(transport: Transport, events: tuple[str, ...], wait_s: float) -> str:
    """The first of some events that comes; empty after so long."""
    until_s = time.monotonic() + wait_s
    while time.monotonic() < until_s:
        for _, kind, cdr in transport.received():
            event = json.loads(decoded(kind, cdr).data)["event"]
            if event in events:
                return str(event)
        time.sleep(0.002)
    return ""


def stamped(topic: str, where: tuple[float, float, float]) -> Told:
    """A goal, or a pose for the robot to stand at."""
    x_m, y_m, yaw_rad = where
    at, head = pose(x_m, y_m, 0.0, yaw_rad), header(time.time_ns())
    if topic == "goal_pose":
        kind = "geometry_msgs/msg/PoseStamped"
        return Told(topic, kind, new(kind, header=head, pose=at))
    kind = "geometry_msgs/msg/PoseWithCovarianceStamped"
    guess = new("geometry_msgs/msg/PoseWithCovariance", pose=at, covariance=np.zeros(36))
    return Told(topic, kind, new(kind, header=head, pose=guess))


if __name__ == "__main__":
    main()
