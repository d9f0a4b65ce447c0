"""A scene as a Drake MultibodyPlant, made from the compiled MuJoCo model.

Bodies, joints, rotor inertias, damping, joint ranges and shapes are read from the arrays of the
model and not from MJCF, of which Drake's parser leaves out contact bits and force ranges.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations_with_replacement

import mujoco
import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    Box,
    Capsule,
    CollisionFilterDeclaration,
    Cylinder,
    Ellipsoid,
    GeometryId,
    GeometrySet,
    HalfSpace,
    ProximityProperties,
    SceneGraph,
    Shape,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import (
    AddMultibodyPlant,
    CoulombFriction,
    MultibodyPlant,
    MultibodyPlantConfig,
)
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    PrismaticJoint,
    QuaternionFloatingJoint,
    RevoluteJoint,
    RigidBody,
    RotationalInertia,
    SpatialInertia,
    UnitInertia,
)
from pydrake.systems.framework import Diagram, DiagramBuilder

from sim.drake.contact_model import ContactModel, EngineError
from sim.scene import Scene

# A warning that half-spaces touch no deformable bodies, of which there are none.
logging.getLogger("drake").setLevel(logging.ERROR)
# Extents of a floor that can be moved.
_SLAB_M = (200.0, 200.0, 2.0)
# Drake asks for it also of boxes, whose meshes do not depend on it.
_MESH_M = 1.0
_KINDS, _GEOMS = mujoco.mjtJoint, mujoco.mjtGeom


@dataclass(frozen=True, kw_only=True)
class ScenePlant:
    """The plant of a scene, and where its parts are.

    `base` is the free joint. Other joints and the geoms are known by their numbers in the MuJoCo
    model; `mocap_frames` hold the movable ground, by mocap number.
    """

    diagram: Diagram
    plant: MultibodyPlant
    base: QuaternionFloatingJoint
    joints: Mapping[int, RevoluteJoint | PrismaticJoint]
    geom_of: Mapping[GeometryId, int]
    mocap_frames: Mapping[int, FixedOffsetFrame]


def plant_of(scene: Scene, contact: ContactModel) -> ScenePlant:
    """The scene as Drake simulates it.

    Raises:
        EngineError: the scene has something that Drake cannot hold; the message names it.
    """
    model = scene.model
    require_known(model)
    builder = DiagramBuilder()
    config = MultibodyPlantConfig(
        time_step=contact.timestep_s,
        contact_model="hydroelastic_with_fallback",
        discrete_contact_approximation=contact.approximation,
        stiction_tolerance=contact.stiction_m_s,
        # Contact results are those of the step taken last.
        use_sampled_output_ports=True,
    )
    plant, scene_graph = AddMultibodyPlant(config, builder)
    plant.mutable_gravity_field().set_gravity_vector(model.opt.gravity)
    bodies: dict[int, RigidBody] = {0: plant.world_body()}
    joints: dict[int, RevoluteJoint | PrismaticJoint] = {}
    mocap_frames: dict[int, FixedOffsetFrame] = {}
    for number in range(1, model.nbody):
        if _is_static(model, number):
            continue
        body = plant.AddRigidBody(f"{number}_{model.body(number).name}", _inertia(model, number))
        bodies[number] = body
        mocap = int(model.body_mocapid[number])
        if mocap >= 0:
            frame = FixedOffsetFrame(
                name=f"mocap_{mocap}", P=plant.world_frame(), X_PF=_pose(model, number)
            )
            mocap_frames[mocap] = plant.AddFrame(frame)
            plant.WeldFrames(mocap_frames[mocap], body.body_frame())
        else:
            _add_joint(plant, model, number, bodies, joints)
    geom_of = {}
    for geom in range(model.ngeom):
        if model.geom_contype[geom] or model.geom_conaffinity[geom]:
            geom_of[_add_geom(plant, model, geom, bodies, contact)] = geom
    _filter_collisions(scene_graph, model, geom_of)
    plant.Finalize()
    diagram = builder.Build()
    return ScenePlant(
        diagram=diagram,
        plant=plant,
        base=plant.GetJointByName(model.joint(0).name),
        joints=joints,
        geom_of=geom_of,
        mocap_frames=mocap_frames,
    )


def require_known(model: mujoco.MjModel) -> None:
    """Checks that Drake can hold all of a scene.

    Raises:
        EngineError: it cannot; the message names what.
    """
    if model.neq or model.ntendon:
        what = "closed loops and couplings of joints" if model.neq else "tendons"
        raise EngineError(f"--engine drake holds no {what}: walk this robot with --engine mujoco")
    for joint in range(model.njnt):
        kind = _KINDS(model.jnt_type[joint])
        springs = model.jnt_stiffness[joint], *model.jnt_stiffnesspoly[joint]
        if kind == _KINDS.mjJNT_BALL or any(springs):
            what = "ball joint" if kind == _KINDS.mjJNT_BALL else "sprung joint"
            raise EngineError(
                f"--engine drake holds no {what} such as {model.joint(joint).name}: walk this "
                "robot with --engine mujoco"
            )
    if model.body_jntnum.max() > 1:
        body = model.body(int(model.body_jntnum.argmax())).name
        raise EngineError(f"--engine drake holds no body of several joints, such as {body}")
    for geom in range(model.ngeom):
        if (model.geom_contype[geom] or model.geom_conaffinity[geom]) and _shape(
            model, geom
        ) is None:
            kind = _GEOMS(model.geom_type[geom]).name.removeprefix("mjGEOM_").lower()
            raise EngineError(f"--engine drake holds no {kind} that touches: take a box or capsule")


def _is_static(model: mujoco.MjModel, body: int) -> bool:
    """Whether the body is one with the world, and its shapes are the world's."""
    return bool(model.body_weldid[body] == 0 and model.body_mocapid[body] < 0)


