"""The named sensors of every scene, for rewards, reports and termination.

Sensors describe the state before the last physics step, as in MuJoCo. Units: m, m/s, N, N m.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from sim.robot import Robot

SIDES = ("left", "right")


@dataclass(frozen=True, kw_only=True)
class Sensors:
    """Indices of each sensor in the last axis of `sensordata`; left before right."""

    sole_pos_world: np.ndarray  # (2, 3)
    sole_x_axis_world: np.ndarray  # (2, 3) along the foot
    sole_linvel_world: np.ndarray  # (2, 3)
    ground_force_world: np.ndarray  # (2, 3) on the foot
    pressure_pos_world: np.ndarray  # (2, 3) centre of pressure, 0 without contact
    head_pos_world: np.ndarray  # (3,)
    pelvis_pos_world: np.ndarray  # (3,)
    pelvis_linvel_world: np.ndarray  # (3,)
    com_pos_world: np.ndarray  # (3,) of the whole robot
    com_linvel_world: np.ndarray  # (3,)
    legs_touching: np.ndarray  # (1,) number of contacts between the legs
    wall_contacts: np.ndarray  # (1,) number of contacts between robot and walls
    joint_torque: np.ndarray  # (J,)

    @classmethod
    def of(cls, model: mujoco.MjModel, robot: Robot) -> Sensors:
        """Look the sensors of `add_sensors` up in a compiled model."""

        def at(name: str) -> np.ndarray:
            sensor = model.sensor(name)
            return np.arange(sensor.adr[0], sensor.adr[0] + sensor.dim[0])

        def both(name: str) -> np.ndarray:
            return np.stack([at(f"{side}_{name}") for side in SIDES])

        return cls(
            sole_pos_world=both("sole_pos"),
            sole_x_axis_world=both("sole_x_axis"),
            sole_linvel_world=both("sole_linvel"),
            ground_force_world=both("ground_force")[:, :3],
            pressure_pos_world=both("ground_force")[:, 3:],
            head_pos_world=at("head_pos"),
            pelvis_pos_world=at("pelvis_pos"),
            pelvis_linvel_world=at("pelvis_linvel"),
            com_pos_world=at("com_pos"),
            com_linvel_world=at("com_linvel"),
            legs_touching=at("legs_touching"),
            wall_contacts=at("wall_contacts"),
            joint_torque=np.concatenate([at(f"{j.name}_torque") for j in robot.joints]),
        )


def add_sensors(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Add every sensor to a scene that has the robot and a body named `walls`."""
    sensor, objects = mujoco.mjtSensor, mujoco.mjtObj

    def add(name: str, kind: mujoco.mjtSensor, object_type: mujoco.mjtObj, of: str) -> None:
        spec.add_sensor(name=name, type=kind, objtype=object_type, objname=of)

    def contact(
        name: str,
        fields: tuple[mujoco.mjtConDataField, ...],
        second: tuple[mujoco.mjtObj, str],
        **first: Any,
    ) -> None:
        """The net of all contacts between the two, or of anything with the second.

        A force is the one that the first exerts on the second, in world axes.
        """
        net_force = 3  # mjSENS_CONTACT's reduction over all matching contacts, in world axes
        spec.add_sensor(
            name=name,
            type=sensor.mjSENS_CONTACT,
            reftype=second[0],
            refname=second[1],
            intprm=[sum(1 << int(field) for field in fields), net_force, 1],
            **first,
        )

    told = mujoco.mjtConDataField
    for side in SIDES:
        sole, foot = f"{side}_sole", (objects.mjOBJ_GEOM, f"{side}_foot")
        add(f"{sole}_pos", sensor.mjSENS_FRAMEPOS, objects.mjOBJ_SITE, sole)
        add(f"{sole}_x_axis", sensor.mjSENS_FRAMEXAXIS, objects.mjOBJ_SITE, sole)
        add(f"{sole}_linvel", sensor.mjSENS_FRAMELINVEL, objects.mjOBJ_SITE, sole)
        contact(f"{side}_ground_force", (told.mjCONDATA_FORCE, told.mjCONDATA_POS), foot)
    body = objects.mjOBJ_XBODY
    add("head_pos", sensor.mjSENS_FRAMEPOS, objects.mjOBJ_SITE, "head")
    add("pelvis_pos", sensor.mjSENS_FRAMEPOS, body, "pelvis")
    add("pelvis_linvel", sensor.mjSENS_FRAMELINVEL, body, "pelvis")
    add("com_pos", sensor.mjSENS_SUBTREECOM, objects.mjOBJ_BODY, "pelvis")
    add("com_linvel", sensor.mjSENS_SUBTREELINVEL, objects.mjOBJ_BODY, "pelvis")
    found = (told.mjCONDATA_FOUND,)
    contact("legs_touching", found, (body, "right_leg"), objtype=body, objname="left_leg")
    contact("wall_contacts", found, (body, "walls"), objtype=body, objname="pelvis")
    for joint in robot.joints:
        add(f"{joint.name}_torque", sensor.mjSENS_JOINTACTFRC, objects.mjOBJ_JOINT, joint.name)
