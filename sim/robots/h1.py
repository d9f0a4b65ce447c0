"""Unitree H1: 51.4 kg, 1.80 m, 10 leg joints; arms and waist held fixed. Needs the extra `unitree`.

Masses, inertias, axes, joint ranges, torque limits, rotor inertia and damping are those of the
model `unitree_h1` of MuJoCo Menagerie; speed limits those of Unitree's own description of the
robot (unitreerobotics/unitree_ros at 34e7506, h1.urdf). Ours are the servo gains, half-sitting, the
capsules and boxes, estimated from the bounds of the meshes, and the step model.

The ankle has no roll: with the feet not 0.41 m apart, as the hips are, the soles lean: by up to 3.3
degrees in the step set, and 7 at the corners of the step limits.
"""

from __future__ import annotations

from planner.robot_model import BodyShape, FootShape, StepLimits
from sim.menagerie import MenagerieModel
from sim.robot import GaitTiming, RobotStepModel, both_legs
from sim.solids import Box, capsule

FOOT = FootShape(length_m=0.22, width_m=0.08)

# name, kp, kd, torque limit, speed limit, armature, half-sitting (deg), mirror sign
_LEG = (
    ("hip_yaw", 200, 20, 200, 23, 0.1, 0, -1),
    ("hip_roll", 200, 20, 200, 23, 0.1, 0, -1),
    ("hip_pitch", 200, 20, 200, 23, 0.1, -17, 1),
    ("knee", 250, 25, 300, 14, 0.1, 43, 1),
    ("ankle", 60, 6, 40, 9, 0.1, -26, 1),
)

_MODEL = MenagerieModel(
    file="unitree_h1/h1.xml",
    renamed={"left_hip_yaw_link": "left_leg", "right_hip_yaw_link": "right_leg"},
    joints=both_legs(_LEG, named="{side}_{joint}"),
    # At 0 the forearms point forward.
    held_rad={"left_elbow": 1.1, "right_elbow": 1.1},
    leg_shapes={
        "hip_pitch_link": {"thigh": capsule((0.02, 0, -0.02), (0.01, 0, -0.37), 0.055)},
        "knee_link": {"shank": capsule((0, 0, -0.03), (-0.01, 0, -0.33), 0.045)},
    },
    arm_shapes={
        "shoulder_yaw_link": {"upper_arm": capsule((0, 0, 0.13), (0.01, 0, -0.20), 0.05)},
        "elbow_link": {"forearm": capsule((0, 0, -0.01), (0.28, 0, -0.01), 0.042)},
    },
    body_shapes={
        "pelvis": {"hips": capsule((-0.02, -0.07, -0.12), (-0.02, 0.07, -0.12), 0.09)},
        "torso_link": {
            "torso": Box(centre=(0.02, 0, 0.24), size=(0.19, 0.32, 0.44)),
            "skull": capsule((0.03, 0, 0.56), (0.03, 0, 0.66), 0.092),
        },
    },
    foot="ankle_link",
    sole_m=(0.055, 0, -0.07),
    sole_size_m=(FOOT.length_m, FOOT.width_m, 0.02),
    head=("torso_link", (0.03, 0, 0.66)),
    colours={"black": (0.16, 0.17, 0.19, 1.0), "white": (0.92, 0.92, 0.93, 1.0)},
)

ROBOT = _MODEL.robot(
    name="h1",
    title="Unitree H1",
    step_model=RobotStepModel(
        foot=FOOT,
        body=BodyShape(length_m=0.36, width_m=0.56),
        limits=StepLimits(x_m=(-0.17, 0.29), y_m=(0.33, 0.46), yaw_rad=(-0.13, 0.27)),
        # Of the search, outward (x m, y m, yaw rad): within the limits with room for rounding.
        steps=(
            *((x, 0.40, 0.0) for x in (-0.15, -0.10, 0.0, 0.10, 0.20, 0.28)),
            *((x, 0.45, 0.0) for x in (-0.10, 0.0, 0.10)),
            *((x, 0.35, 0.0) for x in (-0.10, 0.0, 0.15)),
            *((x, 0.40, 0.25) for x in (-0.05, 0.0, 0.10, 0.20)),
            *((x, 0.40, 0.1) for x in (0.0, 0.10, 0.25)),
            *((x, 0.40, -0.1) for x in (0.0, 0.10, 0.20)),
        ),
        stance_width_m=0.40,
        body_margin_m=0.12,
    ),
    gait=GaitTiming(single_support_s=0.5, double_support_s=0.2),
    mass_kg=51.44,
    height_m=1.80,
    pelvis_height_m=0.9863,
    fallen_height_m=0.75,
    # In walks through a room it needs 4.4 at most: without ankle roll the hips and the swinging
    # leg, of which the pendulum knows nothing, hold it sideways.
    steady_pressure_share=5.0,
    training_limits=StepLimits(x_m=(-0.20, 0.32), y_m=(0.31, 0.47), yaw_rad=(-0.17, 0.33)),
)
