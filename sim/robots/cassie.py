"""Cassie of Agility Robotics: 33.3 kg, a pelvis on two legs with five motors each.

A motor each turns hip roll, hip yaw, hip pitch, knee and foot. Below the knee two leaf springs
give, at the shin and at the heel; the achilles rod from thigh to heel spring sets the angle of the
tarsus by that of the knee; crank and plantar rod follow the foot. So of the 11 joints of a leg six
are passive, and each rod closes a loop. Without ankle roll a foot touches the ground in a line.
`sim/robots/cassie_rigid.py` is the same robot without springs and rods.

MENAGERIE  google-deepmind/mujoco_menagerie at 1b428b08, agility_cassie/cassie.xml: MIT licence,
           Copyright (c) 2022 Agility Robotics. Places, axes, masses, inertias, ranges, damping,
           rotors, springs, loops, motors and collision shapes. Numbers alone, of the left leg; the
           right one is its exact mirror image, there but for 0.1 mm at the hip roll.
APEX       osudrl/apex at 82c44af, cassie/cassie.py: half-sitting.
GAZEBO     DAIRLab/cassie-gazebo-sim, ISC licence, Copyright (c) 2018 Agility Robotics: meshes.
DERIVED    Computed from these with MuJoCo: passive joints in half-sitting, height.
ESTIMATED  Ours, as said there: servo gains, step model, looks.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from planner.robot_model import BodyShape, FootShape, StepLimits
from sim.robot import (
    LEFT_LEG_BITS,
    RIGHT_LEG_BITS,
    UPPER_BODY_BITS,
    GaitTiming,
    PassiveJoint,
    Robot,
    RobotStepModel,
    both_legs,
)
from sim.solids import Ellipsoid, Rod, Vector, add_mesh, add_shape, capsule, set_mass

if TYPE_CHECKING:
    import mujoco

Axes = tuple[Vector, Vector]
_UPRIGHT: Axes = ((1, 0, 0), (0, 1, 0))


@dataclass(frozen=True, kw_only=True)
class _Joint:
    """A joint of the left leg about the z axis of its body, or about all for a ball.

    `range_deg`, `ref_deg`: MuJoCo's, () for no range. The motor turns `rotor` (kg m2, at the
    joint). `spring` is N m/rad, from 0.
    """

    kind: Literal["hinge", "ball"] = "hinge"
    range_deg: tuple[float, ...] = ()
    ref_deg: float = 0.0
    damping: float = 0.0
    spring: float = 0.0
    rotor: float = 0.0


@dataclass(frozen=True, kw_only=True)
class _Link:
    """A body of the left leg: where it is in its parent, and of what.

    `axes` are the directions of x and y in the parent; `inertia` (kg m2) is xx, yy, zz, xy, xz, yz
    about the centre of mass.
    """

    name: str
    parent: str
    pos: Vector
    axes: Axes = _UPRIGHT
    mass_kg: float
    com: Vector
    inertia: tuple[float, float, float, float, float, float]
    joint: _Joint | None


# fmt: off
# All from MENAGERIE.
_PELVIS_KG, _PELVIS_COM = 10.33, (0.05066, 0.0, 0.02841)  # published: 0.3 mm off the middle plane
_PELVIS_INERTIA = (0.085821, 0.049222, 0.08626, 0.0, -0.00016022, 0.0)
_KNEE_TURN: Axes = ((0.70711, -0.70711, 0), (0.70711, 0.70711, 0))
_LINKS = (
    _Link(
        name="hip_roll", parent="pelvis", pos=(0.021, 0.135, 0), axes=((0, 0, -1), (0, 1, 0)),
        mass_kg=1.82, com=(-0.01793, 0.0001, -0.04428),
        inertia=(0.003431, 0.003793, 0.002135, -6.65e-07, -0.00084, 3.99e-06),
        joint=_Joint(range_deg=(-15, 22.5), damping=1, rotor=0.038125),
    ),
    _Link(
        name="hip_yaw", parent="hip_roll", pos=(0, 0, -0.07), axes=((0, 0, 1), (0, 1, 0)),
        mass_kg=1.171, com=(0, -1e-05, -0.034277),
        inertia=(0.002443, 0.002803, 0.000842, -4e-08, 2.462e-07, -2.71e-08),
        joint=_Joint(range_deg=(-22.5, 22.5), damping=1, rotor=0.038125),
    ),
    _Link(
        name="hip_pitch", parent="hip_yaw", pos=(0, 0, -0.09), axes=((0, 0, -1), (1, 0, 0)),
        mass_kg=5.52, com=(0.05946, 5e-05, -0.03581),
        inertia=(0.010898, 0.029714, 0.030257, -0.0002669, -5.721e-05, 9.17e-06),
        joint=_Joint(range_deg=(-50, 80), damping=1, rotor=0.09344),
    ),
    _Link(
        name="achilles_rod", parent="hip_pitch", pos=(0, 0, 0.045),
        axes=((0.7922, -0.60599, -0.072096), (0.60349, 0.79547, -0.054922)),
        mass_kg=0.1567, com=(0.24719, 0, 0),
        inertia=(3.754e-06, 0.004487, 0.004488, -3.74e-08, -1.61e-08, 0),
        joint=_Joint(kind="ball", damping=0.01),
    ),
    _Link(
        name="knee", parent="hip_pitch", pos=(0.12, 0, 0.0045), axes=_KNEE_TURN,
        mass_kg=0.7578, com=(0.023, 0.03207, -0.002181),
        inertia=(0.001376, 0.0010335, 0.0021637, -0.00039744, -4.085e-05, -5.374e-05),
        joint=_Joint(range_deg=(-164, -37), ref_deg=-45, damping=1, rotor=0.09344),
    ),
    _Link(
        name="knee_spring", parent="knee", pos=(0.06068, 0.08241, 0),
        mass_kg=0.186, com=(0.0836, 0.0034, 0),
        inertia=(5.215e-05, 0.00041205, 0.0003669, 6.87e-06, 0, 0),
        joint=None,
    ),
    _Link(
        name="shin", parent="knee", pos=(0.06068, 0.04741, 0),
        mass_kg=0.577, com=(0.18338, 0.001169, 0.0002123),
        inertia=(0.00035939, 0.014728, 0.014707, -0.00020981, 2.266e-05, -1.2e-07),
        joint=_Joint(range_deg=(-20, 20), damping=0.1, spring=1500),
    ),
    _Link(
        name="tarsus", parent="shin", pos=(0.43476, 0.02, 0),
        axes=((0.52992, 0.84805, 0), (-0.84805, 0.52992, 0)),
        mass_kg=0.782, com=(0.11046, -0.03058, -0.00131),
        inertia=(0.00039238, 0.013595, 0.013674, 0.00023651, -4.987e-05, -4.82e-06),
        joint=_Joint(range_deg=(50, 170), ref_deg=58, damping=0.1),
    ),
    _Link(
        name="heel_spring", parent="tarsus", pos=(-0.01269, -0.03059, 0.00092),
        axes=((-0.91211, 0.40829, 0.036948), (-0.40992, -0.90952, -0.068841)),
        mass_kg=0.126, com=(0.081, 0.0022, 0),
        inertia=(2.959e-05, 0.00022231, 0.0002007, 7.15e-06, -6e-07, 1e-07),
        joint=_Joint(spring=1250),
    ),
    _Link(
        name="foot_crank", parent="tarsus", pos=(0.058, -0.034, 0.02275),
        mass_kg=0.1261, com=(0.00493, 2e-05, -0.00215),
        inertia=(2.6941e-05, 4.9621e-05, 6.3362e-05, -2.1e-09, -3.9623e-06, -1.09e-08),
        joint=_Joint(range_deg=(-140, -30), damping=1),
    ),
    _Link(
        name="plantar_rod", parent="foot_crank", pos=(0.055, 0, -0.00791),
        mass_kg=0.1186, com=(0.17792, 0, 0),
        inertia=(2.779e-06, 0.001774, 0.001775, -2.34e-08, -8.1e-09, 0),
        joint=_Joint(),
    ),
    _Link(
        name="foot", parent="tarsus", pos=(0.408, -0.04, 0),
        mass_kg=0.1498, com=(0.00474, 0.02748, -0.00014),
        inertia=(0.00017388, 0.00016793, 0.00033261, 0.00011814, 1.36e-06, -4e-07),
        joint=_Joint(range_deg=(-140, -30), damping=1, rotor=0.01225),
    ),
)
# Each loop: rod, what its far end holds, and how far out (m) that is. Both ends meet in the posture
# in which all angles are those of `ref_deg`, or 0.
_LOOPS = (("achilles_rod", "heel_spring", 0.5012), ("plantar_rod", "foot", 0.35012))
_LOOP_SOLREF = (0.005, 1.0)
# Ours, not MuJoCo's (0.9, 0.95), with which the rods give by 2 mm under half the weight, as steel
# does not, and the pelvis sinks by another 1 cm.
_LOOP_SOLIMP = (0.99, 0.999, 0.001, 0.5, 2.0)

# Collision shapes, with the feet.
_PELVIS_SHAPES = {
    "torso": Ellipsoid(centre=(0.03, 0, 0.03), radii=(0.15, 0.12, 0.13)),
    "left_hip": capsule((-0.04, 0.14, 0.01), (0.02, 0.14, 0.01), 0.095),
    "right_hip": capsule((-0.04, -0.14, 0.01), (0.02, -0.14, 0.01), 0.095),
}
_SOLE = capsule((0.069746, -0.010224, 0), (-0.052821, 0.092622, 0), 0.02)  # from heel to toe
_LEG_SHAPES: dict[str, dict[str, Rod]] = {
    "hip_pitch": {"thigh": capsule((0, 0, -0.05), (0.12, 0, -0.05), 0.08)},
    "shin": {
        "knee": capsule((-0.06, 0, 0), (0.17, -0.01, 0), 0.04),
        "shin": capsule((0.17, -0.023, 0), (0.38, 0, 0), 0.027),
        "shin_spring": capsule((-0.045, 0.045, 0), (0.43476, 0, 0), 0.025),
    },
    "tarsus": {
        "heel": capsule((0.01, -0.03059, 0.00092), (0.23, -0.04, 0), 0.028),
        "crank": capsule((0.04, -0.07, 0.00092), (0.208, -0.04, 0), 0.033),
        "tarsus": capsule((0.208, -0.04, 0), (0.43, -0.04, 0), 0.02),
    },
    "foot": {"foot": _SOLE},
}
# fmt: on
# What is seen: docs/make/cassie_meshes.py. Colours are ESTIMATED; what is not named is dark.
MESHES = Path(__file__).with_name("cassie_meshes.npz")
_LIGHT, _DARK, _STEEL = (0.88, 0.87, 0.84, 1.0), (0.20, 0.21, 0.24, 1.0), (0.62, 0.64, 0.67, 1.0)
_COLOURS = {
    **dict.fromkeys(("pelvis", "hip_pitch"), _LIGHT),
    **dict.fromkeys(("achilles_rod", "plantar_rod", "knee_spring", "heel_spring"), _STEEL),
}
# MENAGERIE's capsule: 16 cm from centre to centre of its caps.
FOOT = FootShape(length_m=0.20, width_m=0.04)

# Name, kp, kd, torque limit (N m), speed limit (rad/s), rotor (kg m2), half-sitting (deg), mirror
# sign. Limits and speeds: those of the motors through the gears. Gains ESTIMATED, well above APEX's
# 100, 100, 88, 96, 50, and no more than reaches the torque limit at about half a radian: the knee
# bears 42 N m in half-sitting, and the hip roll as much on one foot, where APEX's give by 25
# degrees. Half-sitting: knee of APEX; hip pitch and foot such that soles are flat and the centre of
# mass, 1.8 cm behind their middle there, above it.
_LEG = (
    ("hip-roll", 200, 20, 112.5, 12.15, 0.038125, 0.0, -1),
    ("hip-yaw", 200, 20, 112.5, 12.15, 0.038125, 0.0, -1),
    ("hip-pitch", 250, 25, 195.2, 8.51, 0.09344, 27.2964, 1),
    ("knee", 400, 40, 195.2, 8.51, 0.09344, -68.74, 1),
    ("foot", 80, 8, 45, 11.52, 0.01225, -92.104, 1),
)
JOINTS = both_legs(_LEG, named="{side}-{joint}")
# In half-sitting, DERIVED: springs as half the weight on each foot bends them, loops closed. Angle
# or quaternion, and mirror signs.
SHIN_RAD, HEEL_RAD = -0.03864, -0.027973
_PASSIVE: tuple[tuple[str, tuple[float, ...], tuple[int, ...]], ...] = (
    ("achilles-rod", (0.97530346, 0.00116962, 0.01528214, -0.22033666), (-1, -1, 1)),
    ("shin", (SHIN_RAD,), (1,)),
    ("tarsus", (1.49682196,), (1,)),
    ("heel-spring", (HEEL_RAD,), (1,)),
    ("foot-crank", (-1.49961651,), (1,)),
    ("plantar-rod", (1.48121494,), (1,)),
)


def _matrix(axes: Axes) -> np.ndarray:
    """The rotation (3, 3) to the parent's axes; published to five digits, made exact here."""
    x = np.array(axes[0], float)
    x /= np.linalg.norm(x)
    y = np.array(axes[1], float)
    y -= (x @ y) * x
    y /= np.linalg.norm(y)
    return np.column_stack([x, y, np.cross(x, y)])


