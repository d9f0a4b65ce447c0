"""The replay: a page of its own whose recording says what happened, when, and where."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import replace

import msgspec
import numpy as np
import pytest
import zstandard

from app.navigation.placed import Placed
from app.pictures.rendering import Recording
from app.viewer.camera import FIELD_OF_VIEW_RAD
from app.viewer.replay import FRAMES_PER_S, MAX_FRAMES, Story, frame_indices, write_replay
from app.viewer.scene import DARK, LIGHT, robot_meshes_of
from maps.grid import OccupancyGrid
from planner.plan import FootstepPlan, feet_at
from planner.robot_model import Side
from sim.robots import get_robot, robot_names
from sim.scene import build_scene

STEP_S = 0.5
GRID = OccupancyGrid(cells=np.zeros((40, 60), np.uint8), resolution_m=0.05)


def recorded(page: str, *, dark: bool = False) -> dict:
    """What the page's player is given: durationSeconds, and messages as (time, message)."""
    (embedded,) = re.findall(
        r"__VISER_EMBED_DATA__ = '([^']+)'" if dark else r'__VISER_EMBED_DATA__="([^"]+)"', page
    )
    data = base64.b64decode(embedded)
    plain = zstandard.ZstdDecompressor().decompressobj().decompress(data[8:])
    length = int.from_bytes(plain[:8], "little")
    return msgspec.msgpack.decode(plain[8 : 8 + length])


@pytest.fixture(scope="module")
def story() -> Story:
    """Two seconds in which the robot slides along x and two steps are placed."""
    robot = get_robot("jvrc1")
    standing = build_scene(robot, timestep_s=0.001).standing_qpos
    time_s = np.arange(0, 2.001, 0.025)
    qpos = np.tile(standing, (len(time_s), 1))
    qpos[:, 0] += time_s / 10
    feet, goal_feet = feet_at((0, 0, 0), 0.2), feet_at((0.2, 0, 0), 0.2)
    plan = FootstepPlan(
        start_feet_world=feet,
        start=(0, 0, 0),
        goal=(0.2, 0, 0),
        side=np.array([Side.LEFT, Side.RIGHT]),
        pose_world=goal_feet,
    )
    placed = tuple(
        Placed(
            side=side,
            asked_world=goal_feet[side],
            placed_world=goal_feet[side],
            time_s=STEP_S * (1 + side),
        )
        for side in Side
    )
    return Story(
        recording=Recording(qpos=qpos, time_s=time_s),
        plans=((0.0, plan),),
        placed=placed,
        goal=(0.2, 0, 0),
        title="A walk & more",
        outcome="reached </script> & all",
    )


@pytest.fixture(scope="module")
def page(story, tmp_path_factory) -> str:
    path = tmp_path_factory.mktemp("replay") / "walk.html"
    cells = np.zeros((40, 60), np.uint8)
    cells[0], cells[-1] = 1, 2
    grid = OccupancyGrid(cells=cells, resolution_m=0.05, origin=(-1.0, -1.0, 0.0))
    write_replay(path, grid, get_robot("jvrc1"), story)
    return path.read_text(encoding="utf-8")


def test_a_panel_tells_of_steps_errors_and_outcome(page):
    (text,) = re.findall(r"const walk = (\{.*?\}), at = ", page)
    told = json.loads(text)
    # Left comes down 0.5 s, right 1 s after the start, both where they were asked to.
    assert told["steps"] == [[0.5, 0, 0.0], [1.0, 1, 0.0]]
    assert told["outcome"] == "reached </script> & all"
    assert told["end"] == pytest.approx(2.0)
    assert (told["time"][0], told["time"][-1]) == (0.0, 2.0)
    assert len(told["pelvis"]) == len(told["time"]) == 81
    assert told["pelvis"][40] == pytest.approx(0.8086, abs=1e-3)
    assert page.count("<title>A walk &amp; more</title>") == 1
    assert "<summary>A walk &amp; more</summary>" in page
    assert "LEFT" not in page[page.index('<details id="walk"') :]


def test_it_plays_as_long_as_the_walk_and_a_little_more(page):
    assert recorded(page)["durationSeconds"] == pytest.approx(2.0 + 2.0)


def test_in_the_dark_the_same_walk_is_on_a_dark_floor(page):
    def told(dark: bool) -> tuple[list, list]:
        messages = recorded(page, dark=dark)["messages"]
        moved = [
            (time_s, message["name"], message["position"])
            for time_s, message in messages
            if message["type"] == "SetPositionMessage"
        ]
        drawn = {m["name"]: m["props"] for _, m in messages if "props" in m}
        return moved, drawn["/map/floor"]["color"]

    (moved, light), (moved_too, dark) = told(False), told(True)
    assert moved == moved_too
    assert tuple(light) == LIGHT.floor
    assert tuple(dark) == DARK.floor


