"""What is special about one robot: a value that names it, and the rules its model keeps to.

A robot is a folder with a robot file (`sim/robot_file.py`), or one module in `sim/robots/` that
defines `ROBOT`. Its `build()` returns an `MjSpec` that keeps to the names in
docs/robot-file.md, so that no other file knows the robot's own. Collision geoms are in group 3,
visual ones in group 2 (no contacts).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from planner.robot_model import StepLimits, StepModel

if TYPE_CHECKING:
    import mujoco

PHYSICS_GROUP = 3
VISUAL_GROUP = 2

# Contact bits: (contype, conaffinity). Two geoms touch when one's type meets the other's affinity.
# Everything of the robot can touch its surroundings; of the robot itself only leg meets leg.
SURROUNDINGS_BITS = (1, 0)
UPPER_BODY_BITS = (0, 1)
LEFT_LEG_BITS = (2, 1 | 4)
RIGHT_LEG_BITS = (4, 1 | 2)

# Geoms of the ground of a map that is not flat have names that begin like this.
GROUND_PREFIX = "ground_"
GRAVITY_M_S2 = 9.81


@dataclass(frozen=True, kw_only=True)
class LegJoint:
    """One actuated joint: a position servo with torque `kp (target - q) - kd dq`, clipped.

    `mirror_sign` is +1 where the joint of the other leg has the same angle in the mirrored
    posture (pitch), -1 where it has the opposite one (roll, yaw). `role` is what a robot file says
    that it is for, one of `sim/joint_roles.py`.
    """

    name: str
    kp: float
    kd: float
    torque_limit_nm: float
    speed_limit_rad_s: float
    armature_kg_m2: float
    half_sitting_rad: float
    mirror_sign: int
    role: str = field(default="", compare=False)


@dataclass(frozen=True, kw_only=True)
class PassiveJoint:
    """A joint without a motor, which springs, closed loops or couplings of the model move.

    `half_sitting` is its angle in rad, or of a ball joint the quaternion w, x, y, z; `mirror_sign`
    as of `LegJoint`, of a ball joint for its turn about x, y and z. No policy sees or moves it.
    """

    name: str
    half_sitting: tuple[float, ...]
    mirror_sign: tuple[int, ...]


# Joint, kp, kd, torque limit, speed limit, armature, half-sitting in degrees, mirror sign.
LegRow = tuple[str, float, float, float, float, float, float, int]


def both_legs(
    leg: Iterable[LegRow], *, named: str, sides: tuple[str, str] = ("left", "right")
) -> tuple[LegJoint, ...]:
    """The joints of both legs from a table of one, from the hip down.

    `named` makes the name of a joint of the model from `{side}` and `{joint}`.
    """
    return tuple(
        LegJoint(
            name=named.format(side=side, joint=joint),
            kp=kp,
            kd=kd,
            torque_limit_nm=torque,
            speed_limit_rad_s=speed,
            armature_kg_m2=armature,
            half_sitting_rad=math.radians(angle_deg),
            mirror_sign=sign,
        )
        for side in sides
        for joint, kp, kd, torque, speed, armature, angle_deg, sign in leg
    )


# A step model with the costs of steps and clearance that all robots here share.
RobotStepModel = partial(
    StepModel,
    turn_cost_m=0.05,
    side_cost_m=0.2,
    back_cost_m=0.2,
    clearance_m=0.25,
    clearance_cost_m=0.25,
    foot_margin_m=0.03,
)


@dataclass(frozen=True, kw_only=True)
class GaitTiming:
    """Durations of one step: the swing (single support), then both feet down."""

    single_support_s: float
    double_support_s: float

    @property
    def step_s(self) -> float:
        """Seconds from one foot's lift-off to the other's."""
        return self.single_support_s + self.double_support_s


@dataclass(frozen=True, kw_only=True, repr=False)
class Robot:
    """Everything that is special about one robot.

    `joints` holds the left leg's joints, then the right leg's in the same order. `height_m` is from
    the soles to the top of the head with all those joints at 0, or in half-sitting where there are
    `passive` joints: the others of the left leg, then of the right one in the same order. The
    pelvis height (m, above the sole) and pitch are those of the half-sitting posture with flat
    soles. An episode ends, and a walk counts as fallen, when the pelvis is less than
    `fallen_height_m` above the lower foot. `add_meshes` dresses a spec that `build` made, for
    pictures; a robot without it is drawn by its collision shapes. `needs` names the module of a
    package that `build` takes the model from, and the extra of this project that installs it, where
    that is not always installed. `training_limits` are the step limits to train on; they may be
    wider than those of plans, so that what is planned lies well inside what was learned. None for
    the same. How far they let a step rise is the highest stair that `train` takes.
    `steady_pressure_share` is above how far out, in shares of half a sole, the centre of pressure
    has to be in walks that nothing disturbs; beyond it a step changes (`controller/recovery.py`).
    Physics steps may last `longest_timestep_s` at most, or the simulation is not stable. A robot
    takes the policies of the robot `trained_as` too, which has the same joints. A robot from a file
    has the `folder` that the file is in, where its policy is looked for, and the `digest` of what a
    policy learns from.
    """

    name: str
    title: str
    step_model: StepModel
    gait: GaitTiming
    joints: tuple[LegJoint, ...]
    mass_kg: float
    height_m: float
    pelvis_height_m: float
    pelvis_pitch_rad: float
    fallen_height_m: float
    build: Callable[[], mujoco.MjSpec]
    add_meshes: Callable[[mujoco.MjSpec], None] | None = None
    passive: tuple[PassiveJoint, ...] = ()
    needs: tuple[str, str] | None = None
    training_limits: StepLimits | None = None
    steady_pressure_share: float = 1.1
    longest_timestep_s: float = 0.005
    trained_as: str = ""
    folder: Path | None = None
    digest: str = ""

    def __repr__(self) -> str:
        return f"Robot({self.name}: {self.mass_kg:.0f} kg, {len(self.joints)} leg joints)"

    @property
    def option(self) -> str:
        """What `--robot` takes for it: a name, or the folder of its file."""
        return self.name if self.folder is None else str(self.folder)

    @property
    def weight_n(self) -> float:
        """Weight of the robot."""
        return self.mass_kg * GRAVITY_M_S2

    @cached_property
    def training_model(self) -> StepModel:
        """The step model with the limits to train on."""
        return replace(self.step_model, limits=self.training_limits or self.step_model.limits)

    @cached_property
    def half_sitting_rad(self) -> np.ndarray:
        """Joint angles (J,) of the half-sitting posture."""
        return np.array([joint.half_sitting_rad for joint in self.joints])

    @cached_property
    def mirror_joints(self) -> tuple[np.ndarray, np.ndarray]:
        """Index (J,) and sign (J,) such that mirrored = sign * angles[..., index]."""
        half = len(self.joints) // 2
        index = np.r_[half : 2 * half, 0:half]
        return index, np.array([float(joint.mirror_sign) for joint in self.joints])