def transform(position: np.ndarray, quaternion: np.ndarray) -> RigidTransform:
    """Of a position (3,) and a quaternion w, x, y, z."""
    unit = np.asarray(quaternion, float)
    return RigidTransform(Quaternion(unit / np.linalg.norm(unit)), np.asarray(position, float))


def _pose(model: mujoco.MjModel, body: int) -> RigidTransform:
    """Of the body in its parent."""
    return transform(model.body_pos[body], model.body_quat[body])


def _world_pose(model: mujoco.MjModel, body: int) -> RigidTransform:
    """Of a static body in the world."""
    pose = RigidTransform()
    while body:
        pose = _pose(model, body) @ pose
        body = int(model.body_parentid[body])
    return pose


def spatial_inertia(
    mass_kg: float, com_m: np.ndarray, moments: np.ndarray, quaternion: np.ndarray
) -> SpatialInertia:
    """Of a body about its origin, from principal moments (3,) about its centre of mass."""
    if mass_kg == 0:
        return SpatialInertia(0.0, np.zeros(3), UnitInertia(0.0, 0.0, 0.0))
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, np.asarray(quaternion, float))
    axes = turn.reshape(3, 3)
    tensor = axes @ np.diag(moments) @ axes.T
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = tensor
    return SpatialInertia.MakeFromCentralInertia(
        mass_kg, com_m, RotationalInertia(xx, yy, zz, xy, xz, yz)
    )


def _inertia(model: mujoco.MjModel, body: int) -> SpatialInertia:
    return spatial_inertia(
        float(model.body_mass[body]),
        model.body_ipos[body],
        model.body_inertia[body],
        model.body_iquat[body],
    )


def _add_joint(
    plant: MultibodyPlant,
    model: mujoco.MjModel,
    body: int,
    bodies: Mapping[int, RigidBody],
    joints: dict[int, RevoluteJoint | PrismaticJoint],
) -> None:
    """Joins the body to its parent by its joint, or rigidly if it has none."""
    parent, child = bodies[int(model.body_parentid[body])], bodies[body]
    if not model.body_jntnum[body]:
        plant.WeldFrames(parent.body_frame(), child.body_frame(), _pose(model, body))
        return
    number = int(model.body_jntadr[body])
    name, kind = model.joint(number).name, _KINDS(model.jnt_type[number])
    if kind == _KINDS.mjJNT_FREE:
        plant.AddJoint(QuaternionFloatingJoint(name, plant.world_frame(), child.body_frame()))
        return
    place = RigidTransform(np.asarray(model.jnt_pos[number], float))
    on_parent = plant.AddFrame(
        FixedOffsetFrame(
            name=f"{name}_parent", P=parent.body_frame(), X_PF=_pose(model, body) @ place
        )
    )
    on_child = plant.AddFrame(
        FixedOffsetFrame(name=f"{name}_child", P=child.body_frame(), X_PF=place)
    )
    dof = int(model.jnt_dofadr[number])
    limited = bool(model.jnt_limited[number])
    low, high = model.jnt_range[number] if limited else (-np.inf, np.inf)
    kind_of_joint = RevoluteJoint if kind == _KINDS.mjJNT_HINGE else PrismaticJoint
    joint = plant.AddJoint(
        kind_of_joint(
            name=name,
            frame_on_parent=on_parent,
            frame_on_child=on_child,
            axis=model.jnt_axis[number],
            pos_lower_limit=low,
            pos_upper_limit=high,
            damping=float(model.dof_damping[dof]),
        )
    )
    joints[number] = joint
    actuator = plant.AddJointActuator(name, joint)
    actuator.set_default_rotor_inertia(float(model.dof_armature[dof]))
    actuator.set_default_gear_ratio(1.0)


