"""Unitree G1: 33.3 kg, 1.32 m, 12 leg joints; arms and waist held fixed. Needs extra `unitree`.

Masses, inertias, axes, joint ranges, torque limits, rotor inertia and friction are those of the
model `unitree_g1` of MuJoCo Menagerie; speed limits those of Unitree's own description of the
robot (unitreerobotics/unitree_ros at 1ab5f1e, g1_29dof_rev_1_0.urdf). Ours are the servo gains
(those of JVRC-1 by the mass), half-sitting, the capsules and boxes, estimated from the bounds of
the meshes and the contact points of the model's feet, and the step model.
"""

from __future__ import annotations

from planner.robot_model import BodyShape, FootShape, StepLimits
from sim.menagerie import MenagerieModel
from sim.robot import GaitTiming, RobotStepModel, both_legs
from sim.solids import Box, capsule

FOOT = FootShape(length_m=0.18, width_m=0.07)

# name, kp, kd, torque limit, speed limit, armature, half-sitting (deg), mirror sign
_LEG = (
    ("hip_pitch", 110, 11, 88, 32, 0.01, -18, 1),
    ("hip_roll", 110, 11, 139, 20, 0.01, 0, -1),
    ("hip_yaw", 110, 11, 88, 32, 0.01, 0, -1),
    ("knee", 135, 13.5, 139, 20, 0.01, 38, 1),
    ("ankle_pitch", 45, 4.5, 50, 30, 0.01, -20, 1),
    ("ankle_roll", 45, 4.5, 50, 30, 0.01, 0, -1),
)

_MODEL = MenagerieModel(
    file="unitree_g1/g1.xml",
    renamed={"left_hip_pitch_link": "left_leg", "right_hip_pitch_link": "right_leg"},
    joints=both_legs(_LEG, named="{side}_{joint}_joint"),
    # At 0 the upper arms hang and the forearms point forward.
    held_rad={
        "left_shoulder_pitch_joint": 0.2,
        "right_shoulder_pitch_joint": 0.2,
        "left_shoulder_roll_joint": 0.10,
        "right_shoulder_roll_joint": -0.10,
        "left_elbow_joint": 1.0,
        "right_elbow_joint": 1.0,
    },
    leg_shapes={
        "hip_yaw_link": {"thigh": capsule((-0.02, 0, 0.02), (-0.075, 0, -0.16), 0.05)},
        "knee_link": {"shank": capsule((0.01, 0, -0.03), (0, 0, -0.25), 0.037)},
    },
    arm_shapes={
        "shoulder_yaw_link": {"upper_arm": capsule((0, 0, 0.09), (0.01, 0, -0.07), 0.042)},
        "elbow_link": {"forearm": capsule((0, 0, -0.01), (0.32, 0, -0.01), 0.042)},
    },
    body_shapes={
        "pelvis": {"hips": capsule((0, -0.06, -0.08), (0, 0.06, -0.08), 0.07)},
        "torso_link": {
            "torso": Box(centre=(0.008, 0, 0.14), size=(0.155, 0.22, 0.30)),
            "skull": capsule((0.008, 0, 0.36), (0.008, 0, 0.407), 0.08),
        },
    },
    foot="ankle_roll_link",
    sole_m=(0.035, 0, -0.035),
    sole_size_m=(FOOT.length_m, FOOT.width_m, 0.02),
    head=("torso_link", (0.008, 0, 0.40)),
    colours={"black": (0.16, 0.17, 0.19, 1.0), "metal": (0.82, 0.83, 0.85, 1.0)},
)

ROBOT = _MODEL.robot(
    name="g1",
    title="Unitree G1",
    step_model=RobotStepModel(
        foot=FOOT,
        body=BodyShape(length_m=0.40, width_m=0.50),
        limits=StepLimits(x_m=(-0.14, 0.24), y_m=(0.19, 0.34), yaw_rad=(-0.2, 0.4)),
        # Of the search, outward (x m, y m, yaw rad): within the limits with room for rounding.
        steps=(
            *((x, 0.24, 0.0) for x in (-0.10, -0.05, 0.0, 0.05, 0.10, 0.15, 0.20)),
            *((x, 0.29, 0.0) for x in (-0.05, 0.0, 0.10)),
            *((x, 0.25, 0.3) for x in (-0.05, 0.0, 0.10, 0.15)),
            *((x, 0.25, 0.15) for x in (0.0, 0.10, 0.20)),
            *((x, 0.24, -0.15) for x in (0.0, 0.10, 0.15)),
        ),
        stance_width_m=0.24,
        body_margin_m=0.06,
    ),
    gait=GaitTiming(single_support_s=0.65, double_support_s=0.3),
    mass_kg=33.34,
    height_m=1.32,
    pelvis_height_m=0.757,
    fallen_height_m=0.56,
    # In walks through a room its small soles need 1.6 at most; JVRC-1 needs 0.67, HRP-5P 0.9.
    steady_pressure_share=1.7,
)
