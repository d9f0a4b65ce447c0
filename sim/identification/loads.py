"""What a joint's servo has to move along a log: inertia and load torque, by MuJoCo's model.

Each joint is looked at alone: pelvis and other joints move as they were measured.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from sim.identification.robot_log import RobotLog, continuous
from sim.robot import GRAVITY_M_S2
from sim.scene import Scene
from sim.sensors import SIDES

GRID_S = 0.005
# Local polynomials: of this order, over at least so many rows and so much time to each side.
_ORDER, _SIDE_ROWS, _SIDE_S = 4, 3, 0.05
# Turn of a joint from which the load's change with its angle is found.
_TURN_RAD, _COARSE = 0.01, 8
# A foot swings while all its corners are this much above the other sole.
_CLEAR_M = 0.01


@dataclass(frozen=True, kw_only=True)
class Loads:
    """Along a grid of G times: what joint j's servo moves while all else moves as measured.

    Its torque is `inertia_kg_m2 * acceleration + load_nm + stiffness_nm_rad * (q - pos_rad)` while
    its foot is in the air; other times are not meant.
    All but the first (G,) and the last are (G, J).
    """

    time_s: np.ndarray
    pos_rad: np.ndarray
    vel_rad_s: np.ndarray
    inertia_kg_m2: np.ndarray
    load_nm: np.ndarray
    stiffness_nm_rad: np.ndarray
    swings: np.ndarray  # (G, 2) whether the left, the right foot is in the air


def smoothed(
    time_s: np.ndarray, values: np.ndarray, at_s: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values (G, K), first and second derivatives of samples (N, K) at the times (G,).

    By a polynomial of fourth order through the samples around each one (Savitzky and Golay 1964),
    which need not be evenly apart.
    """
    usual_s = float(np.median(np.diff(time_s)))
    side = max(_SIDE_ROWS, round(_SIDE_S / usual_s))
    nearest = np.searchsorted((time_s[1:] + time_s[:-1]) / 2, at_s)
    centre = np.clip(np.arange(len(time_s)), side, len(time_s) - 1 - side)
    rows = centre[:, None] + np.arange(-side, side + 1)
    powers = np.arange(_ORDER + 1)
    span_s = side * usual_s
    base = ((time_s[rows] - time_s[:, None]) / span_s)[..., None] ** powers
    factors = np.einsum("npr,nrk->npk", np.linalg.pinv(base), values[rows])
    x = ((at_s - time_s[nearest]) / span_s)[:, None]
    found = factors[nearest]
    value = np.einsum("gp,gpk->gk", x**powers, found)
    first = np.einsum("gp,gpk->gk", powers[1:] * x ** powers[:-1], found[:, 1:])
    curve = powers[2:] * (powers[2:] - 1)
    second = np.einsum("gp,gpk->gk", curve * x ** powers[:-2], found[:, 2:])
    return value, first / span_s, second / span_s**2


