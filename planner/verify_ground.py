"""Independent check of a plan's heights by polygons (shapely), for `verify.py`."""

from __future__ import annotations

import math

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import affinity

from maps.grid import OccupancyGrid
from planner.robot_model import Side, StepModel

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
