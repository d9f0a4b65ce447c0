"""Independent check of a plan by exact polygons (shapely), sharing no geometry with the search."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import shapely
from numpy.typing import NDArray

from maps.grid import OccupancyGrid
from planner.plan import FootstepPlan, PlanStatus
from planner.robot_model import BodyShape, FootShape, Side, StepModel
from planner.time_limit import check_time

FloatArray = NDArray[np.float64]
_TOLERANCE_M = 1e-6
# Boxes shrink by this much, so that contact within rounding is no overlap.
_OVERLAP_TOLERANCE_M = 1e-7


def violations(
    plan: FootstepPlan,
    grid: OccupancyGrid,
    model: StepModel,
    *,
    unknown_is_free: bool = False,
    stood_freely: bool = True,
    goal_reach: tuple[float, float] = (0.0, 0.0),
) -> list[str]:
    """What is wrong with a plan, or the first part of one, one line each; empty if it is right.

    Sides alternate; each step is within the limits; consecutive feet keep the gap; the boxes of
    feet (at every step) and body (at every pair of feet and over every single foot) keep their
    margins from blocked cells and the map's edge; feet are on the highest ground below them,
    which is level; rise and fall and the ground that a foot swings over are within the limits; the
    last two feet are those of the goal pose, exactly. stood_freely: the plan began at a pair pose,
    so the margins count in the first step too; false where it began from feet as they stood.
    goal_reach: metres from the goal and radians off its heading at which both feet may stand, side
    by side, in the end. Raises OutOfTime where a limit passes on the way.
    """
    is_part = plan.status is PlanStatus.TIMED_OUT and len(plan) > 0
    if not plan.found and not is_part:
        return [f"status is {plan.status}, not found"]
    if not len(plan):
        there = _feet_are_at_goal(plan, model, goal_reach)
        return [] if there else ["empty, but the feet are not at the goal"]
    floor = _Floor(grid, model, unknown_is_free)
    wrong: list[str] = []
    support = plan.start_feet_world[Side(int(plan.side[0])).other]
    for i, (side, pose) in enumerate(zip(plan.side, plan.pose_world, strict=True)):
        check_time()
        swing = Side(int(side))
        if i and swing == plan.side[i - 1]:
            wrong.append(f"step {i}: {swing.name.lower()} foot twice in a row")
        margin_m = model.body_margin_m if i or stood_freely else 0.0
        for found in (
            _limit_violations(support, pose, swing, model),
            floor.collisions(support, pose, swing, margin_m),
            floor.height_violations(support, pose, swing),
        ):
            wrong += [f"step {i}: {what}" for what in found]
        support = pose
    if plan.found and not _feet_are_at_goal(plan, model, goal_reach):
        wrong.append("the last two feet are not the goal's")
    return wrong


def _feet_are_at_goal(
    plan: FootstepPlan, model: StepModel, goal_reach: tuple[float, float]
) -> bool:
    """Whether the feet end within a nanometre of the goal feet, worked out here once more.

    Of the goal's own, or of those of the pose where they are if that is near enough to the goal.
    """
    if len(plan) == 1:
        return False
    left, right = plan.start_feet_world
    for side, pose in zip(plan.side[-2:], plan.pose_world[-2:], strict=True):
        left, right = (pose, right) if side == Side.LEFT else (left, pose)
    x_m, y_m, yaw_rad = plan.goal
    mid_m = (left[:2] + right[:2]) / 2
    off_rad = abs(math.remainder(left[3] - yaw_rad, 2 * math.pi))
    if math.dist(mid_m, (x_m, y_m)) > goal_reach[0] + 1e-8 or off_rad > goal_reach[1] + 1e-8:
        return False
    if any(goal_reach):
        x_m, y_m, yaw_rad = mid_m[0], mid_m[1], left[3]
    reach = 1e-9 if len(plan) else 2e-6
    for foot, sign in ((left, 1), (right, -1)):
        wanted = _beside((x_m, y_m, yaw_rad), sign * model.stance_width_m / 2)
        turn = math.remainder(foot[3] - yaw_rad, 2 * math.pi)
        if math.dist(wanted, foot[:2]) > reach or abs(turn) > reach:
            return False
    return True


def _limit_violations(
    support: FloatArray, pose: FloatArray, swing: Side, model: StepModel
) -> Iterator[str]:
    """Limits and overlap of one step."""
    if not np.all(np.isfinite(pose)):
        yield f"pose {pose} is not finite"
    out = 1.0 if swing == Side.LEFT else -1.0
    ahead_m, aside_m = _turned(pose[0] - support[0], pose[1] - support[1], -support[3])
    values = ahead_m, out * aside_m, out * math.remainder(pose[3] - support[3], 2 * math.pi)
    limits = model.limits
    for name, value, (low, high) in zip(
        ("x", "y", "yaw"), values, (limits.x_m, limits.y_m, limits.yaw_rad), strict=True
    ):
        if not low - 1e-6 <= value <= high + 1e-6:
            yield f"{name} {value:.4f} is outside {low}..{high}"
    if len(limits.reach_m):
        beyond_m = shapely.distance(shapely.Polygon(limits.reach_m), shapely.Point(values[:2]))
        if not beyond_m <= 1e-6:
            at = f"x {values[0]:.4f}, y {values[1]:.4f}"
            yield f"{at} is {beyond_m:.4f} m outside the polygon {limits.reach_m}"
    apart_m = shapely.distance(_box(support, model.foot), _box(pose, model.foot))
    if apart_m < model.foot_gap_m - 1e-9:
        yield f"the feet are {apart_m:.4f} m apart, less than {model.foot_gap_m}"


class _Floor:
    """The cells of one map as polygons in the grid frame."""

    def __init__(self, grid: OccupancyGrid, model: StepModel, unknown_is_free: bool) -> None:
        self._grid, self._model = grid, model
        self._blocked = grid.blocked(unknown_is_free)

    def collisions(
        self, support: FloatArray, pose: FloatArray, swing: Side, pair_margin_m: float
    ) -> Iterator[str]:
        """What foot and body of one step hit; poses (4,)."""
        model = self._model
        left_m = model.stance_width_m / 2 * (-1.0 if swing == Side.LEFT else 1.0)
        turn = math.remainder(pose[3] - support[3], 2 * math.pi)
        pair = np.array([*(support[:2] + pose[:2]) / 2, support[3] + turn / 2])
        single = np.array([*_beside(pose, left_m), pose[3]])
        for name, at, shape, margin_m in (
            ("the foot", pose, model.foot, model.foot_margin_m),
            ("the body on both feet", pair, model.body, pair_margin_m),
            ("the body on one foot", single, model.body, model.body_margin_m),
        ):
            box = _box(self._in_grid(at), shape, _OVERLAP_TOLERANCE_M)
            if self._hits(box, margin_m):
                yield f"{name} hits something at {at[0]:z.3f}, {at[1]:z.3f}"

    def height_violations(
        self, support: FloatArray, pose: FloatArray, swing: Side
    ) -> Iterator[str]:
        """What is wrong with the heights of a step from a support foot (4,) to a pose (4,)."""
        model = self._model
        if self._grid.elevation_m is None:
            if pose[2] != 0.0:
                yield f"z {pose[2]} is not 0 on a flat floor"
            return
        foot = self._in_grid(pose)
        tread = _box(foot, model.foot, _TOLERANCE_M - model.level_margin_m)
        heights = self._heights_below(tread, 0.0)
        near = self._heights_below(tread, 3 * _TOLERANCE_M)
        if len(heights) == 0 or np.ptp(heights) > model.level_m + _TOLERANCE_M:
            yield f"the ground at {pose[0]:z.3f}, {pose[1]:z.3f} is not level: {heights}"
        elif not heights.max() - _TOLERANCE_M <= pose[2] <= near.max() + _TOLERANCE_M:
            yield f"z {pose[2]} is not the height of the ground, {heights.max()}"
        rise_m = pose[2] - support[2]
        low_m, high_m = model.limits.z_m
        if not low_m - _TOLERANCE_M <= rise_m <= high_m + _TOLERANCE_M:
            yield f"rise {rise_m:.4f} is outside {low_m}..{high_m}"
        highest_m = max(pose[2], support[2]) + model.swing_clear_m
        for area in _swing_areas(self._in_grid(support), foot, swing, model):
            passed = self._heights_below(area, 0.0)
            if len(passed) and passed.max() > highest_m + _TOLERANCE_M:
                yield f"the foot swings over ground at z {passed.max():.3f}"

    def _in_grid(self, pose: FloatArray) -> FloatArray:
        """x, y and yaw (3,) of a pose in the world (x, y, ..., yaw), in the grid frame."""
        x0_m, y0_m, yaw_rad = self._grid.origin
        x, y = _turned(pose[0] - x0_m, pose[1] - y0_m, -yaw_rad)
        return np.array([x, y, pose[-1] - yaw_rad])

    def _hits(self, area: shapely.Polygon, margin_m: float) -> bool:
        """Whether an area is within a margin of a blocked cell or the map's edge."""
        low_x, low_y, high_x, high_y = area.bounds
        size_x, size_y = self._grid.size_m
        if min(low_x, low_y, size_x - high_x, size_y - high_y) < margin_m:
            return True
        return len(self._near(area, margin_m, self._blocked, self._blocked)) > 0

    def _heights_below(self, area: shapely.Polygon, margin_m: float) -> FloatArray:
        """Heights (n,) of the free cells within a margin of an area."""
        assert self._grid.elevation_m is not None
        return self._near(area, margin_m, ~self._blocked, self._grid.elevation_m)

    def _near(
        self,
        area: shapely.Polygon,
        margin_m: float,
        mask: NDArray[np.bool_],
        values: NDArray[np.generic],
    ) -> FloatArray:
        """Values (n,) of a mask's cells within a margin of an area; alike neighbours count once."""
        size_m = self._grid.resolution_m
        bounds = np.array(area.bounds) + np.array([-1, -1, 1, 1]) * margin_m
        low_x, low_y, high_x, high_y = (max(0, int(v // size_m)) for v in bounds)
        window = slice(low_y, high_y + 1), slice(low_x, high_x + 1)
        inside, value = mask[window], values[window]
        if not inside.any():
            return np.zeros(0)
        # Neighbours in a row that are alike make one rectangle.
        begins = np.ones(inside.shape, bool)
        begins[:, 1:] = (inside[:, 1:] != inside[:, :-1]) | (value[:, 1:] != value[:, :-1])
        first = np.flatnonzero(begins)
        cells = np.diff(first, append=inside.size)
        row, col = np.divmod(first, inside.shape[1])
        left, low = (col + low_x) * size_m, (row + low_y) * size_m
        rectangles = shapely.box(left, low, left + cells * size_m, low + size_m)
        near = inside.ravel()[first] & (shapely.distance(rectangles, area) <= margin_m)
        return np.asarray(value.ravel()[first][near], float)


def _swing_areas(
    support: FloatArray, pose: FloatArray, swing: Side, model: StepModel
) -> Iterator[shapely.Polygon]:
    """Where the soles pass: from beside the support foot to the pose, and on to beside that."""
    left_m = model.stance_width_m * (1.0 if swing == Side.LEFT else -1.0)
    for start, end, yaw_rad in (
        (_beside(support, left_m), pose[:2], pose[2]),
        (support[:2], _beside(pose, -left_m), support[2]),
    ):
        if math.dist(start, end) < 1e-5:
            continue
        turn = yaw_rad - math.atan2(end[1] - start[1], end[0] - start[0])
        width_m = abs(math.sin(turn)) * model.foot.length_m
        width_m += abs(math.cos(turn)) * model.foot.width_m
        # Flat ends: the strip stops at the points.
        line = shapely.LineString([start, end])
        yield line.buffer(width_m / 2 - _TOLERANCE_M, cap_style="flat")


def _beside(pose: FloatArray | tuple[float, ...], left_m: float) -> FloatArray:
    """The point so far to the left of a pose (x, y, ..., yaw)."""
    x, y = _turned(0.0, left_m, pose[-1])
    return np.array([pose[0] + x, pose[1] + y])


def _box(pose: FloatArray, shape: FootShape | BodyShape, less_m: float = 0.0) -> shapely.Polygon:
    """The box of a foot or body at a pose (x, y, ..., yaw), so much less on all sides."""
    half_l, half_w = shape.length_m / 2 - less_m, shape.width_m / 2 - less_m
    corners = (half_l, half_w), (-half_l, half_w), (-half_l, -half_w), (half_l, -half_w)
    turned = (_turned(x, y, pose[-1]) for x, y in corners)
    return shapely.Polygon([(pose[0] + x, pose[1] + y) for x, y in turned])


def _turned(x: float, y: float, yaw_rad: float) -> tuple[float, float]:
    """A point turned about the origin."""
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    return cos * x - sin * y, sin * x + cos * y
