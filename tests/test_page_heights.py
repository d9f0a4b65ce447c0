"""The page on a floor that is not flat: what lies on it lies at its height."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import viser

from app.viewer.map_scene import add_floor
from app.viewer.markers import Footprints, Marker
from app.viewer.obstacle_editor import ObstacleEditor
from app.viewer.obstacles import Obstacle
from app.viewer.pointer import surface_of
from app.viewer.server import open_server
from maps.map_files import load_map
from planner.robot_model import FootShape, Side
from sim.scene import WALL_HEIGHT_M

STAIRS = load_map("maps/stairs.yaml")


@pytest.fixture
def scene() -> Iterator[viser.SceneApi]:
    server = open_server(title="heights")
    yield server.scene
    server.stop()


async def nothing(_event: object) -> None:
    """What a click does here."""


def shown(scene: viser.SceneApi, name: str) -> np.ndarray:
    """Vertices (n, 3) of a mesh of the scene that are not put aside."""
    handle: Any = scene._handle_from_node_name[name]
    vertices = np.array(handle.vertices)
    return vertices[vertices[:, 2] > -0.5]


def test_the_ground_is_drawn_as_high_as_it_is(scene):
    add_floor(scene, STAIRS)
    tops = [
        shown(scene, name)[:, 2].max()
        for name in scene._handle_from_node_name
        if name.startswith("/map/ground/")
    ]
    assert sorted(tops) == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    walls = shown(scene, "/map/walls")
    assert walls[:, 2].max() == pytest.approx(0.6 + WALL_HEIGHT_M)
    assert walls[:, 2].min() == 0


def test_footprints_path_and_goal_lie_on_the_ground(scene):
    footprints = Footprints(scene, STAIRS, FootShape(length_m=0.2, width_m=0.1))
    poses = np.array([[2.15, 0.1, 0.1, 0.0], [4.1, 0.1, 0.6, 0.3]])
    footprints.plan(np.array([Side.LEFT, Side.LEFT]), poses)
    soles = shown(scene, "/steps/planned_left")[:8]
    assert soles[:4, 2] == pytest.approx(0.1, abs=0.02)
    assert soles[4:, 2] == pytest.approx(0.6, abs=0.02)
    assert soles[:4, :2].mean(axis=0) == pytest.approx(poses[0, :2])
    # From the floor up the first step and on.
    footprints.path(np.array([[1.8, 0.0], [1.95, 0.0], [2.1, 0.0], [2.25, 0.0]]))
    path = shown(scene, "/path")[:12].reshape(3, 4, 3)
    assert path[:, :, 2].max(axis=1) == pytest.approx([0.0, 0.1, 0.1], abs=0.02)
    marker = Marker(scene, "/goal", height_m=surface_of(STAIRS).height_m)
    for goal, ground_m in (((4.1, 0.0, 0.0), 0.6), ((0.0, 0.0, 1.0), 0.0)):
        marker.show(goal)
        assert marker._arrow.position[2] == pytest.approx(ground_m, abs=0.05)


def test_boxes_stand_on_the_ground(scene):
    boxes: list[Obstacle] = []
    obstacle_editor = ObstacleEditor(
        scene,
        STAIRS,
        on_change=boxes.extend,
        is_refused=lambda _: "",
        on_refused=pytest.fail,
        on_click=nothing,
    )
    obstacle_editor.add((4.1, 0.0), (0.4, 0.4))
    assert len(boxes) == 1
    drawn = scene._handle_from_node_name["/map/box_0"]
    assert drawn.position[2] == pytest.approx(0.6 + WALL_HEIGHT_M / 2)
