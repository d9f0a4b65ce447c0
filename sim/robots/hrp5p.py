"""HRP-5P: 103 kg, 1.82 m, 12 leg joints; arms, waist and neck held fixed.

There is no public model of this robot, so this one is put together from single figures; beside
each group below stands where it is from. `docs/hrp5p.md` says the same at more length.

PAPER     Singh et al. 2022, table of HRP-5P: mass, height, torque and speed limits, gait.
AIST      Press release of 2018-11-16 on HRP-5P: height.
WRS       wangyan-hlab/wrs-nxt-IL-RL at c474b89, robotsim/hrp5p: lengths, axes, ranges, centres of
          mass, sole (figures of 2018), and the bounds of its meshes. Numbers only, no code or mesh.
MJLAB     Kooolkimooov/mc_mjlab at cc26985: armature, half-sitting angles, pelvis height.
KO        ArnaudDmt/KineticsObserver pipeline: mass of the pelvis.
DYN       rohanpsingh/dyn-param-search at f1ea583: bounds for the masses of the leg links.
ESTIMATED Ours, as said there: inertias, how the mass is shared, damping, all shapes and colours.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from planner.robot_model import BodyShape, FootShape, StepLimits
from sim.robot import (
    LEFT_LEG_BITS,
    RIGHT_LEG_BITS,
    UPPER_BODY_BITS,
    GaitTiming,
    LegRow,
    Robot,
    RobotStepModel,
    both_legs,
)
from sim.solids import (
    Block,
    Box,
    Colour,
    Rod,
    Shapes,
    Solid,
    Vector,
    add_look,
    add_shape,
    add_shapes,
    add_sole,
    capsule,
    mirrored,
    set_mass,
)

if TYPE_CHECKING:
    import mujoco

SIDES = {"left": 1, "right": -1}  # and where y points outward

# WRS: vertices of the sole, in the frame of the ankle; y outward. Thickness ESTIMATED.
FOOT = FootShape(length_m=0.23, width_m=0.13)
SOLE_M = (0.015, 0.010, -0.102)

# Name, kp, kd, torque limit (N m), speed limit (rad/s), armature (kg m2), half-sitting (deg) and
# mirror sign; body; range of the left joint (deg), positive about the axis. Limits: PAPER.
# Armature, angles: MJLAB; the angles sum to 0, so the pelvis is upright over flat soles. Ranges:
# WRS. Gains ESTIMATED: twice those of JVRC-1, a robot of three fifths the mass.
_JOINTS: tuple[tuple[LegRow, str, tuple[float, float]], ...] = (
    (("CY", 400, 40, 250, 10.29, 0.110084846291, 0.0, -1), "hip_yaw", (-45, 45)),
    (("CR", 400, 40, 600, 7.85, 0.317032732584, 0.0, -1), "hip_roll", (-45, 45)),
    (("CP", 400, 40, 600, 8.58, 0.317032732584, -26.87, 1), "thigh", (-125, 77)),
    (("KP", 500, 50, 1420, 4.66, 1.174334694856, 50.0, 1), "shank", (0, 150)),
    (("AP", 160, 16, 300, 8.49, 0.161699903568, -23.13, 1), "ankle", (-85, 55)),
    (("AR", 160, 16, 250, 10.19, 0.112299753167, 0.0, -1), "foot_link", (-50, 45)),
)
_AXES = {"Y": (0, 0, 1), "R": (1, 0, 0), "P": (0, 1, 0)}  # by the last letter of the joint's name
JOINTS = both_legs([row for row, *_ in _JOINTS], named="{side}{joint}", sides=("L", "R"))
# ESTIMATED, as in the public model of JVRC-1; N m s/rad.
DAMPING = 0.2

# Left leg, from the hip down: position in the parent (m), mass (kg), centre of mass (m), and about
# it the inertia xx, yy, zz, xy, xz, yz (1e-3 kg m2). Positions, centres: WRS. Masses: three
# quarters up DYN's bounds, which brings the whole robot's centre of mass to 0.97 m in half-sitting.
# Inertias ESTIMATED: hulls of WRS's meshes, uniformly dense.
_LEG_LINKS: tuple[tuple[Vector, float, Vector, tuple[float, ...]], ...] = (
    ((0, 0.06, 0), 2.75, (0.00287, -0.00659, 0.05339), (7.94, 8.55, 4.47, -0.10, 0.20, -0.07)),
    ((0, 0, 0), 1.75, (-0.00547, 0.01224, 0), (2.14, 1.21, 1.67, -0.06, 0, 0.07)),
    ((0, 0, 0), 6.75, (0.0063, 0.08159, -0.19192), (119.73, 109.93, 21.86, 0.09, 1.21, -10.44)),
    (
        (0, 0.035, -0.38),
        3.7,
        (0.00737, 0.00845, -0.13877),
        (51.29, 50.11, 5.94, -0.07, -1.62, 0.27),
    ),
    ((0, 0, -0.38), 1.7, (-0.01124, 0.00105, 0.01174), (1.58, 2.41, 1.56, -0.01, -0.05, 0.02)),
    ((0, 0, 0), 1.75, (0.00069, 0.00777, -0.07091), (3.82, 8.72, 8.87, -0.07, 0.74, 0.18)),
)

# The same of the pelvis: mass KO, centre WRS, inertia ESTIMATED like the legs'. What lies off the
# middle plane by less than the figures are good for is set to zero, here and in the upper body.
_PELVIS = (9.8635, (-0.03447, 0, 0.17892), (113.27, 135.97, 110.72, 0, -6.93, 0))
# Chest, head and arms as one, in the pelvis's frame: what PAPER's 103 kg leave, at the centre of
# mass and with the inertia of WRS's links (hulls) in the posture below, scaled to that mass.
_UPPER_BODY = (56.3365, (-0.00519, 0, 0.47800), (4026.8, 3393.4, 2404.7, 0, -448.3, 0))

# Held arms: shoulder pitch and elbow as in MJLAB's half-sitting. Its arms are spread by 20 degrees;
# ours hang at 4, which makes the robot 0.62 m wide instead of 0.78.
SHOULDER_PITCH_DEG, SHOULDER_SPREAD_DEG, ELBOW_DEG = 60.0, 4.0, -105.0
# WRS: where the frames of the upper body lie, those of the chest and shoulder in the pelvis, then
# each in the one before. The wrist's frame is turned on by as much as its forearm.
WAIST_M, HEAD_M, SHOULDER_M = (0.055, 0, 0.274), (0.072, 0, 0.549), (0.087, 0.21, 0.542)
ELBOW_M, WRIST_M = (0.05, 0.02, -0.295804), (-0.05, 0, -0.295804)

# Collision shapes, ESTIMATED from the bounds of WRS's meshes. The thigh's motors lie outward of the
# hip joint, so thighs and shanks stay apart in half-sitting.
_LEG_SHAPES: dict[str, Solid] = {
    "thigh": capsule((0, 0.085, -0.03), (0, 0.070, -0.36), 0.060),
    "shank": capsule((0.01, 0.010, -0.03), (0.01, 0.005, -0.31), 0.050),
}
_BODY_SHAPES: Shapes = {
    "pelvis": {"hips": Box(centre=(-0.030, 0, 0.10), size=(0.34, 0.31, 0.30))},
    "chest": {
        "waist": capsule((-0.03, 0, 0.02), (-0.03, 0, 0.12), 0.11),
        "torso": Box(centre=(-0.085, 0, 0.25), size=(0.36, 0.34, 0.34)),
    },
    "head_link": {"skull": capsule((0, 0, -0.03), (0, 0, 0.04), 0.095)},
}
_ARM_SHAPES: dict[str, Solid] = {
    "upper_arm": capsule((0, 0.01, 0), (0.03, 0.02, -0.29), 0.06),
    "forearm": capsule((-0.03, 0, -0.02), (-0.05, 0.005, -0.42), 0.05),
}

# What is seen: covers light, motors dark. Drawn after the same bounds; colours are our own.
_LIGHT, _DARK, _BLACK = (0.90, 0.91, 0.92, 1.0), (0.27, 0.29, 0.33, 1.0), (0.08, 0.09, 0.11, 1.0)
_ACCENT = (0.80, 0.36, 0.13, 1.0)


def _block(
    below: Vector, size_below: tuple[float, float], above: Vector, size_above: tuple[float, float]
) -> Block:
    return Block(below=below, above=above, size_below=size_below, size_above=size_above)


def _rod(first: Vector, last: Vector, radius: float) -> Rod:
    return Rod(first=first, last=last, radius=radius)


_LOOKS: dict[str, tuple[tuple[Solid, Colour], ...]] = {
    "pelvis": (
        (_block((-0.01, 0, -0.06), (0.16, 0.11), (-0.02, 0, 0.06), (0.24, 0.24)), _DARK),
        (_block((-0.02, 0, 0.06), (0.25, 0.27), (-0.02, 0, 0.17), (0.25, 0.31)), _LIGHT),
        (_block((-0.155, 0, 0.03), (0.09, 0.22), (-0.16, 0, 0.24), (0.09, 0.26)), _DARK),
        (_block((0.09, 0, 0.075), (0.05, 0.12), (0.09, 0, 0.155), (0.06, 0.16)), _ACCENT),
        (_rod((-0.01, 0, 0.16), (0.01, 0, 0.30), 0.085), _BLACK),
        (_rod((0.087, -0.19, 0.542), (0.087, 0.19, 0.542), 0.055), _DARK),
    ),
    "chest": (
        (_rod((-0.02, -0.10, 0), (-0.02, 0.10, 0), 0.075), _DARK),
        (_block((-0.04, 0, 0.03), (0.18, 0.20), (-0.04, 0, 0.12), (0.22, 0.24)), _BLACK),
        (_block((-0.04, 0, 0.10), (0.22, 0.24), (-0.03, 0, 0.27), (0.30, 0.32)), _LIGHT),
        (_block((-0.03, 0, 0.265), (0.30, 0.32), (-0.05, 0, 0.46), (0.19, 0.22)), _LIGHT),
        (_block((0.115, 0, 0.17), (0.03, 0.10), (0.110, 0, 0.31), (0.05, 0.18)), _ACCENT),
        (_block((-0.20, 0, 0.08), (0.10, 0.24), (-0.20, 0, 0.42), (0.13, 0.28)), _DARK),
        (_rod((0.01, 0, 0.40), (0.06, 0, 0.50), 0.058), _BLACK),
    ),
    "head_link": (
        (_block((0.00, 0, -0.07), (0.13, 0.12), (0, 0, 0.03), (0.19, 0.17)), _LIGHT),
        (_block((-0.005, 0, 0.03), (0.19, 0.17), (-0.015, 0, 0.138), (0.13, 0.12)), _LIGHT),
        (_block((0.075, 0, -0.015), (0.05, 0.13), (0.065, 0, 0.060), (0.05, 0.13)), _BLACK),
        (_rod((0, -0.092, 0.02), (0, 0.092, 0.02), 0.035), _DARK),
    ),
    "upper_arm": (
        (_rod((0, -0.065, 0), (0, 0.055, 0), 0.068), _LIGHT),
        (_rod((0, 0.05, 0), (0, 0.07, 0), 0.045), _ACCENT),
        (_block((0.022, 0.02, -0.25), (0.09, 0.09), (0.005, 0.015, -0.03), (0.115, 0.105)), _LIGHT),
        (_rod((0.05, -0.035, -0.2958), (0.05, 0.075, -0.2958), 0.048), _DARK),
    ),
    "forearm": (
        (_block((-0.05, 0, -0.25), (0.075, 0.07), (-0.02, 0, -0.03), (0.10, 0.095)), _LIGHT),
        (_rod((-0.05, 0, -0.24), (-0.05, 0, -0.325), 0.030), _BLACK),
        (_block((-0.05, 0, -0.40), (0.065, 0.035), (-0.05, 0, -0.31), (0.085, 0.06)), _DARK),
        (_block((-0.03, 0, -0.47), (0.025, 0.05), (-0.035, 0, -0.39), (0.025, 0.07)), _BLACK),
        (_block((-0.07, 0, -0.46), (0.022, 0.03), (-0.075, 0, -0.39), (0.022, 0.03)), _BLACK),
    ),
    "leg": (
        (_rod((0, 0, -0.04), (0, 0, 0.125), 0.050), _BLACK),
        (_block((0, 0.01, 0.05), (0.11, 0.105), (0, 0, 0.125), (0.11, 0.105)), _DARK),
    ),
    "hip_roll": ((_rod((-0.075, 0, 0), (0.065, 0, 0), 0.045), _DARK),),
    "thigh": (
        (_rod((0, 0.03, 0), (0, 0.165, 0), 0.062), _DARK),
        (_rod((0, 0.16, 0), (0, 0.172, 0), 0.040), _ACCENT),
        (_block((0, 0.055, -0.36), (0.10, 0.105), (0, 0.085, 0.02), (0.12, 0.125)), _LIGHT),
        (_rod((0, -0.012, -0.38), (0, 0.10, -0.38), 0.060), _DARK),
    ),
    "shank": (
        (_rod((0, -0.050, 0), (0, 0.067, 0), 0.045), _ACCENT),
        (_block((0.005, 0.005, -0.33), (0.07, 0.07), (0.015, 0.01, -0.02), (0.105, 0.10)), _LIGHT),
        (_block((-0.03, 0.005, -0.30), (0.05, 0.05), (-0.035, 0.01, -0.07), (0.06, 0.08)), _DARK),
        (_block((0, 0, -0.40), (0.05, 0.05), (0.005, 0.005, -0.32), (0.065, 0.06)), _BLACK),
    ),
    "ankle": ((_rod((0, -0.045, 0), (0, 0.045, 0), 0.036), _DARK),),
    "foot_link": (
        (_block((0.015, 0.01, -0.102), (0.23, 0.13), (0.012, 0.01, -0.070), (0.22, 0.12)), _DARK),
        (
            _block((0.01, 0.01, -0.072), (0.20, 0.11), (-0.005, 0.003, -0.015), (0.09, 0.075)),
            _LIGHT,
        ),
        (
            _block((0.107, 0.01, -0.085), (0.046, 0.128), (0.105, 0.01, -0.060), (0.03, 0.10)),
            _ACCENT,
        ),
    ),
}


def _add_leg(pelvis: mujoco.MjsBody, side: str, outward: int, bits: tuple[int, int]) -> None:
    """One leg; what is special about the right one is that y points inward."""
    body = pelvis
    turn = np.array([1, 1, 1, outward, 1, outward])
    for joint, link in zip(_JOINTS, _LEG_LINKS, strict=True):
        ((name, *_), body_name, range_deg), (pos, mass_kg, com, inertia) = joint, link
        body = body.add_body(
            name=f"{side}_leg" if body is pelvis else f"{side}_{body_name}", pos=_to(outward, pos)
        )
        set_mass(body, mass_kg, _to(outward, com), 1e-3 * turn * inertia)
        low_deg, high_deg = range_deg
        if outward < 0 and not name.endswith("P"):
            low_deg, high_deg = -high_deg, -low_deg
        body.add_joint(
            name=f"{side[0].upper()}{name}",
            axis=_AXES[name[-1]],
            range=[math.radians(low_deg), math.radians(high_deg)],
            damping=[DAMPING, 0, 0],
        )
        if body_name in _LEG_SHAPES:
            shape = _LEG_SHAPES[body_name]
            add_shape(body, f"{side}_{body_name}", _of(outward, shape), bits)
    add_sole(body, side, _to(outward, SOLE_M), (FOOT.length_m, FOOT.width_m, 0.02), bits)


def _add_upper_body(spec: mujoco.MjSpec, pelvis: mujoco.MjsBody) -> None:
    """Bodies without joints, which the compiler merges into the pelvis."""
    chest = pelvis.add_body(name="chest", pos=WAIST_M)
    mass_kg, com_in_pelvis, inertia = _UPPER_BODY
    x, y, z = np.subtract(com_in_pelvis, WAIST_M)
    set_mass(chest, mass_kg, (x, y, z), 1e-3 * np.array(inertia))
    head = chest.add_body(name="head_link", pos=HEAD_M)
    head.add_site(name="head", pos=[0, 0, 0.05])
    add_shapes(spec, _BODY_SHAPES, UPPER_BODY_BITS)
    for side, outward in SIDES.items():
        pitch, spread, elbow = np.radians(
            [SHOULDER_PITCH_DEG, outward * SHOULDER_SPREAD_DEG, ELBOW_DEG]
        )
        upper = pelvis.add_body(
            name=f"{side}_upper_arm",
            pos=_to(outward, SHOULDER_M),
            quat=_turned((pitch, "P"), (spread, "R")),
        )
        fore = upper.add_body(
            name=f"{side}_forearm", pos=_to(outward, ELBOW_M), quat=_turned((elbow, "P"))
        )
        for body in (upper, fore):
            shape = _ARM_SHAPES[body.name.removeprefix(f"{side}_")]
            add_shape(body, body.name, _of(outward, shape), UPPER_BODY_BITS)


def _turned(*turns: tuple[float, str]) -> np.ndarray:
    """Quaternion of turns by angles in rad about yaw, roll or pitch axes, each in the last's."""
    import mujoco

    quat, turn = np.array([1.0, 0, 0, 0]), np.empty(4)
    for angle_rad, letter in turns:
        mujoco.mju_axisAngle2Quat(turn, np.array(_AXES[letter], float), angle_rad)
        mujoco.mju_mulQuat(quat, quat.copy(), turn)
    return quat


