"""Where the pelvis is, by the legs: odometry over the foot that bears the weight.

What touches the ground does not move. So the pelvis has moved by what the legs say that the point
under the centre of pressure of a loaded foot has moved in the pelvis's frame, turned by the
inertial unit. Taking that point and not the middle of the sole lets a foot roll over its heel or
toes. Where both feet bear weight each counts by its share, as in Bloesch et al. 2012, "State
estimation for legged robots", whose filter takes the same measurements.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from controller.gait import CONTROL_PERIOD_S
from sim.onboard_sensors import SensorReadings
from sim.scene import Scene
from sim.sensors import SIDES

# Share of the robot's weight from which a foot's point counts as resting.
LOADED_WEIGHTS = 0.05


@dataclass(frozen=True, kw_only=True)
class RobotState:
    """What controllers and the navigator go by, of B robots: as it is, or as it is estimated.

    `qpos` (B, nq), `qvel` (B, nv), `soles_world` (B, 2, 4) x, y, z, yaw left before right,
    `com_pos_world` and `com_linvel_world` (B, 3) of the whole robot.
    """

    qpos: np.ndarray
    qvel: np.ndarray
    soles_world: np.ndarray
    com_pos_world: np.ndarray
    com_linvel_world: np.ndarray


class LegOdometry:
    """The state of one robot (B = 1), from where it stood at first and what it measures.

    Its frame is the world's at first and drifts from it; it never jumps.
    """

    def __init__(self, scene: Scene, qpos: np.ndarray, readings: SensorReadings):
        """Begin at rest at qpos (nq,), of which only the pelvis's position is taken."""
        self._scene, self._model = scene, scene.model
        self._data = mujoco.MjData(scene.model)
        self._sites = [self._data.site(f"{side}_sole") for side in SIDES]
        self._bodies = [int(scene.model.site_bodyid[site.id]) for site in self._sites]
        self._least_n = LOADED_WEIGHTS * scene.robot.weight_n
        self._position = np.array(qpos[:3], dtype=float)
        self._velocity = np.zeros(3)
        self._pelvis = scene.model.body("pelvis").id
        self._read(readings)
        self._readings, self._soles = readings, self._soles_from_pelvis()
        self.state = self._state()

    def update(self, readings: SensorReadings, time_s: float = CONTROL_PERIOD_S) -> None:
        """Take the next readings, so long after the last ones."""
        before_m, before = self._soles, self._readings
        self._read(readings)
        now_m = self._soles_from_pelvis()
        loads_n = np.minimum(before.force_n, readings.force_n)
        shares = _shares(loads_n, self._least_n)
        if shares.any():
            point_m = (before.pressure_sole_m + readings.pressure_sole_m) / 2
            moved = [
                _point(before_m[foot], point_m[foot]) - _point(now_m[foot], point_m[foot])
                for foot in range(2)
            ]
            self._position = self._position + shares @ np.array(moved)
        else:
            self._position = self._position + self._velocity * time_s
        self._readings, self._soles = readings, now_m
        self._estimate_velocity(readings)
        self.state = self._state()

    def raise_by(self, height_m: float) -> None:
        """Correct the height, where the ground is known."""
        self._position = self._position + np.array([0.0, 0.0, height_m])
        self.state = self._state()

    def _read(self, readings: SensorReadings) -> None:
        data, scene = self._data, self._scene
        data.qpos[:3] = 0.0
        data.qpos[3:7] = readings.pelvis_wxyz
        data.qpos[scene.joint_qpos] = readings.joint_pos_rad
        data.qvel[:3] = 0.0
        data.qvel[3:6] = readings.rate_rad_s
        data.qvel[scene.joint_qvel] = readings.joint_vel_rad_s
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_comPos(self._model, data)

    def _soles_from_pelvis(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Position (3,) and axes (3, 3) of each sole from the pelvis, turned as the world is."""
        return [(site.xpos.copy(), site.xmat.reshape(3, 3).copy()) for site in self._sites]

    def _estimate_velocity(self, readings: SensorReadings) -> None:
        """From the joints' rates: the point that bears does not move."""
        shares = _shares(readings.force_n, self._least_n)
        if not shares.any():
            return
        jacobian = np.empty((3, self._model.nv))
        velocity = np.zeros(3)
        for foot, share in enumerate(shares):
            point = _point(self._soles[foot], readings.pressure_sole_m[foot])
            mujoco.mj_jac(self._model, self._data, jacobian, None, point, self._bodies[foot])
            velocity -= share * (jacobian @ self._data.qvel)
        self._velocity = velocity

    def _state(self) -> RobotState:
        model, data = self._model, self._data
        data.qvel[:3] = self._velocity
        mujoco.mj_comVel(model, data)
        mujoco.mj_subtreeVel(model, data)
        qpos = np.array(data.qpos)
        qpos[:3] = self._position
        soles = np.array(
            [
                [*(position + self._position), math.atan2(axes[1, 0], axes[0, 0])]
                for position, axes in self._soles
            ]
        )
        return RobotState(
            qpos=qpos[None],
            qvel=np.array(data.qvel)[None],
            soles_world=soles[None],
            com_pos_world=(data.subtree_com[self._pelvis] + self._position)[None],
            com_linvel_world=np.array(data.subtree_linvel[self._pelvis])[None],
        )


def _point(sole: tuple[np.ndarray, np.ndarray], point_m: np.ndarray) -> np.ndarray:
    """A point x, y (2,) of a sole, from the pelvis."""
    position, axes = sole
    return np.asarray(position + axes[:, :2] @ point_m)


def _shares(force_n: np.ndarray, least_n: float) -> np.ndarray:
    """Each foot's share (2,) of what those bear that bear enough; all 0 where none does."""
    bearing = np.where(force_n >= least_n, force_n, 0.0)
    return np.asarray(bearing / max(bearing.sum(), 1e-12))
