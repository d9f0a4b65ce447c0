"""Cameras, footprints, what is cut away by hand-worked cases; films, strips, portraits with GL."""

from __future__ import annotations

import os
import platform
import subprocess
from pathlib import Path

import numpy as np
import pytest

from app.navigation.placed import Placed
from app.pictures.film import captioned, tile
from app.pictures.line_of_sight import Boxes, eye_position, hides, obstacles_of, points_to_see
from app.pictures.portrait import TILE_HEIGHT, TILE_WIDTH, VIEWS_DEG, main
from app.pictures.rendering import (
    Footmark,
    Recording,
    View,
    add_footmarks,
    camera_path,
    footmarks_of,
    resampled,
)
from planner.plan import FootstepPlan, feet_at
from planner.robot_model import FootShape, Side
from sim.gl import NoGlError, prepare_gl
from sim.posture import standing
from sim.robot import VISUAL_GROUP
from sim.robots import get_robot, robot_names
from sim.scene import build_scene
from tests.programs import drawn_by, picture_at, run_python


def recording_of(xy_yaw: np.ndarray) -> Recording:
    """A free joint alone, at 40 Hz."""
    count = len(xy_yaw)
    qpos = np.zeros((count, 7))
    qpos[:, :2] = xy_yaw[:, :2]
    qpos[:, 3], qpos[:, 6] = np.cos(xy_yaw[:, 2] / 2), np.sin(xy_yaw[:, 2] / 2)
    return Recording(qpos=qpos, time_s=np.arange(count) / 40)


def test_the_nearest_moment():
    recording = Recording(qpos=np.zeros((3, 7)), time_s=np.array([0.0, 1.0, 3.0]))
    times_s = np.array([-1.0, 0.4, 0.6, 1.9, 2.1, 9.0])
    assert recording.nearest(times_s).tolist() == [0, 0, 1, 1, 2, 2]


def test_a_recording_of_one_moment():
    recording = Recording(qpos=np.zeros((1, 7)), time_s=np.array([0.0]))
    assert recording.nearest(np.array([0.0, 5.0])).tolist() == [0, 0]
    assert camera_path(recording, View()).lookat_m.shape == (1, 3)


def test_a_recording_refuses_what_does_not_fit():
    with pytest.raises(ValueError, match=r"\(2, 7\) must be"):
        Recording(qpos=np.zeros((2, 7)), time_s=np.zeros(3))
    with pytest.raises(ValueError, match="at least one moment"):
        Recording(qpos=np.zeros((0, 7)), time_s=np.zeros(0))


def test_the_camera_stands_still_when_the_robot_does():
    path = camera_path(recording_of(np.tile([2.0, 1.0, 0.5], (200, 1))), View(azimuth_deg=30))
    np.testing.assert_allclose(path.lookat_m, np.tile([2.0, 1.0, 0.75], (200, 1)))
    np.testing.assert_allclose(path.azimuth_deg, np.degrees(0.5) + 30)


def test_the_camera_does_not_sway_with_the_gait():
    time_s = np.arange(800) / 40
    sway_m = 0.05 * np.sin(2 * np.pi * time_s / 2.2)
    path = camera_path(
        recording_of(np.column_stack([0.2 * time_s, sway_m, 0 * time_s])), View(smooth_s=3)
    )
    middle = slice(200, 600)
    assert np.abs(path.lookat_m[middle, 1]).max() < 0.01
    np.testing.assert_allclose(path.lookat_m[middle, 0], 0.2 * time_s[middle], atol=1e-6)


def test_the_camera_turns_on_where_the_heading_passes_half_a_turn():
    yaw_rad = np.linspace(3.0, 3.4, 400)
    path = camera_path(recording_of(np.column_stack([0 * yaw_rad, 0 * yaw_rad, yaw_rad])), View())
    assert np.all(np.diff(path.azimuth_deg) >= 0)
    assert np.ptp(path.azimuth_deg) < np.degrees(0.41)


def test_the_eye_lies_against_the_direction_of_view():
    # Looking along +x and level from 3 m; then straight down.
    np.testing.assert_allclose(eye_position(np.array([1, 2, 0.5]), 3, 0, 0), [-2, 2, 0.5])
    np.testing.assert_allclose(
        eye_position(np.array([1, 2, 0.5]), 3, 0, -90), [1, 2, 3.5], atol=1e-12
    )