def _shape(model: mujoco.MjModel, geom: int) -> Shape | None:
    """Drake's shape of a geom; None where it has none."""
    size = model.geom_size[geom]
    makers = {
        _GEOMS.mjGEOM_PLANE: HalfSpace,
        _GEOMS.mjGEOM_BOX: lambda: Box(*(2 * size)),
        _GEOMS.mjGEOM_SPHERE: lambda: Sphere(size[0]),
        _GEOMS.mjGEOM_CAPSULE: lambda: Capsule(size[0], 2 * size[1]),
        _GEOMS.mjGEOM_CYLINDER: lambda: Cylinder(size[0], 2 * size[1]),
        _GEOMS.mjGEOM_ELLIPSOID: lambda: Ellipsoid(*size),
    }
    maker = makers.get(_GEOMS(model.geom_type[geom]))
    return None if maker is None else maker()


def _add_geom(
    plant: MultibodyPlant,
    model: mujoco.MjModel,
    geom: int,
    bodies: Mapping[int, RigidBody],
    contact: ContactModel,
) -> GeometryId:
    body = int(model.geom_bodyid[geom])
    pose = transform(model.geom_pos[geom], model.geom_quat[geom])
    if body not in bodies:
        pose, body = _world_pose(model, body) @ pose, 0
    shape = _shape(model, geom)
    if isinstance(shape, HalfSpace) and body:
        # Drake's broad phase ends the process when what moves has no bounds.
        shape, pose = Box(*_SLAB_M), pose @ RigidTransform([0.0, 0.0, -_SLAB_M[2] / 2])
    return plant.RegisterCollisionGeometry(
        bodies[body], pose, shape, f"geom_{geom}", _properties(model, geom, contact)
    )


def _properties(model: mujoco.MjModel, geom: int, contact: ContactModel) -> ProximityProperties:
    """Compliant soles on rigid ground touch over an area; all other pairs touch at points.

    A sole's pressure is the modulus times depth over half its least extent, on the floor and on
    treads alike; a box of ground that is compliant would be the softer the larger it is.
    """
    properties = ProximityProperties()
    friction = contact.friction
    if friction is None:
        friction = float(model.geom_friction[geom, 0])
    AddContactMaterial(
        properties=properties,
        dissipation=contact.dissipation_s_m,
        friction=CoulombFriction(friction, friction),
    )
    properties.AddProperty("material", "relaxation_time", contact.relaxation_s)
    if model.geom(geom).name in ("left_foot", "right_foot"):
        AddCompliantHydroelasticProperties(_MESH_M, contact.modulus_pa, properties)
    elif is_ground(model, geom):
        AddRigidHydroelasticProperties(_MESH_M, properties)
    return properties


def is_ground(model: mujoco.MjModel, geom: int) -> bool:
    """Whether a geom is of the floor, of a map's ground or of a tread: not of robot or walls."""
    body = int(model.geom_bodyid[geom])
    return bool(model.body_weldid[body] == 0 and model.body(body).name != "walls")


def _filter_collisions(
    scene_graph: SceneGraph, model: mujoco.MjModel, geom_of: Mapping[GeometryId, int]
) -> None:
    """Let those pairs touch that MuJoCo's contact bits let touch."""
    groups: dict[tuple[int, int], list[GeometryId]] = {}
    for name, geom in geom_of.items():
        bits = int(model.geom_contype[geom]), int(model.geom_conaffinity[geom])
        groups.setdefault(bits, []).append(name)
    declared = CollisionFilterDeclaration()
    for first, second in combinations_with_replacement(groups, 2):
        if first[0] & second[1] or second[0] & first[1]:
            continue
        if first == second:
            declared.ExcludeWithin(GeometrySet(groups[first]))
        else:
            declared.ExcludeBetween(GeometrySet(groups[first]), GeometrySet(groups[second]))
    scene_graph.collision_filter_manager().Apply(declared)