def _mirror(link: str) -> np.ndarray:
    """Diagonal (3,) that mirrors in the frame of a body: its y or z axis points to the side."""
    return np.array([1, -1, 1] if link in ("pelvis", "hip_roll", "hip_yaw") else [1, 1, -1])


def _add_links(spec: mujoco.MjSpec, side: str) -> None:
    import mujoco

    is_right = side == "right"
    for link in _LINKS:
        of_parent, own = (
            np.where(is_right, _mirror(name), 1.0) for name in (link.parent, link.name)
        )
        turn = of_parent[:, None] * _matrix(link.axes) * own
        quat = np.empty(4)
        mujoco.mju_mat2Quat(quat, np.ascontiguousarray(turn).ravel())
        x, y, z = own
        parent = link.parent if link.parent == "pelvis" else _body(side, link.parent)
        body = spec.body(parent).add_body(
            name=_body(side, link.name), pos=of_parent * link.pos, quat=quat
        )
        set_mass(
            body,
            link.mass_kg,
            own * link.com,
            np.array([1, 1, 1, x * y, x * z, y * z]) * link.inertia,
        )
        if link.joint is not None:
            _add_joint(body, f"{side}-{link.name.replace('_', '-')}", link.joint, x * y)


def _add_joint(body: mujoco.MjsBody, name: str, joint: _Joint, mirror_sign: int) -> None:
    import mujoco

    if joint.kind == "ball":
        body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_BALL, damping=[joint.damping, 0, 0])
        return
    ends = np.radians(sorted(mirror_sign * end for end in joint.range_deg))
    body.add_joint(
        name=name,
        axis=[0, 0, 1],
        damping=[joint.damping, 0, 0],
        stiffness=[joint.spring, 0, 0],
        ref=math.radians(joint.ref_deg),
        armature=joint.rotor,
        **({"range": ends} if len(ends) else {}),
    )


