"""The ROS 2 node: map, goal and pose come in, the robot walks, and all that it does goes out."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from app.navigation.live_navigator import LiveNavigator, WalkHistory
from app.navigation.navigator import NavigatorConfig
from app.navigation.planner_process import PlannerProcess, World, place_to_stand
from app.navigation.replanner import Replanner
from app.output import one_line, say
from app.ros.messages import (
    MAP_FRAME,
    Told,
    decoded,
    grid_of,
    new,
    pose2d_of,
    stamp,
    text,
    told_map,
)
from app.ros.plan_requests import PlanRequests, RequestError, read_request, refusal
from app.ros.transport import Transport
from app.ros.walk_stream import WalkStream
from controller.gait import CONTROL_PERIOD_S
from controller.policy import Policy
from maps.grid import OccupancyGrid
from planner.options import PlannerOptions
from planner.plan import Pose
from sim.robot import Robot

TICK_NS = round(CONTROL_PERIOD_S * 1e9)
# Simulated time that is behind real time by more than this is not caught up.
_FORGIVEN_S = 0.5
_LOOK_EVERY_S = 0.002
# A robot that rests tells its state at 10 Hz.
_REST_TICKS = 4


class FootstepNode:
    """A simulated robot that ROS 2 steers; `step` is to be called all the time, by one thread.

    Until there is a map there is no robot. A message that cannot be used gives one line of warning.
    pace: simulated over real time, inf for as fast as it goes. `behind_s` is how far the robot is
    behind that.
    """

    def __init__(
        self,
        transport: Transport,
        robot: Robot,
        policy: Policy,
        *,
        grid: OccupancyGrid | None = None,
        start: Pose = (0.0, 0.0, 0.0),
        options: PlannerOptions | None = None,
        seed: int = 0,
        sim_time: bool = False,
        pace: float = 1.0,
        warn: Callable[[str], None] = say,
    ) -> None:
        self._transport, self._robot, self._policy = transport, robot, policy
        self._options, self._start, self._seed = options or PlannerOptions(), start, seed
        self._sim_time, self._pace, self._warn = sim_time, pace, warn
        self._planner: PlannerProcess | None = None
        self._replanner: Replanner | None = None
        self._stream: WalkStream | None = None
        self._notice: object = None
        self._ticks = 0
        self._due_s = time.monotonic()
        self.behind_s = 0.0
        self._handlers: dict[str, Callable[[Any], None]] = {
            "map": self._take_map,
            "goal_pose": self._take_goal,
            "initialpose": self._take_initial_pose,
            "plan_request": self._take_request,
        }
        self._requests = PlanRequests(robot.name)
        transport.subscribe("map", "nav_msgs/msg/OccupancyGrid", is_latched=True)
        transport.subscribe("goal_pose", "geometry_msgs/msg/PoseStamped")
        transport.subscribe("initialpose", "geometry_msgs/msg/PoseWithCovarianceStamped")
        transport.subscribe("plan_request", "std_msgs/msg/String")
        if grid is not None:
            self._set_grid(grid)
            transport.publish(told_map(grid, self._now_ns()))

    @property
    def navigator(self) -> LiveNavigator | None:
        """The robot, if there is one."""
        return None if self._replanner is None else self._replanner.navigator

    @property
    def time_s(self) -> float:
        """How long there has been a node, in simulated time."""
        return self._ticks * CONTROL_PERIOD_S

    def is_ready(self, wait_s: float) -> bool:
        """Whether a goal would be planned for at once; waits for so long."""
        return self._planner is None or self._planner.is_ready(wait_s)

    def step(self) -> None:
        """Takes what has come, moves the robot when that is due, else sleeps a little."""
        for topic, kind, cdr in self._transport.received():
            self._take(topic, kind, cdr)
        if self._replanner is not None:
            self._replanner.listen()
            self._tell_notice(self._replanner)
            self._tell_changes(self._replanner)
        for document in self._requests.answers():
            self._publish_plan(document)
        left_s = self._due_s - time.monotonic()
        self.behind_s = max(0.0, -left_s)
        if left_s > 0:
            time.sleep(min(left_s, _LOOK_EVERY_S))
            return
        period_s = CONTROL_PERIOD_S / self._pace
        self._due_s = max(self._due_s + period_s, time.monotonic() - _FORGIVEN_S)
        self._ticks += 1
        if self._replanner is not None:
            self._tick(self._replanner)
        if self._sim_time:
            clock = new("rosgraph_msgs/msg/Clock", clock=stamp(self._now_ns()))
            self._transport.publish(Told("clock", "rosgraph_msgs/msg/Clock", clock))

    def close(self) -> None:
        """Ends the planner and leaves ROS."""
        if self._planner is not None:
            self._planner.close()
        self._requests.close()
        self._transport.close()

    def _tick(self, replanner: Replanner) -> None:
        navigator = replanner.navigator
        if not navigator.rests:
            navigator.tick()
            replanner.ticked()
        elif self._ticks % _REST_TICKS:
            return
        assert self._stream is not None
        plan, _ = replanner.shown_plan
        for told in self._stream.ticked(navigator, self._now_ns(), plan):
            self._transport.publish(told)

    def _tell_changes(self, replanner: Replanner) -> None:
        assert self._stream is not None
        plan, _ = replanner.shown_plan
        for told in self._stream.changes(replanner.navigator, self._now_ns(), plan):
            self._transport.publish(told)

    def _tell_notice(self, replanner: Replanner) -> None:
        notice = replanner.notice
        if notice is not None and notice is not self._notice:
            near = notice.alternative
            what = "" if near is None else "; {:z.2f},{:z.2f},{:z.2f} would do".format(*near)
            self._warn(f"warning: {one_line(notice.text)}{what}")
        self._notice = notice

    def _take(self, topic: str, kind: str, cdr: bytes) -> None:
        try:
            message = decoded(kind, cdr)
        except Exception as error:  # whatever the bytes may hold
            self._warn(f"warning: {topic}: not a {kind}: {one_line(error) or type(error).__name__}")
            return
        try:
            head = getattr(message, "header", None)
            if head is not None and head.frame_id != MAP_FRAME:
                raise ValueError(f"the frame is {head.frame_id!r}, must be {MAP_FRAME!r}")
            self._handlers[topic](message)
        except ValueError as error:
            self._warn(f"warning: {topic}: {one_line(error)}")

    def _take_map(self, message: Any) -> None:
        self._set_grid(grid_of(message))

    def _take_goal(self, message: Any) -> None:
        goal = pose2d_of(message.pose)
        if self._replanner is None:
            raise ValueError("there is no map yet")
        self._replanner.ask(goal, fresh=True)

    def _take_initial_pose(self, message: Any) -> None:
        pose = pose2d_of(message.pose.pose)
        if self._replanner is None:
            self._start = pose
            return
        grid = self._replanner.navigator.grid
        blocked, free = place_to_stand(self._world(grid), pose)
        if blocked:
            near = "" if free is None else "; {:z.2f},{:z.2f},{:z.2f} would do".format(*free)
            raise ValueError(f"the robot cannot stand there: {blocked}{near}")
        self._replanner.take(self._standing(grid, pose))

    def _take_request(self, message: Any) -> None:
        try:
            request = read_request(message.data, self._robot.step_model.stance_width_m)
            if self._replanner is None:
                raise RequestError("there is no map yet", request.id)
            point = self._replanner.navigator.replan_point()
            self._requests.ask(request, point.feet_world, point.first_side)
        except RequestError as error:
            # Who asked waits for an answer.
            self._publish_plan(refusal(error))
            raise

    def _publish_plan(self, document: str) -> None:
        self._transport.publish(Told("plan", "std_msgs/msg/String", text(document)))

    def _set_grid(self, grid: OccupancyGrid) -> None:
        """The map from now on; with the first one the robot is put on it."""
        if self._replanner is None or self._planner is None:
            blocked, free = place_to_stand(self._world(grid), self._start)
            if blocked and free is None:
                raise ValueError(f"the robot cannot stand at its start: {blocked}")
            self._planner = self._planner or PlannerProcess(self._world(grid))
            self._planner.set_world(self._world(grid))
            self._requests.set_world(self._world(grid))
            navigator = self._standing(grid, free or self._start)
            self._replanner = Replanner(self._planner, WalkHistory(), navigator)
            self._stream = WalkStream(navigator)
            for told in self._stream.latched(None, self._now_ns()):
                self._transport.publish(told)
            return
        before = self._replanner.navigator.grid
        is_same = before.resolution_m == grid.resolution_m and before.origin == grid.origin
        if is_same and np.array_equal(before.cells, grid.cells):
            return
        self._planner.set_world(self._world(grid))
        self._requests.set_world(self._world(grid))
        self._replanner.navigator.set_grid(grid, self._planner)
        self._replanner.plan_anew()

    def _standing(self, grid: OccupancyGrid, pose: Pose) -> LiveNavigator:
        navigator = LiveNavigator(
            grid,
            self._robot,
            self._policy,
            start=pose,
            goal=pose,
            seed=self._seed,
            config=NavigatorConfig(planner=self._options),
            planner=self._planner,
        )
        # Sensors tell of the step before: there must be one.
        navigator.tick()
        return navigator

    def _world(self, grid: OccupancyGrid) -> World:
        return World(grid=grid, model=self._robot.step_model, options=self._options)

    def _now_ns(self) -> int:
        return self._ticks * TICK_NS if self._sim_time else time.time_ns()
