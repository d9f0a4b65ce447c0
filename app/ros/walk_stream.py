"""The stream of ROS 2 messages that a walk gives: robot, plan, footprints and events."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from app.navigation.navigator import Navigator
from app.navigation.placed import Placed
from app.ros.description import ROOT_FRAME, FrameTransform, RobotFrames
from app.ros.messages import (
    FootprintMarkers,
    Told,
    body_poses,
    header,
    new,
    path,
    quaternion,
    text,
    told_map,
    vector,
)
from controller.gait import CONTROL_PERIOD_S
from maps.grid import OccupancyGrid
from planner.plan import FootstepPlan
from planner.robot_model import Side
from sim.sensors import SIDES


class WalkStream:
    """All that a walk tells, tick by tick, for whoever writes or sends it.

    `latched()` is told first; after each `tick()` of a navigator, `ticked()`. Time is given in
    nanoseconds, of the simulation or of the wall, as the reader wants it.
    """

    def __init__(self, navigator: Navigator) -> None:
        self._foot = navigator.robot.step_model.foot
        self._planned = FootprintMarkers("planned", self._foot, opacity=0.5)
        self._placed = FootprintMarkers("placed", self._foot, opacity=1.0)
        self._frames = RobotFrames(navigator.scene)
        self._plan: FootstepPlan | None = None
        self._last: Placed | None = None
        self._outcome: object = None

    def latched(self, grid: OccupancyGrid | None, time_ns: int) -> Iterator[Told]:
        """What stays as it is: map, if it is given, robot description and fixed frames."""
        if grid is not None:
            yield told_map(grid, time_ns)
        kind = "std_msgs/msg/String"
        yield Told("robot_description", kind, text(self._frames.urdf), is_latched=True)
        fixed = transforms(self._frames.fixed(), time_ns)
        yield Told("tf_static", "tf2_msgs/msg/TFMessage", fixed, is_latched=True)

    def ticked(
        self, navigator: Navigator, time_ns: int, shown: FootstepPlan | None = None
    ) -> Iterator[Told]:
        """The robot's state, and what `changes` gives."""
        self._frames.place(navigator.qpos[-1])
        moving = transforms(self._frames.moving(), time_ns)
        yield Told("tf", "tf2_msgs/msg/TFMessage", moving)
        yield Told("joint_states", "sensor_msgs/msg/JointState", _joints(navigator, time_ns))
        yield Told("joint_targets", "sensor_msgs/msg/JointState", _targets(navigator, time_ns))
        yield Told("odom", "nav_msgs/msg/Odometry", _odometry(navigator, time_ns))
        yield from self._forces(navigator, time_ns)
        cursor = navigator.walker.cursor
        phase = float(math.atan2(*cursor.clock[0]) % (2 * math.pi)) / (2 * math.pi)
        yield Told("gait_phase", "std_msgs/msg/Float64", new("std_msgs/msg/Float64", data=phase))
        yield from self.changes(navigator, time_ns, shown)

    def _forces(self, navigator: Navigator, time_ns: int) -> Iterator[Told]:
        sensors = navigator.scene.sensors.ground_force_world
        for side in Side:
            # The mean over the physics steps of the tick: contacts chatter.
            force = navigator.walker.sim.sensors[0][:, sensors[side]].mean(axis=0)
            wrench = new(
                "geometry_msgs/msg/Wrench",
                force=vector(self._frames.in_sole(side, force)),
                torque=vector((0.0, 0.0, 0.0)),
            )
            head = header(time_ns, f"{SIDES[side]}_sole")
            message = new("geometry_msgs/msg/WrenchStamped", header=head, wrench=wrench)
            yield Told(f"{SIDES[side]}_foot_force", "geometry_msgs/msg/WrenchStamped", message)

    def changes(
        self, navigator: Navigator, time_ns: int, shown: FootstepPlan | None = None
    ) -> Iterator[Told]:
        """What is new of plan, footprints and outcome since this was last asked.

        shown: the plan to be seen, if not the one that is followed.
        """
        placed = navigator.placed
        plan = shown
        if plan is None and navigator.followed:
            plan = navigator.followed[-1][1]
        if plan is not self._plan:
            self._plan = plan
            yield from self._told_plan(plan, time_ns)
            if plan is not None:
                yield _event(navigator, "plan", steps=len(plan), cost_m=round(plan.cost_m, 4))
        last = placed[-1] if placed else None
        if last is not self._last:
            self._last = last
            poses = np.array([step.placed_world for step in placed]).reshape(-1, 4)
            markers = self._placed.show([step.side for step in placed], poses, time_ns)
            kind = "visualization_msgs/msg/MarkerArray"
            yield Told("footsteps_placed", kind, markers, is_latched=True)
            if last is not None:
                yield _event(
                    navigator,
                    "step",
                    side=last.side.name.lower(),
                    error_m=round(last.error_m, 5),
                    error_rad=round(last.error_rad, 5),
                )
        if navigator.outcome is not self._outcome:
            self._outcome = navigator.outcome
            if navigator.outcome is not None:
                yield _event(navigator, str(navigator.outcome), reason=navigator.reason)

    def _told_plan(self, plan: FootstepPlan | None, time_ns: int) -> Iterator[Told]:
        """Footprints and path of a plan; none of none."""
        side = [] if plan is None else plan.side.tolist()
        poses = np.zeros((0, 4)) if plan is None else plan.pose_world
        markers = self._planned.show(side, poses, time_ns)
        kind = "visualization_msgs/msg/MarkerArray"
        yield Told("footsteps", kind, markers, is_latched=True)
        yield Told("path", "nav_msgs/msg/Path", path(body_poses(plan), time_ns), is_latched=True)


