"""The page: scene, controls and pointer brought together around a session."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from app.controllers import load_walker
from app.navigation.live_navigator import Notice
from app.navigation.planner_process import somewhere_to_stand
from app.navigation.route import Waypoint
from app.viewer.access import Access
from app.viewer.address import Addresses, Link, is_same
from app.viewer.camera import Cameras
from app.viewer.map_chooser import MapChooser
from app.viewer.markers import Footprints, PoseMarkers
from app.viewer.obstacles import Obstacle, ObstacleEditor, boxes_of, cells_below, obstacles_of
from app.viewer.panel import Panel
from app.viewer.planner_marks import PlannerMarks, SearchMarks
from app.viewer.pointer import (
    FLOOR,
    ROBOT,
    WALL,
    FloorPointer,
    Pointed,
    SurfaceHit,
    Tool,
    facing,
    surface_of,
)
from app.viewer.scene import RobotScene, add_floor, add_lights, robot_meshes_of
from app.viewer.server import LOCAL, PageServer, open_server
from app.viewer.session import Session
from app.viewer.snapshot import Snapshot
from app.viewer.theme import ThemeSwitches
from app.viewer.waypoints import WaypointMarkers
from controller.observation import pelvis_yaw_rad
from controller.walker import Controller
from maps.grid import OccupancyGrid
from planner.options import PlannerOptions
from planner.plan import Pose
from sim.robot import Robot
from sim.robots import robot_names

FRAMES_PER_S = 30.0
# Nobody watches: just so often that whoever comes sees what is.
_UNSEEN_FRAMES_PER_S = 4.0
_NOTICE_FOR_S = 12.0
_IN_THE_WAY = {WALL: "an obstacle of the map", 0: "a box"}


class Maps(NamedTuple):
    """Maps among which a page lets choose, and the name of the one that is there."""

    all: dict[str, Path]
    chosen: str


class WantedMap(NamedTuple):
    """A map that somebody has chosen: a place to stand on it, and the link that asked for it."""

    name: str
    grid: OccupancyGrid
    start: Pose
    link: Link | None = None


class Page:
    """Shows a session to whoever opens the page, and passes their commands on.

    `wanted_map` is what somebody has chosen instead of this map.

    Words are shown anew every `text_every_s`, plots every `plot_every_s`, all else at every frame.
    """

    text_every_s = 0.25
    plot_every_s = 0.5

    def __init__(
        self,
        server: PageServer,
        session: Session,
        *,
        robots: tuple[str, ...],
        load: Callable[[str], tuple[Robot, Controller]],
        maps: Maps | None = None,
    ) -> None:
        self.server, self.session, self._load = server, session, load
        self._grid, self._tool = session.setup.bare_grid, Tool.GOAL
        self._notice: Notice | None = None
        self._notice_until_s = 0.0
        self._shown: Snapshot | None = None
        self._text_s = self._plot_s = 0.0
        self._drawing = threading.Lock()
        scene, grid, robot = server.scene, self._grid, session.setup.robot
        self._bare_surface = surface_of(grid)
        add_lights(scene)
        self._pointer = FloorPointer(
            add_floor(scene, grid),
            self._bare_surface,
            on_pose=self._pointed,
            meets_robot=self._meets_robot,
            on_drag=self._hold_camera,
            on_waypoint=self._waypoint_pointed,
        )
        self._planner_marks, self._search_marks = PlannerMarks(scene), SearchMarks(scene)
        self._pose_markers = PoseMarkers(scene, lambda pose: self._pointer.surface.height_m(pose))
        self._waypoint_markers = WaypointMarkers(
            scene, lambda pose: self._pointer.surface.height_m(pose)
        )
        self.obstacle_editor = ObstacleEditor(
            scene,
            grid,
            on_change=self._boxes_changed,
            is_refused=self._why_refused,
            on_refused=self._say,
            on_click=self._pointer.clicked,
            on_drag=self._hold_camera,
        )
        self._footprints = Footprints(scene, grid, robot.step_model.foot)
        self._robot_scene = RobotScene(scene, robot_meshes_of(robot))
        self.panel = Panel(
            server.gui,
            session,
            self.obstacle_editor,
            robots=robots,
            set_robot=self._set_robot,
            use_tool=self._use,
            toggle_follow=lambda client_id: self.cameras.toggle(client_id),
            say=self._say,
        )
        self.wanted_map: WantedMap | None = None
        self._link: Link | None = None
        self.map_chooser: MapChooser | None = None
        if maps is not None:
            with server.gui.add_folder("Map", order=self.panel.map_order, expand_by_default=False):
                self.map_chooser = MapChooser(
                    server.gui, maps=maps.all, chosen=maps.chosen, on_map=self._want, say=self._say
                )
        self.cameras = Cameras(
            server,
            grid,
            order=self.panel.switch_order,
            met=lambda *ray: self._pointer.surface.met(*ray),
        )
        self._themes = ThemeSwitches(server, order=self.panel.theme_order)
        self._addresses = Addresses(server, follow=self.follow, say=self._say)
        # Whoever goes in the middle of a drag points at nothing any more.
        server.on_client_disconnect(lambda _client: self._pose_markers.point(None))

    def _want(self, name: str, grid: OccupancyGrid) -> None:
        start = somewhere_to_stand(replace(self.session.setup.world, grid=grid))
        if start is None:
            self._say(f"{name}: the robot can stand nowhere on this map")
        else:
            self.wanted_map = WantedMap(name, grid, start, self._link)

    @property
    def link(self) -> Link:
        """What opens a page like this one."""
        now, setup = self.session.snapshot, self.session.setup
        goal = now.requested or now.goal
        return Link(
            map=setup.map_name,
            robot=setup.robot.option,
            start=now.start,
            via=now.waypoints,
            goal=goal,
            boxes=boxes_of(now.obstacles, self._grid),
        )

    def follow(self, link: Link) -> None:
        """Does what a link asks for; what is so already stays as it is."""
        now = self.link
        if link.map not in ("", now.map):
            if self.map_chooser is None or not self.map_chooser.has(link.map):
                self._say(f"the map {link.map} of the link is not here: choose or send it")
                return
            self._link = link
            self.map_chooser.choose(link.map)
            self._link = None
            return
        begins_anew = link.robot not in ("", now.robot)
        if begins_anew and link.robot not in self.panel.robot.options:
            self._say(f"the robot {link.robot} of the link is not here")
            return
        if begins_anew:
            self.panel.robot.value = link.robot
        is_put = link.start is not None and not is_same(link.start, now.start)
        if link.boxes is not None:
            # Before it is put there: it may be where a box stands that goes.
            stood = (link.start or now.start) if begins_anew or is_put else None
            self._put_boxes(obstacles_of(link.boxes, self._grid), stood)
        if is_put:
            self.session.reset(link.start)
            begins_anew = True
        is_other_goal = link.goal is not None and not is_same(link.goal, now.goal)
        if begins_anew or is_other_goal or not link.leaves(now.via):
            self.session.set_waypoints(link.via)
        if link.goal is not None and (begins_anew or is_other_goal):
            self.session.go_to(link.goal)

    @property
    def visitors(self) -> int:
        """How many have the page open."""
        return self.cameras.count

    def wait_for_visitor(self) -> None:
        """Shows the scene as it is until somebody has opened the page."""
        self.run(is_over=lambda: bool(self.server.get_clients()))

    def run(self, is_over: Callable[[], bool] = lambda: False) -> None:
        """Shows what happens until `is_over`, or for ever; a frame that fails ends the page."""
        while not is_over():
            began_s = time.monotonic()
            self.show(self.session.snapshot)
            rate = FRAMES_PER_S if self.server.get_clients() else _UNSEEN_FRAMES_PER_S
            time.sleep(max(0.0, 1 / rate - (time.monotonic() - began_s)))

    def show(self, snapshot: Snapshot) -> None:
        """Draws one moment; what has not changed since the last is left alone."""
        with self._drawing, self.server.atomic():
            if len(snapshot.qpos) != self._robot_scene.meshes.model.nq:
                return  # The robot has just been exchanged for another one.
            self._robot_scene.pose(snapshot.qpos)
            self._pose_markers.show(snapshot)
            self._waypoint_markers.show(snapshot.waypoints, snapshot.notice)
            self._planner_marks.show(snapshot.notice, self.session.setup.world)
            self._search_marks.show(snapshot.answer, self.session.setup.world)
            self._show_steps(snapshot)
            if self._shown is not None and snapshot.restores != self._shown.restores:
                self.obstacle_editor.put(snapshot.obstacles)
                self._pointer.surface = self._bare_surface.with_boxes(snapshot.obstacles)
            self._shown = snapshot
        place = snapshot.qpos[:2]
        ground_m = np.array([*place, float(self._grid.height_m(place))])
        self.cameras.show(ground_m, float(pelvis_yaw_rad(snapshot.qpos[None])[0]))
        self._themes.show()
        now_s = time.monotonic()
        if now_s - self._text_s >= self.text_every_s:
            self._text_s = now_s
            self._addresses.show(self.link)
            self.panel.show(snapshot, self._notice if now_s < self._notice_until_s else None)
        if now_s - self._plot_s >= self.plot_every_s:
            self._plot_s = now_s
            self.panel.plots.show_forces(self.session.history.forces())

    def _show_steps(self, new: Snapshot) -> None:
        old, footprints = self._shown, self._footprints
        if old is None or new.plan is not old.plan or new.done != old.done:
            footprints.plan(new.plan, new.done)
        if old is None or new.placed_side is not old.placed_side:
            footprints.placed(new.placed_side, new.placed_world)
            footprints.path(new.path_world)
            self.panel.plots.show_errors(new.placed_side, new.foot_error_m)

    def _say(self, text: str) -> None:
        self._notice, self._notice_until_s = Notice(text=text), time.monotonic() + _NOTICE_FOR_S

    def _use(self, tool: Tool) -> None:
        self._tool = tool
        self._pointer.use(tool)
        self.obstacle_editor.use(can_move=tool is Tool.BOX)

    def _pointed(self, pointed: Pointed, on: int, is_final: bool) -> None:
        if self._tool is Tool.BOX:
            self._box_pointed(pointed, on)
            return
        qpos = self.session.snapshot.qpos
        yaw_rad = float(pelvis_yaw_rad(qpos[None])[0])
        pose = facing(pointed, (float(qpos[0]), float(qpos[1])), yaw_rad)
        self._pose_markers.point(None if is_final else pose)
        if is_final and self._tool is Tool.ROBOT:
            self.session.reset(pose)
        elif is_final:
            self.session.go_to(pose, in_the_way=_IN_THE_WAY.get(min(on, 0), ""))

    def _waypoint_pointed(self, pointed: Pointed, on: int) -> None:
        if on != FLOOR:
            self._say("a waypoint lies on the floor")
            return
        now = self.session.snapshot
        qpos = now.qpos
        before = (float(qpos[0]), float(qpos[1])), float(pelvis_yaw_rad(qpos[None])[0])
        if now.waypoints:
            pose = now.waypoints[-1].pose
            before = pose[:2], pose[2]
        waypoint = Waypoint(pose=facing(pointed, *before), stands=self.panel.waypoints.stands)
        self.session.add_waypoint(waypoint)

    def _box_pointed(self, pointed: Pointed, on: int) -> None:
        if on == ROBOT:
            self._say("that is the robot: boxes stand on the floor")
        elif on == WALL:
            self._say("an obstacle of the map stands there: boxes stand on the floor")
        elif on == FLOOR:
            self.obstacle_editor.add(pointed[:2], self.panel.box_size_m)
        else:
            self.obstacle_editor.remove(on)

    def _meets_robot(self, origin: ArrayLike, direction: ArrayLike) -> tuple[float, SurfaceHit]:
        x_m, y_m = (float(value) for value in self.session.snapshot.qpos[:2])
        ground_m = float(self._grid.height_m((x_m, y_m)))
        where = SurfaceHit(x_m=x_m, y_m=y_m, z_m=ground_m, on=ROBOT)
        return self._robot_scene.hit_distance_m(origin, direction), where

    def _boxes_changed(self, obstacles: Sequence[Obstacle]) -> None:
        self._pointer.surface = self._bare_surface.with_boxes(obstacles)
        self.session.set_obstacles(obstacles)

    def _put_boxes(self, wanted: Sequence[Obstacle], stood: Pose | None) -> None:
        """Sets these boxes and no others; `stood` is where the robot is about to be put."""
        now = self.session.snapshot.obstacles
        if [cells_below(it, self._grid) for it in wanted] == [
            cells_below(it, self._grid) for it in now
        ]:
            return
        free = tuple(it for it in wanted if not self.session.is_on_robot(it, stood))
        if len(free) < len(wanted):
            self._say("no box can stand on the robot: one of the link is left out")
        self.obstacle_editor.put(free)
        self._boxes_changed(free)

    def _hold_camera(self, client_id: int) -> None:
        self.cameras.hold(client_id)

    def _why_refused(self, obstacle: Obstacle) -> str:
        return "no box can stand on the robot" if self.session.is_on_robot(obstacle) else ""

    def _set_robot(self, name: str) -> None:
        """Exchanges the robot; one that nothing can walk is refused."""
        try:
            robot, policy = self._load(name)
            meshes = robot_meshes_of(robot)
        except Exception as error:
            # Whatever is wrong with a robot is told on the page, and the one that is there stays.
            self._say(f"{name} cannot be chosen: {error}")
            return
        with self._drawing:
            self._robot_scene.remove()
            self._footprints.clear()
            self.session.set_robot(robot, policy)
            self._footprints = Footprints(self.server.scene, self._grid, robot.step_model.foot)
            self._robot_scene = RobotScene(self.server.scene, meshes)
            self._shown = None


@contextlib.contextmanager
def open_page(
    grid: OccupancyGrid,
    robot: Robot,
    policy: Controller,
    *,
    title: str,
    map_name: str = "",
    host: str = LOCAL,
    names: Sequence[str] = (),
    access: Access | None = None,
    port: int = 0,
    start: Sequence[float] = (0.0, 0.0, 0.0),
    goal: Sequence[float] | None = None,
    options: PlannerOptions | None = None,
    seed: int = 0,
    load: Callable[[str], tuple[Robot, Controller]] = load_walker,
    robots: Sequence[str] = (),
    maps: Maps | None = None,
) -> Iterator[Page]:
    """A page about one robot on one map; on leaving, robot, planner and server end.

    Neither the robot lives nor is the page drawn until somebody says so: `page.session.start()`,
    `page.run()`. `load` gives the robots among which the page lets choose: this one, those that
    come along, and `robots`; `maps` are the maps, if it lets choose any. For names and access see
    `open_server`.

    Raises:
        InputError: The address cannot be had.
    """
    with contextlib.ExitStack() as stack:
        server = open_server(host=host, port=port, title=title, names=names, access=access)
        stack.callback(server.stop)
        session = Session(
            grid,
            robot,
            policy,
            start=start,
            goal=goal,
            options=options,
            seed=seed,
            map_name=map_name,
        )
        stack.callback(session.close)
        choice = tuple(dict.fromkeys((*robot_names(), *robots, robot.option)))
        page = Page(server, session, robots=choice, load=load, maps=maps)
        if page.map_chooser is not None:
            stack.callback(page.map_chooser.close)
        yield page
