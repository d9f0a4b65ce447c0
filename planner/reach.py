"""Convex polygons of where the swing foot may land, and the half planes that bound them.

Points are x_m, y_m in the support foot's frame, y outward positive; vertices go counter-clockwise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Point = tuple[float, float]
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
