"""Why there is no plan, as the page draws it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
import pytest
import viser

from app.navigation.live_navigator import Notice
from app.navigation.planner_process import Answer, World
from app.viewer.planner_marks import EXPANDED_RGB, PlannerMarks, SearchMarks, shades_of, shut_out
from app.viewer.server import open_server
from maps.grid import OccupancyGrid
from planner.collision import terrain_of
from planner.endpoints import what_obstructs
from planner.options import PlannerOptions
from planner.plan import FootstepPlan, NarrowPlace, feet_at
from planner.search.search_record import SearchRecord
from sim.robots import get_robot

MODEL = get_robot("jvrc1").step_model
# 4 by 3 m with a block in the middle.
CELLS = np.zeros((60, 80), np.uint8)
CELLS[25:35, 36:44] = 1
GRID = OccupancyGrid(cells=CELLS, resolution_m=0.05, origin=(5.0, -3.0, 0.7))
WORLD = World(grid=GRID, model=MODEL, options=PlannerOptions())


@pytest.fixture
def scene() -> Iterator[viser.SceneApi]:
    server = open_server(title="marks")
    yield server.scene
    server.stop()


@pytest.mark.parametrize("yaw_rad", [0.0, 0.7, 2.0])
def test_margins_are_where_no_pose_of_that_heading_is_free(yaw_rad):
    shut = shut_out(GRID, MODEL, yaw_rad, unknown_is_free=False)
    terrain = terrain_of(GRID, unknown_is_free=False)
    blocked = np.zeros(GRID.shape, bool)
    for row, col in np.ndindex(GRID.shape):
        x_m, y_m = GRID.cell_to_world((row, col))
        feet = feet_at((float(x_m), float(y_m), yaw_rad), MODEL.stance_width_m)
        blocked[row, col] = bool(what_obstructs(GRID, terrain, MODEL, feet))
    assert not shut[CELLS > 0].any()
    shut |= CELLS > 0
    # The same but for the cells at the edge of it.
    grown = cv2.dilate(shut.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    shrunk = cv2.erode(shut.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    assert (shrunk <= blocked).all()
    assert (blocked <= grown).all()
    assert (shut != blocked).sum() < 0.1 * blocked.sum()


def test_a_long_body_shuts_out_more_beside_it_than_ahead():
    # Facing along the block's short side the feet and arms reach less far ahead than aside.
    column = GRID.shape[1] // 2
    along = shut_out(GRID, MODEL, GRID.origin[2], unknown_is_free=False)[:, column]
    across = shut_out(GRID, MODEL, GRID.origin[2] + np.pi / 2, unknown_is_free=False)[:, column]
    needs_m = MODEL.body.width_m - MODEL.body.length_m
    assert (along.sum() > across.sum()) == (needs_m > 0)


def test_unknown_ground_counts_unless_it_is_free():
    cells = np.zeros((60, 80), np.uint8)
    cells[30, 40] = 2
    grid = OccupancyGrid(cells=cells, resolution_m=0.05)
    assert shut_out(grid, MODEL, 0.0, unknown_is_free=False)[30, 42]
    assert not shut_out(grid, MODEL, 0.0, unknown_is_free=True)[30, 42]


def shown(scene: viser.SceneApi) -> tuple[int, Any]:
    """How many rectangles of margins are to be seen, and the mark of the narrow place, if any."""
    sheet: Any = scene.get_handle_by_name("/margins")
    mark: Any = scene.get_handle_by_name("/narrow")
    return int((np.array(sheet.vertices)[:, 2] >= 0).sum()) // 4, mark if mark.visible else None


def test_what_is_drawn_goes_with_the_refusal(scene):
    marks = PlannerMarks(scene)
    marks.show(Notice(text="goal: off", refused=(6.0, -1.0, 0.0)), WORLD)
    rectangles, mark = shown(scene)
    assert rectangles > 4
    assert mark is None
    narrow = NarrowPlace(x=6.0, y=-2.0, width_m=0.5, needed_m=0.72)
    marks.show(Notice(text="no path", refused=(6.0, -1.0, 0.0), narrow_place=narrow), WORLD)
    rectangles, mark = shown(scene)
    assert rectangles == 0
    assert (*mark.position[:2], mark.radius) == (6.0, -2.0, 0.36)
    word: Any = scene.get_handle_by_name("/narrow/word")
    assert word.text == "0.50 m wide, 0.72 m needed"
    marks.show(None, WORLD)
    assert shown(scene) == (0, None)


def test_more_expansions_make_a_cell_darker():
    assert shades_of(np.array([1, 2, 9, 99])).tolist() == [0, 0, 1, 3]
    assert shades_of(np.zeros(0)).tolist() == []


def test_expanded_cells_lie_along_the_goal_and_go_with_the_record(scene):
    marks = SearchMarks(scene)
    goal = (6.0, -1.0, np.pi / 4)
    plan = FootstepPlan(start_feet_world=feet_at(goal, MODEL.stance_width_m), start=goal, goal=goal)
    record = SearchRecord(
        time_s=np.array([0.1]),
        cost_m=np.array([1.0]),
        lower_bound_m=np.array([1.0]),
        expanded=np.array([[6.0, -1.0, 1.0], [6.1, -1.0, 50.0]]),
    )

    def drawn(shade: int) -> np.ndarray:
        sheet: Any = scene.get_handle_by_name(f"/expanded/{shade}")
        vertices = np.array(sheet.vertices)
        return vertices[vertices[:, 2] > -0.5]

    marks.show(Answer(number=1, plan=plan, record=record), WORLD)
    assert [len(drawn(shade)) for shade in range(len(EXPANDED_RGB))] == [4, 0, 0, 4]
    # Turned by 45 degrees its corners are ahead of and beside its middle.
    reach_m = MODEL.cell_m / np.sqrt(2)
    away = np.abs(drawn(0)[:, :2] - (6.0, -1.0))
    assert np.sort(away.max(axis=1)) == pytest.approx([reach_m] * 4, abs=1e-6)
    assert away.min(axis=1) == pytest.approx([0.0] * 4, abs=1e-6)
    marks.show(Answer(number=2, plan=plan), WORLD)
    assert [len(drawn(shade)) for shade in range(len(EXPANDED_RGB))] == [0] * 4
