"""Inverse kinematics of the whole body, and the joint torques that go with it.

Each tick one step of differential inverse kinematics takes the model's posture to the wanted soles,
centre of mass and upright pelvis. The torques are those of that posture at rest under gravity and
the wanted wrenches of the ground.
"""

from __future__ import annotations

from dataclasses import dataclass

import mink
import mujoco
import numpy as np

from controller.lipm.pattern import StageFailed
from planner.plan import wrap_angle
from sim.scene import Scene
from sim.sensors import SIDES

# Weights of squared errors, m or rad.
CONTACT_WEIGHT, COM_WEIGHT, SWING_WEIGHT, PELVIS_WEIGHT, POSTURE_WEIGHT = 1e4, 1e3, 5e2, 1e2, 1e-2

# A knee nearer to straight than this has to turn fast for the body to move by little.
KNEE_LEAST_RAD = 0.75
# Where stairs or wide steps leave no other way a knee comes as near to straight as this.
KNEE_REACH_RAD = 0.5
HIP, KNEE, ANKLE = 0, 3, 4  # of a leg's six joints


def left_leg(scene: Scene, knee_rad: float) -> np.ndarray:
    """From hip to ankle (3,), of the left leg in half-sitting but for a knee bent by so much."""
    robot, model = scene.robot, scene.model
    data, names = mujoco.MjData(model), [joint.name for joint in robot.joints]
    knee = model.joint(names[KNEE])

    def leg(angle_rad: float) -> np.ndarray:
        data.qpos[:] = scene.standing_qpos
        data.qpos[knee.qposadr[0]] = angle_rad
        mujoco.mj_kinematics(model, data)
        hip, ankle = (data.joint(names[which]).xanchor for which in (HIP, ANKLE))
        return np.array(ankle - hip)

    least_rad, most_rad = knee.range.tolist()
    angles = np.linspace(least_rad, most_rad, 400)
    straight_rad = angles[np.argmax([np.linalg.norm(leg(angle)) for angle in angles])]
    return leg(
        straight_rad + np.copysign(knee_rad, robot.joints[KNEE].half_sitting_rad - straight_rad)
    )


def lowered_m(scene: Scene) -> float:
    """How far below half-sitting the body must walk: both knees stay bent in the longest step.

    The hips are then midway between the feet, half of that step from either ankle.
    """
    robot, names = scene.robot, [joint.name for joint in scene.robot.joints]
    longest_m = np.linalg.norm(left_leg(scene, KNEE_LEAST_RAD))
    data = _standing(scene)
    hip, ankle = (data.joint(names[which]).xanchor for which in (HIP, ANKLE))
    x_m, y_m, z_m = np.abs(ankle - hip)
    x_m += robot.training_model.limits.x_m[1] / 2
    return float(max(z_m - np.sqrt(longest_m**2 - x_m**2 - y_m**2), 0.0))


@dataclass(frozen=True, kw_only=True)
class LegReach:
    """How far the legs reach with the pelvis upright: `longest_m` from hip to ankle.

    `hip_m` (2, 3) is from the centre of mass to each hip, in the heading frame, `ankle_m` (2, 3)
    from the middle of each sole to its ankle, in the sole's.
    """

    hip_m: np.ndarray
    ankle_m: np.ndarray
    longest_m: float

    @classmethod
    def of(cls, scene: Scene) -> LegReach:
        """With the knees bent by `KNEE_REACH_RAD`, all else as in half-sitting."""
        names, data = [joint.name for joint in scene.robot.joints], _standing(scene)
        half, com = len(names) // 2, data.subtree_com[1]
        hips = [data.joint(names[HIP + k * half]).xanchor for k in range(2)]
        ankles = [data.joint(names[ANKLE + k * half]).xanchor for k in range(2)]
        soles = [data.site(f"{side}_sole").xpos for side in SIDES]
        return cls(
            hip_m=np.array(hips) - com,
            ankle_m=np.array(ankles) - np.array(soles),
            longest_m=float(np.linalg.norm(left_leg(scene, KNEE_REACH_RAD))),
        )

    def most_com_z_m(self, com: np.ndarray, feet: np.ndarray, side: int) -> float:
        """Greatest height of a centre of mass x, y (2,) at which a leg reaches its foot.

        The feet (2, 4) are x, y, z, yaw; the pelvis heads midway between them.
        """
        yaw_rad = feet[0, 3] + float(wrap_angle(feet[1, 3] - feet[0, 3])) / 2
        foot = feet[side]
        hip = com + _rotated(self.hip_m[side], yaw_rad)
        ankle = foot[:2] + _rotated(self.ankle_m[side], foot[3])
        across_m = min(float(np.hypot(*(ankle - hip))), 0.8 * self.longest_m)
        up_m = np.sqrt(self.longest_m**2 - across_m**2)
        return float(foot[2] + self.ankle_m[side, 2] + up_m - self.hip_m[side, 2])


@dataclass(frozen=True, kw_only=True)
class BodyTargets:
    """What the posture shall come to.

    `soles` and their rotations (2, 3), (2, 3, 3) in the world, `standing` (2,) which of them bear
    weight, `com` (3,), `yaw_rad` of the pelvis, which is otherwise as in half-sitting.
    """

    soles: np.ndarray
    rotations: np.ndarray
    standing: np.ndarray
    com: np.ndarray
    yaw_rad: float