def _add_shapes(spec: mujoco.MjSpec, side: str, bits: tuple[int, int]) -> None:
    import mujoco

    for link, shapes in _LEG_SHAPES.items():
        for name, rod in shapes.items():
            shape = _on_side(rod, link, side)
            add_shape(spec.body(_body(side, link)), f"{side}_{name}", shape, bits)
    heel, toe = (np.array(end) for end in (_SOLE.first, _SOLE.last))
    forward = (toe - heel) / np.linalg.norm(toe - heel)
    up = np.cross(forward, [0, 0, -1])  # the body's z points to the right
    quat = np.empty(4)
    turn = np.column_stack([forward, [0, 0, -1], up])
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(turn).ravel())
    centre = (heel + toe) / 2 - _SOLE.radius * up
    spec.body(_body(side, "foot")).add_site(name=f"{side}_sole", pos=centre, quat=quat)


def _add_loops(spec: mujoco.MjSpec, side: str) -> None:
    import mujoco

    for rod, other, length_m in _LOOPS:
        spec.add_equality(
            type=mujoco.mjtEq.mjEQ_CONNECT,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            name=_body(side, rod),
            name1=_body(side, rod),
            name2=_body(side, other),
            data=[length_m, *[0.0] * 11],
            solref=_LOOP_SOLREF,
            solimp=_LOOP_SOLIMP,
        )


