"""Step models, plans and their file, the step table, collision checks, refusals and pictures."""

from __future__ import annotations

import json
import math
import re

import cv2
import numpy as np
import pytest
import shapely
from shapely import affinity

from maps.grid import Cell, OccupancyGrid
from planner.api import Planner, plan_footsteps
from planner.collision import box_free, point_clearance, terrain_of
from planner.lattice import allowed, build_step_table, feet_apart, table_steps
from planner.model import BodyShape, FootShape, Side, StepLimits
from planner.options import PlannerOptions
from planner.picture import LEFT, RIGHT, Canvas, body_path, draw_plan, write_picture
from planner.plan import FootstepPlan, PlanStatus, feet_at, pair_pose, relative_step, wrap_angle
from planner.verify import violations
from tests.planner_oracle import small_model

FLOOR = OccupancyGrid(cells=np.zeros((30, 40), np.uint8), resolution_m=0.1)


@pytest.fixture(scope="module")
def plan():
    return plan_footsteps(FLOOR, small_model(), start=(1.0, 1.0, 0.2), goal=(2.5, 1.8, 1.0))


# Models


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"steps": ()}, "steps is empty"),
        ({"steps": ((0.5, 0.2, 0.0),)}, r"step \(0.5, 0.2, 0.0\) lies outside"),
        ({"stance_width_m": 0.5}, "stance_width_m 0.5: the step limits"),
        ({"stance_width_m": 0.0}, "stance_width_m 0.0 must be"),
        ({"cell_m": 0.5}, "cell_m 0.5 must be from"),
        ({"headings": 4}, "headings 4 must be"),
        ({"headings": 30}, "headings 30 must be a multiple of 4"),
        ({"foot_margin_m": -0.1}, "foot_margin_m -0.1"),
        ({"turn_cost_m": -1.0}, "turn_cost_m -1.0"),
        ({"foot": FootShape(length_m=0.2, width_m=0.2)}, "or the feet overlap"),
    ],
)
def test_a_step_model_that_cannot_walk_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        small_model(**change)


def test_limits_with_low_above_high_are_refused():
    with pytest.raises(ValueError, match="y_m"):
        StepLimits(x_m=(0.0, 0.1), y_m=(0.3, 0.2), yaw_rad=(0.0, 0.1))


def test_limits_that_no_node_meets_are_refused():
    tight = StepLimits(x_m=(-0.001, 0.3), y_m=(0.199, 0.201), yaw_rad=(0.0, 0.0))
    with pytest.raises(ValueError, match="take a smaller cell_m"):
        build_step_table(small_model(limits=tight, steps=((0.21, 0.2, 0.0),)))


def test_sides():
    assert (Side.LEFT.other, Side.RIGHT.other) == (Side.RIGHT, Side.LEFT)
    assert (Side.LEFT.outward, Side.RIGHT.outward) == (1, -1)


# Poses


def test_feet_stand_left_and_right_of_their_pose():
    feet = feet_at((1.0, 2.0, math.pi / 2), 0.2)
    np.testing.assert_allclose(
        feet, [[0.9, 2.0, 0.0, math.pi / 2], [1.1, 2.0, 0.0, math.pi / 2]], atol=1e-12
    )
    np.testing.assert_allclose(pair_pose(feet), (1.0, 2.0, math.pi / 2))


def test_the_mean_heading_goes_the_short_way():
    feet = np.array([[0.0, 0.1, 0.0, 3.1], [0.0, -0.1, 0.0, -3.1]])
    assert abs(pair_pose(feet)[2]) == pytest.approx(math.pi, abs=1e-9)


def test_a_step_is_counted_outward_for_either_foot():
    support = np.array([1.0, 1.0, 0.0, math.pi / 2])
    left = np.array([0.7, 1.3, 0.0, math.pi / 2 + 0.1])
    np.testing.assert_allclose(relative_step(support, left, Side.LEFT), (0.3, 0.3, 0.1))
    right = np.array([1.3, 1.3, 0.0, math.pi / 2 - 0.1])
    np.testing.assert_allclose(relative_step(support, right, Side.RIGHT), (0.3, 0.3, 0.1))


