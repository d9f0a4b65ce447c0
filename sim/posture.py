"""States of a robot in a scene: at rest, mirrored, over given feet; the reach of shapes."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import mujoco
import numpy as np

from sim.scene import Scene
from sim.sensors import SIDES

# In a step, legs without ankle roll lean by this much at most.
LEAN_RAD = np.radians(8.0)
# By how much the legs must stay off their joints' ends in every step that is planned.
SPARE_RAD = np.radians(2.0)
_ITERATIONS = 30
_OFF = 1e-4  # m and rad


class PostureError(ValueError):
    """The feet are out of reach; the message says which and how far off they end."""


def state_at(scene: Scene, qpos: np.ndarray) -> mujoco.MjData:
    """A state with all that MuJoCo computes of it."""
    data = mujoco.MjData(scene.model)
    data.qpos[:] = qpos
    mujoco.mj_forward(scene.model, data)
    return data


def standing(scene: Scene, *, sunk_m: float = 0.0) -> mujoco.MjData:
    """Half-sitting, lower by so much."""
    qpos = scene.standing_qpos.copy()
    qpos[2] -= sunk_m
    return state_at(scene, qpos)


def mirrored_qpos(scene: Scene, qpos: np.ndarray) -> np.ndarray:
    """The state (nq,) seen in a mirror that lies in the plane y = 0."""
    index, sign = scene.robot.mirror_joints
    mirrored = qpos.copy()
    mirrored[1] *= -1
    mirrored[[4, 6]] *= -1
    mirrored[scene.joint_qpos] = sign * qpos[scene.joint_qpos][index]
    for mine, theirs, signs in _passive_pairs(scene, "qpos"):
        mirrored[mine] = signs * qpos[theirs]
    return mirrored


def mirrored_qvel(scene: Scene, qvel: np.ndarray) -> np.ndarray:
    """The velocities (nv,) seen in that mirror."""
    index, sign = scene.robot.mirror_joints
    mirrored = qvel.copy()
    mirrored[[1, 3, 5]] *= -1
    mirrored[scene.joint_qvel] = sign * qvel[scene.joint_qvel][index]
    for mine, theirs, signs in _passive_pairs(scene, "qvel"):
        mirrored[mine] = signs * qvel[theirs]
    return mirrored


def _passive_pairs(scene: Scene, of: str) -> Iterator[tuple[slice, slice, np.ndarray]]:
    """For each passive joint: where it is in qpos or qvel, where the other leg's is, and signs."""
    passive, model = scene.robot.passive, scene.model
    half = len(passive) // 2
    for joint, other in zip(passive, passive[half:] + passive[:half], strict=True):
        signs = np.array(joint.mirror_sign, float)
        if of == "qpos" and len(signs) == 3:
            signs = np.r_[1.0, signs]  # a quaternion's w stays as it is
        starts = (
            int(getattr(model.joint(one.name), f"{'qpos' if of == 'qpos' else 'dof'}adr")[0])
            for one in (joint, other)
        )
        mine, theirs = (slice(start, start + len(signs)) for start in starts)
        yield mine, theirs, signs


def reach_m(
    scene: Scene, data: mujoco.MjData, geom: int, axes: np.ndarray | None = None
) -> np.ndarray:
    """Half extents (3,) along the axes (3, 3), its columns, of a collision shape about its centre.

    By default along those of the world.

    Raises:
        ValueError: It is no box, sphere, capsule or ellipsoid.
    """
    turn, size = data.geom_xmat[geom].reshape(3, 3), scene.model.geom_size[geom]
    turn = np.abs(turn if axes is None else axes.T @ turn)
    kind = mujoco.mjtGeom(scene.model.geom_type[geom])
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return turn @ size
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return np.full(3, size[0])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return turn[:, 2] * size[1] + size[0]
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return np.linalg.norm(turn * size, axis=1)
    raise ValueError(f"{scene.model.geom(geom).name} must be a box, sphere, capsule or ellipsoid")


