"""The model-based controller: from the cursor's steps and the robot's state to joint targets.

Every 5 ms: the pattern's centre of mass, feedback of the DCM, wrenches of the feet, admittance,
swing foot, inverse kinematics, and joint targets for stiff servos.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from controller.gait import CONTROL_PERIOD_S
from controller.lipm.admittance import FootAdmittance, sole_wrench, tilted, upward_wrenches
from controller.lipm.height import HeightGenerator
from controller.lipm.pattern import (
    CAUTIOUS_SHARE,
    INWARD_SHARE,
    SAMPLE_S,
    SOLE_SHARE,
    PatternGenerator,
    Pendulum,
    StageFailed,
    phases_of,
)
from controller.lipm.servos import joint_targets, require_pace
from controller.lipm.stabilizer import DcmFeedback, ForceDistribution, VelocityFilter
from controller.lipm.swing_foot import SwingFoot, has_landed, swing_over
from controller.lipm.whole_body import BodyTargets, LegReach, WholeBody, lowered_m
from controller.observation import places, policy_fields
from controller.step_cursor import UpcomingSteps
from controller.walker import Walker
from planner.plan import pair_pose, wrap_angle
from sim.robot import GRAVITY_M_S2, Robot
from sim.scene import PHYSICS_TIMESTEP_S, Scene, build_scene

PARTS = 5
# From this error of the DCM on, ahead or aside, the robot counts as pushed: steps may change, and
# the pattern begins anew from where the centre of mass is, which the posture follows at this rate.
# For a `steady_pressure_share` of 1: JVRC-1 is pushed from 4.5 cm ahead or 2.5 cm aside on.
PUSHED_M, CATCH_UP_HZ = np.array([0.06, 0.033]), 10.0
# It is so until a foot is lifted with the DCM nearer to the pattern's than this; meanwhile the
# pattern keeps as near to the robot.
CALM_M = 0.02
# By how much later a foot may be lifted, in control ticks.
WAIT_TICKS = (0, 6, 12, 24)
# From touch-down until a foot bears the weight.
LOADING_TICKS = 2
PART_S = CONTROL_PERIOD_S / PARTS
REPLAN_PARTS = round(SAMPLE_S / PART_S)


@dataclass
class Lag:
    """How far the posture's centre of mass (2,) is off the pattern's, and its velocity (2,)."""

    com: np.ndarray
    velocity: np.ndarray

    def advance(self, time_s: float) -> None:
        """Come closer for a time, critically damped."""
        pull = CATCH_UP_HZ**2 * self.com + 2 * CATCH_UP_HZ * self.velocity
        self.velocity = self.velocity - time_s * pull
        self.com = self.com + time_s * self.velocity


class RobotControl:
    """The controller of robot `row` of a walker."""

    def __init__(self, walker: Walker, row: int, scene: Scene, below_m: float):
        self._walker, self._row, robot = walker, row, walker.robot
        self._body = WholeBody(scene)
        model = scene.model
        self._data = mujoco.MjData(model)
        self._height_m = self._body.com[2] - below_m
        self._height = HeightGenerator(height_m=self._height_m, reach=LegReach.of(scene))
        foot = robot.step_model.foot
        half_sole_m = np.array([foot.length_m, foot.width_m]) / 2
        self._pattern = PatternGenerator(self._height_m, half_sole_m)
        self._inward_m = INWARD_SHARE * half_sole_m[1]
        self._pushed_m = PUSHED_M * robot.steady_pressure_share
        self._omega = np.sqrt(GRAVITY_M_S2 / self._height_m)
        self._distribution = ForceDistribution(half_sole_m)
        self._pelvis = model.body("pelvis").id
        self._sites = [model.site(f"{side}_sole").id for side in ("left", "right")]
        self._observed = places(policy_fields(robot))
        self._mass_kg = float(model.body_subtreemass[self._pelvis])
        self._placed = -1
        self._swing: SwingFoot | None = None
        self._swing_side = 0
        self._landed = False

    @property
    def relaxed(self) -> dict[str, int]:
        """How often each stage dropped its constraints since the robot was placed."""
        return {
            "pattern": self._pattern.relaxed,
            "distribution": self._distribution.relaxed,
            "inverse_kinematics": self._body.relaxed,
        }

    def _place(self) -> None:
        """Begin anew where the robot stands."""
        self._pattern.relaxed = self._distribution.relaxed = self._body.relaxed = 0
        scene, body = self._body.scene, self._body
        soles = self._measured_soles()
        feet = soles.copy()
        feet[:, 2] = soles[:, 2].mean()
        body.place(scene.qpos_at(np.array(pair_pose(feet)), feet[:, 2].mean()))
        self._feet = feet
        self._swing, self._landed = None, False
        self._admittance = FootAdmittance()
        self._feedback = DcmFeedback(omega=self._omega)
        self._velocity = VelocityFilter(omega=self._omega)
        com = self._data.subtree_com[self._pelvis]
        self._height.state = np.array([com[2], 0.0, 0.0])
        for _ in range(10):
            body.follow(self._targets(com), 0.1)
        self._pendulum = Pendulum(
            com=com[:2].copy(), velocity=np.zeros(2), acceleration=np.zeros(2)
        )
        self._lag = Lag(com=np.zeros(2), velocity=np.zeros(2))
        self.pushed, self._error_m = False, 0.0
        self._jerk = np.zeros((1, 2))
        self._count = 0

    def _measure(self, latest: np.ndarray, sensed: np.ndarray) -> None:
        """Posture and motion, and the wrenches (2, 6) that the soles bear, in their own axes."""
        model, data, walker, row = self._body.scene.model, self._data, self._walker, self._row
        known = walker.sim if walker.estimated is None else walker.estimated
        data.qpos[:], data.qvel[:] = known.qpos[row], known.qvel[row]
        scene, observed = walker.scene, self._observed
        data.qpos[scene.joint_qpos] = sensed[observed["joint_pos_rad"]]
        data.qvel[scene.joint_qvel] = sensed[observed["joint_vel_rad_s"]]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_subtreeVel(model, data)
        if walker.readings is not None:
            self._borne = upward_wrenches(walker.readings.force_n, walker.readings.pressure_sole_m)
            return
        self._borne = np.zeros((2, 6))
        force = latest[scene.sensors.ground_force_world]
        pressure = latest[scene.sensors.pressure_pos_world]
        for side in np.flatnonzero(force[:, 2] > 1.0):
            sole, axes = data.site_xpos[self._sites[side]], data.site_xmat[self._sites[side]]
            self._borne[side] = sole_wrench(force[side], pressure[side], sole, axes.reshape(3, 3))

    def _measured_soles(self) -> np.ndarray:
        data = self._data
        x_axes = data.site_xmat[self._sites]
        yaw = np.arctan2(x_axes[:, 3], x_axes[:, 0])
        return np.column_stack([data.site_xpos[self._sites], yaw])

    def targets(self, latest: np.ndarray, sensed: np.ndarray, part: int) -> np.ndarray:
        """Joint targets (J,) for the next 5 ms, by the sensors and the policy's observation."""
        self._measure(latest, sensed)
        if self._placed != self._walker.placed[self._row]:
            self._placed = self._walker.placed[self._row]
            self._place()
        cursor = self._walker.cursor
        steps = _later(cursor.upcoming(self._row), part * PART_S)
        self._move_swing_foot(steps)
        data, pendulum = self._data, self._pendulum
        com, velocity = data.subtree_com[self._pelvis], data.subtree_linvel[self._pelvis, :2]
        if self._walker.readings is not None:
            soles = self._measured_soles()
            velocity = self._velocity.update(com[:2], velocity, soles, self._borne, PART_S)
        if self._is_pushed(com[:2], velocity) or self._count % REPLAN_PARTS == 0:
            self._catch_up(com[:2], velocity)
            self._replan(steps)
            self._count = 0
        self._count += 1
        reference = pendulum.com, pendulum.velocity, pendulum.acceleration
        pendulum.advance(self._jerk[0], PART_S)
        self._height.advance(PART_S)
        self._lag.advance(PART_S)
        asked = self._feedback.acceleration(reference, com[:2], velocity, PART_S)
        wrenches = self._wrenches(com, asked)
        self._give_way(wrenches)
        return self._joint_targets(wrenches)

    def _replan(self, steps: UpcomingSteps) -> None:
        """Choose the pattern's jerk and the height over the steps to come.

        A foot that stands is lifted later where only that lets the centre of mass come to rest.
        """
        pattern, pendulum = self._pattern, self._pendulum
        jerk = None
        may_wait = len(steps.side) > 0 and steps.lift_off_s[0] > 0
        for share, wait_ticks in product(
            (CAUTIOUS_SHARE, SOLE_SHARE), WAIT_TICKS if may_wait else (0,)
        ):
            later = _later(steps, -wait_ticks * CONTROL_PERIOD_S)
            phases = phases_of(self._feet, later, self._inward_m)
            jerk = pattern.solve(pendulum, phases, share)
            if jerk is not None:
                self._walker.cursor.postpone(self._row, wait_ticks)
                break
        if jerk is None:
            self.pushed = True
            phases = phases_of(self._feet, steps, self._inward_m)
            jerk = pattern.solve_open_ended(pendulum, phases)
        self._jerk = jerk
        self._height.solve(pattern.path(pendulum, jerk), phases)

    def _is_pushed(self, com: np.ndarray, velocity: np.ndarray) -> bool:
        """Whether a push has just put the DCM, of a centre of mass (2,), far off the pattern's."""
        pendulum = self._pendulum
        error = pendulum.com - com + (pendulum.velocity - velocity) / self._omega
        self._error_m = float(np.linalg.norm(error))
        yaw = self._heading_rad
        ahead_aside = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]]) @ error
        before = self.pushed
        self.pushed = before or bool((np.abs(ahead_aside) >= self._pushed_m).any())
        return self.pushed and not before

    def _catch_up(self, com: np.ndarray, velocity: np.ndarray) -> None:
        """Begin the pattern of a pushed robot anew from where the centre of mass (2,) is."""
        if not self.pushed or self._error_m < CALM_M:
            return
        pendulum = self._pendulum
        zmp = pendulum.com - pendulum.acceleration / self._omega**2
        self._lag.com = self._lag.com + pendulum.com - com
        self._lag.velocity = self._lag.velocity + pendulum.velocity - velocity
        pendulum.com, pendulum.velocity = com.copy(), velocity.copy()
        pendulum.acceleration = self._omega**2 * (com - zmp)

    def _give_way(self, wrenches: np.ndarray) -> None:
        """Admittance of the feet to what they bear, against the wrenches (2, 6) asked for."""
        rotations = self._data.site_xmat[self._sites].reshape(2, 3, 3)
        wanted = (wrenches.reshape(2, 2, 3) @ rotations).reshape(2, 6)
        self._admittance.follow(wanted, self._borne, self._standing(), PART_S)

    def _joint_targets(self, wrenches: np.ndarray) -> np.ndarray:
        body, pendulum = self._body, self._pendulum
        target = self._targets(np.array([*pendulum.com + self._lag.com, self._height.state[0]]))
        dq = body.follow(target, PART_S)[self._body.scene.joint_qvel]
        torque = body.torque_nm(wrenches)
        angles = body.qpos[body.scene.joint_qpos]
        return joint_targets(self._walker.robot, angles, dq, torque)

    def _standing(self) -> np.ndarray:
        standing = np.ones(2, dtype=bool)
        if self._swing is not None:
            standing[self._swing_side] = False
        return standing

    def _wrenches(self, com: np.ndarray, asked: np.ndarray) -> np.ndarray:
        """Of the ground on the soles, for an acceleration (2,) of the centre of mass."""
        standing = self._standing()
        load = standing.astype(float)
        soles = self._data.site_xpos[self._sites]
        if standing.all():
            zmp = com[:2] - asked / self._omega**2
            across = soles[1, :2] - soles[0, :2]
            right = float((zmp - soles[0, :2]) @ across / (across @ across))
            right = min(max(right, 0.05), 0.95)
            load = np.array([1 - right, right])
        rotations = self._data.site_xmat[self._sites].reshape(2, 3, 3)
        return self._distribution.share(
            self._mass_kg, com, np.array([*asked, self._height.state[2]]), soles, rotations, load
        )

    def _targets(self, com: np.ndarray) -> BodyTargets:
        feet, admittance = self._feet, self._admittance
        soles = feet[:, :3].copy()
        soles[:, 2] += admittance.height_m
        return BodyTargets(
            soles=soles,
            rotations=np.stack(
                [
                    tilted(pose[3], tilt)
                    for pose, tilt in zip(feet, admittance.tilt_rad, strict=True)
                ]
            ),
            standing=self._standing(),
            com=com,
            yaw_rad=self._heading_rad,
        )

    @property
    def _heading_rad(self) -> float:
        """Midway between the headings of the feet."""
        left_rad, right_rad = self._feet[:, 3]
        return float(left_rad + wrap_angle(right_rad - left_rad) / 2)

    def _move_swing_foot(self, steps: UpcomingSteps) -> None:
        cursor, row = self._walker.cursor, self._row
        swinging = bool(cursor.swinging[row])
        side = int(cursor.side[row])
        if self._swing is None and swinging and not self._landed:
            self._anchor(1 - side)
            self._swing_side, self.pushed = side, self.pushed and self._error_m >= CALM_M
            over_z_m = float(cursor.swing_over_z_m[row])
            self._swing = swing_over(self._feet[side].copy(), steps.pose_world[0], over_z_m)
        elif self._landed and not swinging:
            self._landed = False
        if self._swing is None:
            return
        side = self._swing_side
        target = cursor.foot_targets[row, side]
        time_s = -steps.lift_off_s[0] if len(steps.side) else np.inf
        swing_s = steps.touch_down_s[0] - steps.lift_off_s[0] if len(steps.side) else 0.1
        force_n = float(self._borne[side, 2])
        sole_z_m = float(self._feet[side, 2])
        if has_landed(sole_z_m, target[2], time_s, swing_s, force_n):
            self._swing, self._landed = None, swinging
            return
        self._feet[side] = self._swing.move(target, time_s, swing_s)

    def _anchor(self, side: int) -> None:
        """Turn and move the whole posture on the floor to where its support foot really stands."""
        measured = self._measured_soles()[side]
        mine = self._feet[side]
        yaw = float(wrap_angle(measured[3] - mine[3]))
        turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        offset = measured[:2] - turn @ mine[:2]
        self._pendulum.shift(turn, offset)
        self._feet[:, :2] = self._feet[:, :2] @ turn.T + offset
        self._feet[:, 3] += yaw
        qpos = self._body.qpos
        qpos[:2] = turn @ qpos[:2] + offset
        quat = np.zeros(4)
        mujoco.mju_mulQuat(quat, np.array([np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]), qpos[3:7])
        qpos[3:7] = quat
        self._body.move(qpos)


