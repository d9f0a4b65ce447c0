"""Independent check of a plan by exact polygons (shapely), sharing no geometry with the search."""

from __future__ import annotations

import math

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import affinity

from maps.grid import OccupancyGrid
from planner.plan import FootstepPlan
from planner.robot_model import Side, StepModel

# Independent check of a plan's heights by polygons (shapely), for `verify.py`.

FloatArray = NDArray[np.float64]
_TOLERANCE_M = 1e-6


class Ground:
    """The floor of one map as squares of equal height; blocked cells are no floor."""

    def __init__(self, grid: OccupancyGrid, unknown_is_free: bool) -> None:
        self._grid = grid
        self._free = ~grid.blocked(unknown_is_free)

    def step(
        self, support: FloatArray, pose: FloatArray, swing: Side, model: StepModel
    ) -> list[str]:
        """What is wrong with the heights of a step from a support foot (4,) to a pose (4,)."""
        if self._grid.elevation_m is None:
            return [] if pose[2] == 0.0 else [f"z {pose[2]} is not 0 on a flat floor"]
        wrong = []
        heights = self._below(_sole(pose, model, model.level_margin_m))
        near = self._below(_sole(pose, model, model.level_margin_m + 2 * _TOLERANCE_M))
        if len(heights) == 0 or np.ptp(heights) > model.level_m + _TOLERANCE_M:
            wrong.append(f"the ground at {pose[0]:.3f}, {pose[1]:.3f} is not level: {heights}")
        elif not heights.max() - _TOLERANCE_M <= pose[2] <= near.max() + _TOLERANCE_M:
            wrong.append(f"z {pose[2]} is not the height of the ground, {heights.max()}")
        rise_m = pose[2] - support[2]
        low_m, high_m = model.limits.z_m
        if not low_m - _TOLERANCE_M <= rise_m <= high_m + _TOLERANCE_M:
            wrong.append(f"rise {rise_m:.4f} is outside {low_m}..{high_m}")
        highest_m = max(pose[2], support[2]) + model.swing_clear_m
        for way in _ways(support, pose, swing, model):
            passed = self._below(way)
            if len(passed) and passed.max() > highest_m + _TOLERANCE_M:
                wrong.append(f"the foot swings over ground at z {passed.max():.3f}")
        return wrong

    def _below(self, area_world: shapely.Polygon) -> FloatArray:
        """Heights (n,) of the free cells that an area overlaps."""
        x0, y0, yaw_rad = self._grid.origin
        moved = affinity.translate(area_world, -x0, -y0)
        area = affinity.rotate(moved, -yaw_rad, origin=(0, 0), use_radians=True)
        size_m = self._grid.resolution_m
        low_x, low_y, high_x, high_y = (max(0, int(v // size_m)) for v in area.bounds)
        window = slice(low_y, high_y + 1), slice(low_x, high_x + 1)
        assert self._grid.elevation_m is not None
        free, heights = self._free[window], self._grid.elevation_m[window]
        if not free.size:
            return np.zeros(0)
        # Neighbours in a row that are as high as each other make one rectangle.
        begins = np.ones(free.shape, bool)
        begins[:, 1:] = (free[:, 1:] != free[:, :-1]) | (heights[:, 1:] != heights[:, :-1])
        first = np.flatnonzero(begins)
        cells = np.diff(first, append=free.size)
        row, col = np.divmod(first, free.shape[1])
        left, low = (col + low_x) * size_m, (row + low_y) * size_m
        rectangles = shapely.box(left, low, left + cells * size_m, low + size_m)
        below = free.ravel()[first] & shapely.intersects(rectangles, area)
        return np.asarray(heights.ravel()[first][below], float)


def _sole(pose: FloatArray, model: StepModel, margin_m: float) -> shapely.Polygon:
    """The box of a foot with a margin, a little smaller than it is."""
    half_l = model.foot.length_m / 2 + margin_m - _TOLERANCE_M
    half_w = model.foot.width_m / 2 + margin_m - _TOLERANCE_M
    box = shapely.box(-half_l, -half_w, half_l, half_w)
    turned = affinity.rotate(box, pose[3], origin=(0, 0), use_radians=True)
    return affinity.translate(turned, pose[0], pose[1])


def _ways(
    support: FloatArray, pose: FloatArray, swing: Side, model: StepModel
) -> list[shapely.Polygon]:
    """Where the soles pass: from beside the support foot to the pose, and on to beside that."""
    out_m = model.stance_width_m * (1.0 if swing == Side.LEFT else -1.0)
    beside_support = _beside(support, out_m)
    beside_pose = _beside(pose, -out_m)
    ways = []
    for start, end, yaw_rad in (
        (beside_support, pose[:2], pose[3]),
        (support[:2], beside_pose, support[3]),
    ):
        length_m = math.dist(start, end)
        if length_m < 1e-5:
            continue
        turn = yaw_rad - math.atan2(end[1] - start[1], end[0] - start[0])
        width_m = abs(math.sin(turn)) * model.foot.length_m
        width_m += abs(math.cos(turn)) * model.foot.width_m
        line = shapely.LineString([start, end])
        # Flat ends: the strip stops at the points.
        ways.append(line.buffer(width_m / 2 - _TOLERANCE_M, cap_style="flat"))
    return ways


def _beside(foot: FloatArray, left_m: float) -> FloatArray:
    """The point so far to the left of a foot."""
    return np.array([foot[0] - left_m * math.sin(foot[3]), foot[1] + left_m * math.cos(foot[3])])


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
    """What is wrong with a plan that was found, one line each; empty if it is right.

    Sides alternate; each step is within the limits; consecutive feet keep the gap; the boxes of
    feet (at every step) and body (at every pair of feet and over every single foot), margins
    included, lie on the map and off blocked cells; feet are on the highest ground below them,
    which is level; rise and fall and the ground that a foot swings over are within the limits; the
    last two feet are those of the goal pose, exactly. stood_freely: the plan began at a pair pose,
    so the margins count in the first step too; false where it began from feet as they stood.
    goal_reach: metres from the goal and radians off its heading at which both feet may stand, side
    by side, in the end.
    """
    if not plan.found:
        return [f"status is {plan.status}, not found"]
    if not len(plan):
        there = _feet_are_at_goal(plan, model, goal_reach)
        return [] if there else ["empty, but the feet are not at the goal"]
    checker = _Checker(grid, unknown_is_free)
    ground = Ground(grid, unknown_is_free)
    wrong: list[str] = []
    support = plan.start_feet_world[Side(int(plan.side[0])).other]
    for i, (side, pose) in enumerate(zip(plan.side, plan.pose_world, strict=True)):
        swing = Side(int(side))
        if i and swing == plan.side[i - 1]:
            wrong.append(f"step {i}: {swing.name.lower()} foot twice in a row")
        margin_m = model.body_margin_m if i or stood_freely else 0.0
        wrong += [f"step {i}: {what}" for what in _step_wrongs(support, pose, swing, model)]
        wrong += [
            f"step {i}: {what}" for what in checker.step(support, pose, swing, model, margin_m)
        ]
        wrong += [f"step {i}: {what}" for what in ground.step(support, pose, swing, model)]
        support = pose
    if not _feet_are_at_goal(plan, model, goal_reach):
        wrong.append("the last two feet are not the goal's")
    return wrong


def _feet_are_at_goal(
    plan: FootstepPlan, model: StepModel, goal_reach: tuple[float, float]
) -> bool:
    """Whether the feet end within a nanometre of the goal feet, worked out here once more.

    Of the goal's own, or of those of the pose where they are if that is near enough to the goal.
    """
    feet = dict(zip((0, 1), plan.start_feet_world, strict=True))
    feet.update({int(s): p for s, p in zip(plan.side[-2:], plan.pose_world[-2:], strict=True)})
    if len(plan) == 1:
        return False
    x_m, y_m, yaw_rad = plan.goal
    mid_m = (feet[0][:2] + feet[1][:2]) / 2
    off_rad = abs(math.remainder(feet[0][3] - yaw_rad, 2 * math.pi))
    if math.dist(mid_m, (x_m, y_m)) > goal_reach[0] + 1e-8 or off_rad > goal_reach[1] + 1e-8:
        return False
    if any(goal_reach):
        x_m, y_m, yaw_rad = mid_m[0], mid_m[1], feet[0][3]
    reach = 1e-9 if len(plan) else 2e-6
    for side, sign in ((0, 1), (1, -1)):
        half = sign * model.stance_width_m / 2
        foot = x_m - half * math.sin(yaw_rad), y_m + half * math.cos(yaw_rad)
        turn = math.remainder(feet[side][3] - yaw_rad, 2 * math.pi)
        if math.dist(foot, feet[side][:2]) > reach or abs(turn) > reach:
            return False
    return True


def _step_wrongs(support: FloatArray, pose: FloatArray, swing: Side, model: StepModel) -> list[str]:
    """Limits and overlap of one step."""
    wrong = []
    if not np.all(np.isfinite(pose)):
        wrong.append(f"pose {pose} is not finite")
    out = 1.0 if swing == Side.LEFT else -1.0
    ahead_m, aside_m = _turned(pose[0] - support[0], pose[1] - support[1], -support[3])
    values = ahead_m, out * aside_m, out * math.remainder(pose[3] - support[3], 2 * math.pi)
    limits = model.limits
    for name, value, (low, high) in zip(
        ("x", "y", "yaw"), values, (limits.x_m, limits.y_m, limits.yaw_rad), strict=True
    ):
        if not low - 1e-6 <= value <= high + 1e-6:
            wrong.append(f"{name} {value:.4f} is outside {low}..{high}")
    if len(limits.reach_m):
        beyond_m = shapely.distance(shapely.Polygon(limits.reach_m), shapely.Point(values[:2]))
        if not beyond_m <= 1e-6:
            at = f"x {values[0]:.4f}, y {values[1]:.4f}"
            wrong.append(f"{at} is {beyond_m:.4f} m outside the polygon {limits.reach_m}")
    apart_m = shapely.distance(
        _box(support, model.foot.length_m, model.foot.width_m),
        _box(pose, model.foot.length_m, model.foot.width_m),
    )
    if apart_m < model.foot_gap_m - 1e-9:
        wrong.append(f"the feet are {apart_m:.4f} m apart, less than {model.foot_gap_m}")
    return wrong


def _box(pose: FloatArray | tuple[float, ...], length_m: float, width_m: float) -> shapely.Polygon:
    """Rectangle of a size centred on a pose whose first two entries are x, y and last is yaw."""
    half_l, half_w = length_m / 2, width_m / 2
    corners = (half_l, half_w), (-half_l, half_w), (-half_l, -half_w), (half_l, -half_w)
    turned = (_turned(x, y, pose[-1]) for x, y in corners)
    return shapely.Polygon([(pose[0] + x, pose[1] + y) for x, y in turned])


def _turned(x: float, y: float, yaw_rad: float) -> tuple[float, float]:
    """A point turned about the origin."""
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    return cos * x - sin * y, sin * x + cos * y


class _Checker:
    """Polygons against the blocked cells of one map."""

    def __init__(self, grid: OccupancyGrid, unknown_is_free: bool) -> None:
        self._blocked = grid.blocked(unknown_is_free)
        self._size_m = grid.resolution_m
        self._origin = grid.origin

    def step(
        self,
        support: FloatArray,
        pose: FloatArray,
        swing: Side,
        model: StepModel,
        pair_margin_m: float,
    ) -> list[str]:
        """What the boxes of one step hit."""
        inward = model.stance_width_m / 2 * (-1.0 if swing == Side.LEFT else 1.0)
        turn = math.remainder(pose[3] - support[3], 2 * math.pi)
        pair = np.array([*(support[:2] + pose[:2]) / 2, support[3] + turn / 2])
        single = np.array(
            [
                pose[0] - inward * math.sin(pose[3]),
                pose[1] + inward * math.cos(pose[3]),
                pose[3],
            ]
        )
        foot, body = model.foot, model.body
        boxes = (
            ("the foot", pose, foot.length_m, foot.width_m, model.foot_margin_m),
            ("the body on both feet", pair, body.length_m, body.width_m, pair_margin_m),
            ("the body on one foot", single, body.length_m, body.width_m, model.body_margin_m),
        )
        return [
            f"{name} hits something at {at[0]:.3f}, {at[1]:.3f}"
            for name, at, length_m, width_m, margin_m in boxes
            if self.hits(at, length_m + 2 * margin_m, width_m + 2 * margin_m)
        ]

    def hits(self, pose_world: FloatArray, length_m: float, width_m: float) -> bool:
        """Whether a box overlaps a blocked cell or leaves the map."""
        x0_m, y0_m, yaw_rad = self._origin
        at = (
            *_turned(pose_world[0] - x0_m, pose_world[1] - y0_m, -yaw_rad),
            pose_world[-1] - yaw_rad,
        )
        box = _box(at, length_m - 2 * _OVERLAP_TOLERANCE_M, width_m - 2 * _OVERLAP_TOLERANCE_M)
        low_x, low_y, high_x, high_y = box.bounds
        rows, cols = self._blocked.shape
        if min(low_x, low_y) < 0 or high_x > cols * self._size_m or high_y > rows * self._size_m:
            return True
        x0, y0, x1, y1 = (int(v // self._size_m) for v in box.bounds)
        row, col = np.nonzero(self._blocked[y0 : y1 + 1, x0 : x1 + 1])
        if not len(row):
            return False
        left, low = (col + x0) * self._size_m, (row + y0) * self._size_m
        squares = shapely.box(left, low, left + self._size_m, low + self._size_m)
        return bool(np.any(shapely.intersects(squares, box)))
