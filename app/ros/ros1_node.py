"""The ROS 1 node: the services and topics of the old package's footstep_planner."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from app.output import one_line
from app.ros.messages import (
    FootprintMarkers,
    body_poses,
    grid_of,
    header,
    new,
    path,
    pose,
    pose2d_of,
)
from app.ros.ros1_messages import LEFT, RIGHT, as_ros1, humanoid_nav_msgs, ros1_class
from app.ros.ros1_parameters import NodeParameters
from maps.grid import OccupancyGrid
from planner.between_feet import plan_between_feet
from planner.body_path import body_path
from planner.plan import FootstepPlan, PlanStatus, Pose, finite_pose
from planner.planner import Planner
from planner.robot_model import Side

NODE = "footstep_planner"
_TOPICS = {
    "footsteps_array": "visualization_msgs/MarkerArray",
    "path": "nav_msgs/Path",
    "heuristic_path": "nav_msgs/Path",
    "expanded_states": "sensor_msgs/PointCloud",
    "start": "geometry_msgs/PoseStamped",
}
# What is asked of a planner.
Question = Callable[[Planner], FootstepPlan]
_LEGS = {Side.LEFT: LEFT, Side.RIGHT: RIGHT}


class FootstepPlannerNode:
    """Plans when a service is called, and when the topics have given map, start and goal.

    rospy must have been initialised; it calls from threads of its own, and one plan is made at a
    time. Poses on topics and in `plan_footsteps` are those of the middle between the feet; those of
    feet are of their origins, `sole_ahead_m` behind the middle of the sole.
    """

    def __init__(self, parameters: NodeParameters, *, grid: OccupancyGrid | None = None) -> None:
        import rospy

        self._rospy, self._parameters = rospy, parameters
        self._lock = threading.RLock()
        self._planner: Planner | None = None
        self._frame = "map"
        self._start: Pose | None = None
        self._goal: Pose | None = None
        self._markers = FootprintMarkers(NODE, parameters.model.foot, opacity=0.6)
        for line in parameters.warnings:
            rospy.logwarn(line)
        if grid is not None:
            self._planner = Planner(grid, parameters.model, parameters.options)
        self._publishers = {
            topic: rospy.Publisher(f"~{topic}", ros1_class(kind), latch=True, queue_size=1)
            for topic, kind in _TOPICS.items()
        }
        for topic, kind, handler in (
            ("map", "nav_msgs/OccupancyGrid", self._take_map),
            ("goal", "geometry_msgs/PoseStamped", self._take_goal),
            ("initialpose", "geometry_msgs/PoseWithCovarianceStamped", self._take_start),
        ):
            rospy.Subscriber(topic, ros1_class(kind), self._guarded(topic, handler), queue_size=1)
        services = humanoid_nav_msgs()
        rospy.Service("plan_footsteps", services.PlanFootsteps, self._plan_footsteps)
        rospy.Service(
            "plan_footsteps_feet", services.PlanFootstepsBetweenFeet, self._plan_footsteps_feet
        )

    def _guarded(self, topic: str, handler: Callable[[Any], None]) -> Callable[[Any], None]:
        """The handler, whose ValueError becomes one line of warning."""

        def guarded(message: Any) -> None:
            with self._lock:
                try:
                    handler(message)
                except ValueError as error:
                    self._rospy.logwarn("%s: %s", topic, one_line(error))

        return guarded

    def _take_map(self, message: Any) -> None:
        grid = grid_of(message)
        model, options = self._parameters.model, self._parameters.options
        before = self._planner
        self._frame = message.header.frame_id or "map"
        if before is not None and _is_same_but(grid, before.grid, 0):
            return
        limit = self._parameters.changed_cells_limit
        if before is not None and _is_same_but(grid, before.grid, limit):
            before.take_map(grid)
        else:
            self._planner = Planner(grid, model, options)
        self._plan_by_topics()

    def _take_goal(self, message: Any) -> None:
        self._goal = self._pose_in_map(message.header, message.pose)
        if self._start is None:
            raise ValueError("waits for a start: initialpose gives it")
        self._plan_by_topics()

    def _take_start(self, message: Any) -> None:
        self._start = self._pose_in_map(message.header, message.pose.pose)
        self._tell_start(self._start)
        self._plan_by_topics()

    def _pose_in_map(self, head: Any, where: Any) -> Pose:
        if head.frame_id.lstrip("/") != self._frame.lstrip("/"):
            raise ValueError(f"the frame is {head.frame_id!r}, must be {self._frame!r}")
        return pose2d_of(where)

    def _plan_by_topics(self) -> None:
        if self._start is not None and self._goal is not None:
            self._plan(self._between_poses(self._start, self._goal))

    def _plan_footsteps(self, request: Any) -> Any:
        def question() -> Question:
            return self._between_poses(*_poses(request.start, request.goal))

        return self._answer("plan_footsteps", humanoid_nav_msgs().PlanFootsteps, question)

    def _plan_footsteps_feet(self, request: Any) -> Any:
        def question() -> Question:
            start = self._soles_of(_poses(request.start_left.pose, request.start_right.pose))
            goal = self._soles_of(_poses(request.goal_left.pose, request.goal_right.pose))
            return lambda planner: plan_between_feet(planner, start, goal)

        kind = humanoid_nav_msgs().PlanFootstepsBetweenFeet
        return self._answer("plan_footsteps_feet", kind, question)

    def _between_poses(self, start: Pose, goal: Pose) -> Question:
        """Pair poses are those of the feet's origins; the planner counts from their soles."""
        ends = _moved(np.array([start, goal]), self._parameters.sole_ahead_m)
        return lambda planner: planner.plan(start=ends[0], goal=ends[1])

    def _soles_of(self, origins: Sequence[Pose]) -> np.ndarray:
        """Poses (2, 4) of the soles of feet, left then right, whose origins are there."""
        soles = _moved(np.array(origins), self._parameters.sole_ahead_m)
        return np.insert(soles, 2, 0.0, axis=1)

    def _plan(self, question: Question) -> FootstepPlan:
        """Plans, and tells of it on the topics, and why in the log where there is no plan.

        Raises:
            ValueError: There is no map yet.
        """
        if self._planner is None:
            raise ValueError("there is no map yet")
        plan = question(self._planner)
        if not plan.found:
            self._rospy.logwarn("no plan: %s: %s", plan.status, one_line(plan.reason))
        self._tell(self._planner, plan)
        return plan

    def _answer(self, service: str, kind: Any, question: Callable[[], Question]) -> Any:
        """The response of a service: the call itself never fails, `result` tells."""
        response = kind._response_class()
        with self._lock:
            try:
                plan = self._plan(question())
            except ValueError as error:
                self._rospy.logwarn("%s: %s", service, one_line(error))
                return response
        response.result = plan.found
        response.costs, response.final_eps = plan.cost_m, plan.epsilon
        response.planning_time, response.expanded_states = plan.time_s, plan.expansions
        if plan.found:
            response.footsteps = [
                self._target(*step) for step in zip(*_all_feet(plan), strict=True)
            ]
        return response

    def _target(self, side: int, sole_world: np.ndarray) -> Any:
        """A StepTarget of a sole (4,): the origin of the foot, in the map."""
        target = humanoid_nav_msgs().StepTarget()
        origin = _moved(sole_world[None, [0, 1, 3]], -self._parameters.sole_ahead_m)[0]
        target.pose.x, target.pose.y, target.pose.theta = origin.tolist()
        target.leg = _LEGS[Side(side)]
        return target

    def _tell(self, planner: Planner, plan: FootstepPlan) -> None:
        """Footprints, paths and expanded states of a plan; none of what there is not."""
        now_ns = self._rospy.Time.now().to_nsec()
        found = plan if plan.found else None
        side, soles = _all_feet(plan) if plan.found else ([], np.zeros((0, 4)))
        self._publish("footsteps_array", self._markers.show(side, soles, now_ns))
        self._publish("path", path(body_poses(found), now_ns))
        on_map = plan.status not in (PlanStatus.OFF_MAP, PlanStatus.GOAL_BLOCKED)
        way = body_path(planner, plan.start, plan.goal) if on_map else np.zeros((0, 2))
        self._publish("heuristic_path", path(_with_headings(way), now_ns))
        record = planner.record if plan.expansions else None
        cells = [] if record is None else record.expanded[:, :2].tolist()
        point = "geometry_msgs/msg/Point32"
        cloud = new(
            "sensor_msgs/msg/PointCloud",
            header=header(now_ns),
            points=[new(point, x=x_m, y=y_m, z=0.0) for x_m, y_m in cells],
            channels=[],
        )
        self._publish("expanded_states", cloud)
        self._tell_start(
            finite_pose(_moved(np.array([plan.start]), -self._parameters.sole_ahead_m)[0])
        )

    def _tell_start(self, start: Pose) -> None:
        head = header(self._rospy.Time.now().to_nsec())
        x_m, y_m, yaw_rad = start
        where = pose(x_m, y_m, 0.0, yaw_rad)
        self._publish("start", new("geometry_msgs/msg/PoseStamped", header=head, pose=where))

    def _publish(self, topic: str, message: Any) -> None:
        self._publishers[topic].publish(as_ros1(_TOPICS[topic], message, self._frame))