def test_angles_wrap_into_one_turn():
    np.testing.assert_allclose(
        wrap_angle([3.5 * math.pi, -3.5 * math.pi]), (-math.pi / 2, math.pi / 2)
    )


# plan.json


def test_a_plan_survives_its_file(plan):
    again = FootstepPlan.from_json(plan.to_json())
    np.testing.assert_array_equal(again.pose_world, plan.pose_world)
    np.testing.assert_array_equal(again.side, plan.side)
    np.testing.assert_array_equal(again.start_feet_world, plan.start_feet_world)
    assert again.to_json() == plan.to_json()


def test_the_file_has_the_documented_keys(plan):
    document = json.loads(plan.to_json())
    assert document["format"] == "footstep-plan/1"
    assert list(document) == [
        *("format", "robot", "map", "start", "goal", "status", "reason", "start_feet", "steps"),
        *("cost_m", "epsilon", "expansions", "time_to_first_s", "time_s", "planner"),
    ]
    assert document["status"] == "found"
    assert document["start_feet"]["left"] == plan.start_feet_world[0].tolist()
    first = document["steps"][0]
    assert first["side"] == Side(int(plan.side[0])).name.lower()
    assert [first[key] for key in ("x", "y", "z", "yaw")] == plan.pose_world[0].tolist()
    assert document["steps"][-1]["x"] == plan.pose_world[-1, 0]


def test_an_unproven_bound_is_null_in_the_file():
    failed = plan_footsteps(FLOOR, small_model(), start=(1, 1, 0), goal=(9, 9, 0))
    document = json.loads(failed.to_json())
    assert document["epsilon"] is None
    assert document["steps"] == []
    assert FootstepPlan.from_json(failed.to_json()).epsilon == math.inf


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.pop("steps"), "'steps' is missing"),
        (lambda d: d.update(format="footstep-plan/9"), "footstep-plan/9"),
        (lambda d: d["steps"][0].update(side="middle"), "'middle'"),
        (lambda d: d["steps"][0].update(x="far"), "far"),
        (lambda d: d.update(start=[0, 0]), r"\[0, 0\] must be 3 finite numbers"),
        (lambda d: d.update(status="maybe"), "maybe"),
    ],
)
def test_a_file_that_is_no_plan_is_refused(plan, change, message):
    document = json.loads(plan.to_json())
    change(document)
    with pytest.raises(ValueError, match="not a plan") as error:
        FootstepPlan.from_json(json.dumps(document))
    assert re.search(message, str(error.value))
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize("text", ["", "[1]", "{}", "{"])
def test_text_that_is_no_plan_is_refused(text):
    with pytest.raises(ValueError, match="not a plan"):
        FootstepPlan.from_json(text)


def test_plans_are_read_only(plan):
    with pytest.raises(ValueError, match="read-only"):
        plan.pose_world[0, 0] = 1.0


# The step table

MODELS = {
    "coarse": small_model(),
    "fine": small_model(cell_m=0.03, headings=64),
    "tight": small_model(
        cell_m=0.05,
        headings=32,
        limits=StepLimits(x_m=(-0.15, 0.3), y_m=(0.15, 0.35), yaw_rad=(-0.2, 0.4)),
        steps=((0.3, 0.2, 0.0), (0.0, 0.35, 0.0), (0.2, 0.2, 0.4), (-0.15, 0.15, -0.2)),
        stance_width_m=0.19,
    ),
}


@pytest.mark.parametrize("name", MODELS)
def test_no_rounded_step_breaks_the_limits_or_brings_the_feet_together(name):
    model = MODELS[name]
    table = build_step_table(model)
    real = table.cost_um > 0
    steps = table_steps(table, model)[real]
    assert len(steps) > model.headings
    assert model.limits.contain(steps).all()
    assert feet_apart(steps, model.foot, model.foot_gap_m).all()
    # And it stays near the step that was asked for.
    wanted = np.broadcast_to(np.array(model.steps), (*real.shape, 3))[real]
    assert np.hypot(*(steps - wanted)[:, :2].T).max() < 2.2 * model.cell_m