def posture_over(scene: Scene, feet_world: np.ndarray) -> mujoco.MjData:
    """Both soles flat on the poses x, y, z, yaw (2, 4), pelvis midway at its walking height.

    Inverse kinematics by damped least squares on MuJoCo's Jacobians, one leg after the other,
    blind to joint ranges: with six joints to a leg there is one posture near half-sitting. Legs of
    five joints have no ankle roll: their soles lean as the legs do, by `LEAN_RAD` at most. Loops
    and couplings of passive joints stay closed, springs as they are in half-sitting.

    Raises:
        PostureError: The feet do not get there.
    """
    model, data = scene.model, mujoco.MjData(scene.model)
    middle = feet_world.mean(axis=0)
    data.qpos[:] = scene.qpos_at(middle[[0, 1, 3]])
    half = len(scene.robot.joints) // 2
    moved = [_moved_dofs(scene, k) for k in range(2)]
    to_soles, open_loops = np.full((2, 6), np.inf), np.zeros(1)
    for _ in range(_ITERATIONS):
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        loops, open_loops = _loops(model, data)
        velocity = np.zeros(model.nv)
        for k, side in enumerate(SIDES):
            site = model.site(f"{side}_sole").id
            jacobian = np.zeros((6, model.nv))
            mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], site)
            # All in the foot's own axes: position, roll, pitch, yaw.
            along = np.kron(np.eye(2), data.site_xmat[site].reshape(3, 3).T)
            to_soles[k] = along @ to_pose(data, site, feet_world[k])
            task = [0, 1, 2, 4, 5] if half == 5 else range(6)
            mine = loops[:, moved[k]].any(axis=1)
            rows = np.vstack([(along @ jacobian)[task], loops[mine]])[:, moved[k]]
            wanted = np.r_[to_soles[k, task], -open_loops[mine]]
            damped = rows @ rows.T + 1e-6 * np.eye(len(rows))
            velocity[moved[k]] = rows.T @ np.linalg.solve(damped, wanted)
        mujoco.mj_integratePos(model, data.qpos, velocity, 0.5)
    off = np.abs(to_soles) - ([0, 0, 0, LEAN_RAD, 0, 0] if half == 5 else 0)
    if not max(off.max(), np.abs(open_loops).max(initial=0.0)) < _OFF:
        told = feet_world.round(3).tolist()
        raise PostureError(f"no posture over {told}: off by {off.max():.3f} m or rad")
    mujoco.mj_forward(model, data)
    return data


def loop_residual(scene: Scene, data: mujoco.MjData) -> float:
    """By how much the worst loop or coupling of the passive joints is open in a state, m or rad."""
    return float(np.abs(_loops(scene.model, data)[1]).max(initial=0.0))


def _moved_dofs(scene: Scene, leg: int) -> np.ndarray:
    """The velocities that inverse kinematics move: all of a leg but its springs."""
    robot, model = scene.robot, scene.model
    half = len(robot.passive) // 2
    dofs = list(scene.joint_qvel[leg * len(robot.joints) // 2 :][: len(robot.joints) // 2])
    for passive in robot.passive[leg * half : (leg + 1) * half]:
        joint = model.joint(passive.name)
        if not np.any(joint.stiffness):
            start = int(joint.dofadr[0])
            dofs += range(start, start + len(passive.mirror_sign))
    return np.array(dofs)


def _loops(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
    """Jacobian (n, nv) of the equality constraints, and by how much (n,) they are violated."""
    if not model.neq:
        return np.zeros((0, model.nv)), np.zeros(0)
    mujoco.mj_makeConstraint(model, data)
    of_loops = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
    return data.efc_J.reshape(-1, model.nv)[of_loops], data.efc_pos[of_loops]


def to_pose(data: mujoco.MjData, site: int, pose: np.ndarray) -> np.ndarray:
    """Way (6,) in m and rad from the site to the level pose x, y, z, yaw."""
    cos, sin = np.cos(pose[3]), np.sin(pose[3])
    level = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    quat, turn = np.empty(4), np.empty(3)
    mujoco.mju_mat2Quat(quat, (level @ data.site_xmat[site].reshape(3, 3).T).ravel())
    mujoco.mju_quat2Vel(turn, quat, 1.0)
    return np.concatenate([pose[:3] - data.site_xpos[site], turn])


def joint_ranges(scene: Scene) -> np.ndarray:
    """Low and high end (J, 2) of every joint in rad."""
    return np.array([scene.model.joint(joint.name).range for joint in scene.robot.joints])


def planned_steps(scene: Scene) -> list[tuple[float, float, float]]:
    """The step set, and the corners of the limits."""
    model = scene.robot.step_model
    corners = itertools.product(model.limits.x_m, model.limits.y_m, model.limits.yaw_rad)
    within = [corner for corner in corners if model.limits.contain(corner)]
    vertices = ((*at, yaw) for at in model.limits.reach_m for yaw in model.limits.yaw_rad)
    within += [vertex for vertex in vertices if model.limits.contain(vertex)]
    return [*model.steps, *within]


def step_spare_rad(scene: Scene, step: tuple[float, float, float], swing: int) -> tuple[float, int]:
    """How far off its end the joint is that comes nearest to one in a step, and which it is.

    Raises:
        PostureError: The feet are out of reach, or the legs touch.
    """
    x, y, yaw = step
    outward = 1 - 2 * swing
    feet = np.zeros((2, 4))
    feet[swing] = [x, outward * y, 0, outward * yaw]
    data = posture_over(scene, feet)
    if data.sensordata[scene.sensors.legs_touching][0] > 0:
        raise PostureError("the legs touch")
    ranges, angles = joint_ranges(scene), data.qpos[scene.joint_qpos]
    spare = np.minimum(angles - ranges[:, 0], ranges[:, 1] - angles)
    worst = int(spare.argmin())
    return float(spare[worst]), worst
