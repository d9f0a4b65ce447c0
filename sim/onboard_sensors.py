"""What a real robot measures: its joints, an inertial unit in the pelvis, and forces at the soles.

Simulated from the true state with the errors of real sensors. Where the robot is does not come up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import mujoco
import numpy as np

from sim.scene import Scene
from sim.sensors import SIDES
from sim.terrain import yaw_quaternion


@dataclass(frozen=True, kw_only=True)
class SensorErrors:
    """Standard deviations of the errors; those named `bias` are drawn once a walk.

    The defaults are assumptions about an industrial inertial unit, encoders of 14 bits behind the
    gear, and force-torque sensors in the ankles; what a certain robot has is in its data sheets.
    The heading of an inertial unit without a magnetometer drifts: it is the integral of its rate.
    """

    joint_pos_rad: float = 0.0005
    joint_vel_rad_s: float = 0.02
    tilt_bias_rad: float = math.radians(0.2)
    tilt_rad: float = math.radians(0.05)
    rate_rad_s: float = 0.005
    heading_drift_bias_rad_s: float = math.radians(0.02)
    force_n: float = 2.0
    pressure_m: float = 0.002

    def __post_init__(self) -> None:
        """Raises ValueError for a negative error, or one that is not finite."""
        for field in fields(self):
            value = getattr(self, field.name)
            if not 0 <= value < math.inf:
                raise ValueError(f"{field.name} {value} must be finite and not negative")


EXACT = SensorErrors(**{field.name: 0.0 for field in fields(SensorErrors)})


@dataclass(frozen=True, kw_only=True)
class SensorReadings:
    """One reading. Arrays per joint (J,) are in the robot's order, per foot left before right.

    `pelvis_wxyz` (4,): orientation by the inertial unit, its heading since it was set at the start.
    `rate_rad_s` (3,): angular velocity in the pelvis's axes. `force_n` (2,): upward force on each
    sole. `pressure_sole_m` (2, 2): centre of pressure in each sole's own x, y, 0 without force.
    """

    joint_pos_rad: np.ndarray
    joint_vel_rad_s: np.ndarray
    pelvis_wxyz: np.ndarray
    rate_rad_s: np.ndarray
    force_n: np.ndarray
    pressure_sole_m: np.ndarray


class OnboardSensors:
    """The sensors of one simulated robot; the same seed and walk give the same readings."""

    def __init__(
        self,
        scene: Scene,
        errors: SensorErrors,
        *,
        seed: int,
        encoder_offset_rad: np.ndarray | None = None,
    ):
        """Set up; encoder_offset_rad (J,) is by how much each encoder reads too much."""
        joints = len(scene.joint_qpos)
        self._offset_rad = np.zeros(joints) if encoder_offset_rad is None else encoder_offset_rad
        self._scene, self._errors = scene, errors
        self._data = mujoco.MjData(scene.model)
        self._rng = np.random.default_rng(seed)
        self._tilt_bias_rad = self._rng.normal(0.0, errors.tilt_bias_rad, 2)
        self._drift_rad_s = self._rng.normal(0.0, errors.heading_drift_bias_rad_s)

    def read(
        self, qpos: np.ndarray, qvel: np.ndarray, sensors: np.ndarray, time_s: float
    ) -> SensorReadings:
        """A reading at the true state qpos (nq,), qvel (nv,), sensordata (nsensordata,).

        time_s is the time since the inertial unit's heading was set.
        """
        scene, errors, normal = self._scene, self._errors, self._rng.normal
        joints = len(scene.joint_qpos)
        tilt_rad = self._tilt_bias_rad + normal(0.0, errors.tilt_rad, 2)
        tilted, turned = np.empty(4), np.empty(4)
        rotation = np.array([*tilt_rad, 0.0])
        angle_rad = float(np.linalg.norm(rotation))
        axis = rotation / angle_rad if angle_rad > 0 else np.array([1.0, 0.0, 0.0])
        mujoco.mju_axisAngle2Quat(tilted, axis, angle_rad)
        mujoco.mju_mulQuat(tilted, np.array(qpos[3:7]), tilted.copy())
        mujoco.mju_mulQuat(turned, yaw_quaternion(self._drift_rad_s * time_s), tilted)
        named = scene.sensors
        force_n = np.array(sensors[named.ground_force_world[:, 2]])
        pressure_m = self._in_soles(qpos, np.array(sensors[named.pressure_pos_world]))
        force_n += normal(0.0, errors.force_n, 2)
        pressure_m += normal(0.0, errors.pressure_m, (2, 2))
        joint_rad = qpos[scene.joint_qpos] + self._offset_rad
        bears = np.array(sensors[named.ground_force_world[:, 2]]) > 0
        return SensorReadings(
            joint_pos_rad=joint_rad + normal(0.0, errors.joint_pos_rad, joints),
            joint_vel_rad_s=qvel[scene.joint_qvel] + normal(0.0, errors.joint_vel_rad_s, joints),
            pelvis_wxyz=turned,
            rate_rad_s=qvel[3:6] + normal(0.0, errors.rate_rad_s, 3),
            force_n=np.maximum(force_n, 0.0),
            pressure_sole_m=pressure_m * bears[:, None],
        )

    def _in_soles(self, qpos: np.ndarray, points_world: np.ndarray) -> np.ndarray:
        """Points (2, 3) in the world, one a foot, in that sole's x, y (2, 2)."""
        data = self._data
        data.qpos[:] = qpos
        mujoco.mj_kinematics(self._scene.model, data)
        sites = [data.site(f"{side}_sole") for side in SIDES]
        return np.array(
            [
                (site.xmat.reshape(3, 3).T @ (point - site.xpos))[:2]
                for site, point in zip(sites, points_world, strict=True)
            ]
        )