def _later(steps: UpcomingSteps, time_s: float) -> UpcomingSteps:
    return replace(
        steps, lift_off_s=steps.lift_off_s - time_s, touch_down_s=steps.touch_down_s - time_s
    )


@dataclass(frozen=True, kw_only=True)
class LipmController:
    """Walks any robot whose servos are `stiff`; needs no training.

    It goes by the true state, or by what the walker's robot measures and estimates.
    """

    is_paced: ClassVar[bool] = False

    def step_range_s(self, robot: Robot) -> tuple[float, float]:
        """Shortest and longest duration of a step: the robot's own."""
        return robot.gait.step_s, robot.gait.step_s

    def require_pace(self, robot: Robot, step_s: ArrayLike) -> None:
        """Checks that it can take steps of these durations.

        Raises:
            ControllerError: it walks at another pace.
        """
        require_pace(robot, step_s)

    def start(self, walker: Walker) -> Callable[[], np.ndarray]:
        """A function that advances the walker by one control step, as `Walker.act` does.

        A robot of which a stage fails keeps its last joint targets; `walker.failures` says why.
        """
        # The model of all rows: the robot on a bare floor, whatever there is around the walker's.
        scene = build_scene(walker.robot, timestep_s=PHYSICS_TIMESTEP_S)
        below_m = lowered_m(scene)
        walker.loading_ticks = LOADING_TICKS
        rows = [RobotControl(walker, row, scene, below_m) for row in range(walker.sim.count)]
        sent = np.tile(walker.robot.half_sitting_rad, (len(rows), 1))

        def tick() -> np.ndarray:
            parts = iter(range(PARTS))

            def targets(latest: np.ndarray) -> np.ndarray:
                part, sensed = next(parts), walker.noise(walker.observe())
                for row, control in enumerate(rows):
                    if walker.failures[row]:
                        continue
                    try:
                        sent[row] = control.targets(latest[row], sensed[row], part)
                    except StageFailed as failure:
                        walker.failures[row] = str(failure)
                    walker.relaxed[row] = control.relaxed
                    walker.disturbed[row] = control.pushed
                return sent

            return walker.act_in_parts(PARTS, targets)

        return tick
