"""Servos of the model-based controller: which robots it takes, their gains, and joint targets.

It walks on stiff joints, as robots under position control do; the policy's are soft. The gains
belong to the controller, and reports tell them. This module loads neither MuJoCo nor mink.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sim.robot import Robot

# Stiffness and damping over the robot's own: three hip joints, knee, two ankle joints. For JVRC-1
# these give the stiff gains of isri-aist/jvrc_mj_description at dae70c0 (pdgains/PDgains_sim.dat):
# 5000 and 30, 6000 and 50, 3000 and 20 N m/rad and N m s/rad.
STIFFER = (*((25.0, 1.5),) * 3, (24.0, 2.0), *((37.5, 2.5),) * 2)
# It tells a push from its own gait, so a step is moved as soon as the pressure would have to be out
# by this share of what policies of the robot need in undisturbed walks.
SURE_SHARE = 0.68
LIBRARIES = ("mink", "daqp")


class ControllerError(ValueError):
    """The model-based controller cannot walk this robot, or not so; the message says why."""


def stiff(robot: Robot) -> Robot:
    """The robot with the servo gains that the model-based controller walks on.

    Raises:
        ControllerError: it has other legs than those of six joints, or a library is missing.
    """
    half = len(robot.joints) // 2
    if half != len(STIFFER):
        raise ControllerError(
            f"--controller lipm cannot walk {robot.name}: it needs legs of {len(STIFFER)} joints "
            f"with an ankle that rolls, and those of {robot.name} have {half}"
        )
    for library in LIBRARIES:
        if importlib.util.find_spec(library) is None:
            raise ControllerError(
                f"--controller lipm needs {library}, which is not installed: "
                "python -m pip install -e '.[lipm]'"
            )
    joints = tuple(
        replace(joint, kp=joint.kp * kp, kd=joint.kd * kd)
        for joint, (kp, kd) in zip(robot.joints, STIFFER * 2, strict=True)
    )
    steady_share = SURE_SHARE * robot.steady_pressure_share
    return replace(robot, joints=joints, steady_pressure_share=steady_share)


def joint_targets(
    robot: Robot, angle_rad: np.ndarray, speed_rad_s: np.ndarray, torque_nm: np.ndarray
) -> np.ndarray:
    """Targets (J,) by which servos exert the torques (J,) at the wanted angles and speeds."""
    kp = np.array([joint.kp for joint in robot.joints])
    kd = np.array([joint.kd for joint in robot.joints])
    return angle_rad + (torque_nm + kd * speed_rad_s) / kp


def require_pace(robot: Robot, step_s: ArrayLike) -> None:
    """Checks that steps take as long as the robot's gait.

    Raises:
        ControllerError: they do not.
    """
    if np.abs(np.asarray(step_s) - robot.gait.step_s).max() > 1e-6:
        raise ControllerError(
            f"--controller lipm takes steps of {robot.gait.step_s:g} s: walk at --pace normal"
        )


def report_of(
    robot: Robot, sensed: bool = False, relaxed: Mapping[str, int] | None = None
) -> dict[str, Any]:
    """What a report says of the controller that walks a `stiff` robot.

    sensed: whether it goes by the robot's sensors. relaxed: how often each stage dropped its
    constraints; None: that is told elsewhere.
    """
    true = "true base pose and velocity, contact forces"
    told = {} if relaxed is None else {"relaxed": dict(relaxed)}
    return {
        "name": "lipm",
        "rate_hz": 200,
        "state": "joints, inertial unit and forces at the soles, as measured" if sensed else true,
        "kp_nm_rad": {joint.name: joint.kp for joint in robot.joints},
        "kd_nm_s_rad": {joint.name: joint.kd for joint in robot.joints},
        **told,
    }