def box(centre_m: tuple[float, float, float], yaw_rad: float = 0.0) -> Boxes:
    """One box of 0.2 x 2 x 1 m."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    return Boxes(
        geom=np.array([0]),
        centre_m=np.array([centre_m], dtype=float),
        T_world_box=np.array([[[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]]),
        half_m=np.array([[0.1, 1.0, 0.5]]),
    )


EYE_M, ROBOT_M = np.array([-3.0, 0.0, 0.5]), np.array([[0.0, 0.0, 0.5]])


@pytest.mark.parametrize(
    ("boxes", "hidden"),
    [
        (box((-1, 0, 0.5)), True),
        (box((-1, 0.9, 0.5)), True),
        (box((-1, 1.1, 0.5)), False),  # beside the line
        (box((1, 0, 0.5)), False),  # behind the robot
        (box((-4, 0, 0.5)), False),  # behind the camera
        (box((-1, 0, 1.2)), False),  # above the line
        (box((-1, 0.9, 0.5), yaw_rad=np.pi / 2), False),  # turned along the line, beside it
        (box((-1, 0.05, 0.5), yaw_rad=np.pi / 2), True),
    ],
)
def test_only_what_stands_between_is_cut_away(boxes, hidden):
    assert hides(boxes, EYE_M, ROBOT_M).tolist() == [hidden]


def boxes_at(*extents: tuple[float, float, float, float], yaw_rad: float = 0.0) -> Boxes:
    """Boxes of x and y from, to, on a map that is turned."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    low, high = np.array([e[::2] for e in extents]), np.array([e[1::2] for e in extents])
    centre = np.column_stack([(low + high) / 2, np.full(len(low), 0.5)])
    return Boxes(
        geom=np.arange(len(low)),
        centre_m=centre @ turn.T,
        T_world_box=np.tile(turn, (len(low), 1, 1)),
        half_m=np.column_stack([(high - low) / 2, np.full(len(low), 0.5)]),
    )


@pytest.mark.parametrize("yaw_rad", [0.0, 0.7])
def test_small_boxes_that_touch_are_one_obstacle_and_walls_are_not(yaw_rad):
    plant = [(0, 0.4, 0, 0.1), (0.1, 0.3, 0.1, 0.2), (0.1, 0.3, -0.2, 0.0)]
    alone = [(0.5, 0.6, 0.0, 0.1)]
    walls = [(2, 6, 0, 0.2), (5.8, 6, 0.2, 4)]
    label = obstacles_of(boxes_at(*plant, *alone, *walls, yaw_rad=yaw_rad))
    assert len(set(label[:3])) == 1
    assert len(set(label)) == 4
    assert label[4] != label[5]


def test_between_moments_the_walk_goes_on_evenly():
    walk = recording_of(np.array([[0, 0, 3.0], [1, 0, 3.2], [1, 2, 3.2]]))
    shown = resampled(walk, np.array([-1.0, 0.0125, 0.0375, 9.0]))
    assert shown.qpos[:, :2] == pytest.approx(np.array([[0, 0], [0.5, 0], [1, 1], [1, 2]]))
    yaw_rad = 2 * np.arctan2(shown.qpos[:, 6], shown.qpos[:, 3])
    assert yaw_rad == pytest.approx([3.0, 3.1, 3.2, 3.2], abs=1e-6)
    assert np.linalg.norm(shown.qpos[:, 3:7], axis=1) == pytest.approx(1.0)
    assert resampled(recording_of(np.zeros((1, 3))), np.array([0.0, 1.0])).qpos.shape == (2, 7)


def test_a_caption_leaves_the_middle_as_it_is_and_what_does_not_fit_out():
    picture = np.zeros((360, 640, 3), np.uint8)
    done = captioned(picture, "a title", "1.0 s")
    assert not done[40:320].any()
    assert np.median(done[:10]) > 150
    assert done[350:, :200, 2].max() > done[350:, :200, 0].min()
    assert not picture.any()
    # No title over the time, and none at all on small pictures.
    long = captioned(np.zeros((360, 640, 3), np.uint8), "a title " * 30, "1.0 s")
    assert np.array_equal(long, captioned(np.zeros((360, 640, 3), np.uint8), "", "1.0 s"))
    assert not captioned(np.zeros((120, 160, 3), np.uint8), "a title", "1.0 s").any()


