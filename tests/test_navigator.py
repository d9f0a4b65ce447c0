"""Planning and walking with the shipped policy, on flat maps, on stairs, and many at a time."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from app.commands.trials import TrialsOptions, draw_trials, walk_one
from app.evaluation.trials_summary import summarise, table
from app.navigation.live_navigator import LiveNavigator, WalkHistory
from app.navigation.navigator import Navigator, NavigatorConfig
from app.navigation.planner_process import PlannerProcess
from app.navigation.replanner import Replanner
from app.navigation.report import Outcome
from app.pictures.line_of_sight import fixed_boxes
from controller.policy import Policy, load_policy
from maps.grid import Cell, OccupancyGrid
from maps.map_files import load_map
from planner.endpoints import Footing
from planner.plan import FootstepPlan
from planner.planner import Planner
from sim.posture import state_at
from sim.robot import GROUND_PREFIX
from sim.robots import get_robot
from sim.scene import min_clearance_m, scene_of

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


def test_a_walk_that_ends_in_no_numbers_still_has_a_report():
    walker = navigator(empty_map(), (1.5, 0.0, 0.0))
    walker.plan()
    while len(walker.placed) < 5:
        walker.tick()
    walker.walker.sim.qvel[:] = np.nan
    walker.tick()
    assert walker.outcome is Outcome.FELL
    assert "finite" in walker.reason
    gait = json.loads(walker.report().to_json())["gait"]
    assert gait["pelvis_height_m"]["at_rest"] is None
    assert gait["speed_m_s"] > 0.1


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


def trials_options(**options) -> TrialsOptions:
    return TrialsOptions(map=Path("drawn"), **options)


def test_trials_are_drawn_apart_and_repeat():
    options = trials_options(count=5, apart=1.0, seed=3)
    trials = draw_trials(empty_map(4.0), options)
    assert trials == draw_trials(empty_map(4.0), options)
    assert trials != draw_trials(empty_map(4.0), replace(options, seed=4))
    for trial in trials:
        assert np.hypot(*np.subtract(trial.goal[:2], trial.start[:2])) >= 1.0


def test_reachable_pairs_lie_on_one_side_of_a_wall():
    grid = empty_map(6.0)
    cells = grid.cells.copy()
    middle = cells.shape[1] // 2
    cells[:, middle : middle + 2] = 1
    walled = grid.with_cells(cells)
    x_m = float(walled.cell_to_world((0, middle))[0])
    for reachable in (True, False):
        trials = draw_trials(walled, trials_options(count=30, apart=1.0, reachable=reachable))
        crossing = sum((t.start[0] < x_m) != (t.goal[0] < x_m) for t in trials)
        assert (crossing == 0) == reachable


def test_trials_walk_and_are_summed_up_by_outcome():
    options = trials_options(count=2, apart=0.3)
    trials = draw_trials(empty_map(4.0), options)
    near = [replace(t, goal=(t.start[0], t.start[1], t.start[2] + 0.2)) for t in trials]
    results = [walk_one(empty_map(4.0), options, trial) for trial in near]
    summary = summarise(results)
    assert summary["walks"] == summary["reached"] == 2
    assert summary["steps_taken"] == sum(len(r["foot_errors_m"]) for r in results) > 0
    assert "reached" in table(summary)
    json.dumps(summary)


@pytest.mark.parametrize("gap_m", [0.0, 0.5])
def test_pairs_that_no_way_joins_are_counted_apart(gap_m):
    grid = empty_map(4.0)
    cells = grid.cells.copy()
    middle, gap = cells.shape[1] // 2, round(gap_m / 0.05)
    cells[gap:, middle : middle + 2] = 1
    walled = grid.with_cells(cells)
    (wall_x_m, y_m), (_, gap_y_m) = walled.cell_to_world((40, middle)), walled.cell_to_world((5, 0))
    options = trials_options(count=1, apart=0.1)
    (trial,) = draw_trials(walled, options)
    x_m = float(wall_x_m)
    beside = replace(trial, start=(x_m - 0.9, y_m, 0.0), goal=(x_m - 0.8, y_m, 0.0))
    across = replace(trial, start=(x_m - 0.9, y_m, 0.0), goal=(x_m + 0.9, y_m, 0.0))
    summary = summarise([walk_one(walled, options, t) for t in (beside, across, across)])
    assert (summary["reached"], summary["no_path"], summary["unconnected"]) == (1, 2, 2)
    places = summary["narrow_places"]
    assert [place["pairs"] for place in places] == ([2] if gap_m else [])
    for place in places:
        assert place["width_m"] == pytest.approx(gap_m, abs=0.11)
        assert (place["x"], place["y"]) == pytest.approx((x_m, gap_y_m), abs=0.2)
    # A place is not said to be at -0.0.
    shifted = [place | {"x": -0.01, "y": -0.04} for place in places]
    assert ("at 0.0,0.0" in table(summary | {"narrow_places": shifted})) == bool(gap_m)
    text = table(summary)
    assert "1 (33.3 %), of 1 that a way joins" in text
    assert "2 pairs lie in parts that this robot cannot pass between" in text


STAIRS = load_map("maps/stairs.yaml")


LANDING = (3.95, 0.0, 0.0)


def on_stairs(start, goal, kind=Navigator, **options) -> Navigator:
    return kind(STAIRS, ROBOT, load_policy(ROBOT), start=start, goal=goal, **options)


@pytest.fixture(scope="module")
def on_landing() -> Navigator:
    return walk(on_stairs(LANDING, (4.3, 0.05, 0.1)))


def test_a_walk_up_on_the_landing_is_a_walk(on_landing):
    assert on_landing.outcome is Outcome.REACHED, on_landing.reason
    assert len(on_landing.placed) == len(on_landing.plans[0]) >= 3
    heights = np.array(on_landing.qpos)[:, 2]
    assert heights.min() > 0.6 + ROBOT.fallen_height_m
    assert heights[0] == pytest.approx(0.6 + ROBOT.pelvis_height_m, abs=0.01)


def test_feet_are_told_by_the_height_of_the_ground(on_landing):
    for placed in on_landing.placed:
        assert placed.asked_world[2] == placed.placed_world[2] == 0.6
        assert placed.error_m < 0.05
    assert (on_landing.plans[0].start_feet_world[:, 2] == 0.6).all()


@pytest.mark.slow
def test_the_shipped_policy_walks_over_the_stairs():
    over = walk(on_stairs((1.4, 0.1, 0.0), (6.8, 0.0, 0.2)))
    assert over.outcome is Outcome.REACHED, over.reason
    heights = np.array([placed.placed_world[2] for placed in over.placed])
    assert heights.max() == 0.6
    assert heights[-1] == 0.0
    # The whole robot is up there, not only its feet.
    pelvis_m = np.array(over.qpos)[:, 2]
    assert pelvis_m.max() > 0.6 + ROBOT.fallen_height_m
    assert pelvis_m[-1] < pelvis_m.max() - 0.4


@pytest.mark.slow
def test_the_shipped_policy_steps_over_the_sills():
    over = walk(navigator(load_map("maps/sills.yaml"), (6.0, 2.0, 0.0)))
    assert over.outcome is Outcome.REACHED, over.reason
    assert over.replans == 0
    assert max(placed.error_m for placed in over.placed) < 0.05


def test_treads_are_no_walls():
    scene = scene_of(STAIRS, ROBOT, False)
    # Shins in the first risers, so that treads are touched; the walls are 1.2 m to either side.
    data = state_at(scene, scene.qpos_at(np.array([2.0, 0.0, 0.0])))
    assert data.ncon > 4
    assert data.sensordata[scene.sensors.wall_contacts[0]] == 0
    clearance = min_clearance_m(scene, data.qpos[None])
    assert clearance == pytest.approx(1.2 - 0.3, abs=0.1)


@pytest.mark.parametrize(("x_m", "ground_m"), [(1.0, 0.0), (2.15, 0.1), (4.1, 0.6), (5.75, 0.2)])
def test_walls_stand_beside_the_robot_wherever_it_is(x_m, ground_m):
    scene = scene_of(STAIRS, ROBOT, False)
    pose = np.array([x_m, 1.2, 0.0]) if x_m > 2 else np.array([-2.0, 0.0, 0.0])
    data = state_at(scene, scene.qpos_at(pose, ground_m))
    assert data.sensordata[scene.sensors.wall_contacts[0]] > 0
    # Walls reach up to 1 m above the floor beside them, all the way.
    walls = scene.model.geom_bodyid == scene.model.body("walls").id
    tops = (scene.model.geom_pos + scene.model.geom_size)[walls, 2]
    near = np.linalg.norm(
        np.maximum(
            np.abs(scene.model.geom_pos[walls, :2] + (-2.0, -2.5) - pose[:2])
            - scene.model.geom_size[walls, :2],
            0,
        ),
        axis=1,
    )
    assert tops[near < 0.05].min() >= ground_m + 1.0 - 1e-9


@pytest.mark.parametrize("height_m", [0.0, 0.25, -1.5])
def test_a_level_floor_is_where_its_height_says(height_m):
    grid = OccupancyGrid(
        cells=np.zeros((40, 40), np.uint8),
        resolution_m=0.1,
        origin=(-2.0, -2.0, 0.0),
        elevation_m=np.full((40, 40), height_m),
    )
    scene = scene_of(grid, ROBOT, False)
    footing = Footing(grid, ROBOT.step_model, False)
    assert footing.stand_m((0.3, 0.2, 0.5)) == height_m
    data = mujoco.MjData(scene.model)
    data.qpos[:] = scene.qpos_at(np.array([0.3, 0.2, 0.5]), height_m)
    data.ctrl[:] = ROBOT.half_sitting_rad
    mujoco.mj_step(scene.model, data, 100)
    force = data.sensordata[scene.sensors.ground_force_world[:, 2]]
    assert abs(force).sum() == pytest.approx(9.81 * ROBOT.mass_kg, rel=0.5)
    soles = scene.soles_at(data.qpos)
    assert soles[:, 2] == pytest.approx(height_m, abs=0.01)


def test_a_foot_that_rests_at_another_height_than_planned_calls_for_another_plan(on_landing):
    assert on_landing.replans == 0
    # To the planner the ground is 5 cm higher than it is.
    assert STAIRS.elevation_m is not None
    higher = replace(STAIRS, elevation_m=STAIRS.elevation_m + 0.05)
    walker = on_stairs(LANDING, (4.3, 0.05, 0.1), planner=Planner(higher, ROBOT.step_model))
    walker.plan()
    while not walker.placed:
        walker.tick()
    placed = walker.placed[0]
    assert placed.asked_world[2] - placed.placed_world[2] == pytest.approx(0.05)
    assert walker.replans == 1


def test_a_robot_that_stops_keeps_to_the_height_of_its_tread():
    live = on_stairs(LANDING, (4.3, 0.05, 0.1), kind=LiveNavigator)
    assert isinstance(live, LiveNavigator)
    plan = live.plan()
    live.going = True
    # In the swing of the first step.
    while not live.walker.cursor.swinging[0]:
        live.tick()
    live.halt()
    stop = live.waiting
    assert isinstance(stop, FootstepPlan)
    assert len(stop) == 1 < len(plan)
    assert stop.pose_world[0, 2] == 0.6


class SlowPlanner(PlannerProcess):
    """Takes questions and has no answer yet."""

    def __init__(self):
        self.number = 0

    def ask(self, *, once=False, **_):
        self.number += 1
        return self.number

    def answers(self):
        return []


def test_a_live_robot_does_not_walk_on_onto_what_is_put_before_it():
    grid, start, goal = empty_map(), (0.0, 0.0, 0.0), (2.0, 0.0, 0.0)
    live = LiveNavigator(grid, ROBOT, load_policy(ROBOT), start=start, goal=goal)
    replanner = Replanner(SlowPlanner(), WalkHistory(), live)
    plan = Planner(grid, ROBOT.step_model).plan(start=start, goal=goal)
    live.tick()
    live.go(goal, plan, live.replan_point(), fresh=True)
    while len(live.placed) < 3:
        live.tick()
    x_m = float(live.qpos[-1][0])
    wall = with_wall(grid, x_m + 0.75, -1.0, x_m + 1.0, 1.0)  # beyond the step that has begun
    live.set_grid(wall, Planner(wall, ROBOT.step_model))
    replanner.plan_anew()
    for _ in range(200):
        live.tick()
    assert not live.has_ended, live.reason
    assert replanner.question is not None
    assert replanner.question.goal == goal
    toe_m = ROBOT.step_model.foot.length_m / 2
    assert max(placed.placed_world[0] for placed in live.placed) + toe_m < x_m + 0.75


def test_trials_are_drawn_on_level_ground_only():
    trials = draw_trials(STAIRS, trials_options(count=30, apart=5.0))
    poses = [pose for trial in trials for pose in (trial.start, trial.goal)]
    footing = Footing(STAIRS, ROBOT.step_model, False)
    assert len(poses) == 60
    # Treads are too narrow for both feet in most headings; where they do fit, they fit level.
    assert {footing.stand_m(pose) for pose in poses} >= {0.0}
    edges_m = np.concatenate([2.0 + 0.3 * np.arange(6), 4.7 + 0.3 * np.arange(6)])
    assert min(np.abs(edges_m - pose[0]).min() for pose in poses) > 0.05


def test_ground_is_drawn_solid_and_a_flat_map_has_none_but_the_floor():
    flat, uneven = (
        scene_of(grid, ROBOT, False).model for grid in (replace(STAIRS, elevation_m=None), STAIRS)
    )
    assert [geoms_of_ground(model) for model in (flat, uneven)] == [0, 11]
    data = mujoco.MjData(uneven)
    mujoco.mj_kinematics(uneven, data)
    # Boxes that may turn to glass: the walls alone.
    walls = np.flatnonzero(uneven.geom_bodyid == uneven.body("walls").id)
    assert fixed_boxes(uneven, data).geom.tolist() == walls.tolist()


def geoms_of_ground(model: mujoco.MjModel) -> int:
    names = [model.geom(geom).name for geom in range(model.ngeom)]
    return sum(name.startswith(GROUND_PREFIX) for name in names)