def transforms(frames: Iterable[FrameTransform], time_ns: int) -> Any:
    """A TFMessage of frames in their parents."""
    found = [
        new(
            "geometry_msgs/msg/TransformStamped",
            header=header(time_ns, parent),
            child_frame_id=child,
            transform=new(
                "geometry_msgs/msg/Transform",
                translation=vector(position),
                rotation=quaternion(wxyz),
            ),
        )
        for parent, child, position, wxyz in frames
    ]
    return new("tf2_msgs/msg/TFMessage", transforms=found)


def _event(navigator: Navigator, event: str, **fields: Any) -> Told:
    document = {"event": event, "time_s": round(navigator.time_s, 4), **fields}
    return Told("plan_events", "std_msgs/msg/String", text(json.dumps(document)))


def _joints(navigator: Navigator, time_ns: int) -> Any:
    scene, sim = navigator.scene, navigator.walker.sim
    return new(
        "sensor_msgs/msg/JointState",
        header=header(time_ns, ""),
        name=[joint.name for joint in navigator.robot.joints],
        position=np.array(sim.qpos[0, scene.joint_qpos], float),
        velocity=np.array(sim.qvel[0, scene.joint_qvel], float),
        effort=np.array(navigator.walker.joint_torque_nm()[0], float),
    )


def _targets(navigator: Navigator, time_ns: int) -> Any:
    """The joint targets of the tick that has ended, stamped with the time they were sent."""
    return new(
        "sensor_msgs/msg/JointState",
        header=header(max(time_ns - round(1e9 * CONTROL_PERIOD_S), 0), ""),
        name=[joint.name for joint in navigator.robot.joints],
        position=np.array(navigator.walker.target_rad[0], float),
        velocity=np.zeros(0),
        effort=np.zeros(0),
    )


def _odometry(navigator: Navigator, time_ns: int) -> Any:
    """The pelvis in the map; the twist is in the pelvis's own axes, as nav_msgs/Odometry has it."""
    import mujoco

    qpos, qvel = navigator.walker.sim.qpos[0], navigator.walker.sim.qvel[0]
    back, own = np.zeros(4), np.zeros(3)
    mujoco.mju_negQuat(back, qpos[3:7])
    mujoco.mju_rotVecQuat(own, np.array(qvel[:3], float), back)
    at = new(
        "geometry_msgs/msg/Pose",
        position=vector(qpos[:3], "Point"),
        orientation=quaternion(qpos[3:7]),
    )
    twist = new("geometry_msgs/msg/Twist", linear=vector(own), angular=vector(qvel[3:6]))
    unknown = np.zeros(36)
    return new(
        "nav_msgs/msg/Odometry",
        header=header(time_ns),
        child_frame_id=ROOT_FRAME,
        pose=new("geometry_msgs/msg/PoseWithCovariance", pose=at, covariance=unknown),
        twist=new("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=unknown),
    )