def _to(outward: int, point: Vector) -> Vector:
    """A point given for the left side, on the side that is asked for."""
    return point if outward > 0 else mirrored(point)


def _of(outward: int, solid: Solid) -> Solid:
    return solid if outward > 0 else solid.mirrored()


def build() -> mujoco.MjSpec:
    """The model: links and joints from the tables above, all symmetric."""
    import mujoco

    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.compiler.fusestatic = True
    pelvis = spec.worldbody.add_body(name="pelvis")
    pelvis.add_freejoint(name="root")
    mass_kg, com, inertia = _PELVIS
    set_mass(pelvis, mass_kg, com, 1e-3 * np.array(inertia))
    for (side, outward), bits in zip(SIDES.items(), (LEFT_LEG_BITS, RIGHT_LEG_BITS), strict=True):
        _add_leg(pelvis, side, outward, bits)
    _add_upper_body(spec, pelvis)
    return spec


def add_looks(spec: mujoco.MjSpec) -> None:
    """Dresses the model in covers and motors, for pictures."""
    for name, parts in _LOOKS.items():
        for solid, rgba in parts:
            if name in ("pelvis", "chest", "head_link"):
                add_look(spec, spec.body(name), solid, rgba)
                continue
            for side, outward in SIDES.items():
                add_look(spec, spec.body(f"{side}_{name}"), _of(outward, solid), rgba)


