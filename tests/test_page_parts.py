"""What the page is made of: boxes in whole cells, the pointer, the pace, the words."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from app.cli import main
from app.output import ExitCode
from app.viewer.obstacles import Obstacle, snapped, with_obstacles
from app.viewer.panel import CHOSEN, SPEEDS, in_degrees, marked, status_text, unmarked
from app.viewer.pointer import Pointed, facing, toward
from app.viewer.scenario import EditHistory, Scenario
from app.viewer.scene import on_floor
from app.viewer.simulation_clock import SimulationClock
from app.viewer.snapshot import Snapshot
from maps.grid import OccupancyGrid

GRID = OccupancyGrid(cells=np.zeros((20, 30), np.uint8), resolution_m=0.1, origin=(5.0, -3.0, 0.5))


def box(x_m: float, y_m: float, size_x_m: float, size_y_m: float) -> Obstacle:
    return Obstacle(number=0, x_m=x_m, y_m=y_m, size_x_m=size_x_m, size_y_m=size_y_m)


def test_a_box_covers_every_cell_that_it_touches():
    grid = with_obstacles(GRID, [box(1.0, 0.55, 0.32, 0.1)])
    # x from 0.84 to 1.16 m is columns 8 to 11, y from 0.5 to 0.6 m is row 5.
    assert sorted(map(tuple, np.argwhere(grid.cells == 1))) == [(5, col) for col in range(8, 12)]
    assert not GRID.cells.any()


def test_a_snapped_box_is_what_is_blocked_and_stays_so():
    rough = box(1.03, 0.57, 0.32, 0.11)
    once = snapped(rough, GRID)
    assert snapped(once, GRID) == once
    blocked = with_obstacles(GRID, [once]).cells
    assert np.array_equal(blocked, with_obstacles(GRID, [rough]).cells)
    assert blocked.sum() * 0.01 == pytest.approx(once.size_x_m * once.size_y_m)
    centre = np.argwhere(blocked)[:, ::-1].mean(axis=0) * 0.1 + 0.05
    assert centre == pytest.approx((once.x_m, once.y_m))


@pytest.mark.parametrize("place", [(-4.0, 1.0), (9.0, 9.0), (2.99, 1.99)])
def test_a_box_off_the_map_is_kept_at_its_edge(place):
    inside = snapped(box(place[0], place[1], 0.4, 0.4), GRID)
    assert with_obstacles(GRID, [inside]).cells.any()
    assert 0 < inside.x_m < 3
    assert 0 < inside.y_m < 2


def test_distance_to_a_box():
    assert box(1, 1, 0.4, 0.2).distance_m(1.1, 1.05) == 0
    assert box(1, 1, 0.4, 0.2).distance_m(1.5, 1.5) == pytest.approx(math.hypot(0.3, 0.4))


def test_a_ray_meets_the_floor_where_it_should():
    assert on_floor((1, 2, 4), (0.5, -0.25, -1)) == pytest.approx((3, 1))
    assert on_floor((1, 2, 4), (0.5, -0.25, 0.1)) is None
    assert on_floor((1, 2, 4), (1, 0, 0)) is None


def test_a_drag_says_where_to_look_and_a_click_does_not():
    assert toward((1, 1), (1, 3)) == pytest.approx((1, 1, math.pi / 2))
    assert toward((1, 1), (1.05, 1)) == Pointed(1, 1, None)
    assert facing(Pointed(2, 2), (0, 0), 3.0) == pytest.approx((2, 2, math.pi / 4), abs=1e-3)
    assert facing(Pointed(0.1, 0.1), (0, 0), 3.0) == pytest.approx((0.1, 0.1, 3.0))
    assert facing(Pointed(2, 2, 1.0), (0, 0), 3.0) == (2, 2, 1.0)


class Clock:
    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def ticks_in(clock: SimulationClock, monotonic: Clock, seconds: float) -> int:
    count = 0
    for _ in range(round(seconds / 0.005)):
        while clock.is_due() and count < 10_000:
            clock.ticked(0.025)
            count += 1
        monotonic.now_s += 0.005
    return count


@pytest.mark.parametrize(("factor", "ticks"), [(1.0, 80), (2.0, 160), (0.0, 0)])
def test_time_passes_as_fast_as_it_is_told_to(factor, ticks):
    monotonic = Clock()
    clock = SimulationClock(factor, monotonic)
    assert ticks_in(clock, monotonic, 2.0) == pytest.approx(ticks, abs=2)
    clock.is_due()
    assert clock.reached == pytest.approx(factor, abs=0.1)


def test_a_robot_that_waits_does_not_hurry():
    monotonic = Clock()
    clock = SimulationClock(math.inf, monotonic)
    clock.is_idle = True
    assert ticks_in(clock, monotonic, 1.0) == pytest.approx(40, abs=2)
    clock.is_idle = False
    assert clock.wait_s() == 0


def test_a_long_stop_is_not_made_up_for():
    monotonic = Clock()
    clock = SimulationClock(1.0, monotonic)
    ticks_in(clock, monotonic, 1.0)
    monotonic.now_s += 60
    assert ticks_in(clock, monotonic, 0.1) < 30
    monotonic.now_s += 60
    clock.skip()
    assert ticks_in(clock, monotonic, 0.1) == pytest.approx(4, abs=1)


def test_the_status_says_what_is_known_and_no_more():
    bare = status_text(Snapshot(qpos=np.zeros(7)))
    assert bare.startswith("### Standing")
    assert not set("123456789") & set(bare.removeprefix("### "))
    walking = Snapshot(
        qpos=np.zeros(7),
        status="walking",
        answer_s=0.042,
        foot_error_m=np.array([0.01, 0.03, 0.02]),
        clearance_m=0.25,
        goal_error=(1.5, 0.1),
    )
    told = status_text(walking)
    for words in ("Walking", "42 ms", "2.0 cm, at most 3.0 cm", "25 cm"):
        assert words in told
    loading = status_text(replace(walking, loading="loading the planner"))
    assert loading.startswith("### Loading the planner")
    assert loading.count("\n") == told.count("\n")
    reached = status_text(replace(walking, status="reached", goal_error=(0.012, 0.1)))
    assert "1.2 cm, 5.7°" in reached
    # The buttons below stay where they are.
    assert bare.count("\n") == told.count("\n") == reached.count("\n")


def test_the_button_that_is_pressed_is_marked_and_means_the_same():
    names = marked(SPEEDS, "Slow")
    assert [name for name in names if name.startswith(CHOSEN)] == [f"{CHOSEN}Slow"]
    assert [unmarked(name) for name in names] == list(SPEEDS)


@pytest.mark.parametrize(
    ("start", "words"),
    [("-1.95,0,0", "the nearest free pose is -"), ("9,0,0", "is off the map")],
)
def test_serve_refuses_a_start_where_nobody_can_stand(start, words, capsys, monkeypatch):
    monkeypatch.setattr("app.viewer.page.open_page", pytest.fail)
    assert main(["serve", "--map", "maps/room.png", "--start", start]) == ExitCode.BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert f"--start {start}" in line
    assert words in line


def test_edits_are_taken_back_and_made_again_until_another_one_is_made():
    first, second, third, fourth = (
        Scenario(start=(0, 0, 0), goal=(float(x), 0, 0)) for x in range(1, 5)
    )
    history = EditHistory(first)
    for scenario in (second, second, third):
        history.note(scenario, is_edit=True)
    assert [history.undo(), history.undo(), history.undo()] == [second, first, None]
    assert history.redo() == second
    history.note(fourth, is_edit=True)
    assert history.redo() is None
    assert [history.undo(), history.undo()] == [second, first]


def test_what_nobody_set_is_not_taken_back():
    walks, stopped = Scenario(start=(0, 0, 0), goal=(1, 0, 0)), Scenario(start=(0, 0, 0))
    history = EditHistory(walks)
    history.note(stopped, is_edit=False)
    assert history.undo() is None
    history.note(walks, is_edit=True)
    assert history.undo() == stopped


def test_a_refused_goal_was_no_edit():
    first, refused = Scenario(start=(0, 0, 0)), Scenario(start=(0, 0, 0), goal=(9, 9, 0))
    history = EditHistory(first)
    history.note(refused, is_edit=True)
    history.note(first, is_edit=False)
    assert history.undo() is None


def test_a_planners_reason_is_told_in_the_unit_of_the_page():
    told = in_degrees(
        "goal: the body at 2.00,2.95 would touch; the nearest free pose is 1.9,3,1.5708"
    )
    assert told.endswith("the nearest free pose is 1.9,3,90°")
    assert in_degrees("no path at all") == "no path at all"
