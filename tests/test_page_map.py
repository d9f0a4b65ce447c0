"""The map on the page: what a click meets first, heights, and boxes drawn as one solid."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import trimesh
import viser

from app.viewer.markers import Footprints, Marker
from app.viewer.obstacles import Obstacle, ObstacleEditor, snapped
from app.viewer.pointer import FLOOR, WALL, Surface, SurfaceHit, surface_of
from app.viewer.scene import add_floor, solid
from app.viewer.server import open_server
from maps.grid import OccupancyGrid
from maps.map_files import load_map
from planner.plan import FootstepPlan
from planner.robot_model import FootShape, Side
from sim.scene import WALL_HEIGHT_M

# A hall of 3 by 2 m with a wall across it, from x = 1.0 to 1.1 m; walls are 1 m high.
CELLS = np.zeros((20, 30), np.uint8)
CELLS[:, 10] = 1
HALL = OccupancyGrid(cells=CELLS, resolution_m=0.1)


def met(surface: Surface, origin: tuple[float, ...], direction: tuple[float, ...]) -> SurfaceHit:
    found = surface.met(origin, direction)
    assert found is not None
    return found


def place(found: SurfaceHit) -> tuple[float, float, float]:
    return found.x_m, found.y_m, found.z_m


def check(found: SurfaceHit, on: int, place_m: tuple[float, float, float]) -> None:
    assert found.on == on
    assert place(found) == pytest.approx(place_m)


def test_a_ray_that_meets_nothing_before_ends_on_the_floor():
    found = met(surface_of(HALL), (2.0, 1.0, 1.5), (0.5, -0.25, -1.0))
    assert found.on == FLOOR
    assert place(found) == pytest.approx((2.75, 0.625, 0.0))


def test_a_wall_is_no_glass():
    # Toward the floor at x = 2.5 behind the wall: at x = 1 the ray is 0.6 m high.
    found = met(surface_of(HALL), (0.0, 1.0, 1.0), (2.5, 0.0, -1.0))
    assert found.on == WALL
    assert place(found) == pytest.approx((1.0, 1.0, 0.6))
    # From the other side it is the other face.
    found = met(surface_of(HALL), (2.5, 1.0, 1.0), (-2.5, 0.1, -1.0))
    assert place(found) == pytest.approx((1.1, 1.056, 0.44))


def test_a_wall_has_a_top_and_may_be_looked_over():
    found = met(surface_of(HALL), (0.05, 1.0, 3.0), (1.0, 0.0, -2.0))
    check(found, WALL, (1.05, 1.0, 1.0))
    # At x = 1.1 it is 1.1 m high still.
    found = met(surface_of(HALL), (0.0, 1.0, 3.3), (1.0, 0.0, -2.0))
    check(found, FLOOR, (1.65, 1.0, 0.0))
    found = met(surface_of(HALL), (1.05, 0.5, 3.0), (0.0, 0.0, -1.0))
    check(found, WALL, (1.05, 0.5, 1.0))


def test_what_the_eye_is_in_is_glass():
    found = met(surface_of(HALL), (1.05, 1.0, 0.5), (1.0, 0.0, -1.0))
    check(found, FLOOR, (1.55, 1.0, 0.0))


def test_beyond_the_map_is_floor_and_above_the_horizon_nothing():
    surface = surface_of(HALL)
    found = met(surface, (2.0, 1.0, 1.0), (2.0, 0.0, -1.0))
    check(found, FLOOR, (4.0, 1.0, 0.0))
    found = met(surface, (5.0, 9.0, 1.0), (0.0, 0.1, -1.0))
    check(found, FLOOR, (5.0, 9.1, 0.0))
    assert surface.met((2.0, 1.0, 1.5), (1.0, 0.0, 0.1)) is None
    # A ray that rises may meet a wall all the same.
    assert met(surface, (2.0, 1.0, 0.5), (-1.0, 0.0, 0.1)).on == WALL


def test_a_box_hides_what_is_behind_it_and_has_a_number():
    box = snapped(Obstacle(number=7, x_m=2.0, y_m=1.0, size_x_m=0.2, size_y_m=0.2), HALL)
    surface = surface_of(HALL).with_boxes([box])
    found = met(surface, (2.0, 0.0, 0.9), (0.0, 1.8, -0.9))
    check(found, 7, (2.0, 0.9, 0.45))
    assert met(surface_of(HALL), (2.0, 0.0, 0.9), (0.0, 1.8, -0.9)).on == FLOOR
    beside = met(surface, (2.2, 0.0, 0.9), (0.0, 1.8, -0.9))
    check(beside, FLOOR, (2.2, 1.8, 0.0))


def test_a_map_may_be_turned_in_the_world():
    turned = OccupancyGrid(cells=CELLS, resolution_m=0.1, origin=(5.0, -3.0, math.pi / 2))
    # The grid's x is the world's y, and its y the world's -x.
    found = met(surface_of(turned), (4.0, -3.0, 1.0), (0.0, 2.5, -1.0))
    check(found, WALL, (4.0, -2.0, 0.6))


def test_on_steps_a_ray_ends_on_the_tread_or_at_the_riser():
    # Floor at 0.1 m, and at 0.3 m from x = 1 on.
    heights = np.full((20, 30), 0.1)
    heights[:, 10:] = 0.3
    cells = np.zeros((20, 30), np.uint8)
    stairs = surface_of(OccupancyGrid(cells=cells, resolution_m=0.1, elevation_m=heights))
    for origin, direction, wanted in (
        ((2.0, 1.0, 1.3), (0.0, 0.1, -1), (2.0, 1.1, 0.3)),
        ((0.5, 1.0, 1.1), (0.0, 0.1, -1), (0.5, 1.1, 0.1)),
        ((0.5, 1.0, 1.3), (0.8, 0.0, -1), (1.3, 1.0, 0.3)),
        ((2.0, 1.0, 1.3), (-1.2, 0.0, -1), (0.56, 1.0, 0.1)),
        ((0.0, 1.0, 0.7), (2.0, 0.0, -1), (1.0, 1.0, 0.2)),
    ):
        found = met(stairs, origin, direction)
        check(found, FLOOR, wanted)


def test_walls_are_as_high_as_they_are_drawn():
    surface = surface_of(load_map("maps/stairs.yaml"))
    assert surface.top_m.max() == pytest.approx(0.6 + WALL_HEIGHT_M)
    assert set(np.unique(surface.on)) <= {FLOOR, WALL}
    assert surface.top_m[surface.on == FLOOR].max() == pytest.approx(0.6)


def test_rays_meet_what_small_steps_along_them_meet():
    rng = np.random.default_rng(5)
    cells = (rng.random((20, 30)) < 0.15).astype(np.uint8)
    surface = surface_of(OccupancyGrid(cells=cells, resolution_m=0.1))
    seen = set()
    for _ in range(100):
        origin = np.array([*rng.uniform(-1, 3, 2), rng.uniform(1.1, 3)])
        target = np.array([*rng.uniform(0.05, (2.95, 1.95)), 0.0])
        found = surface.met(origin, target - origin)
        for share in np.linspace(0, 1, 2001):
            point = origin + share * (target - origin)
            col, row = np.floor(point[:2] / 0.1).astype(int)
            on_map = 0 <= row < 20 and 0 <= col < 30
            if on_map and point[2] <= (1.0 if cells[row, col] else 0.0):
                break
        assert found is not None
        # Small steps may cut a corner of a wall; the ray may not, and meets nothing that is not.
        assert math.dist(place(found), origin) < math.dist(point, origin) + 1e-3
        ahead = np.array(place(found)) + 1e-9 * (target - origin)
        col, row = np.floor(ahead[:2] / 0.1).astype(int)
        assert cells[row, col] == (found.on == WALL)
        assert 0 <= found.z_m <= (1.0 + 1e-9 if found.on == WALL else 1e-9)
        seen.add(found.on)
    assert seen == {FLOOR, WALL}


STAIRS = load_map("maps/stairs.yaml")


@pytest.fixture
def scene() -> Iterator[viser.SceneApi]:
    server = open_server(title="heights")
    yield server.scene
    server.stop()


async def nothing(_event: object) -> None:
    """What a click does here."""


def node(scene: viser.SceneApi, name: str) -> Any:
    found = scene.get_handle_by_name(name)
    assert found is not None, name
    return found


def shown(scene: viser.SceneApi, name: str) -> np.ndarray:
    """Vertices (n, 3) of a mesh of the scene that are not put aside."""
    vertices = np.array(node(scene, name).vertices)
    return vertices[vertices[:, 2] > -0.5]


def test_the_ground_is_drawn_as_high_as_it_is(scene):
    add_floor(scene, STAIRS)
    tops = [
        shown(scene, name)[:, 2].max()
        for name in (f"/map/ground/{shade}" for shade in range(100))
        if scene.get_handle_by_name(name)
    ]
    assert sorted(tops) == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    walls = shown(scene, "/map/walls")
    assert walls[:, 2].max() == pytest.approx(0.6 + WALL_HEIGHT_M)
    assert walls[:, 2].min() == 0


def test_footprints_path_and_goal_lie_on_the_ground(scene):
    footprints = Footprints(scene, STAIRS, FootShape(length_m=0.2, width_m=0.1))
    poses = np.array([[2.15, 0.1, 0.1, 0.0], [4.1, 0.1, 0.6, 0.3]])
    plan = FootstepPlan(
        start_feet_world=poses,
        start=(0, 0, 0),
        goal=(4, 0, 0),
        side=np.array([Side.RIGHT, Side.LEFT, Side.LEFT, Side.LEFT], np.int8),
        pose_world=np.concatenate([poses, poses]),
    )
    footprints.plan(plan)
    assert len(shown(scene, "/steps/next_right")) == len(shown(scene, "/steps/next_left")) == 4
    soles = shown(scene, "/steps/planned_left")
    assert len(soles) == 8
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
        assert node(scene, "/goal").position[2] == pytest.approx(ground_m, abs=0.05)


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
    assert node(scene, "/map/box_0").position[2] == pytest.approx(0.6 + WALL_HEIGHT_M / 2)


def mesh(boxes: list[list[float]], rise_m: float = 1.0) -> trimesh.Trimesh:
    vertices_m, faces = solid(np.array(boxes), base_m=0.0, rise_m=rise_m, cell_m=0.5)
    return trimesh.Trimesh(vertices_m, faces, process=False)


def test_two_boxes_that_touch_have_the_faces_of_one():
    # 2 x 1 m and 1 m high, cut in two: a lid in two pieces, and five upright faces less.
    drawn = mesh([[0.5, 0.5, 0.5, 0.5, 0.0], [1.5, 0.5, 0.5, 0.5, 0.0]])
    assert drawn.area == pytest.approx(2 * 1 + (2 + 1 + 2 + 1) * 1)
    assert len(drawn.faces) == 2 * (2 + 4)
    lo, hi = drawn.bounds
    assert (*lo, *hi) == pytest.approx((0, 0, 0, 2, 1, 1))


def test_the_higher_one_shows_what_the_lower_one_does_not_hide():
    drawn = mesh([[0.5, 0.5, 0.5, 0.5, 0.0], [1.5, 0.5, 0.5, 0.5, 0.5]])
    step = (drawn.triangles_center[:, 0] == 1.0) & (np.abs(drawn.face_normals[:, 0]) > 0.5)
    assert drawn.area_faces[step].sum() == pytest.approx(0.5)
    # It looks to where it is lower.
    assert drawn.face_normals[step, 0] == pytest.approx(-1)


def test_all_faces_look_outward():
    drawn = mesh([[-1.25, 3.0, 0.75, 0.5, 0.0]])
    away = drawn.triangles_center - (-1.25, 3.0, 0.5)
    assert len(away) == 10
    assert (np.einsum("fi,fi->f", drawn.face_normals, away) > 0.4).all()


def test_boxes_that_are_put_back_are_drawn_where_they_were(scene):
    changes: list[Any] = []
    editor = ObstacleEditor(
        scene,
        STAIRS,
        on_change=changes.append,
        is_refused=lambda _: "",
        on_refused=pytest.fail,
        on_click=nothing,
    )
    editor.add((0.0, 0.0), (0.4, 0.4))
    editor.add((1.0, 0.0), (0.4, 0.4))
    ((first,), (_, second)) = changes
    moved = Obstacle(number=1, x_m=first.x_m, y_m=second.y_m, size_x_m=0.8, size_y_m=0.4)
    editor.put([moved])
    assert scene.get_handle_by_name("/map/box_0") is None
    drawn = node(scene, "/map/box_1")
    assert tuple(drawn.position[:2]) == (first.x_m, second.y_m)
    assert tuple(drawn.dimensions[:2]) == (0.8, 0.4)
    editor.put([second, first])
    assert tuple(node(scene, "/map/box_1").position[:2]) == (second.x_m, second.y_m)
    # Nobody was told: it is others who set them. The one added last goes first.
    assert len(changes) == 2
    editor.remove_last()
    assert changes[-1] == (second,)
