"""A footstep plan, the plan.json format, and the poses of a pair of feet."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from maps.files import from_json
from planner.robot_model import Side

FORMAT = "footstep-plan/1"
Pose = tuple[float, float, float]
FloatArray = NDArray[np.float64]
_STEP_KEYS = ("x", "y", "z", "yaw")


class PlanStatus(StrEnum):
    """Outcome of a planning request; only FOUND carries steps to the goal.

    TIMED_OUT carries the first of them where a part was asked for.
    """

    FOUND = "found"
    START_BLOCKED = "start_blocked"
    GOAL_BLOCKED = "goal_blocked"
    OFF_MAP = "off_map"
    NO_PATH = "no_path"
    TIMED_OUT = "timed_out"


@dataclass(frozen=True, kw_only=True)
class NarrowPlace:
    """Where the widest way is narrowest, too narrow to walk through facing ahead.

    x, y in metres, as in the documents that hold it; the width there and the width needed.
    """

    x: float
    y: float
    width_m: float
    needed_m: float

    def __str__(self) -> str:
        return (
            f"the passage at {self.x:z.2f},{self.y:z.2f} is {self.width_m:.2f} m wide; "
            f"to walk ahead the robot needs {self.needed_m:.2f} m"
        )


@dataclass(frozen=True, kw_only=True)
class PlanWaypoint:
    """A pair pose on the way of a plan: both feet are on it after `step` of the plan's steps.

    stands: the robot stands there for a moment, and the plan ends; otherwise it walks on.
    """

    pose: Pose
    step: int
    stands: bool = False


def _no_sides() -> NDArray[np.int8]:
    return np.zeros(0, np.int8)


def _no_poses() -> FloatArray:
    return np.zeros((0, 4))


@dataclass(frozen=True, kw_only=True, repr=False)
class FootstepPlan:
    """Steps in the order in which they are taken, and what made them.

    side (N,): Side of each step. pose_world (N, 4): x_m, y_m, z_m, yaw_rad of each foot placed.
    start_feet_world (2, 4): where the feet stand before the first step, left then right.
    step_s (N,): how long each step takes, from lift-off to the next foot's; None: as long as the
        gait of the robot does.
    narrow_place: where there is no plan, the place that is too narrow to walk through, if any is.
    waypoints: the poses that it was asked to pass on the way, in order; each within the tolerance
        of the goal, where there is one.
    start, goal: pair poses x_m, y_m, yaw_rad. Arrays are read-only.
    epsilon: proven bound: what the search found costs at most epsilon times the optimum on the
        lattice, and refinement only lowers that; inf if nothing is proven.
    cost_before_refinement_m: cost of the plan that the search found, before its steps were moved to
        lower the cost, which epsilon is about; None where that was not asked for.
    """

    start_feet_world: FloatArray
    start: Pose
    goal: Pose
    side: NDArray[np.int8] = field(default_factory=_no_sides)
    pose_world: FloatArray = field(default_factory=_no_poses)
    step_s: FloatArray | None = None
    narrow_place: NarrowPlace | None = None
    waypoints: tuple[PlanWaypoint, ...] = ()
    robot: str = ""
    map: str = ""
    status: PlanStatus = PlanStatus.FOUND
    reason: str = ""
    cost_m: float = 0.0
    cost_before_refinement_m: float | None = None
    epsilon: float = 1.0
    expansions: int = 0
    time_to_first_s: float = 0.0
    time_s: float = 0.0
    planner: str = ""

    def __post_init__(self) -> None:
        side = np.array(self.side, dtype=np.int8)
        pose = np.array(self.pose_world, dtype=float)
        feet = np.array(self.start_feet_world, dtype=float)
        if side.ndim != 1 or pose.shape != (len(side), 4):
            raise ValueError(f"pose_world {pose.shape} must be (N, 4) with N = {side.shape}")
        if feet.shape != (2, 4):
            raise ValueError(f"start_feet_world {feet.shape} must be (2, 4)")
        arrays = {"side": side, "pose_world": pose, "start_feet_world": feet}
        if self.step_s is not None:
            arrays["step_s"] = step_s = np.array(self.step_s, dtype=float)
            if step_s.shape != side.shape or not np.all((step_s > 0) & np.isfinite(step_s)):
                raise ValueError(f"step_s must be a positive number for each of {len(side)} steps")
        at = [waypoint.step for waypoint in self.waypoints]
        if at != sorted(at) or not all(0 <= step <= len(side) for step in at):
            raise ValueError(f"waypoints at steps {at} are not in the order of {len(side)} steps")
        for name, array in arrays.items():
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.side)

    def __repr__(self) -> str:
        if not self.found:
            part = f"{len(self)} first steps, " if len(self) else ""
            return f"FootstepPlan({part}{self.status}: {self.reason})"
        bound = f"at most {self.epsilon:.2f} times the least" if self.epsilon > 1 else "the least"
        return f"FootstepPlan({len(self)} steps, cost {self.cost_m:.2f} m, {bound})"

    @property
    def found(self) -> bool:
        """Whether there is a plan to walk (it may be empty when the feet already stand there)."""
        return self.status is PlanStatus.FOUND

    def to_json(self) -> str:
        """The plan as text of plan.json; an unproven bound (inf) becomes null."""
        document = {
            "format": FORMAT,
            "robot": self.robot,
            "map": self.map,
            "start": [float(v) for v in self.start],
            "goal": [float(v) for v in self.goal],
            "status": str(self.status),
            "reason": self.reason,
            **({"narrow_place": asdict(self.narrow_place)} if self.narrow_place else {}),
            **({"waypoints": [_of(point) for point in self.waypoints]} if self.waypoints else {}),
            "start_feet": {
                side.name.lower(): self.start_feet_world[side].tolist() for side in Side
            },
            "steps": [
                {
                    "side": Side(int(side)).name.lower(),
                    **dict(zip(_STEP_KEYS, self.pose_world[k].tolist(), strict=True)),
                    **({} if self.step_s is None else {"step_s": float(self.step_s[k])}),
                }
                for k, side in enumerate(self.side)
            ],
            "cost_m": self.cost_m,
            "cost_before_refinement_m": self.cost_before_refinement_m,
            "epsilon": self.epsilon if math.isfinite(self.epsilon) else None,
            "expansions": self.expansions,
            "time_to_first_s": self.time_to_first_s,
            "time_s": self.time_s,
            "planner": self.planner,
        }
        return json.dumps(document, indent=1, allow_nan=False)

    @staticmethod
    def from_json(text: str) -> FootstepPlan:
        """The plan that plan.json text holds. Raises ValueError naming what is wrong in it."""
        try:
            document = from_json(text)
        except ValueError as error:
            raise ValueError(f"not a plan: invalid JSON ({error})") from None
        if not isinstance(document, dict) or document.get("format") != FORMAT:
            found = document.get("format") if isinstance(document, dict) else type(document)
            raise ValueError(f"not a plan: format is {found!r}, must be {FORMAT!r}")
        try:
            return _from_document(document)
        except KeyError as error:
            raise ValueError(f"not a plan: key {error} is missing") from None
        except (TypeError, ValueError, AttributeError, OverflowError) as error:
            raise ValueError(f"not a plan: {error!s:.400}") from None


def finite_pose(values: Iterable[float]) -> Pose:
    """Three numbers as a pose. Raises ValueError unless all are finite."""
    x_m, y_m, yaw_rad = _numbers(values, 3)
    return x_m, y_m, yaw_rad


def _from_document(document: Mapping[str, Any]) -> FootstepPlan:
    steps = document["steps"]
    epsilon = document["epsilon"]
    before = document.get("cost_before_refinement_m")
    timed = [step["step_s"] for step in steps if "step_s" in step]
    if timed and len(timed) < len(steps):
        raise ValueError(f"{len(timed)} of {len(steps)} steps have a step_s: give all or none")
    return FootstepPlan(
        start_feet_world=np.array(
            [_numbers(document["start_feet"][s.name.lower()], 4) for s in Side]
        ),
        start=finite_pose(document["start"]),
        goal=finite_pose(document["goal"]),
        side=np.array([_side(step["side"]) for step in steps], dtype=np.int8),
        pose_world=np.array(
            [_numbers([step[key] for key in _STEP_KEYS], 4) for step in steps]
        ).reshape(-1, 4),
        step_s=np.array(_numbers(timed, len(steps))) if timed else None,
        robot=str(document["robot"]),
        map=str(document["map"]),
        status=PlanStatus(document["status"]),
        reason=str(document["reason"]),
        narrow_place=_narrow_place(document.get("narrow_place")),
        waypoints=tuple(_waypoint(point) for point in document.get("waypoints", ())),
        cost_m=float(document["cost_m"]),
        cost_before_refinement_m=None if before is None else float(before),
        epsilon=math.inf if epsilon is None else float(epsilon),
        expansions=int(document["expansions"]),
        time_to_first_s=float(document["time_to_first_s"]),
        time_s=float(document["time_s"]),
        planner=str(document["planner"]),
    )


def _narrow_place(document: Mapping[str, float] | None) -> NarrowPlace | None:
    if document is None:
        return None
    keys = ("x", "y", "width_m", "needed_m")
    return NarrowPlace(**dict(zip(keys, _numbers([document[k] for k in keys], 4), strict=True)))


def _of(waypoint: PlanWaypoint) -> dict[str, float | int | bool]:
    x_m, y_m, yaw_rad = (float(v) for v in waypoint.pose)
    return {"x": x_m, "y": y_m, "yaw": yaw_rad, "step": waypoint.step, "stands": waypoint.stands}


def _waypoint(document: Mapping[str, Any]) -> PlanWaypoint:
    step, stands = document["step"], document["stands"]
    if type(step) is not int or type(stands) is not bool:
        raise ValueError(f"step {step!r} must be a count, stands {stands!r} true or false")
    pose = finite_pose(document[key] for key in ("x", "y", "yaw"))
    return PlanWaypoint(pose=pose, step=step, stands=stands)


def _side(name: str) -> Side:
    try:
        return Side[name.upper()]
    except KeyError:
        raise ValueError(f"side {name!r} must be 'left' or 'right'") from None


def _numbers(values: Iterable[float], count: int) -> list[float]:
    numbers = [float(value) for value in values]
    if len(numbers) != count or not all(math.isfinite(value) for value in numbers):
        raise ValueError(f"{values} must be {count} finite numbers")
    return numbers


def wrap_angle(angle_rad: ArrayLike) -> FloatArray:
    """Angle(s) in [-pi, pi)."""
    wrapped: FloatArray = (np.asarray(angle_rad, dtype=float) + np.pi) % (2 * np.pi) - np.pi
    return wrapped


def to_frame(poses: FloatArray, frame: ArrayLike) -> FloatArray:
    """Poses (n, 3) x_m, y_m, yaw_rad as seen from a pose (3,)."""
    x_m, y_m, yaw_rad = (float(v) for v in np.asarray(frame))
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    x, y = poses[:, 0] - x_m, poses[:, 1] - y_m
    return np.column_stack(
        [cos * x + sin * y, cos * y - sin * x, wrap_angle(poses[:, 2] - yaw_rad)]
    )


def from_frame(poses: FloatArray, frame: ArrayLike) -> FloatArray:
    """Poses (n, 3) as `to_frame` gives them, in the frame that the pose (3,) is in."""
    x_m, y_m, yaw_rad = (float(v) for v in np.asarray(frame))
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    x, y = poses[:, 0], poses[:, 1]
    return np.column_stack(
        [x_m + cos * x - sin * y, y_m + sin * x + cos * y, wrap_angle(poses[:, 2] + yaw_rad)]
    )


def feet_at(pose: ArrayLike, stance_width_m: float) -> FloatArray:
    """Feet (2, 4) of a robot that stands at the pair pose (x_m, y_m, yaw_rad) on z = 0."""
    x_m, y_m, yaw_rad = (float(v) for v in np.asarray(pose, dtype=float))
    half = stance_width_m / 2
    dx_m, dy_m = -half * math.sin(yaw_rad), half * math.cos(yaw_rad)
    return np.array(
        [[x_m + dx_m, y_m + dy_m, 0.0, yaw_rad], [x_m - dx_m, y_m - dy_m, 0.0, yaw_rad]]
    )


def pair_pose(feet: ArrayLike) -> FloatArray:
    """Pair pose (3,) of two feet (2, 4): the point midway and the mean heading, in [-pi, pi)."""
    a, b = np.asarray(feet, dtype=float)
    yaw_rad = a[3] + float(wrap_angle(b[3] - a[3])) / 2
    return np.array([(a[0] + b[0]) / 2, (a[1] + b[1]) / 2, float(wrap_angle(yaw_rad))])


def relative_steps(
    support: FloatArray, swing: FloatArray, outward: NDArray[np.integer] | int
) -> FloatArray:
    """`relative_step` (..., 3) of poses x, y, yaw (..., 3); outward (...): `Side.outward`."""
    dx_m, dy_m = swing[..., 0] - support[..., 0], swing[..., 1] - support[..., 1]
    cos, sin = np.cos(support[..., 2]), np.sin(support[..., 2])
    turn = wrap_angle(swing[..., 2] - support[..., 2])
    x_m, y_m = cos * dx_m + sin * dy_m, cos * dy_m - sin * dx_m
    return np.stack([x_m, outward * y_m, outward * turn], axis=-1)


def relative_step(support: ArrayLike, swing: ArrayLike, swing_side: Side) -> FloatArray:
    """Step (x, y, yaw) of the swing foot pose (4,) in the frame of the support foot (4,).

    y and yaw are counted outward, so the result compares with StepLimits whatever the side.
    """
    a, b = np.asarray(support, dtype=float), np.asarray(swing, dtype=float)
    dx_m, dy_m = b[0] - a[0], b[1] - a[1]
    cos, sin = math.cos(a[3]), math.sin(a[3])
    out = swing_side.outward
    return np.array(
        [
            cos * dx_m + sin * dy_m,
            out * (-sin * dx_m + cos * dy_m),
            out * float(wrap_angle(b[3] - a[3])),
        ]
    )
