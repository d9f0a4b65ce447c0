"""JVRC-1: 62.4 kg, 1.71 m, 12 leg joints; arms, waist and neck held fixed.

Masses, inertias, axes, joint ranges and speed limits are those of the URDF in the PyPI package
`jvrc-description` 1.1.1 (CNRS-UM LIRMM / CNRS-AIST JRL, S. Caron). The URDF has neither rotor
inertia nor real torque limits: armature is from the MJCF model of the same robot
(isri-aist/jvrc_mj_description), torque limits from its 2022 edition, servo gains, half-sitting
posture and gait durations from the reference code of Singh et al. 2022
(LearningHumanoidWalking, `envs/jvrc/configs/base.yaml` and `tasks/stepping_task.py`).
The sole box is that model's. Our own choices: arms that hang closer to the body than the
reference's, so that the robot is 0.62 m wide, and the capsules that stand for legs and body.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from typing import TYPE_CHECKING

from planner.robot_model import BodyShape, FootShape, StepLimits
from sim.robot import (
    LEFT_LEG_BITS,
    RIGHT_LEG_BITS,
    UPPER_BODY_BITS,
    GaitTiming,
    Robot,
    RobotStepModel,
    both_legs,
)
from sim.solids import Shapes, add_shapes, add_sole, add_urdf_meshes, capsule, fix_joint

if TYPE_CHECKING:
    import mujoco

FOOT = FootShape(length_m=0.20, width_m=0.10)
SOLE_M, SOLE_SIZE_M = (0.029, 0, -0.10778), (FOOT.length_m, FOOT.width_m, 0.02)

# Held posture of the joints that the policy does not move; all others of the upper body at 0.
ARM_POSE_RAD = {
    "R_SHOULDER_P": 0.15,
    "L_SHOULDER_P": 0.15,
    "R_SHOULDER_R": -0.04,
    "L_SHOULDER_R": 0.04,
    "R_ELBOW_P": -0.5,
    "L_ELBOW_P": -0.5,
}

# name, kp, kd, torque limit, speed limit, armature, half-sitting (deg), mirror sign
_LEG = (
    ("HIP_P", 200, 20, 600, 12.56636, 0.1925, -30, 1),
    ("HIP_R", 200, 20, 600, 8.90117, 0.1813, 0, -1),
    ("HIP_Y", 200, 20, 250, 8.90117, 0.1237, 0, -1),
    ("KNEE", 250, 25, 1420, 14.66075, 0.1305, 50, 1),
    ("ANKLE_R", 80, 8, 300, 15.18435, 0.0653, 0, -1),
    ("ANKLE_P", 80, 8, 250, 14.18435, 0.1337, -24, 1),
)
JOINTS = both_legs(_LEG, named="{side}_{joint}", sides=("L", "R"))

# Capsules that cover the meshes of the package to within about a centimetre; sides by prefix.
_LEG_SHAPES: Shapes = {
    "HIP_Y_S": {"thigh": capsule((0.01, 0, -0.10), (0, 0, -0.35), 0.055)},
    "KNEE_S": {"shank": capsule((0.03, 0, -0.03), (0.04, 0, -0.32), 0.053)},
}
_ARM_SHAPES: Shapes = {
    "SHOULDER_Y_S": {"upper_arm": capsule((-0.01, 0, -0.05), (0, 0, -0.29), 0.045)},
    "ELBOW_P_S": {"forearm": capsule((-0.01, 0, -0.03), (0, 0, -0.40), 0.042)},
}
_BODY_SHAPES: Shapes = {
    "pelvis": {"hips": capsule((0, -0.04, 0.04), (0, 0.04, 0.04), 0.11)},
    "WAIST_R_S": {
        "chest": capsule((0.01, -0.07, 0.16), (0.01, 0.07, 0.16), 0.11),
        "shoulders": capsule((0, -0.24, 0.33), (0, 0.24, 0.33), 0.06),
    },
    "NECK_P_S": {"head": capsule((0.01, 0, 0.05), (0.01, 0, 0.11), 0.10)},
}


def build() -> mujoco.MjSpec:
    """The model: bodies and joints from the URDF, collision shapes of our own."""
    import jvrc_description
    import mujoco

    root = ET.parse(jvrc_description.urdf_path).getroot()
    for link in root.findall("link"):
        # MuJoCo does not read .dae meshes.
        for element in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(element)
    spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"))
    # Links without a joint of their own are merged into their parents: 13 bodies move.
    spec.compiler.fusestatic = True
    # The empty root link takes the free joint, and so the name; the pelvis link merges into it.
    pelvis = spec.body("base_link")
    pelvis.name = "pelvis"
    pelvis.add_freejoint(name="root")
    for equality in list(spec.equalities):  # the fingers' mimic constraints
        spec.delete(equality)
    legs = {joint.name for joint in JOINTS}
    for joint in list(spec.joints):
        if joint.name not in legs and joint.type != mujoco.mjtJoint.mjJNT_FREE:
            fix_joint(spec, joint, ARM_POSE_RAD.get(joint.name, 0.0))
    sides = (("left", "L_", LEFT_LEG_BITS), ("right", "R_", RIGHT_LEG_BITS))
    for side, prefix, bits in sides:
        spec.body(f"{prefix}HIP_P_S").name = f"{side}_leg"
        add_shapes(spec, _LEG_SHAPES, bits, body=prefix, name=f"{side}_")
        add_sole(spec.body(f"{prefix}ANKLE_P_S"), side, SOLE_M, SOLE_SIZE_M, bits)
    add_shapes(spec, _BODY_SHAPES, UPPER_BODY_BITS)
    for side, prefix, _ in sides:
        add_shapes(spec, _ARM_SHAPES, UPPER_BODY_BITS, body=prefix, name=f"{side}_")
    spec.body("NECK_P_S").add_site(name="head", pos=[0.01, 0, 0.11])
    return spec


def add_meshes(spec: mujoco.MjSpec) -> None:
    """Dresses the model in the meshes of the package, with joints darker than limbs."""
    import jvrc_description

    dark, blue = (0.25, 0.27, 0.31, 1.0), (0.16, 0.36, 0.62, 1.0)
    joints = ("HIP_R", "SHOULDER_P", "ELBOW_P", "WRIST_Y")
    add_urdf_meshes(
        spec,
        jvrc_description.urdf_path,
        jvrc_description.meshes_path,
        renamed={"L_HIP_P_S": "left_leg", "R_HIP_P_S": "right_leg"},
        accents={
            **{f"{side}_{name}_S": dark for side in "LR" for name in joints},
            "WAIST_Y_S": dark,
            "NECK_Y_S": dark,
            "PELVIS_S": blue,
            "WAIST_R_S": blue,
        },
    )


ROBOT = Robot(
    name="jvrc1",
    title="JVRC-1",
    step_model=RobotStepModel(
        foot=FOOT,
        body=BodyShape(length_m=0.40, width_m=0.62),
        # Of 1200 walks that began near the corners of these limits and went on turning as the
        # lattice does, the shipped policy fell in none; from the corners of the training limits
        # below, turning as sharply as those allow, in 8 %.
        limits=StepLimits(
            x_m=(-0.15, 0.31), y_m=(0.16, 0.31), yaw_rad=(-0.16, 0.30), z_m=(-0.10, 0.10)
        ),
        # Of the search, outward (x m, y m, yaw rad): within the limits with room for rounding.
        steps=(
            *((x, 0.20, 0.0) for x in (-0.15, -0.10, 0.0, 0.10, 0.20, 0.30)),
            *((x, 0.30, 0.0) for x in (-0.10, 0.0, 0.15)),
            *((x, 0.22, 0.3) for x in (-0.05, 0.0, 0.10, 0.20)),
            *((x, 0.22, 0.15) for x in (0.0, 0.10, 0.25)),
            *((x, 0.20, -0.15) for x in (0.0, 0.10, 0.20)),
        ),
        stance_width_m=0.20,
        body_margin_m=0.11,
        # It lifts its feet by 20 cm. Of 50 walks between rooms with sills as high none fell.
        swing_clear_m=0.05,
    ),
    gait=GaitTiming(single_support_s=0.75, double_support_s=0.35),
    joints=JOINTS,
    mass_kg=62.4,
    height_m=1.71,
    pelvis_height_m=0.8086,
    pelvis_pitch_rad=math.radians(4.0),
    fallen_height_m=0.60,
    build=build,
    add_meshes=add_meshes,
    training_limits=StepLimits(
        x_m=(-0.20, 0.35), y_m=(0.16, 0.34), yaw_rad=(-0.2, 0.4), z_m=(-0.15, 0.15)
    ),
)
