"""Boxes that stand side by side as one solid: no faces where they touch.

Where two boxes touch, the edges of their faces would flicker through the tops.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class Mesh(NamedTuple):
    """Triangles: vertices_m (V, 3), faces (F, 3), counter-clockwise as seen from outside."""

    vertices_m: FloatArray
    faces: NDArray[np.int64]


def solid(boxes: FloatArray, *, base_m: float, rise_m: float, cell_m: float) -> Mesh:
    """Boxes (n, 5) of `maps.terraces` as they are seen from above, each `rise_m` above its height.

    They stand on `base_m`, and on whole cells of the side `cell_m`.
    """
    edges = np.round(
        np.stack([boxes[:, :2] - boxes[:, 2:4], boxes[:, :2] + boxes[:, 2:4]], axis=1) / cell_m
    ).astype(int)
    tops_m = boxes[:, 4] + rise_m
    first = edges[:, 0].min(axis=0) - 1
    cols, rows = edges[:, 1].max(axis=0) + 1 - first
    top_m = np.full((rows, cols), base_m)
    for ((x0, y0), (x1, y1)), reach_m in zip(edges - first, tops_m, strict=True):
        top_m[y0:y1, x0:x1] = reach_m
    quads = np.concatenate(
        [_lids(edges, tops_m, cell_m), _walls(top_m, first, cell_m), _fronts(top_m, first, cell_m)]
    )
    corner = 4 * np.arange(len(quads))[:, None, None]
    faces = (corner + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    return Mesh(quads.reshape(-1, 3), faces)


def _lids(edges: NDArray[np.int64], tops_m: FloatArray, cell_m: float) -> FloatArray:
    """The tops, (n, 4, 3)."""
    (x0, y0), (x1, y1) = cell_m * edges.transpose(1, 2, 0)
    xs, ys = np.stack([x0, x1, x1, x0], axis=1), np.stack([y0, y0, y1, y1], axis=1)
    return np.stack([xs, ys, np.repeat(tops_m[:, None], 4, axis=1)], axis=2)


def _walls(top_m: FloatArray, first: NDArray[np.int64], cell_m: float) -> FloatArray:
    """The faces that look along x, (n, 4, 3): between each cell and the next in its row."""
    runs = _runs(top_m[:, :-1], top_m[:, 1:])
    x, y0, y1 = ((runs[:, :3] + np.array([1, 0, 0]) + first[[0, 1, 1]]) * cell_m).T
    return _upright(np.stack([x, y0], axis=1), np.stack([x, y1], axis=1), runs[:, 3], runs[:, 4])


def _fronts(top_m: FloatArray, first: NDArray[np.int64], cell_m: float) -> FloatArray:
    """The faces that look along y, (n, 4, 3): between each cell and the next in its column."""
    runs = _runs(top_m.T[:, :-1], top_m.T[:, 1:])
    y, x0, x1 = ((runs[:, :3] + np.array([1, 0, 0]) + first[[1, 0, 0]]) * cell_m).T
    return _upright(np.stack([x1, y], axis=1), np.stack([x0, y], axis=1), runs[:, 3], runs[:, 4])


def _runs(near_m: FloatArray, far_m: FloatArray) -> FloatArray:
    """Where two neighbours differ in height: column, first row, row after the last, both heights.

    Neighbours one below the other with the same two heights make one run; (n, 5).
    """
    found = [np.zeros((0, 5))]
    for col in np.flatnonzero((near_m != far_m).any(axis=0)):
        pair = np.stack([near_m[:, col], far_m[:, col]], axis=1)
        starts = np.flatnonzero(np.append(True, (pair[1:] != pair[:-1]).any(axis=1)))
        ends = np.append(starts[1:], len(pair))
        is_face = pair[starts, 0] != pair[starts, 1]
        runs = np.column_stack([np.full(len(starts), col), starts, ends, pair[starts]])
        found.append(runs[is_face])
    return np.concatenate(found)


def _upright(
    begin: FloatArray, end: FloatArray, near_m: FloatArray, far_m: FloatArray
) -> FloatArray:
    """Faces between points (n, 2) that look to where it is lower: ahead if near is higher."""
    low, high = np.minimum(near_m, far_m)[:, None], np.maximum(near_m, far_m)[:, None]
    ahead = (near_m > far_m)[:, None]
    left, right = np.where(ahead, begin, end), np.where(ahead, end, begin)
    return np.stack(
        [
            np.hstack([left, low]),
            np.hstack([right, low]),
            np.hstack([right, high]),
            np.hstack([left, high]),
        ],
        axis=1,
    )