def _on_side(rod: Rod, link: str, side: str) -> Rod:
    """A rod of the left leg on a side."""
    own = _mirror(link) if side == "right" else np.ones(3)
    first, last = (tuple(own * end) for end in (rod.first, rod.last))
    return replace(rod, first=first, last=last)


def _body(side: str, link: str) -> str:
    return f"{side}_leg" if link == "hip_roll" else f"{side}_{link}"


def build() -> mujoco.MjSpec:
    """The model, with springs and closed loops, all symmetric."""
    import mujoco

    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.compiler.fusestatic = True
    pelvis = spec.worldbody.add_body(name="pelvis")
    pelvis.add_freejoint(name="root")
    set_mass(pelvis, _PELVIS_KG, _PELVIS_COM, _PELVIS_INERTIA)
    for name, shape in _PELVIS_SHAPES.items():
        add_shape(pelvis, name, shape, UPPER_BODY_BITS)
    pelvis.add_site(name="head", pos=[0.03, 0, 0.16])
    for side, bits in (("left", LEFT_LEG_BITS), ("right", RIGHT_LEG_BITS)):
        _add_links(spec, side)
        _add_shapes(spec, side, bits)
        _add_loops(spec, side)
    return spec


def add_meshes(spec: mujoco.MjSpec) -> None:
    """Dresses the model, or the one without rods, in the meshes of the real robot."""
    with np.load(MESHES) as meshes:
        for link in ("pelvis", *(link.name for link in _LINKS)):
            vertices, faces = meshes[f"{link}_vertices"], meshes[f"{link}_faces"]
            colour = _COLOURS.get(link, _DARK)
            if link == "pelvis":
                add_mesh(spec, spec.body(link), vertices, faces, colour)
                continue
            for side in ("left", "right"):
                body = spec.body(_body(side, link))
                if body is not None and side == "left":
                    add_mesh(spec, body, vertices, faces, colour)
                elif body is not None:  # triangles of a mirror image turn the other way round
                    add_mesh(spec, body, vertices * _mirror(link), faces[:, ::-1], colour)


