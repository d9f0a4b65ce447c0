"""The loop of planning and walking, with the shipped policy, on small maps made here."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from app.commands.trials import TrialSettings, draw_trials, summarise, table, walk_one
from app.navigation.navigator import Navigator, NavigatorConfig
from app.navigation.report import Outcome
from controller.policy import Policy, load_policy
from maps.grid import Cell, OccupancyGrid
from planner.planner import Planner
from sim.clearance import min_clearance_m
from sim.robots import get_robot

ROBOT = get_robot("jvrc1")


def empty_map(size_m: float = 6.0) -> OccupancyGrid:
    cells = round(size_m / 0.05)
    return OccupancyGrid(
        cells=np.zeros((cells, cells), np.uint8),
        resolution_m=0.05,
        origin=(-size_m / 2, -size_m / 2, 0.0),
    )


def with_wall(grid: OccupancyGrid, x0: float, y0: float, x1: float, y1: float) -> OccupancyGrid:
    cells = grid.cells.copy()
    (r0, c0), (r1, c1) = grid.world_to_cell([(x0, y0), (x1, y1)])
    cells[r0 : r1 + 1, c0 : c1 + 1] = Cell.OCCUPIED
    return grid.with_cells(cells)


def navigator(grid: OccupancyGrid, goal, *, policy: Policy | None = None, **options) -> Navigator:
    return Navigator(
        grid, ROBOT, policy or load_policy(ROBOT), start=(0.0, 0.0, 0.0), goal=goal, **options
    )


def walk(walker: Navigator) -> Navigator:
    walker.plan()
    while walker.outcome is None:
        walker.tick()
    return walker


@pytest.fixture(scope="module")
def short_walk() -> Navigator:
    return walk(navigator(empty_map(), (0.5, 0.2, 0.4)))


def test_short_walk_reaches_its_goal_and_stands(short_walk):
    assert short_walk.outcome is Outcome.REACHED, short_walk.reason
    distance_m, angle_rad = short_walk.goal_error
    assert distance_m < 0.05
    assert angle_rad < 0.1
    assert np.linalg.norm(short_walk.walker.sim.qvel[0, :3]) < 0.05


def test_every_planned_step_is_taken_by_its_own_foot(short_walk):
    plan = short_walk.plans[0]
    assert short_walk.replans == 0
    assert [int(p.side) for p in short_walk.placed] == plan.side.tolist()
    for placed, pose in zip(short_walk.placed, plan.pose_world, strict=True):
        assert placed.asked_world == pytest.approx(pose)
        assert placed.error_m < 0.08


def test_nothing_moves_but_by_physics(short_walk):
    """No teleport: between control steps the pelvis moves no faster than the robot can."""
    qpos = np.array(short_walk.qpos)
    assert len(qpos) > 100
    speed_m_s = np.linalg.norm(np.diff(qpos[:, :3], axis=0), axis=1) / 0.025
    assert speed_m_s.max() < 1.5
    assert qpos[:, 2].min() > get_robot("jvrc1").fallen_height_m


def test_same_seed_same_walk_and_another_seed_another(short_walk):
    again = walk(navigator(empty_map(), (0.5, 0.2, 0.4)))
    assert np.array_equal(np.array(again.qpos), np.array(short_walk.qpos))
    other = navigator(empty_map(), (0.5, 0.2, 0.4), seed=1)
    assert not np.array_equal(other.qpos[0], short_walk.qpos[0])


def test_robot_that_stands_at_the_goal_stays_there():
    walker = navigator(empty_map(), (0.0, 0.0, 0.0))
    walk(walker)
    assert walker.outcome is Outcome.REACHED
    assert walker.goal_error[0] < 0.03


def test_feet_that_miss_lead_to_a_new_plan_from_where_they_are():
    config = NavigatorConfig(replan_error_m=0.0, max_replans=3)
    walker = walk(navigator(empty_map(), (0.5, 0.0, 0.0), config=config))
    assert walker.outcome is Outcome.REACHED
    assert walker.replans == 3
    for plan, placed in zip(walker.plans[1:], walker.placed, strict=False):
        assert plan.start_feet_world[placed.side] == pytest.approx(placed.placed_world)
        assert plan.side[0] == placed.side.other


def test_robot_without_skill_falls():
    still = load_policy(ROBOT)
    weight, bias = still.layers[-1]
    idle = (np.zeros_like(weight), np.zeros_like(bias))
    policy = replace(still, layers=(*still.layers[:-1], idle))
    walker = walk(navigator(empty_map(), (1.0, 0.0, 0.0), policy=policy))
    assert walker.outcome is Outcome.FELL
    assert walker.outcome.exit_code == 4
    assert "fell near" in walker.reason


def test_simulation_that_leaves_the_finite_numbers_is_a_fall_with_a_reason():
    walker = navigator(empty_map(), (1.0, 0.0, 0.0))
    walker.plan()
    walker.walker.sim.qvel[:] = np.nan
    walker.tick()
    assert walker.outcome is Outcome.FELL
    assert "finite" in walker.reason


def test_wall_that_the_planner_does_not_know_of_is_a_collision():
    blind = Planner(empty_map(), ROBOT.step_model)
    wall = with_wall(empty_map(), 0.5, -1.0, 0.6, 1.0)
    walker = navigator(wall, (1.5, 0.0, 0.0), planner=blind)
    walk(walker)
    assert walker.outcome is Outcome.COLLIDED
    assert walker.outcome.exit_code == 4
    x, _ = walker.walker.sim.qpos[0, :2]
    assert 0.0 < x < 0.5
    # Touching is felt at once, but within its control step the robot leans in a little.
    clearance_m = min_clearance_m(walker.scene, np.array(walker.qpos))
    assert clearance_m is not None
    assert -0.05 < clearance_m <= 0.0


def test_goal_behind_a_closed_wall_has_no_path():
    walker = navigator(with_wall(empty_map(), 1.0, -3.0, 1.1, 2.99), (2.0, 0.0, 0.0))
    plan = walker.plan()
    assert walker.outcome is Outcome.NO_PATH
    assert walker.outcome.exit_code == 3
    assert walker.reason == plan.reason != ""


def test_time_runs_out():
    config = NavigatorConfig(spare_time_s=-3.0)
    walker = walk(navigator(empty_map(), (0.5, 0.0, 0.0), config=config))
    assert walker.outcome is Outcome.TIMED_OUT
    assert "still walking after" in walker.reason


@pytest.fixture(scope="module")
def settings() -> TrialSettings:
    return TrialSettings(grid=empty_map(4.0), robot="jvrc1")


def test_trials_are_drawn_apart_and_repeat(settings):
    trials = draw_trials(settings, 5, 1.0, seed=3)
    assert trials == draw_trials(settings, 5, 1.0, seed=3)
    assert trials != draw_trials(settings, 5, 1.0, seed=4)
    for trial in trials:
        assert np.hypot(*np.subtract(trial.goal[:2], trial.start[:2])) >= 1.0


def test_trials_walk_and_are_summed_up_by_outcome(settings):
    trials = draw_trials(settings, 2, 0.3, seed=0)
    near = [replace(t, goal=(t.start[0], t.start[1], t.start[2] + 0.2)) for t in trials]
    results = [walk_one(settings, trial) for trial in near]
    summary = summarise(results)
    assert summary["walks"] == summary["reached"] == 2
    assert summary["steps_taken"] == sum(len(r["foot_errors_m"]) for r in results) > 0
    assert "reached" in table(summary)
    json.dumps(summary)
