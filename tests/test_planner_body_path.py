"""The body's path around obstacles, against a slow search over the same cells."""

from __future__ import annotations

import heapq
import math

import numpy as np
import pytest

from planner.body_path import body_path
from planner.collision import terrain_of
from planner.plan import to_frame
from planner.planner import Planner
from tests.planner_floor import LATTICE, walled
from tests.planner_oracle import small_model

GOAL = (3.0, 0.8, 0.3)
# 4 x 2.4 m with a wall across it at x = 2 that leaves a gap at large y.
GAP = walled(24, 40, [(0, 20, 17, 21)])


def least_m(way: np.ndarray, cell_m: float, radius_m: float) -> float:
    """Length of the least path over cells whose middles have that clearance, by Dijkstra."""
    field = terrain_of(GAP, False).clearance_m
    moves = [
        (a, b)
        for a in range(-2, 3)
        for b in range(-2, 3)
        if math.gcd(a, b) == 1 and (a, b) != (0, 0)
    ]
    cos, sin = math.cos(GOAL[2]), math.sin(GOAL[2])

    def is_free(cell: tuple[int, int]) -> bool:
        x, y = cell[0] * cell_m, cell[1] * cell_m
        x, y = GOAL[0] + cos * x - sin * y, GOAL[1] + sin * x + cos * y
        row, col = int(y // 0.1), int(x // 0.1)
        return 0 <= row < 24 and 0 <= col < 40 and float(field[row, col]) > radius_m

    first = to_frame(np.array([[*way[0], 0.0]]), GOAL)[0, :2] / cell_m
    start = (round(first[0]), round(first[1]))
    best, queue = {start: 0.0}, [(0.0, start)]
    while queue:
        cost, cell = heapq.heappop(queue)
        if cell == (0, 0):
            return cost
        if cost > best[cell]:
            continue
        for a, b in moves:
            to, there = (cell[0] + a, cell[1] + b), cost + math.hypot(a, b) * cell_m
            if is_free(to) and there < best.get(to, math.inf):
                best[to] = there
                heapq.heappush(queue, (there, to))
    return math.inf


def test_it_leads_through_the_gap_and_is_as_short_as_can_be():
    model = small_model()
    way = body_path(Planner(GAP, model, LATTICE), (0.8, 0.6, 1.0), GOAL)
    assert math.dist(way[0], (0.8, 0.6)) <= model.cell_m
    assert way[-1] == pytest.approx(GOAL[:2], abs=1e-9)
    beside = way[np.abs(way[:, 0] - 2.05) < 0.06]
    assert len(beside)
    assert beside[:, 1].min() > 1.7
    length_m = float(np.hypot(*np.diff(way, axis=0).T).sum())
    # Whoever may pass nearer to the corner has the shorter way: between a thin and a wide body.
    assert least_m(way, model.cell_m, 0.0) <= length_m + 1e-9
    assert length_m <= least_m(way, model.cell_m, 0.3) + 1e-9


def test_it_is_straight_on_an_open_floor():
    planner = Planner(walled(24, 40), small_model(), LATTICE)
    way = body_path(planner, (0.5, 1.0, 0.0), (3.5, 1.0, 0.0))
    assert np.ptp(way[:, 1]) < 1e-9
    assert np.all(np.diff(way[:, 0]) > 0)


def test_there_is_none_behind_a_wall_or_off_the_map():
    shut = Planner(walled(24, 40, [(0, 20, 24, 21)]), small_model(), LATTICE)
    assert body_path(shut, (0.8, 0.6, 0.0), GOAL).shape == (0, 2)
    assert body_path(shut, (99.0, 0.6, 0.0), GOAL).shape == (0, 2)