def passive_joints(names: Collection[str]) -> tuple[PassiveJoint, ...]:
    """The passive joints of both legs that are named, without their sides."""
    return tuple(
        PassiveJoint(
            name=f"{side}-{name}",
            half_sitting=_of(side, values, signs),
            mirror_sign=signs,
        )
        for side in ("left", "right")
        for name, values, signs in _PASSIVE
        if name in names
    )


def _of(side: str, values: tuple[float, ...], signs: tuple[int, ...]) -> tuple[float, ...]:
    """Angle or quaternion of the left leg on a side."""
    if side == "left":
        return values
    kept = values[: len(values) - len(signs)]  # w of a quaternion
    turned = values[len(kept) :]
    return (*kept, *(sign * value for sign, value in zip(signs, turned, strict=True)))


# ESTIMATED: those of a robot of this size without ankle roll, well inside what the hips reach.
LIMITS = StepLimits(x_m=(-0.20, 0.32), y_m=(0.20, 0.36), yaw_rad=(-0.17, 0.33))

ROBOT = Robot(
    name="cassie",
    title="Cassie",
    step_model=RobotStepModel(
        foot=FOOT,
        # The legs count: the ankles' tops are 32 cm behind the middle of the feet.
        body=BodyShape(length_m=0.66, width_m=0.54),
        limits=StepLimits(x_m=(-0.17, 0.29), y_m=(0.22, 0.34), yaw_rad=(-0.13, 0.27)),
        # Of the search, outward (x m, y m, yaw rad): within the limits with room for rounding.
        steps=(
            *((x, 0.26, 0.0) for x in (-0.15, -0.10, 0.0, 0.10, 0.20, 0.28)),
            *((x, 0.31, 0.0) for x in (-0.10, 0.0, 0.10)),
            *((x, 0.26, 0.25) for x in (-0.05, 0.0, 0.10, 0.20)),
            *((x, 0.26, 0.1) for x in (0.0, 0.10, 0.25)),
            *((x, 0.26, -0.1) for x in (0.0, 0.10, 0.20)),
        ),
        stance_width_m=0.26,
        body_margin_m=0.12,
    ),
    gait=GaitTiming(single_support_s=0.5, double_support_s=0.2),
    joints=JOINTS,
    passive=passive_joints([name for name, *_ in _PASSIVE]),
    mass_kg=33.312,
    height_m=1.148,
    pelvis_height_m=0.9884,
    pelvis_pitch_rad=0.0,
    fallen_height_m=0.73,
    # Of a sole that is 4 cm wide: without ankle roll hips and swinging leg hold it sideways, as H1.
    steady_pressure_share=10.0,
    # At 5 ms it blows up; at 2.5 ms it moves as at 0.5 ms.
    longest_timestep_s=0.0025,
    trained_as="cassie-rigid",
    build=build,
    add_meshes=add_meshes,
    training_limits=LIMITS,
)