def test_what_is_to_be_seen_spreads_across_the_view():
    points_m = points_to_see(np.array([1.0, 0.0]), np.array([-3.0, 0.0, 2.0]))
    np.testing.assert_allclose(points_m[:, 0], 1.0)
    assert set(points_m[:, 1]) == {-0.25, 0.0, 0.25}


def test_tiles_fill_rows_and_leave_the_rest_white():
    pictures = [np.full((2, 3, 3), number, np.uint8) for number in range(3)]
    tiled = tile(pictures, 2)
    assert tiled.shape == (4, 6, 3)
    assert tiled[::2, ::3, 0].tolist() == [[0, 1], [2, 255]]


def test_without_a_gl_library_one_line_names_the_packages(monkeypatch):
    def broken(*_args, **_kwargs):
        return subprocess.CompletedProcess(args=(), returncode=1)

    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    monkeypatch.setattr(subprocess, "run", broken)
    with pytest.raises(NoGlError) as caught:
        prepare_gl()
    assert "\n" not in str(caught.value)
    for package in ("libegl1", "libgl1-mesa-dri", "libosmesa6"):
        assert package in str(caught.value)
    assert os.environ["MUJOCO_GL"] == "disable"


def test_the_way_that_was_asked_for_is_tried_first(monkeypatch):
    tried = []

    def note(*_args, env, **_kwargs):
        tried.append(env["MUJOCO_GL"])
        return subprocess.CompletedProcess(args=(), returncode=0 if len(tried) == 2 else 1)

    monkeypatch.setattr(platform, "system", lambda: "Linux")
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    monkeypatch.setattr(subprocess, "run", note)
    assert prepare_gl() == "egl"
    assert tried == ["osmesa", "egl"]
    assert os.environ["MUJOCO_GL"] == "egl"


def test_mujoco_can_be_imported_whatever_the_variable_says():
    code = "from sim.gl import switch_gl_off; switch_gl_off(); import mujoco"
    environment = {**os.environ, "MUJOCO_GL": "no such library"}
    assert run_python("-c", code, env=environment).returncode == 0


FOOT = FootShape(length_m=0.2, width_m=0.1)


def plan_of(*steps: tuple[Side, float]) -> FootstepPlan:
    """Steps of a side each, at x and the height 0.3."""
    return FootstepPlan(
        start_feet_world=feet_at((0, 0, 0), 0.2),
        start=(0, 0, 0),
        goal=(1, 0, 0),
        side=np.array([side for side, _ in steps], np.int8),
        pose_world=np.array([[x_m, 0, 0.3, 0] for _, x_m in steps]),
    )


def placed_at(side: Side, x_m: float, time_s: float) -> Placed:
    pose = np.array([x_m, 0.0, 0.3, 0.0])
    return Placed(side=side, asked_world=pose, placed_world=pose, time_s=time_s)


def shown(marks: list[Footmark], time_s: float) -> list[tuple[float, bool]]:
    """x and whether it is a full print, of all marks of that time."""
    now = (mark for mark in marks if mark.from_s <= time_s < mark.until_s)
    return sorted((mark.pose_world[0], mark.is_placed) for mark in now)


def test_a_planned_step_gives_way_to_where_the_foot_came_down():
    plans = [(0.0, plan_of((Side.LEFT, 1.0), (Side.RIGHT, 2.0)))]
    marks = footmarks_of(FOOT, plans, [placed_at(Side.LEFT, 1.01, 1.5)])
    assert shown(marks, 0.0) == [(1.0, False), (2.0, False)]
    assert shown(marks, 1.5) == [(1.01, True), (2.0, False)]
    assert shown(marks, 99.0) == [(1.01, True), (2.0, False)]


def test_a_new_plan_takes_the_place_of_the_old_one():
    plans = [
        (0.0, plan_of((Side.LEFT, 1.0), (Side.RIGHT, 2.0), (Side.LEFT, 3.0))),
        (1.5, plan_of((Side.RIGHT, 2.5))),
    ]
    marks = footmarks_of(
        FOOT, plans, [placed_at(Side.LEFT, 1.0, 1.5), placed_at(Side.RIGHT, 2.5, 2.5)]
    )
    assert shown(marks, 1.4) == [(1.0, False), (2.0, False), (3.0, False)]
    assert shown(marks, 1.5) == [(1.0, True), (2.5, False)]
    assert shown(marks, 2.5) == [(1.0, True), (2.5, True)]