@pytest.mark.parametrize("name", MODELS)
def test_costs_are_those_of_the_rounded_step(name):
    model = MODELS[name]
    table = build_step_table(model)
    steps = table_steps(table, model)
    real = table.cost_um > 0
    length_m = np.hypot(steps[..., 0], steps[..., 1])
    np.testing.assert_allclose(table.cost_um[real] / 1e6, length_m[real] + 0.1, atol=1e-6)


@pytest.mark.parametrize("name", MODELS)
def test_the_right_foots_steps_mirror_the_lefts(name):
    model = MODELS[name]
    table = build_step_table(model)
    mirrored = -np.arange(model.headings) % model.headings
    for left, right, sign in (
        (table.d_col, table.d_col, 1),
        (table.d_row, table.d_row, -1),
        (table.d_heading, table.d_heading, -1),
        (table.cost_um, table.cost_um, 1),
    ):
        np.testing.assert_array_equal(left[:, 0], sign * right[mirrored, 1])


def test_optional_costs_add_up_by_hand():
    model = small_model(turn_cost_m=0.5, side_cost_m=2.0, back_cost_m=3.0)
    table, steps = build_step_table(model), table_steps(build_step_table(model), model)
    checked = 0
    for k, (x_m, y_m, yaw_rad) in enumerate(steps[0, 0]):
        if table.cost_um[0, 0, k]:
            extra = 0.5 * abs(yaw_rad) + 2.0 * abs(y_m - 0.2) + 3.0 * max(0.0, -x_m)
            by_hand = math.hypot(x_m, y_m) + 0.1 + extra
            assert table.cost_um[0, 0, k] == pytest.approx(by_hand * 1e6, abs=1)
            checked += 1
    assert checked == 5


def test_feet_apart_never_contradicts_polygons():
    rng = np.random.default_rng(1)
    foot = FootShape(length_m=0.2, width_m=0.1)
    steps = rng.uniform((-0.3, 0.0, -0.8), (0.3, 0.4, 0.8), (2000, 3))
    apart = feet_apart(steps, foot, 0.02)
    box = shapely.box(-0.1, -0.05, 0.1, 0.05)
    for (x_m, y_m, yaw_rad), says_apart in zip(steps, apart, strict=True):
        turned = affinity.rotate(box, yaw_rad, origin=(0, 0), use_radians=True)
        distance_m = box.distance(affinity.translate(turned, x_m, y_m))
        if says_apart:
            assert distance_m >= 0.02 - 1e-9
        else:
            # Grown boxes have corners, so the check may ask for more, but not for much.
            assert distance_m <= 0.02 * math.sqrt(2)
    assert 0.2 < apart.mean() < 0.9


def test_a_step_onto_the_other_foot_is_not_allowed():
    model = small_model(limits=StepLimits(x_m=(-0.2, 0.3), y_m=(0.0, 0.4), yaw_rad=(-0.4, 0.8)))
    assert allowed(np.array([[0.0, 0.2, 0.0], [0.0, 0.1, 0.0]]), model).tolist() == [True, False]


# Collision


def test_box_checks_agree_with_polygons_exactly():
    rng = np.random.default_rng(2)
    cells = (rng.random((40, 50)) < 0.04).astype(np.uint8)
    grid = OccupancyGrid(cells=cells, resolution_m=0.07)
    terrain = terrain_of(grid, False)
    row, col = np.nonzero(cells)
    squares = shapely.union_all(shapely.box(col, row, col + 1, row + 1))
    blocked = affinity.scale(squares, 0.07, 0.07, origin=(0, 0))
    shapely.prepare(blocked)
    floor = shapely.box(0, 0, 3.5, 2.8)
    hits = 0
    for x, y, yaw in rng.uniform((-0.1, -0.1, -4.0), (3.6, 2.9, 4.0), (3000, 3)):
        half_l, half_w = rng.uniform(0.01, 0.4, 2)
        box = shapely.box(-half_l, -half_w, half_l, half_w)
        box = affinity.rotate(box, yaw, origin=(0, 0), use_radians=True)
        box = affinity.translate(box, x, y)
        is_free = floor.covers(box) and not blocked.intersects(box)
        said = box_free(terrain, x, y, math.cos(yaw), math.sin(yaw), half_l, half_w)
        assert said == is_free
        hits += not is_free
    assert 500 < hits < 2900