class WholeBody:
    """The model's posture, qpos (nq,), which follows the targets."""

    def __init__(self, scene: Scene):
        self.scene, self.relaxed = scene, 0
        model = self.scene.model
        self._configuration = mink.Configuration(model, self.scene.standing_qpos)
        self._sites = np.array([model.site(f"{side}_sole").id for side in SIDES])
        self._soles = [mink.FrameTask(f"{side}_sole", "site", 1.0, 1.0) for side in SIDES]
        self._com = mink.ComTask(np.sqrt(COM_WEIGHT))
        self._pelvis = mink.FrameTask("pelvis", "body", 0.0, np.sqrt(PELVIS_WEIGHT))
        self._posture = mink.PostureTask(model, np.sqrt(POSTURE_WEIGHT))
        self._posture.set_target(self.scene.standing_qpos)
        self._limits: list[mink.Limit] = [mink.ConfigurationLimit(model)]
        self._upright = self.scene.standing_qpos[3:7]
        self._velocity, self._acceleration = np.zeros(model.nv), np.zeros(model.nv)
        self._force = np.zeros(model.nv)
        self._jacobian = np.zeros((6, model.nv))

    @property
    def qpos(self) -> np.ndarray:
        """The posture (nq,), a copy."""
        return self._configuration.q

    @property
    def com(self) -> np.ndarray:
        """Its centre of mass (3,)."""
        return self._configuration.data.subtree_com[1].copy()

    def place(self, qpos: np.ndarray) -> None:
        """Take up a posture at once, at rest."""
        self._configuration.update(qpos)
        self._velocity[:] = self._acceleration[:] = 0.0

    def move(self, qpos: np.ndarray) -> None:
        """Take up a posture at once and go on moving as before."""
        self._configuration.update(qpos)

    def sole(self, side: int) -> tuple[np.ndarray, np.ndarray]:
        """Position (3,) and rotation (3, 3) of a sole."""
        data, site = self._configuration.data, self._sites[side]
        return data.site_xpos[site].copy(), data.site_xmat[site].reshape(3, 3).copy()

    def follow(self, targets: BodyTargets, time_s: float) -> np.ndarray:
        """Move towards the targets for a time; the velocity qvel (nv,) that it took.

        Where no motion keeps the joints within their ranges, one that leaves them is taken.

        Raises:
            StageFailed: there is none even so.
        """
        for side, task in enumerate(self._soles):
            cost = np.sqrt(CONTACT_WEIGHT if targets.standing[side] else SWING_WEIGHT)
            task.set_position_cost(cost)
            task.set_orientation_cost(cost)
            task.set_target(_transform(targets.rotations[side], targets.soles[side]))
        self._com.set_target(targets.com)
        turn = np.array([np.cos(targets.yaw_rad / 2), 0, 0, np.sin(targets.yaw_rad / 2)])
        quat = np.zeros(4)
        mujoco.mju_mulQuat(quat, turn, self._upright)
        self._pelvis.set_target(mink.SE3.from_rotation_and_translation(mink.SO3(quat), np.zeros(3)))
        velocity = self._velocity_to(time_s, self._limits)
        if velocity is None:
            self.relaxed += 1
            velocity = self._velocity_to(time_s, [])
        if velocity is None:
            raise StageFailed("the inverse kinematics have no solution")
        self._configuration.integrate_inplace(velocity, time_s)
        self._acceleration = (velocity - self._velocity) / time_s
        self._velocity = velocity
        return velocity

    def _velocity_to(self, time_s: float, limits: list[mink.Limit]) -> np.ndarray | None:
        tasks = [*self._soles, self._com, self._pelvis, self._posture]
        try:
            velocity = mink.solve_ik(self._configuration, tasks, time_s, "daqp", limits=limits)
        except mink.NoSolutionFound:
            return None
        return np.asarray(velocity) if np.isfinite(velocity).all() else None

    def torque_nm(self, wrenches: np.ndarray) -> np.ndarray:
        """Joint torques (J,) of the last motion under the ground's wrenches (2, 6) on the soles.

        They are the inverse dynamics of the model, rotors and friction of the joints included.
        """
        model, data, joints = self.scene.model, self._configuration.data, self.scene.joint_qvel
        data.qvel[:], data.qacc[:] = self._velocity, self._acceleration
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, 1, self._force)
        force = self._force[joints] + model.dof_armature[joints] * self._acceleration[joints]
        force += model.dof_damping[joints] * self._velocity[joints]
        for site, wrench in zip(self._sites, wrenches, strict=True):
            if wrench.any():
                jacobian = self._jacobian
                mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], site)
                force -= (jacobian.T @ wrench)[joints]
        return force


def _standing(scene: Scene) -> mujoco.MjData:
    """The robot in half-sitting."""
    data = mujoco.MjData(scene.model)
    data.qpos[:] = scene.standing_qpos
    mujoco.mj_kinematics(scene.model, data)
    mujoco.mj_comPos(scene.model, data)
    return data


def _rotated(point: np.ndarray, yaw_rad: float) -> np.ndarray:
    """A point's x, y (2,), turned."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.array([cos * point[0] - sin * point[1], sin * point[0] + cos * point[1]])


def _transform(rotation: np.ndarray, position: np.ndarray) -> mink.SE3:
    return mink.SE3.from_rotation_and_translation(mink.SO3.from_matrix(rotation), position)