def test_cameras_show_the_whole_map_in_windows_of_all_shapes(page):
    """A camera for each shape, the map's corners in the window of the narrowest that it is for."""
    (text,) = re.findall(r"const cameras = (\[.*?\]), aspect = ", page)
    cameras = json.loads(text)
    assert cameras[0][0] < 390 / 844 < 2560 / 1080 < cameras[-1][0]
    middle_m = np.array([-1.0 + 60 * 0.05 / 2, -1.0 + 40 * 0.05 / 2, 0.0])
    corners_m = middle_m + np.array([[x, y, 0] for x in (-1.5, 1.5) for y in (-1.0, 1.0)])
    for aspect, position_m in cameras:
        forward = middle_m - np.array(position_m)
        forward /= np.linalg.norm(forward)
        up = np.cross([1.0, 0.0, 0.0], forward)
        away_m = corners_m - np.array(position_m)
        half = np.tan(FIELD_OF_VIEW_RAD / 2) * (away_m @ forward)
        assert np.all(np.abs(away_m[:, 0]) < aspect * half)
        assert np.all(np.abs(away_m @ up) < half)


def test_it_is_small_and_names_no_script_elsewhere(page):
    assert len(page) < 2_000_000
    assert not re.findall(r'<(?:script|link)[^>]+(?:src|href)="(?!data:)', page)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["jvrc1", "hrp5p"])
def test_a_walk_of_forty_seconds_can_be_sent_by_mail(name, story, tmp_path):
    """Below 6 MB, though every joint moves all the time, and each in its own way."""
    robot = get_robot(name)
    standing = build_scene(robot, timestep_s=0.001).standing_qpos
    time_s = np.arange(0, 40.001, 0.025)
    qpos = np.tile(standing, (len(time_s), 1))
    qpos[:, 0] += time_s / 10
    qpos[:, 7:] += np.random.default_rng(0).normal(0, 0.1, (len(time_s), qpos.shape[1] - 7))
    path = tmp_path / "walk.html"
    moved = replace(story, recording=Recording(qpos=qpos, time_s=time_s))
    write_replay(path, GRID, robot, moved)
    assert recorded(path.read_text(encoding="utf-8"))["durationSeconds"] == pytest.approx(42)
    assert path.stat().st_size < 6_000_000


def test_the_pelvis_is_where_it_was(page):
    messages = recorded(page)["messages"]
    seen = [
        (time_s, message["position"])
        for time_s, message in messages
        if message["type"] == "SetPositionMessage" and message["name"] == "/robot/pelvis"
    ]
    assert len(seen) == 2.0 * FRAMES_PER_S + 1
    first = seen[0][1]
    for time_s, position in seen:
        assert position[0] - first[0] == pytest.approx(time_s / 10, abs=2e-3)
        assert position[1:] == pytest.approx(first[1:], abs=1e-3)


def test_footprints_appear_when_the_feet_come_down(page):
    messages = recorded(page)["messages"]
    shown = {
        message["name"]: time_s
        for time_s, message in messages
        if message["type"] == "SceneNodeUpdateMessage" and "/placed_" in message["name"]
    }
    assert shown["/steps/placed_left"] == pytest.approx(STEP_S, abs=1 / FRAMES_PER_S)
    assert shown["/steps/placed_right"] == pytest.approx(2 * STEP_S, abs=1 / FRAMES_PER_S)


def test_nothing_moves_the_camera_while_it_plays(page):
    cameras = [
        time_s for time_s, message in recorded(page)["messages"] if "Camera" in message["type"]
    ]
    assert cameras
    assert not any(cameras)


def test_a_long_walk_gets_fewer_frames(story):
    time_s = np.arange(0, 1000.0, 0.025)
    indices = frame_indices(Recording(qpos=np.zeros((len(time_s), 7)), time_s=time_s))
    assert len(indices) == MAX_FRAMES
    assert indices[0] == 0
    assert indices[-1] == len(time_s) - 1


@pytest.mark.parametrize("name", robot_names())
def test_each_robot_has_a_look(name):
    robot = get_robot(name)
    meshes = robot_meshes_of(robot)
    standing = build_scene(robot, timestep_s=0.001).standing_qpos
    positions, quaternions = meshes.poses(standing)
    assert len(positions) == len(quaternions) == len(meshes.names) == len(meshes.parts) > 5
    assert "pelvis" in meshes.names
    assert all(parts for parts in meshes.parts)