def loads_along(log: RobotLog, scene: Scene, *, hanging: bool) -> Loads:
    """The loads of every joint along a log, in the air.

    The pelvis's acceleration is that of the accelerometer where the log has one; 0 when the robot
    hangs in a stand; else it follows from the foot that stands, which is at rest. So for a robot
    that walks the loads of a leg hold while its foot swings, and `swings` tells when.
    """
    model, joints = scene.model, len(scene.joint_qvel)
    at_s = np.arange(log.time_s[0], log.time_s[-1], GRID_S)
    pos, vel, acc = smoothed(log.time_s, log.joint_pos_rad, at_s)
    angvel, angacc, _ = smoothed(log.time_s, log.angvel_rad_s, at_s)
    quat = smoothed(log.time_s, continuous(log.quat_world_pelvis), at_s)[0]
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    swings, linacc = np.full((len(at_s), 2), True), np.zeros((len(at_s), 2, 3))
    if not hanging:
        soles, corners_z = _soles(scene, quat, pos)
        swings = corners_z - soles[:, ::-1, 2] > _CLEAR_M
        # Of the pelvis while the left, the right foot swings: the other one is at rest.
        moves = smoothed(at_s, soles.reshape(len(at_s), 6), at_s)[2].reshape(-1, 2, 3)
        linacc = -moves[:, ::-1]
    if log.accel_m_s2 is not None:
        linacc[:] = _accelerations(smoothed(log.time_s, log.accel_m_s2, at_s)[0], quat)[:, None]

    data = mujoco.MjData(model)
    # 1 where it is not asked for, lest what runs over the end of a window divides by 0.
    inertia = np.ones((len(at_s), joints))
    load, stiffness = np.zeros((2, len(at_s), joints))
    full, torque = np.zeros((model.nv, model.nv)), np.zeros(model.nv)

    def torques() -> np.ndarray:
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, 1, torque)
        return torque[scene.joint_qvel]

    def place(g: int, leg: int) -> None:
        data.qpos[3:7], data.qpos[scene.joint_qpos] = quat[g], pos[g]
        data.qvel[3:6], data.qvel[scene.joint_qvel] = angvel[g], vel[g]
        data.qacc[:3], data.qacc[3:6] = linacc[g, leg], angacc[g]
        data.qacc[scene.joint_qvel] = acc[g]

    for leg in range(2):
        own = np.arange(joints)[leg * joints // 2 : (leg + 1) * joints // 2]
        for g in range(len(at_s)):
            if swings[g, leg]:
                place(g, leg)
                load[g, own] = torques()[own]
                mujoco.mj_crb(model, data)
                mujoco.mj_fullM(model, data, full)
                inertia[g, own] = np.diag(full)[scene.joint_qvel[own]]
        # It changes slowly, and does not matter where a replay goes as the robot went.
        coarse = np.arange(0, len(at_s), _COARSE)
        for g in coarse.tolist():
            for j in own:
                place(g, leg)
                before = torques()[j]
                data.qpos[scene.joint_qpos[j]] += _TURN_RAD
                stiffness[g, j] = (torques()[j] - before) / _TURN_RAD
        for j in own:
            stiffness[:, j] = np.interp(at_s, at_s[coarse], stiffness[coarse, j])
    # RNE is without the rotors; of the joint's own acceleration `inertia` is to take care.
    armature = model.dof_armature[scene.joint_qvel]
    load -= (inertia - armature) * acc
    return Loads(
        time_s=at_s,
        pos_rad=pos,
        vel_rad_s=vel,
        inertia_kg_m2=inertia,
        load_nm=load,
        stiffness_nm_rad=stiffness,
        swings=swings,
    )


def _soles(scene: Scene, quat: np.ndarray, pos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions (G, 2, 3) of the soles from the pelvis in world axes; z (G, 2) of their lowest."""
    data = mujoco.MjData(scene.model)
    foot = scene.robot.step_model.foot
    half = np.array([[foot.length_m, foot.width_m, 0.0]]) / 2
    corners = half * [[1, 1, 0], [1, -1, 0], [-1, 1, 0], [-1, -1, 0]]
    soles, lowest = np.zeros((len(quat), 2, 3)), np.zeros((len(quat), 2))
    for g in range(len(quat)):
        data.qpos[3:7], data.qpos[scene.joint_qpos] = quat[g], pos[g]
        mujoco.mj_kinematics(scene.model, data)
        for k, side in enumerate(SIDES):
            site = data.site(f"{side}_sole")
            soles[g, k] = site.xpos
            lowest[g, k] = (site.xpos + corners @ site.xmat.reshape(3, 3).T)[:, 2].min()
    return soles, lowest


def _accelerations(felt: np.ndarray, quat: np.ndarray) -> np.ndarray:
    """In world axes (G, 3), of what an accelerometer feels (G, 3) at orientations (G, 4)."""
    turned = np.zeros_like(felt)
    for g in range(len(felt)):
        mujoco.mju_rotVecQuat(turned[g], felt[g], quat[g])
    return turned - [0.0, 0.0, GRAVITY_M_S2]