def test_point_clearance_is_a_lower_bound():
    rng = np.random.default_rng(4)
    cells = (rng.random((20, 20)) < 0.02).astype(np.uint8)
    terrain = terrain_of(OccupancyGrid(cells=cells, resolution_m=0.1), False)
    row, col = np.nonzero(cells)
    blocked = shapely.union_all(shapely.box(col * 0.1, row * 0.1, col * 0.1 + 0.1, row * 0.1 + 0.1))
    outside = shapely.box(-9, -9, 9, 9).difference(shapely.box(0, 0, 2, 2))
    solid = blocked.union(outside)
    points = rng.uniform(-0.2, 2.2, (400, 2))
    told = np.array([point_clearance(terrain, x, y) for x, y in points])
    true_m = shapely.distance(solid, shapely.points(points))
    assert np.all(told <= true_m + 1e-6)
    assert told.max() > 0.3


# Refusals


def blocked_at(*boxes):
    cells = np.zeros((30, 40), np.uint8)
    for row0, col0, row1, col1 in boxes:
        cells[row0:row1, col0:col1] = Cell.OCCUPIED
    return FLOOR.with_cells(cells)


@pytest.mark.parametrize(
    ("box", "what"),
    [
        # The pose is 2, 1.5 facing +x: the left foot is at 2, 1.6 and the right one at 2, 1.4.
        ((16, 20, 17, 21), "the left foot at 2.00,1.60"),
        ((13, 20, 14, 21), "the right foot at 2.00,1.40"),
        ((16, 21, 17, 22), "the body at 2.00,1.50"),
    ],
)
def test_a_blocked_goal_or_start_names_foot_or_body_and_a_free_pose(box, what):
    grid, model = blocked_at(box), small_model(foot=FootShape(length_m=0.18, width_m=0.1))
    here, there = (2.0, 1.5, 0.0), (0.8, 0.8, 0.0)
    at_goal = plan_footsteps(grid, model, start=there, goal=here)
    at_start = plan_footsteps(grid, model, start=here, goal=there)
    for plan, status, name in (
        (at_goal, PlanStatus.GOAL_BLOCKED, "goal"),
        (at_start, PlanStatus.START_BLOCKED, "start"),
    ):
        assert plan.status is status
        assert plan.reason.startswith(f"{name}: {what} would touch an obstacle")
        near = [float(v) for v in plan.reason.rsplit(" ", 1)[1].split(",")]
        assert math.dist(near[:2], here[:2]) < 0.5
        assert plan_footsteps(grid, model, start=there, goal=near).found


def test_unknown_ground_blocks_unless_it_is_said_to_be_free():
    cells = np.zeros((30, 40), np.uint8)
    cells[10:20, 18:22] = Cell.UNKNOWN
    grid, model = FLOOR.with_cells(cells), small_model()
    start, goal = (0.8, 0.8, 0.0), (2.0, 1.5, 0.0)
    plan = plan_footsteps(grid, model, start=start, goal=goal)
    assert plan.status is PlanStatus.GOAL_BLOCKED
    brave = PlannerOptions(unknown_is_free=True)
    plan = plan_footsteps(grid, model, start=start, goal=goal, options=brave)
    assert plan.found
    assert violations(plan, grid, model, unknown_is_free=True) == []
    assert violations(plan, grid, model)


@pytest.mark.parametrize(("start", "goal"), [((1, 1, 0), (4.2, 1, 0)), ((-0.1, 1, 0), (1, 1, 0))])
def test_poses_off_the_map_are_named(start, goal):
    plan = plan_footsteps(FLOOR, small_model(), start=start, goal=goal)
    assert plan.status is PlanStatus.OFF_MAP
    assert "from 0,0 to 4,3" in plan.reason
    assert ("start -0.1,1" if start[0] < 0 else "goal 4.2,1") in plan.reason


def test_a_foot_over_the_maps_edge_is_blocked():
    plan = plan_footsteps(FLOOR, small_model(), start=(1, 1, 0), goal=(3.98, 1, 0))
    assert plan.status is PlanStatus.GOAL_BLOCKED


