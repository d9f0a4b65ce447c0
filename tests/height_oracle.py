"""Heights for the slow oracle: levels as unions of squares, and which of them a polygon meets."""

from __future__ import annotations

import math

import numpy as np
import shapely


class HeightOracle:
    """The floor of one map; polygons and poses are in the world."""

    def __init__(self, grid, model):
        self.model = model
        self._levels = []
        free = ~grid.blocked()
        for height in np.unique(grid.elevation_m[free]):
            row, col = np.nonzero(free & (grid.elevation_m == height))
            corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) + np.stack([col, row], 1)[:, None]
            corners_world = grid.grid_to_world(corners * grid.resolution_m)
            area = shapely.union_all(shapely.polygons(corners_world), grid_size=1e-10)
            shapely.prepare(area)
            self._levels.append((height, area))

    def _met(self, polygon):
        return [height for height, area in self._levels if area.intersects(polygon)]

    def under(self, x, y, yaw):
        """Height under a foot; None where the ground is not level or there is none."""
        foot, margin = self.model.foot, self.model.level_margin_m - 1e-7
        ahead = np.array([math.cos(yaw), math.sin(yaw)]) * (foot.length_m / 2 + margin)
        aside = np.array([-math.sin(yaw), math.cos(yaw)]) * (foot.width_m / 2 + margin)
        centre = np.array([x, y])
        ends = centre + ahead + aside, centre + ahead - aside, centre - ahead - aside
        met = self._met(shapely.Polygon([*ends, centre - ahead + aside]))
        if not met or max(met) - min(met) > self.model.level_m + 1e-9:
            return None
        return max(met)

    def can_step(self, support, support_z, swing, swing_z, side):
        """Whether the feet x, y, yaw and their heights make a step; side: of the swing foot."""
        low, high = self.model.limits.z_m
        if not low - 1e-9 <= swing_z - support_z <= high + 1e-9:
            return False
        left = self.model.stance_width_m * (1 if side == 0 else -1)
        top = max(support_z, swing_z) + self.model.swing_clear_m + 1e-9
        ways = (
            (_left_of(support, left), swing[:2], swing[2]),
            (support[:2], _left_of(swing, -left), support[2]),
        )
        return all(self._highest(*way) <= top for way in ways)

    def _highest(self, start, end, yaw):
        start, end = np.array(start), np.array(end)
        length = np.linalg.norm(end - start)
        if length < 1e-6:
            return -math.inf
        along = (end - start) / length
        across = np.array([-along[1], along[0]])
        foot = self.model.foot
        corners = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) / 2
        sole = corners * (foot.length_m, foot.width_m)
        turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
        half = max(sole @ turn @ across) - 1e-7
        side = across * half
        met = self._met(shapely.Polygon([start + side, start - side, end - side, end + side]))
        return max(met, default=-math.inf)


def _left_of(foot, distance_m):
    x, y, yaw = foot
    return x - distance_m * math.sin(yaw), y + distance_m * math.cos(yaw)