# Forward 0.35: PAPER's step length. The rest, ESTIMATED, is JVRC-1's, set outward by what the feet
# are wider; tests/test_robots.py holds the legs to it.
LIMITS = StepLimits(x_m=(-0.20, 0.35), y_m=(0.18, 0.38), yaw_rad=(-0.2, 0.4), z_m=(-0.10, 0.10))

ROBOT = Robot(
    name="hrp5p",
    title="HRP-5P",
    step_model=RobotStepModel(
        foot=FOOT,
        body=BodyShape(length_m=0.52, width_m=0.64),
        # Well inside what is trained, as for JVRC-1.
        limits=replace(LIMITS, x_m=(-0.16, 0.31), y_m=(0.18, 0.33), yaw_rad=(-0.16, 0.31)),
        # Of the search, outward (x m, y m, yaw rad): within the limits with room for rounding.
        steps=(
            *((x, 0.21, 0.0) for x in (-0.15, -0.10, 0.0, 0.10, 0.20, 0.30)),
            *((x, 0.31, 0.0) for x in (-0.10, 0.0, 0.15)),
            *((x, 0.23, 0.3) for x in (-0.05, 0.0, 0.10, 0.20)),
            *((x, 0.23, 0.15) for x in (0.0, 0.10, 0.25)),
            *((x, 0.21, -0.15) for x in (0.0, 0.10, 0.20)),
        ),
        stance_width_m=0.21,
        level_margin_m=0.01,
        body_margin_m=0.11,
    ),
    gait=GaitTiming(single_support_s=0.75, double_support_s=0.35),
    joints=JOINTS,
    mass_kg=103.0,
    height_m=1.82,
    pelvis_height_m=0.7904,
    pelvis_pitch_rad=0.0,
    fallen_height_m=0.58,
    build=build,
    add_meshes=add_looks,
    training_limits=replace(LIMITS, z_m=(-0.15, 0.15)),
)