def test_a_goal_in_a_closet_is_found_out_without_searching_the_lattice():
    grid = blocked_at((9, 24, 11, 37), (20, 24, 22, 37), (9, 24, 22, 26), (9, 35, 22, 37))
    plan = plan_footsteps(grid, small_model(), start=(1, 1, 0), goal=(3.1, 1.55, 0))
    assert plan.status is PlanStatus.NO_PATH
    assert plan.expansions == 0
    assert "enclose" in plan.reason


def test_a_robot_too_near_to_a_wall_may_leave_but_not_come():
    # 4 cm between body and wall, less than the margin of 6 cm.
    grid, model = blocked_at((0, 0, 30, 8)), small_model(body_margin_m=0.06)
    near, far = (1.02, 1.5, 0.0), (2.0, 1.5, 0.0)
    assert plan_footsteps(grid, model, start=far, goal=near).status is PlanStatus.GOAL_BLOCKED
    assert plan_footsteps(grid, model, start=near, goal=far).status is PlanStatus.START_BLOCKED
    feet = feet_at(near, model.stance_width_m)
    plan = plan_footsteps(grid, model, start_feet_world=feet, goal=far)
    assert plan.found
    assert violations(plan, grid, model, stood_freely=False) == []


@pytest.mark.parametrize(
    ("query", "message"),
    [
        ({"goal": (1, 1, 0)}, "either start or start_feet_world"),
        ({"goal": (1, math.nan, 0), "start": (1, 1, 0)}, "goal"),
        ({"goal": (1, 1), "start": (1, 1, 0)}, "goal"),
        ({"goal": (1, 1, 0), "start": (math.inf, 1, 0)}, "start"),
        ({"goal": (1, 1, 0), "start_feet_world": np.zeros((2, 3))}, "start_feet_world"),
    ],
)
def test_numbers_that_are_no_pose_are_refused(query, message):
    with pytest.raises(ValueError, match=message):
        plan_footsteps(FLOOR, small_model(), **query)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": "magic"}, "planner 'magic' must be one of ara"),
        ({"epsilon": 0.5}, "epsilon 0.5"),
        ({"epsilon": math.inf}, "epsilon inf"),
        ({"final_epsilon": 0.5}, "at least 1"),
        ({"max_expansions": 0}, "max_expansions 0"),
        ({"time_limit_s": 0.0}, "time_limit_s 0.0"),
    ],
)
def test_options_that_make_no_sense_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        PlannerOptions(**change)


# The verifier must find what it is there for


def spoiled(plan, **changes):
    fields = {name: getattr(plan, name) for name in plan.__dataclass_fields__}
    return FootstepPlan(**{**fields, **changes})


def test_the_verifier_finds_every_kind_of_wrong(plan):
    model = small_model()
    assert violations(plan, FLOOR, model) == []

    def wrongs(**changes):
        return " ".join(violations(spoiled(plan, **changes), FLOOR, model))

    moved = np.array(plan.pose_world)
    moved[2, 0] += 0.3
    assert "is outside" in wrongs(pose_world=moved)
    same = np.array(plan.side)
    same[1] = same[0]
    assert "twice in a row" in wrongs(side=same)
    short = np.array(plan.pose_world)
    short[-1, 0] += 1e-6
    assert "not the goal's" in wrongs(pose_world=short)
    onto = np.array(plan.pose_world)
    onto[3, :2] = onto[2, :2]
    assert "apart" in wrongs(pose_world=onto)
    lifted = np.array(plan.pose_world)
    lifted[1, 2] = 0.1
    assert "not on the floor" in wrongs(pose_world=lifted)
    assert "not found" in wrongs(status=PlanStatus.NO_PATH)


@pytest.mark.parametrize(
    ("cell_of", "what"), [(0, "the foot hits"), (1, "the body on both feet hits")]
)
def test_the_verifier_finds_what_feet_and_body_hit(plan, cell_of, what):
    i = len(plan) // 2
    middle = (plan.pose_world[i] + plan.pose_world[i - 1]) / 2
    point = (plan.pose_world[i] if cell_of == 0 else middle)[:2]
    row, col = FLOOR.world_to_cell(point)
    assert what in " ".join(
        violations(plan, blocked_at((row, col, row + 1, col + 1)), small_model())
    )


