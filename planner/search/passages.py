"""The narrowest place of the widest way from start to goal, by the distance field alone.

The widest way is the one whose least clearance is greatest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from planner.collision import Terrain
from planner.compiled import njit_no_refcount
from planner.lattice.lattice import Floats
from planner.plan import NarrowPlace
from planner.robot_model import StepModel
from planner.time_limit import check_time

Cells = NDArray[np.int64]

_LEVELS = 1 << 12  # that clearances are told apart by, up to that of the narrower end
_FLOOD_S = 2e-8  # that a cell takes, about, where the field is flooded
_ANGLES, _RAY_M, _RAY_STEP_M = 64, 3.0, 1e-3
_ANGLES_RAD = np.arange(2 * _ANGLES) * (math.pi / _ANGLES)  # all around
_UNSEEN = -2  # a cell that no list of a flood holds


@dataclass(frozen=True, kw_only=True)
class Passage:
    """The narrowest place of a way, in the grid frame.

    ends_m (2, 2): the points x, y where its width meets obstacles. before, behind (n, 2): rows and
    columns of the way on either side, from the place outward.
    """

    ends_m: Floats
    before: Cells
    behind: Cells

    @property
    def width_m(self) -> float:
        """Distance of the obstacles on both sides."""
        return math.dist(self.ends_m[0], self.ends_m[1])


def narrowest_passage(
    clearance_m: NDArray[np.float32], size_m: float, start: tuple[int, int], goal: tuple[int, int]
) -> Passage | None:
    """The narrowest place of the widest way between two cells (row, col) of a field (H, W).

    None where no way leads, or where an end is as narrow as any place between.
    """
    check_time(_FLOOD_S * clearance_m.size)
    level_m = float(min(clearance_m[start], clearance_m[goal])) / _LEVELS
    level = _widest_level(clearance_m, level_m, start, goal) if level_m > 0 else -1
    if level < 0:
        return None
    low, high = level * level_m, (level + 1) * level_m
    way = _widest_way(clearance_m, low, high, start, goal)
    is_narrow = clearance_m[way[:, 0], way[:, 1]] <= high
    first = int(np.argmax(is_narrow))
    last = first + int(np.argmin(np.append(is_narrow[first:], False))) - 1
    at = (first + last) // 2
    row, col = (int(v) for v in way[at])
    ends_m = _shortest_chord(clearance_m, size_m, row, col)
    if ends_m is None:
        return None
    return Passage(ends_m=ends_m, before=way[:at][::-1], behind=way[at + 1 :])


def narrow_place(
    terrain: Terrain, model: StepModel, start: tuple[int, int], goal: tuple[int, int]
) -> NarrowPlace | None:
    """That place, x and y in the grid frame, where the robot cannot walk through facing ahead."""
    passage = narrowest_passage(terrain.clearance_m, terrain.resolution_m, start, goal)
    # What a box touches blocks it.
    if passage is None or passage.width_m > needed_m(model) + 2 * _RAY_STEP_M:
        return None
    x_m, y_m = (float(v) for v in passage.ends_m.mean(axis=0))
    width_m = round(passage.width_m, 2)
    return NarrowPlace(x=x_m, y=y_m, width_m=width_m, needed_m=round(needed_m(model), 3))


def needed_m(model: StepModel) -> float:
    """Width of a passage through which the robot can walk facing ahead."""
    return model.body.width_m + 2 * model.body_margin_m


def components(clearance_m: NDArray[np.float32], radius_m: float) -> NDArray[np.int32]:
    """Numbers (H, W), from 1, of the parts that ways of more than a clearance connect; 0: none."""
    _, label = cv2.connectedComponents((clearance_m > radius_m).astype(np.uint8), connectivity=4)
    return np.asarray(label, np.int32)


def _widest_level(
    clearance_m: NDArray[np.float32], level_m: float, start: tuple[int, int], goal: tuple[int, int]
) -> int:
    """The greatest k of which some way between two cells has more than k level_m; -1 for none.

    Ways keep off the field's outermost cells. More than _LEVELS - 1 counts as that.
    """
    cols = clearance_m.shape[1]
    level = np.full(clearance_m.shape, -1, np.int16)
    steps = np.minimum(clearance_m[1:-1, 1:-1] / np.float32(level_m), _LEVELS)
    level[1:-1, 1:-1] = np.maximum(np.ceil(steps) - 1, -1)
    if min(level[start], level[goal]) < 0:
        return -1
    first, last = start[0] * cols + start[1], goal[0] * cols + goal[1]
    following = np.full(clearance_m.size, _UNSEEN, np.int32)
    heads = np.full(_LEVELS, -1, np.int32)
    return int(_flood_levels(level.reshape(-1), cols, first, last, following, heads))


@njit_no_refcount
def _flood_levels(
    level: NDArray[np.int16],
    cols: int,
    first: int,
    last: int,
    following: NDArray[np.int32],
    heads: NDArray[np.int32],
) -> int:
    """The level at which a flood that goes on at the highest one that it can comes to a cell.

    It is -1 where none leads there. `heads` and `following` hold a list of cells for each level.
    """
    now = int(level[first])
    heads[now], following[first] = first, -1
    while now >= 0:
        cell: int = np.int64(heads[now])  # type: ignore[assignment]
        if cell < 0:
            now -= 1
            continue
        if cell == last:
            break
        heads[now] = following[cell]
        for k in range(4):
            to = cell + (1, -1, cols, -cols)[k]
            if following[to] == _UNSEEN and level[to] >= 0:
                at = min(int(level[to]), now)
                following[to] = heads[at]
                heads[at] = to
    return now


def _widest_way(
    clearance_m: NDArray[np.float32],
    low_m: float,
    high_m: float,
    start: tuple[int, int],
    goal: tuple[int, int],
) -> Cells:
    """Cells (n, 2) of a way of more than low_m, as few of them as can be with no more than high_m.

    There must be such a way.
    """
    rows, cols = clearance_m.shape
    parent = np.full(rows * cols, -1, np.int32)
    queues = np.empty((2, rows * cols + 1), np.int32)
    first, last = start[0] * cols + start[1], goal[0] * cols + goal[1]
    _flood_widest(clearance_m.reshape(-1), cols, low_m, high_m, (first, last), parent, queues)
    way = [last]
    while way[-1] != first:
        way.append(int(parent[way[-1]]))
    return np.column_stack(np.divmod(np.array(way[::-1], np.int64), cols))


@njit_no_refcount
def _flood_widest(
    clearance_m: NDArray[np.float32],
    cols: int,
    low_m: float,
    high_m: float,
    ends: tuple[int, int],
    parent: NDArray[np.int32],
    queues: NDArray[np.int32],
) -> None:
    """Fills in the parents on a way between ends by 0-1 breadth-first search: narrow cells cost 1.

    Cells of one cost in the order in which they were come to, lest the way winds through all of a
    hall. The field's outermost cells count as no ground to go on.
    """
    rows = len(clearance_m) // cols
    first, last = ends
    parent[first] = first
    queues[0, 0] = first
    now, size = 0, 1
    while size > 0 and parent[last] < 0:
        at = later = 0
        while at < size and parent[last] < 0:
            cell: int = np.int64(queues[now, at])  # type: ignore[assignment]
            at += 1
            row, col = cell // cols, cell % cols
            if row == 0 or col == 0 or row == rows - 1 or col == cols - 1:
                continue
            for k in range(4):
                to = cell + (1, -1, cols, -cols)[k]
                if parent[to] >= 0 or clearance_m[to] <= low_m:
                    continue
                parent[to] = cell
                if clearance_m[to] > high_m:
                    queues[now, size] = to
                    size += 1
                else:
                    queues[1 - now, later] = to
                    later += 1
        now, size = 1 - now, later


def _shortest_chord(
    clearance_m: NDArray[np.float32], size_m: float, row: int, col: int
) -> Floats | None:
    """Ends (2, 2) x, y of the shortest line through a cell from obstacle to obstacle."""
    ray_m = min(4 * float(clearance_m[row, col]), _RAY_M)
    while True:
        length_m = _ray_lengths_m(clearance_m, size_m, row, col, ray_m)
        both_m = length_m[:_ANGLES] + length_m[_ANGLES:]
        best = int(np.argmin(both_m))
        # A line of which one ray did not end is longer.
        if both_m[best] <= ray_m or ray_m >= _RAY_M:
            break
        ray_m = min(2 * ray_m, _RAY_M)
    if not np.isfinite(both_m[best]):
        return None
    x, y = (col + 0.5) * size_m, (row + 0.5) * size_m
    ends = [best, best + _ANGLES]
    return np.array([x, y]) + length_m[ends, None] * np.column_stack(
        [np.cos(_ANGLES_RAD[ends]), np.sin(_ANGLES_RAD[ends])]
    )


def _ray_lengths_m(
    clearance_m: NDArray[np.float32], size_m: float, row: int, col: int, most_m: float
) -> Floats:
    """Lengths (2 _ANGLES,) of rays all around from a cell to obstacles, inf beyond a length."""
    x, y = (col + 0.5) * size_m, (row + 0.5) * size_m
    ray = np.arange(0.0, most_m, _RAY_STEP_M)
    cols = np.floor((x + np.cos(_ANGLES_RAD)[:, None] * ray) / size_m).astype(int)
    rows = np.floor((y + np.sin(_ANGLES_RAD)[:, None] * ray) / size_m).astype(int)
    height, width = clearance_m.shape
    inside = (rows >= 0) & (rows < height) & (cols >= 0) & (cols < width)
    hit = ~inside | (clearance_m[rows.clip(0, height - 1), cols.clip(0, width - 1)] <= 0.0)
    return np.where(hit.any(axis=1), ray[hit.argmax(axis=1)], np.inf)


def close_passage(clearance_m: NDArray[np.float32], size_m: float, passage: Passage) -> None:
    """Takes the cells on the line across a place out of the field."""
    corners = np.rint((passage.ends_m / size_m - 0.5) * 256).astype(int)
    shut = np.zeros(clearance_m.shape, np.uint8)
    # So wide that no way slips through between two cells.
    cv2.line(shut, corners[0].tolist(), corners[1].tolist(), 1, thickness=3, shift=8)
    clearance_m[shut > 0] = 0.0
