"""What one robot can reach and stand on: foot and body boxes, step limits, step set.

A foot pose is the centre of the sole on the ground with x forward along the foot. A step
(x, y, yaw) is the pose of the swing foot in the frame of the support foot, with y and yaw counted
outward: positive away from the support foot, so one step serves both sides.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from maps.yaml_files import Section

Point = tuple[float, float]
Interval = tuple[float, float]
Step = tuple[float, float, float]
_ROUNDING_M = 1e-9
_LEAST_AREA_M2 = 1e-6


def half_planes_of(vertices: Sequence[Point]) -> NDArray[np.float64]:
    """Half planes (k, 3) of a convex polygon of k vertices: unit normals n and distances c.

    A point p lies in the polygon where n . p <= c for all; n . p - c is how far in metres it lies
    beyond an edge. (0, 3) without vertices.
    """
    if not len(vertices):
        return np.zeros((0, 3))
    points = np.array(vertices, dtype=float)
    edges = np.roll(points, -1, axis=0) - points
    normals = np.column_stack([edges[:, 1], -edges[:, 0]]) / np.hypot(*edges.T)[:, None]
    return np.column_stack([normals, np.sum(normals * points, axis=1)])


def check_polygon(name: str, vertices: Sequence[Point]) -> None:
    """Raises ValueError unless the vertices are a convex polygon, counter-clockwise."""
    for vertex in vertices:
        if np.shape(vertex) != (2,) or not all(math.isfinite(v) for v in vertex):
            raise ValueError(f"{name}: vertex {vertex} must be two finite numbers x_m, y_m")
    if len(vertices) < 3:
        raise ValueError(f"{name} has {len(vertices)} vertices, must have at least 3, or none")
    if len({tuple(vertex) for vertex in vertices}) < len(vertices):
        raise ValueError(f"{name} {vertices} must not name a vertex twice")
    points = np.array(vertices, dtype=float)
    x, y = (points - points[0]).T
    area_m2 = float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) / 2
    if area_m2 <= -_LEAST_AREA_M2:
        raise ValueError(f"{name} {vertices} is clockwise, must be counter-clockwise")
    if area_m2 < _LEAST_AREA_M2:
        raise ValueError(f"{name} {vertices} has no area, must have at least {_LEAST_AREA_M2} m2")
    planes = half_planes_of(vertices)
    beyond_m = (points @ planes[:, :2].T - planes[:, 2]).max(axis=1)
    if beyond_m.max() > _ROUNDING_M:
        worst = vertices[int(np.argmax(beyond_m))]
        raise ValueError(f"{name} {vertices} must be convex: not so beside vertex {worst}")


class Side(IntEnum):
    """Which foot. Left comes before right in every array of two feet."""

    LEFT = 0
    RIGHT = 1

    @property
    def other(self) -> Side:
        """The opposite side."""
        return Side(1 - self)

    @property
    def outward(self) -> int:
        """Sign of y (and yaw) that points away from the other foot: +1 for left, -1 for right."""
        return 1 - 2 * int(self)


@dataclass(frozen=True, kw_only=True)
class FootShape:
    """Sole as a box centred on the foot pose."""

    length_m: float
    width_m: float

    def __post_init__(self) -> None:
        _check_positive("foot length_m", self.length_m)
        _check_positive("foot width_m", self.width_m)


@dataclass(frozen=True, kw_only=True)
class BodyShape:
    """Outline of the robot seen from above: a box centred on the pair pose.

    The pair pose is the point midway between the feet with their mean heading.
    """

    length_m: float
    width_m: float

    def __post_init__(self) -> None:
        _check_positive("body length_m", self.length_m)
        _check_positive("body width_m", self.width_m)


# A box widened by a disc (their Minkowski sum): half length and half width of the box, and radius.
# It holds all points that are no farther from the box than the radius.
RoundedBox = tuple[float, float, float]


def rounded_box(shape: FootShape | BodyShape, margin_m: float) -> RoundedBox:
    """The ground under a foot or body and as far around it as a margin."""
    return shape.length_m / 2, shape.width_m / 2, float(margin_m)


@dataclass(frozen=True, kw_only=True)
class StepLimits:
    """Closed intervals of the swing foot's pose in the support foot's frame (outward positive).

    z_m: how far a step may fall and rise on maps with elevation; holds 0.
    reach_m: vertices x_m, y_m of a convex polygon, counter-clockwise, in which the swing foot must
        land too; () for the intervals alone.
    """

    x_m: Interval
    y_m: Interval
    yaw_rad: Interval
    z_m: Interval = (-0.01, 0.01)
    reach_m: tuple[Point, ...] = ()

    def __post_init__(self) -> None:
        for name in ("x_m", "y_m", "yaw_rad", "z_m"):
            low, high = getattr(self, name)
            if not (math.isfinite(low) and math.isfinite(high) and low <= high):
                raise ValueError(f"step limits {name}: ({low}, {high}) must be finite, low <= high")
        if not self.z_m[0] <= 0.0 <= self.z_m[1]:
            raise ValueError(f"step limits z_m: {self.z_m} must hold 0, or no floor can be walked")
        if len(self.reach_m):
            check_polygon("step limits reach_m", self.reach_m)

    @property
    def half_planes(self) -> NDArray[np.float64]:
        """Half planes (k, 3) of reach_m: unit normals n and c in metres, n . (x, y) <= c inside."""
        return half_planes_of(self.reach_m)

    def contain(self, steps: ArrayLike, tolerance: float = 1e-9) -> NDArray[np.bool_]:
        """Whether each step of (..., 3) lies within the limits, shape (...).

        tolerance: metres or radians beyond each limit, metres beyond each edge of the polygon.
        """
        array = np.asarray(steps, dtype=float)
        low = np.array([self.x_m[0], self.y_m[0], self.yaw_rad[0]]) - tolerance
        high = np.array([self.x_m[1], self.y_m[1], self.yaw_rad[1]]) + tolerance
        inside: NDArray[np.bool_] = np.all((array >= low) & (array <= high), axis=-1)
        if len(self.reach_m):
            planes = self.half_planes
            beyond_m = array[..., :2] @ planes[:, :2].T - planes[:, 2]
            inside = np.asarray(inside & np.all(beyond_m <= tolerance, axis=-1))
        return inside

    def most_x_m(self, y_m: float, *, backward: bool = False) -> float:
        """Greatest x, or the least if backward, of a step that is this far out and not turned.

        y_m must lie within the limits.
        """
        ends = list(self.x_m)
        for n_x, n_y, c in self.half_planes.tolist():
            if abs(n_x) > 1e-12:
                end, at_m = int(n_x > 0), (c - n_y * y_m) / n_x
                ends[end] = min(ends[1], at_m) if end else max(ends[0], at_m)
        return ends[0] if backward else ends[1]


@dataclass(frozen=True, kw_only=True)
class StepModel:
    """Everything the planner knows about one robot.

    steps: the step set (x_m, y_m, yaw_rad); each must lie within the limits.
    stance_width_m: distance between the feet when standing at a pose.
    step_cost_m: what a step costs on top of the distance between its two feet.
    turn_cost_m, side_cost_m, back_cost_m: optional extra cost of a step per radian of turn, per
        metre by which y differs from the stance width, and per metre backwards.
    clearance_m, clearance_cost_m: optional: a step that leaves less than clearance_m between the
        circle around the body's width and an obstacle costs up to clearance_cost_m more, growing
        linearly as that distance falls to zero.
    foot_margin_m, body_margin_m: least distance of each box from what is blocked: the collision
        check widens the box by a disc of this radius.
    foot_gap_m: least distance between the boxes of two consecutive feet.
    level_margin_m, level_m: on maps with elevation the ground under a foot's box that grows by this
        much on all sides must be level: its highest point is at most level_m above its lowest.
    swing_clear_m: the ground that a foot swings over may be so much higher than the higher of the
        two places that a step joins.
    cell_m, headings: the search lattice.
    """

    foot: FootShape
    body: BodyShape
    limits: StepLimits
    steps: tuple[Step, ...]
    stance_width_m: float
    step_cost_m: float = 0.1
    turn_cost_m: float = 0.0
    side_cost_m: float = 0.0
    back_cost_m: float = 0.0
    clearance_m: float = 0.0
    clearance_cost_m: float = 0.0
    foot_margin_m: float = 0.0
    body_margin_m: float = 0.0
    foot_gap_m: float = 0.01
    level_margin_m: float = 0.02
    level_m: float = 0.01
    swing_clear_m: float = 0.02
    cell_m: float = 0.05
    headings: int = 64

    def __post_init__(self) -> None:
        _check_positive("stance_width_m", self.stance_width_m)
        _check_positive("step_cost_m", self.step_cost_m)
        for name in (
            *("turn_cost_m", "side_cost_m", "back_cost_m", "clearance_m", "clearance_cost_m"),
            *("foot_margin_m", "body_margin_m", "foot_gap_m"),
            *("level_margin_m", "level_m", "swing_clear_m"),
        ):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{name} {value} must be a finite number of 0 or more")
        if not 0.005 <= self.cell_m <= 0.2:
            raise ValueError(f"cell_m {self.cell_m} must be from 0.005 to 0.2")
        if not (isinstance(self.headings, int) and 8 <= self.headings <= 256):
            raise ValueError(f"headings {self.headings} must be a whole number from 8 to 256")
        if self.headings % 4:
            raise ValueError(f"headings {self.headings} must be a multiple of 4")
        self._check_steps()

    def _check_steps(self) -> None:
        if not self.steps:
            raise ValueError("steps is empty: a walk needs at least one step (x, y, yaw)")
        for step in self.steps:
            if len(step) != 3 or not self.limits.contain(step):
                raise ValueError(f"step {step} lies outside the step limits {self.limits}")
        if not self.limits.contain((0.0, self.stance_width_m, 0.0)):
            raise ValueError(
                f"stance_width_m {self.stance_width_m}: the step limits {self.limits} "
                "must allow the step (0, stance_width_m, 0), which ends every walk"
            )
        if self.stance_width_m < self.foot.width_m + self.foot_gap_m:
            raise ValueError(
                f"stance_width_m {self.stance_width_m} must be at least the foot's width "
                f"{self.foot.width_m} + foot_gap_m {self.foot_gap_m}, or the feet overlap"
            )


def level_box(model: StepModel) -> RoundedBox:
    """The ground that must be level under a foot.

    A larger box and not a widened one: its corners keep heels, which land up to the foot margin
    off, from coming down on a sill that a foot has crossed aslant.
    """
    margin_m = model.level_margin_m
    return model.foot.length_m / 2 + margin_m, model.foot.width_m / 2 + margin_m, 0.0


def _check_positive(name: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0):
        raise ValueError(f"{name} {value} must be a finite number above 0")


_SHAPES = ("foot", "body", "limits", "steps")
STEP_MODEL_NEEDS = (*_SHAPES, "stance_width_m")
_NUMBERS = tuple(field.name for field in fields(StepModel) if field.name not in _SHAPES)


def step_model_of(section: Section, beside: tuple[str, ...] = ()) -> StepModel:
    """The step model in a section of a file; `beside` are keys that may stand there too.

    Raises:
        YamlFileError: A key is missing or unknown, or a value is wrong.
    """
    section.check_keys(STEP_MODEL_NEEDS, (*beside, *_SHAPES, *_NUMBERS))
    with_shape: dict[str, Any] = {
        "foot": FootShape(**_sizes_of(section, "foot")),
        "body": BodyShape(**_sizes_of(section, "body")),
        "limits": step_limits_of(section, "limits"),
        "steps": section.points("steps", 3),
    }
    numbers: dict[str, Any] = {key: section.number(key) for key in _NUMBERS if key in section}
    if "headings" in numbers:
        numbers["headings"] = section.whole("headings")
    return section.made(lambda: StepModel(**with_shape, **numbers))


def step_limits_of(section: Section, key: str) -> StepLimits:
    """The step limits below a key of a file.

    Raises:
        YamlFileError: A key is missing or unknown, or a value is wrong.
    """
    known = [field.name for field in fields(StepLimits)]
    limits = section.section(key, ("x_m", "y_m", "yaw_rad"), known)
    intervals = {name: limits.interval(name) for name in limits.values if name != "reach_m"}
    reach_m = limits.points("reach_m", 2) if "reach_m" in limits else ()
    return section.made(lambda: StepLimits(**intervals, reach_m=reach_m))


def _sizes_of(section: Section, key: str) -> dict[str, float]:
    names = ("length_m", "width_m")
    sizes = section.section(key, names, names)
    return {name: sizes.number(name, above=0.0) for name in names}
