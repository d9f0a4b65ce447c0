"""The policy's and the critic's observation, one definition for training and navigation.

Step targets are in the heading frame: origin at the pelvis, x along its heading, z up, with z
measured from the height at which the pelvis stands, so that level ground reads 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.plan import wrap_angle
from sim.robot import Robot

# Training clips scaled observations to this, so that outliers do not dominate the updates.
SCALED_LIMIT = 10.0
# Of a step's x, y, z, heading. A stair of a few centimetres must stand out from level ground.
STEP_SCALE = (0.3, 0.3, 0.05, 0.3)


@dataclass(frozen=True, kw_only=True)
class ObsField:
    """One group of observed numbers, its mirror map and its fixed scale.

    The mirrored field is `sign * field[..., index]`. The policy is given (field - offset) / scale.
    """

    name: str
    index: np.ndarray
    sign: np.ndarray
    scale: np.ndarray
    offset: np.ndarray

    @property
    def width(self) -> int:
        """Count of numbers."""
        return len(self.sign)


def _field(
    name: str,
    sign: tuple[float, ...],
    scale: float | tuple[float, ...],
    index: np.ndarray | None = None,
    offset: np.ndarray | None = None,
) -> ObsField:
    return ObsField(
        name=name,
        index=np.arange(len(sign)) if index is None else index,
        sign=np.array(sign, dtype=float),
        scale=np.broadcast_to(np.asarray(scale, dtype=float), len(sign)),
        offset=np.zeros(len(sign)) if offset is None else offset,
    )


def policy_fields(robot: Robot) -> tuple[ObsField, ...]:
    """The policy's observation, in order.

    Orientation, joints, gait clock, two steps, and the durations of these; older policies lack the
    last.
    """
    index, sign = robot.mirror_joints
    joint_sign = tuple(sign)
    return (
        _field("roll_pitch_rad", (-1, 1), 0.2),
        _field("pelvis_angvel_rad_s", (-1, 1, -1), 1.0),
        _field("joint_pos_rad", joint_sign, 0.5, index, robot.half_sitting_rad),
        _field("joint_vel_rad_s", joint_sign, 4.0, index),
        _field("clock", (-1, -1), 1.0),
        _field("step_1", (1, -1, 1, -1), STEP_SCALE),
        _field("step_2", (1, -1, 1, -1), STEP_SCALE),
        _field("step_s", (1, 1), 0.3, offset=np.full(2, robot.gait.step_s)),
    )


def critic_fields() -> tuple[ObsField, ...]:
    """The critic's further (privileged) observation, in training only.

    Pelvis velocity in the heading frame, pelvis height over its standing height, each foot's error
    from its target (x, y in the heading frame, heading), ground forces over the weight.
    """
    return (
        _field("pelvis_linvel_m_s", (1, -1, 1), 0.5),
        _field("pelvis_height_m", (1,), 0.1),
        _field("sole_errors", (1, -1, -1, 1, -1, -1), 0.1, np.r_[3:6, 0:3]),
        _field("ground_force_weights", (1, 1), 0.5, np.array([1, 0])),
    )


def mirror_map(fields: tuple[ObsField, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Index (N,) and sign (N,) that mirror the whole observation."""
    starts = np.cumsum([0] + [field.width for field in fields[:-1]])
    index = np.concatenate([start + f.index for start, f in zip(starts, fields, strict=True)])
    return index, np.concatenate([field.sign for field in fields])


def places(fields: tuple[ObsField, ...]) -> dict[str, slice]:
    """Where each field lies in the observation, by name."""
    ends = np.cumsum([field.width for field in fields]).tolist()
    return {f.name: slice(end - f.width, end) for f, end in zip(fields, ends, strict=True)}


def layout(fields: tuple[ObsField, ...]) -> list[list[object]]:
    """Names and widths, as stored beside a policy and compared when it is loaded."""
    return [[field.name, field.width] for field in fields]


def normaliser(fields: tuple[ObsField, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Offset (N,) and scale (N,): the policy is given (observation - offset) / scale."""
    offset = np.concatenate([field.offset for field in fields])
    scale = np.concatenate([field.scale for field in fields])
    return offset, scale


def pelvis_yaw_rad(qpos: np.ndarray) -> np.ndarray:
    """Heading (B,) of the pelvis from the free joint's quaternion in qpos (B, nq)."""
    w, x, y, z = qpos[:, 3:7].T
    return np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def roll_pitch_rad(qpos: np.ndarray) -> np.ndarray:
    """Roll and pitch (B, 2) of the pelvis, turned in the order yaw, pitch, roll."""
    w, x, y, z = qpos[:, 3:7].T
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    return np.stack([roll, pitch], axis=1)


def rotate_xy(vector: np.ndarray, yaw_rad: np.ndarray) -> np.ndarray:
    """Vectors (..., >=2) with their x and y rotated by the angles (...)."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    rotated = vector.copy()
    rotated[..., 0] = cos * vector[..., 0] - sin * vector[..., 1]
    rotated[..., 1] = sin * vector[..., 0] + cos * vector[..., 1]
    return rotated


def to_heading_frame(qpos: np.ndarray, vector_world: np.ndarray) -> np.ndarray:
    """World vectors (B, n, >=2) rotated into the pelvis's heading frame."""
    return rotate_xy(vector_world, -pelvis_yaw_rad(qpos)[:, None])


def steps_in_heading_frame(robot: Robot, qpos: np.ndarray, window: np.ndarray) -> np.ndarray:
    """Steps (B, n, 4) in the world as x, y, z, heading in the robot's heading frame."""
    relative = window.copy()
    relative[..., :3] -= qpos[:, None, :3]
    relative = to_heading_frame(qpos, relative)
    relative[..., 2] += robot.pelvis_height_m
    relative[..., 3] = wrap_angle(window[..., 3] - pelvis_yaw_rad(qpos)[:, None])
    return relative


def observe(
    robot: Robot,
    *,
    qpos: np.ndarray,
    qvel: np.ndarray,
    joint_qpos: np.ndarray,
    joint_qvel: np.ndarray,
    clock: np.ndarray,
    window: np.ndarray,
    step_s: np.ndarray,
) -> np.ndarray:
    """The policy's observation (B, 41 for 12 joints) before scaling.

    Args:
        robot: whose half-sitting posture and pelvis height are the reference.
        qpos: free joint and joints (B, nq).
        qvel: their velocities (B, nv).
        joint_qpos: indices of the joints in qpos (J,).
        joint_qvel: indices of the joints in qvel (J,).
        clock: sine and cosine of the gait phase (B, 2), 0 while standing.
        window: the present and the next step in the world (B, 2, 4).
        step_s: durations of these (B, 2).
    """
    steps = steps_in_heading_frame(robot, qpos, window)
    return np.concatenate(
        [
            roll_pitch_rad(qpos),
            qvel[:, 3:6],
            qpos[:, joint_qpos],
            qvel[:, joint_qvel],
            clock,
            steps.reshape(len(qpos), -1),
            step_s,
        ],
        axis=1,
    )
