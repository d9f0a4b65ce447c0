"""How a real robot and its floor differ from the model: motors, encoders, delay, load, ground."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import mujoco
import numpy as np

from sim.robot import Robot


@dataclass(frozen=True, kw_only=True)
class HardwareErrors:
    """What differs; the defaults are the model's own.

    In the servos: `gain` times stiffness and damping. Targets come `delay_s` late, and up to
    `jitter_s` later still, drawn at every control step. `encoder_rad`: each encoder is off by so
    much to one side or the other, drawn once a walk. `backlash_rad`: while the target is within
    half of it from the joint the servo's spring gives no torque, as with play behind the encoder.
    `no_load`: torque falls with speed, from the torque limit at rest to nothing at so many times
    the speed limit; 0 for motors without such a line. In the joints: dry friction `friction_nm` and
    damping `damping_nms` beside the servo's. `payload_kg` is carried at `payload_m` (3,) in the
    pelvis's frame. In the ground: sliding friction times `grip`, and contacts `softness` times as
    slow to push back.
    """

    gain: float = 1.0
    delay_s: float = 0.0
    jitter_s: float = 0.0
    encoder_rad: float = 0.0
    backlash_rad: float = 0.0
    no_load: float = 0.0
    friction_nm: float = 0.0
    damping_nms: float = 0.0
    payload_kg: float = 0.0
    payload_m: tuple[float, float, float] = (0.1, 0.0, 0.2)
    grip: float = 1.0
    softness: float = 1.0

    def __post_init__(self) -> None:
        """Raises ValueError for a number that cannot be."""
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name == "payload_m":
                if not np.isfinite(value).all():
                    raise ValueError(f"payload_m {value} must be finite")
            elif not 0 <= value < math.inf:
                raise ValueError(f"{field.name} {value} must be finite and not below 0")
        for name in ("gain", "grip", "softness"):
            if getattr(self, name) <= 0:
                raise ValueError(f"{name} {getattr(self, name)} must be above 0")

    @property
    def changes_servos(self) -> bool:
        """Whether what the servos do within a control step differs."""
        parts = self.delay_s, self.jitter_s, self.encoder_rad, self.backlash_rad, self.no_load
        return any(part > 0 for part in parts)


def change_model(model: mujoco.MjModel, robot: Robot, errors: HardwareErrors) -> None:
    """Put into a scene's model what of the errors is a matter of the model."""
    dofs = np.array([model.joint(joint.name).dofadr[0] for joint in robot.joints])
    model.dof_frictionloss[dofs] += errors.friction_nm
    model.dof_damping[dofs] += errors.damping_nms
    model.actuator_gainprm[:, 0] *= errors.gain
    model.actuator_biasprm[:, 1:3] *= errors.gain
    # MuJoCo takes the larger friction and the mean time constant of two geoms that touch.
    model.geom_friction[:, 0] *= errors.grip
    model.geom_solref[:, 0] *= errors.softness
    if errors.payload_kg:
        _load(model, errors.payload_kg, np.array(errors.payload_m))
        mujoco.mj_setConst(model, mujoco.MjData(model))


def _load(model: mujoco.MjModel, mass_kg: float, at_m: np.ndarray) -> None:
    """Fix a point mass to the pelvis, at a place in its frame."""
    body = model.body("pelvis").id
    own_kg, own_m = float(model.body_mass[body]), model.body_ipos[body].copy()
    flat = np.empty(9)
    mujoco.mju_quat2Mat(flat, model.body_iquat[body])
    axes = flat.reshape(3, 3)
    both_kg = own_kg + mass_kg
    middle_m = (own_kg * own_m + mass_kg * at_m) / both_kg
    inertia = axes @ np.diag(model.body_inertia[body]) @ axes.T
    for part_kg, place_m in ((own_kg, own_m), (mass_kg, at_m)):
        arm = place_m - middle_m
        inertia += part_kg * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    principal, turned = np.linalg.eigh(inertia)
    if np.linalg.det(turned) < 0:
        turned[:, 0] *= -1
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, turned.ravel())
    model.body_mass[body], model.body_ipos[body] = both_kg, middle_m
    model.body_inertia[body], model.body_iquat[body] = principal, quat
