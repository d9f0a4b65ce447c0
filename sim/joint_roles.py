"""What each joint of a leg is for, from where its axis points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim.robot import Robot

ROLES = ("hip_yaw", "hip_roll", "hip_pitch", "knee", "ankle_pitch", "ankle_roll")
_ABOUT = {0: "roll", 1: "pitch", 2: "yaw"}


class RoleError(ValueError):
    """The joints are not those of a leg: the message says what is missing or too much."""


def roles_of_axes(axes: np.ndarray) -> tuple[str, ...]:
    """The roles of a leg's joints from the hip down, by their axes (J, 3).

    The axes are in a frame whose x is forward, y left and z up, in a posture with straight legs or
    nearly so: those nearest to y pitch, the first at the hip, the next at the knee, the last at the
    ankle; rolls and yaws before the knee are the hip's.

    Raises:
        RoleError: There are not three that pitch, or two of one role.
    """
    abouts = [_ABOUT[int(np.abs(axis).argmax())] for axis in axes]
    pitches = [k for k, about in enumerate(abouts) if about == "pitch"]
    if len(pitches) != 3:
        raise RoleError(
            f"{len(pitches)} joints turn about the left-right axis; a leg has three that do, at "
            "hip, knee and ankle"
        )
    knee = pitches[1]
    roles: list[str] = []
    for k, about in enumerate(abouts):
        if k in pitches:
            roles.append(("hip_pitch", "knee", "ankle_pitch")[pitches.index(k)])
        else:
            roles.append(f"{'hip' if k < knee else 'ankle'}_{about}")
    for role in roles:
        if role not in ROLES:
            raise RoleError(f"a joint below the knee turns the foot to the side: no leg has {role}")
        if roles.count(role) > 1:
            raise RoleError(f"two joints are {role}; a leg has one")
    return tuple(roles)


def roles_of(robot: Robot) -> tuple[str, ...]:
    """The roles of the left leg's joints, from their axes in half-sitting.

    Raises:
        RoleError: They are not those of a leg.
    """
    from sim.scene import build_scene

    return roles_in(build_scene(robot, timestep_s=0.001))


def roles_in(scene: object) -> tuple[str, ...]:
    """As `roles_of`, in a scene that is built already."""
    import mujoco

    from sim.scene import Scene

    assert isinstance(scene, Scene)
    data = mujoco.MjData(scene.model)
    data.qpos[:] = scene.standing_qpos
    mujoco.mj_kinematics(scene.model, data)
    left: Sequence[str] = [j.name for j in scene.robot.joints[: len(scene.robot.joints) // 2]]
    return roles_of_axes(np.array([data.joint(name).xaxis for name in left]))