def _poses(*poses_2d: Any) -> list[Pose]:
    """Pose2D messages as poses. Raises ValueError for numbers that are not finite."""
    return [finite_pose((at.x, at.y, at.theta)) for at in poses_2d]


def _moved(poses: np.ndarray, ahead_m: float) -> np.ndarray:
    """Poses (n, 3) x, y, yaw moved ahead along their own headings."""
    yaw_rad = poses[:, 2]
    return poses + ahead_m * np.column_stack([np.cos(yaw_rad), np.sin(yaw_rad), 0 * yaw_rad])


def _all_feet(plan: FootstepPlan) -> tuple[list[int], np.ndarray]:
    """Sides (n,) and poses (n, 4) of the start's feet and of all steps; the sides alternate."""
    first = Side(int(plan.side[0])) if len(plan) else Side.LEFT
    pair = [first, first.other]
    side = [*map(int, pair), *plan.side.tolist()]
    return side, np.vstack([plan.start_feet_world[pair], plan.pose_world])


def _with_headings(points: np.ndarray) -> np.ndarray:
    """Poses (n, 4) at points (n, 2), each turned toward the next."""
    ahead = np.diff(points, axis=0)
    yaw_rad = np.arctan2(ahead[:, 1], ahead[:, 0])
    yaw_rad = np.append(yaw_rad, yaw_rad[-1:] if len(yaw_rad) else np.zeros(len(points)))
    return np.column_stack([points, 0 * yaw_rad, yaw_rad])


def _is_same_but(grid: OccupancyGrid, other: OccupancyGrid, cells: int) -> bool:
    """Whether two maps have the same frame, and at most so many cells differ."""
    is_alike = (grid.shape, grid.resolution_m, grid.origin) == (
        other.shape,
        other.resolution_m,
        other.origin,
    )
    return is_alike and int(np.count_nonzero(grid.cells != other.cells)) <= cells
