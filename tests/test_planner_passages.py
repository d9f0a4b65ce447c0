"""Narrow passages: the place is named with its width, and what they shut is proven shut."""

from __future__ import annotations

import json

import numpy as np
import pytest

from planner.collision import terrain_of
from planner.options import PlannerOptions
from planner.plan import FootstepPlan, NarrowPlace, PlanStatus
from planner.planner import Planner, plan_footsteps
from planner.search.ara_star import AraStar
from planner.search.passages import narrow_place, needed_m
from planner.search.problem import backward_task
from planner.search.shut_passages import is_shut
from planner.verify import violations
from tests.planner_floor import LATTICE, fine_model, request_of, walled
from tests.planner_oracle import small_model

ROWS, COLS, SIZE_M = 60, 100, 0.05


def hall(*doors: tuple[int, int], thick=1, origin=(0.0, 0.0, 0.0)):
    """A floor of 3 m by 5 m with a wall across it that has doors from row to row."""
    cells = np.ones(ROWS, bool)
    for first, end in doors:
        cells[first:end] = False
    rows = np.flatnonzero(cells)
    boxes = tuple((row, 50, row + 1, 50 + thick) for row in rows.tolist())
    return walled(ROWS, COLS, boxes, origin=origin, resolution_m=SIZE_M)


def place_in(grid, model=None):
    terrain = terrain_of(grid, unknown_is_free=False)
    return narrow_place(terrain, model or small_model(), (30, 10), (30, 90))


@pytest.mark.parametrize(("first", "end"), [(30, 35), (30, 36), (8, 13)])
@pytest.mark.parametrize("thick", [1, 6])
def test_the_place_is_the_door_and_its_width_is_that_of_its_cells(first, end, thick):
    place = place_in(hall((first, end), thick=thick))
    assert place is not None
    assert place.width_m == pytest.approx((end - first) * SIZE_M, abs=0.005)
    assert place.y == pytest.approx((first + end) / 2 * SIZE_M, abs=SIZE_M)
    assert 50 * SIZE_M <= place.x <= (50 + thick) * SIZE_M
    assert place.needed_m == pytest.approx(0.36)


def test_of_two_doors_the_wider_one_is_named_and_none_that_is_wide_enough():
    place = place_in(hall((10, 14), (40, 46)))
    assert place is not None
    assert place.width_m == pytest.approx(0.30, abs=0.005)
    assert place.y == pytest.approx(43 * SIZE_M, abs=SIZE_M)
    assert place_in(hall((10, 14), (40, 48))) is None  # 0.40 m is enough for 0.36
    assert place_in(hall()) is None  # no way at all: nothing that is merely narrow


def test_a_corridor_that_narrows_is_named_where_it_is_narrowest():
    boxes = [(0, 40 + 4 * k, 20 + k, 44 + 4 * k) for k in range(5)]
    boxes += [(40 - k, 40 + 4 * k, 60, 44 + 4 * k) for k in range(5)]
    place = place_in(
        walled(ROWS, COLS, tuple(boxes), resolution_m=SIZE_M), small_model(body_margin_m=0.2)
    )
    assert place is not None
    assert place.width_m == pytest.approx(0.60, abs=0.005)  # rows 24 to 36
    assert 56 * SIZE_M <= place.x <= 60 * SIZE_M


@pytest.mark.parametrize("name", ["ara", "adstar", "astar", "backward"])
def test_the_reason_and_the_document_name_the_place_in_the_world(name):
    origin = (-1.0, 2.0, 0.6)
    grid = hall((28, 33), origin=origin)
    start, goal = ((*grid.grid_to_world((x, 1.5)), 0.6) for x in (0.6, 4.4))
    plan = plan_footsteps(
        grid, fine_model(), start=start, goal=goal, options=PlannerOptions(name=name, refine=False)
    )
    assert plan.status is PlanStatus.NO_PATH
    place = plan.narrow_place
    assert place is not None
    assert (place.x, place.y) == pytest.approx(grid.grid_to_world((2.525, 1.525)), abs=0.05)
    assert f"{place.x:.2f},{place.y:.2f} is 0.25 m wide" in plan.reason
    document = json.loads(plan.to_json())["narrow_place"]
    assert NarrowPlace(**document) == place
    assert FootstepPlan.from_json(plan.to_json()).narrow_place == place