# Pictures


def test_a_picture_shows_feet_where_they_are(plan):
    model = small_model()
    image = draw_plan(plan, FLOOR, model)
    height, width = image.shape[:2]
    assert width / height == pytest.approx(4 / 3, abs=0.01)
    scale = width / 4.0
    for side, pose in list(zip(plan.side, plan.pose_world, strict=True))[:-2]:
        # The toe mark is drawn in the foot's own colour, half a foot ahead of its centre.
        x_m, y_m = pose[0] + 0.06 * math.cos(pose[3]), pose[1] + 0.06 * math.sin(pose[3])
        colour = image[round(height - y_m * scale), round(x_m * scale)].astype(int)
        expected = LEFT if side == Side.LEFT else RIGHT
        assert np.abs(colour - expected).max() < 40


def test_a_large_map_is_cropped_to_the_plan():
    grid = OccupancyGrid(cells=np.zeros((200, 400), np.uint8), resolution_m=0.1)
    plan = plan_footsteps(grid, small_model(), start=(10, 10, 0), goal=(11, 10, 0))
    image = draw_plan(plan, grid, small_model())
    # About 1 m and 1.5 m on each side wide, 0.2 m and the same high.
    assert image.shape[1] / image.shape[0] == pytest.approx(4.0 / 3.2, rel=0.1)


def test_a_failed_plan_and_a_tiny_map_can_be_drawn():
    grid = OccupancyGrid(cells=np.full((1, 3), Cell.UNKNOWN, np.uint8), resolution_m=0.05)
    plan = plan_footsteps(grid, small_model(), start=(0.1, 0.02, 0), goal=(9, 9, 0))
    assert plan.status is PlanStatus.OFF_MAP
    assert draw_plan(plan, grid, small_model()).ndim == 3


def test_the_body_path_joins_start_and_goal(plan):
    path = body_path(plan)
    assert len(path) == len(plan) + 1
    np.testing.assert_allclose(path[0], plan.start, atol=1e-9)
    np.testing.assert_allclose(path[-1], plan.goal, atol=1e-9)


def test_a_canvas_and_its_map_agree_on_pixels():
    grid = OccupancyGrid(cells=np.zeros((20, 30), np.uint8), resolution_m=0.1, origin=(5, -2, 0.4))
    canvas = Canvas(grid)
    cells = np.array([[0, 0], [19, 29], [7, 11]])
    pixels = canvas.pixels(grid.cell_to_world(cells)) / 16
    size = canvas.image.shape[0] / 20
    np.testing.assert_allclose(pixels[:, 0], (cells[:, 1] + 0.5) * size - 0.5, atol=0.1)
    np.testing.assert_allclose(pixels[:, 1], (19.5 - cells[:, 0]) * size - 0.5, atol=0.1)


def test_pictures_are_written_or_refused_in_one_line(tmp_path, plan):
    image = draw_plan(plan, FLOOR, small_model())
    write_picture(image, str(tmp_path / "plan.png"))
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "plan.png")), image)
    for bad in (tmp_path / "none" / "plan.png", tmp_path / "plan.what"):
        with pytest.raises(OSError, match=re.escape(str(bad))):
            write_picture(image, str(bad))


def test_a_planner_kept_gives_the_plans_of_a_fresh_one():
    grid, model = blocked_at((0, 18, 20, 20)), small_model()
    planner = Planner(grid, model)
    for goal in ((3, 1, 0), (3, 1, 0), (1, 2.5, 2), (3, 1, 0)):
        kept = planner.plan(start=(1, 1, 0), goal=goal)
        fresh = plan_footsteps(grid, model, start=(1, 1, 0), goal=goal)
        np.testing.assert_array_equal(kept.pose_world, fresh.pose_world)
        assert kept.expansions == fresh.expansions


def test_body_shape_must_have_a_size():
    with pytest.raises(ValueError, match="body width_m 0"):
        BodyShape(length_m=0.1, width_m=0)
