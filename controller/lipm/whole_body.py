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
from sim.scene import Scene
from sim.sensors import SIDES

# Weights of squared errors, m or rad.
CONTACT_WEIGHT, COM_WEIGHT, SWING_WEIGHT, PELVIS_WEIGHT, POSTURE_WEIGHT = 1e4, 1e3, 5e2, 1e2, 1e-2

# A knee nearer to straight than this has to turn fast for the body to move by little.
KNEE_LEAST_RAD = 0.75
HIP, KNEE, ANKLE = 0, 3, 4  # of a leg's six joints


def lowered_m(scene: Scene) -> float:
    """How far below half-sitting the body must walk: both knees stay bent in the longest step.

    The hips are then midway between the feet, half of that step from either ankle.
    """
    robot, model = scene.robot, scene.model
    data, names = mujoco.MjData(model), [joint.name for joint in robot.joints]
    knee = model.joint(names[KNEE])

    def leg(knee_rad: float) -> np.ndarray:
        """From hip to ankle (3,), of the left leg in half-sitting but for the knee."""
        data.qpos[:] = scene.standing_qpos
        data.qpos[knee.qposadr[0]] = knee_rad
        mujoco.mj_kinematics(model, data)
        hip, ankle = (data.joint(names[which]).xanchor for which in (HIP, ANKLE))
        return np.array(ankle - hip)

    half_sitting_rad = robot.joints[KNEE].half_sitting_rad
    least_rad, most_rad = knee.range.tolist()
    angles = np.linspace(least_rad, most_rad, 400)
    straight_rad = angles[np.argmax([np.linalg.norm(leg(angle)) for angle in angles])]
    bend_rad = np.copysign(KNEE_LEAST_RAD, half_sitting_rad - straight_rad)
    longest_m = np.linalg.norm(leg(straight_rad + bend_rad))
    x_m, y_m, z_m = np.abs(leg(half_sitting_rad))
    x_m += robot.training_model.limits.x_m[1] / 2
    return float(max(z_m - np.sqrt(longest_m**2 - x_m**2 - y_m**2), 0.0))


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


def _transform(rotation: np.ndarray, position: np.ndarray) -> mink.SE3:
    return mink.SE3.from_rotation_and_translation(mink.SO3.from_matrix(rotation), position)