@pytest.mark.parametrize("cells", range(6, 12))
@pytest.mark.parametrize("thick", [1, 5])
def test_a_door_is_shut_only_if_the_full_search_finds_no_way(cells, thick):
    """A long body, which may get through sideways where it cannot walk ahead."""
    model = fine_model()
    grid = hall((30, 30 + cells), thick=thick)
    start, goal = (0.7, 1.5, 0.0), (4.3, 1.5, 0.0)
    request = request_of(grid, model, start, goal)
    shut = is_shut(request)
    plan = plan_footsteps(grid, model, start=start, goal=goal, options=LATTICE)
    assert plan.found == (not shut)
    if plan.found:
        assert violations(plan, grid, model) == []
    else:
        assert cells * SIZE_M <= needed_m(model) + model.cell_m + 1e-9


def boxed(row: int, side: int, *more: tuple[int, int, int, int]):
    """A floor of 3 m by 5 m with a door of 1 m in a wall, and a box with slits beside it."""
    boxes = [(0, 50, 20, 52), (40, 50, ROWS, 52), (row, 44, row + side, 58), *more]
    return walled(ROWS, COLS, boxes, resolution_m=SIZE_M)


@pytest.mark.parametrize("name", ["ara", "adstar"])
def test_a_box_in_a_door_with_slits_on_either_side_shuts_it_without_a_search(name):
    options = PlannerOptions(name=name, refine=False)
    grid, (start, goal) = boxed(23, 14), ((0.7, 1.5, 0.0), (4.3, 1.5, 0.0))
    planner = Planner(walled(ROWS, COLS, resolution_m=SIZE_M), small_model(), options)
    assert planner.plan(start=start, goal=goal).found
    planner.take_map(grid)
    plan = planner.plan(start=start, goal=goal)
    assert plan.status is PlanStatus.NO_PATH
    assert plan.narrow_place is not None
    assert plan.expansions < 20_000
    # The search that asks nobody comes to the same.
    request = request_of(grid, small_model(), start, goal)
    result = AraStar(request, LATTICE, 0.0).run(backward_task(request))
    assert result.status is PlanStatus.NO_PATH
    # With a slit that is wide enough there is a way.
    assert plan_footsteps(boxed(20, 11), small_model(), start=start, goal=goal).found


@pytest.mark.parametrize("seed", range(20))
def test_nothing_is_called_shut_that_a_search_gets_through(seed):
    rng = np.random.default_rng(seed)
    boxes = []
    for col in (40, 60):
        row = int(rng.integers(10, 40))
        width, thick = int(rng.integers(6, 10)), int(rng.integers(1, 4))
        boxes += [(0, col, row, col + thick), (row + width, col, ROWS, col + thick)]
    if seed % 2:  # a box in the last door, with slits beside it
        side, at = width - int(rng.integers(1, 6)), col + int(rng.integers(-4, 4))
        low = row + int(rng.integers(0, width - side + 1))
        boxes += [(low, at, low + side, at + 5)]
    grid, model = walled(ROWS, COLS, tuple(boxes), resolution_m=SIZE_M), fine_model()
    start, goal = (0.5, 1.5, rng.uniform(-3, 3)), (4.5, 1.5, rng.uniform(-3, 3))
    request = request_of(grid, model, start, goal)
    if is_shut(request):
        # By the exhausting search from the other end, which asks nobody.
        result = AraStar(request, LATTICE, 0.0).run(backward_task(request))
        assert result.status is PlanStatus.NO_PATH
