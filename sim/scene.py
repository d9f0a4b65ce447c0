"""Scenes: robot, floor and walls in one MuJoCo model, and the clearance between them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from maps.boxes import Terraces, terraces_of
from maps.grid import OccupancyGrid
from sim.robot import Robot
from sim.sensors import SIDES, Sensors, add_sensors
from sim.terrain import add_floor, add_ground, add_treads, add_walls, yaw_quaternion

PHYSICS_TIMESTEP_S = 0.001
WALL_HEIGHT_M = 1.0
FAR_FROM_WALLS_M = 1.0


def scene_of(
    grid: OccupancyGrid, robot: Robot, unknown_is_free: bool, *, visuals: bool = False
) -> Scene:
    """The robot among the map's obstacles, at the physics rate of navigation."""
    terraces = terraces_of(grid, grid.blocked(unknown_is_free))
    return build_scene(robot, timestep_s=PHYSICS_TIMESTEP_S, terraces=terraces, visuals=visuals)


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A compiled model and the indices of its parts in MuJoCo's arrays.

    `joint_qpos` and `joint_qvel` (J,) index the robot's joints, in the order of `robot.joints`;
    the free joint is qpos[0:7] (x, y, z, then quaternion w, x, y, z) and qvel[0:6] (linear in
    world axes, angular in the pelvis's own). Controls are joint targets (J,) in rad.
    """

    robot: Robot
    model: mujoco.MjModel
    sensors: Sensors
    joint_qpos: np.ndarray
    joint_qvel: np.ndarray
    standing_qpos: np.ndarray
    has_treads: bool = False

    def qpos_at(self, pose: np.ndarray, ground_m: float = 0.0) -> np.ndarray:
        """Half-sitting qpos (nq,) whose soles' midpoint is at the pose x_m, y_m, yaw_rad.

        The soles are at the height of the ground there.
        """
        qpos = self.standing_qpos.copy()
        x, y, yaw = pose
        cos, sin = math.cos(yaw), math.sin(yaw)
        offset_x, offset_y = self.standing_qpos[:2]
        qpos[0] = x + cos * offset_x - sin * offset_y
        qpos[1] = y + sin * offset_x + cos * offset_y
        qpos[2] += ground_m
        mujoco.mju_mulQuat(qpos[3:7], yaw_quaternion(yaw), self.standing_qpos[3:7])
        return qpos

    def soles_at(self, qpos: np.ndarray) -> np.ndarray:
        """Pose x, y, z, yaw of each sole (2, 4) in the world, left then right, at qpos (nq,)."""
        data = mujoco.MjData(self.model)
        data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, data)
        sites = [data.site(f"{side}_sole") for side in SIDES]
        return np.array([[*s.xpos, math.atan2(s.xmat[3], s.xmat[0])] for s in sites])


def build_scene(
    robot: Robot,
    *,
    timestep_s: float,
    terraces: Terraces | None = None,
    visuals: bool = False,
    treads: bool = False,
) -> Scene:
    """The robot in half-sitting on the floor among the walls of a map, by default a bare one.

    With `visuals` the model also gets sky, light, floor pattern and the robot's meshes, if it
    has any; they change nothing in the physics. With `treads` the floor can be moved and there are
    treads to be placed, per simulation (`sim.terrain`).
    """
    spec = _robot_spec(robot, timestep_s)
    _add_servos(spec, robot)
    if treads:
        add_treads(spec)
    else:
        add_floor(spec.worldbody)
    terraces = terraces or Terraces()
    add_ground(spec, terraces)
    add_walls(spec, terraces, WALL_HEIGHT_M)
    add_sensors(spec, robot)
    if visuals:
        _add_looks(spec)
        if robot.add_meshes is not None:
            robot.add_meshes(spec)
    model = spec.compile()
    joints = [model.joint(joint.name) for joint in robot.joints]
    joint_qpos = np.array([joint.qposadr[0] for joint in joints])
    return Scene(
        robot=robot,
        model=model,
        sensors=Sensors.of(model, robot),
        joint_qpos=joint_qpos,
        joint_qvel=np.array([joint.dofadr[0] for joint in joints]),
        standing_qpos=_standing_qpos(robot, model, joint_qpos),
        has_treads=treads,
    )


def robot_mjcf(robot: Robot) -> str:
    """MJCF of the robot on a bare floor for other programs; rotor inertias inside, servos not."""
    spec = _robot_spec(robot, PHYSICS_TIMESTEP_S)
    add_floor(spec.worldbody)
    spec.compile()
    return spec.to_xml()


def _robot_spec(robot: Robot, timestep_s: float) -> mujoco.MjSpec:
    """The robot alone, with the inertias of its rotors."""
    spec = robot.build()
    spec.modelname = robot.name
    spec.option.timestep = timestep_s
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for leg_joint in robot.joints:
        joint = spec.joint(leg_joint.name)
        joint.armature = leg_joint.armature_kg_m2
        joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
    return spec


def _standing_qpos(robot: Robot, model: mujoco.MjModel, joint_qpos: np.ndarray) -> np.ndarray:
    """Half-sitting with flat soles on the ground, their midpoint at the origin, facing +x."""
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    data.qpos[2] = robot.pelvis_height_m
    pitch = robot.pelvis_pitch_rad
    data.qpos[3:7] = [math.cos(pitch / 2), 0.0, math.sin(pitch / 2), 0.0]
    data.qpos[joint_qpos] = robot.half_sitting_rad
    for joint in robot.passive:
        start = model.joint(joint.name).qposadr[0]
        data.qpos[start : start + len(joint.half_sitting)] = joint.half_sitting
    mujoco.mj_kinematics(model, data)
    soles = np.stack([data.site(f"{side}_sole").xpos for side in SIDES])
    data.qpos[0:3] -= soles.mean(axis=0)
    return np.array(data.qpos)


def _add_servos(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Position servos in the order of the robot's joints, with torque limits."""
    for leg_joint in robot.joints:
        limit = leg_joint.torque_limit_nm
        actuator = spec.add_actuator(
            name=leg_joint.name,
            target=leg_joint.name,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            forcelimited=mujoco.mjtLimited.mjLIMITED_TRUE,
            forcerange=[-limit, limit],
        )
        actuator.set_to_position(kp=leg_joint.kp, kv=leg_joint.kd)


def _add_looks(spec: mujoco.MjSpec) -> None:
    """Sky, light and floor pattern."""
    # Set when the spec comes from a URDF; it would throw textures, materials and meshes away.
    spec.compiler.discardvisual = False
    kinds, patterns = mujoco.mjtTexture, mujoco.mjtBuiltin
    sky, floor = ([0.75, 0.83, 0.92], [0.98, 0.98, 1.0]), ([0.86, 0.87, 0.88], [0.80, 0.81, 0.83])
    for name, kind, pattern, (rgb1, rgb2) in (
        ("sky", kinds.mjTEXTURE_SKYBOX, patterns.mjBUILTIN_GRADIENT, sky),
        ("floor", kinds.mjTEXTURE_2D, patterns.mjBUILTIN_CHECKER, floor),
    ):
        spec.add_texture(
            name=name, type=kind, builtin=pattern, rgb1=rgb1, rgb2=rgb2, width=256, height=256
        )
    textures = [""] * int(mujoco.mjtTextureRole.mjNTEXROLE)
    textures[int(mujoco.mjtTextureRole.mjTEXROLE_RGB)] = "floor"
    spec.add_material(name="floor", textures=textures, texrepeat=[1, 1], texuniform=True)
    spec.geom("floor").material = "floor"
    spec.worldbody.add_light(
        pos=[0, 0, 6], dir=[0.2, 0.3, -1], type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    )


def min_clearance_m(scene: Scene, qpos: np.ndarray) -> float | None:
    """Least distance in m between any robot geom and any wall over the states qpos (T, nq).

    Walls farther than `FAR_FROM_WALLS_M` from the robot are ignored; None when all are.
    """
    model = scene.model
    data = mujoco.MjData(model)
    body = model.body("walls")
    walls = np.flatnonzero(model.geom_bodyid == body.id)
    # Collision geoms of the robot: those below the pelvis that can touch anything.
    mine = model.body_rootid[model.geom_bodyid] == model.body("pelvis").id
    robot = np.flatnonzero(mine & (model.geom_conaffinity > 0))
    to_walls, local = np.empty(4), np.empty(3)
    mujoco.mju_negQuat(to_walls, body.quat)
    least = FAR_FROM_WALLS_M
    fromto = np.zeros(6)
    for state in qpos:
        data.qpos[:] = state
        mujoco.mj_kinematics(model, data)
        for geom in robot:
            # In the frame of the walls' body, in which wall boxes are axis-aligned.
            mujoco.mju_rotVecQuat(local, data.geom_xpos[geom] - body.pos, to_walls)
            reach = least + model.geom_rbound[geom]
            offset = np.abs(local - model.geom_pos[walls])
            gap = np.linalg.norm(np.maximum(offset - model.geom_size[walls], 0.0), axis=1)
            for wall in walls[gap < reach]:
                distance = mujoco.mj_geomDistance(model, data, geom, int(wall), least, fromto)
                least = min(least, distance)
    return None if least >= FAR_FROM_WALLS_M else float(least)