def test_no_walk_leaves_no_marks():
    assert shown(footmarks_of(FOOT, [], []), 0.0) == []


def test_they_lie_on_the_ground_in_the_colour_of_their_foot():
    mujoco = pytest.importorskip("mujoco")
    marks = footmarks_of(FOOT, [(0.0, plan_of((Side.LEFT, 1.0), (Side.RIGHT, 2.0)))], [])
    scene = mujoco.MjvScene(mujoco.MjModel.from_xml_string("<mujoco/>"), 100)
    add_footmarks(scene, marks, 0.0)
    assert scene.ngeom == 2
    left, right = scene.geoms[0], scene.geoms[1]
    assert left.pos[0] == pytest.approx(1.0)
    assert left.pos[2] - left.size[2] == pytest.approx(0.3)
    assert list(left.size[:2]) == pytest.approx([0.1, 0.05])
    # Blue for the left foot, orange for the right one.
    assert left.rgba[2] > left.rgba[0]
    assert right.rgba[0] > right.rgba[2]
    full = mujoco.MjvScene(mujoco.MjModel.from_xml_string("<mujoco/>"), 1)
    add_footmarks(full, marks, 0.0)
    assert full.ngeom == 1


def portrait(path: Path, *words: str) -> np.ndarray:
    drawn_by("-m", "app.pictures.portrait", "--robot", "hrp5p", "--image", path, *words)
    return picture_at(path)


@pytest.mark.slow
def test_a_portrait_shows_the_robot_dressed_or_as_it_collides(tmp_path):
    dressed = portrait(tmp_path / "dressed.png")
    shapes = portrait(tmp_path / "shapes.png", "--shapes")
    assert dressed.shape == shapes.shape == (TILE_HEIGHT, TILE_WIDTH * len(VIEWS_DEG), 3)
    # The accents are orange; sky, floor and bare shapes have no such colour.
    for picture, coloured in ((dressed, True), (shapes, False)):
        blue, _, red = np.moveaxis(picture.astype(int), 2, 0)
        orange = red - blue > 60
        for view in np.split(orange, len(VIEWS_DEG), axis=1):
            assert (view.sum() > 100) == coloured


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--robot", "r2d2", "--image", "x.png"], "choose one of"),
        (["--image", "no/such/folder/x.png"], "not a folder"),
        (["--image", "x.pdf"], "must end in"),
        ([], "--image FILE must be given"),
    ],
)
def test_wrong_input_is_told_in_one_line(words, told, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert told in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("name", robot_names())
def test_looks_change_nothing_in_the_physics(name):
    robot = get_robot(name)
    plain = build_scene(robot, timestep_s=0.001)
    dressed = build_scene(robot, timestep_s=0.001, visuals=True)
    for field in ("body_mass", "body_inertia", "body_ipos", "body_iquat", "body_pos", "body_quat"):
        np.testing.assert_array_equal(getattr(plain.model, field), getattr(dressed.model, field))
    np.testing.assert_array_equal(plain.standing_qpos, dressed.standing_qpos)
    added = np.flatnonzero(dressed.model.geom_group == VISUAL_GROUP)
    assert dressed.model.ngeom == plain.model.ngeom + len(added)
    assert not dressed.model.geom_contype[added].any()
    assert not dressed.model.geom_conaffinity[added].any()
    assert dressed.model.ntex == 2


def test_jvrc1_wears_all_its_parts_where_its_shapes_are():
    scene = build_scene(get_robot("jvrc1"), timestep_s=0.001, visuals=True)
    assert scene.model.nmesh == 35
    assert (scene.model.geom_group == VISUAL_GROUP).sum() == 35
    # The mesh of each foot reaches down to the sole: vertices in the world, standing.
    data = standing(scene)
    for prefix, side in (("L", "left"), ("R", "right")):
        mesh = next(
            index
            for index in range(scene.model.nmesh)
            if scene.model.mesh(index).name.startswith(f"{prefix}_ANKLE_P_S")
        )
        geom = int(np.flatnonzero(scene.model.geom_dataid == mesh)[0])
        first, count = scene.model.mesh_vertadr[mesh], scene.model.mesh_vertnum[mesh]
        local = scene.model.mesh_vert[first : first + count]
        world = local @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        assert abs(world[:, 2].min()) < 0.005
        sole = data.site(f"{side}_sole").xpos
        assert np.all(np.abs(world[:, :2].mean(axis=0) - sole[:2]) < 0.06)
