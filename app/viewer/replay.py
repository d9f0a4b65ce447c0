"""A walk as one web page that needs no server: robot, map, footprints and a time slider."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from app.navigation.navigator import Placed
from app.output import ProgressBar, write_text
from app.pictures.rendering import Recording
from app.viewer.camera import aim_pages, overview
from app.viewer.markers import Footprints, Marker
from app.viewer.scene import RobotScene, add_floor, robot_meshes_of
from app.viewer.server import open_server
from maps.grid import OccupancyGrid
from planner.plan import FootstepPlan
from sim.robot import Robot

FRAMES_PER_S = 20.0
# A long walk gets fewer frames, so that the file stays one that can be sent by mail.
MAX_FRAMES = 1600
# Of the window in which it is likely to be watched.
_ASPECT = 1.6


@dataclass(frozen=True, kw_only=True)
class Story:
    """What happened: the walk, the plans with the times at which they were taken up, the steps."""

    recording: Recording
    plans: tuple[tuple[float, FootstepPlan], ...]
    placed: tuple[Placed, ...]
    goal: tuple[float, ...]


def write_replay(path: Path, grid: OccupancyGrid, robot: Robot, story: Story) -> None:
    """Writes the walk as a web page that opens from disk.

    Raises:
        InputError: The file cannot be written.
    """
    server = open_server(title="Footfall")
    try:
        # Before the recording begins: what comes later moves the camera while the walk plays.
        aim_pages(server, overview(grid, _ASPECT, beside_panel=False))
        add_floor(server.scene, grid)
        goal = Marker(server.scene, "/goal", height_m=lambda pose: float(grid.height_m(pose[:2])))
        goal.show(story.goal)
        stage = _Stage(
            RobotScene(server.scene, robot_meshes_of(robot)),
            Footprints(server.scene, grid, robot.step_model.foot),
        )
        frames = frame_indices(story.recording)
        stage.show(story, 0)
        recorder = server.get_scene_serializer()
        time_s = story.recording.time_s
        with ProgressBar("replay, frames", len(frames)) as bar:
            for number, (before, now) in enumerate(pairwise(frames)):
                recorder.insert_sleep(float(time_s[now] - time_s[before]))
                stage.show(story, int(now))
                bar.update(number + 1)
        # Time for the last frame to be seen before the player begins anew.
        recorder.insert_sleep(2.0)
        page = recorder.as_html()
    finally:
        server.stop()
    write_text(path, page)


def frame_indices(recording: Recording) -> np.ndarray:
    """Which moments of the recording are shown: evenly spaced, the first and the last included."""
    seconds = float(recording.time_s[-1] - recording.time_s[0])
    count = int(np.clip(round(seconds * FRAMES_PER_S) + 1, 1, MAX_FRAMES))
    times = np.linspace(recording.time_s[0], recording.time_s[-1], count)
    return np.unique(recording.nearest(times))


class _Stage:
    """Shows one moment of a story; what has not changed since the last is not sent again."""

    def __init__(self, robot_scene: RobotScene, footprints: Footprints) -> None:
        self._robot_scene, self._footprints, self._shown = robot_scene, footprints, (-1, -1)

    def show(self, story: Story, moment: int) -> None:
        self._robot_scene.pose(story.recording.qpos[moment])
        time_s = float(story.recording.time_s[moment])
        plans = sum(begun_s <= time_s for begun_s, _ in story.plans)
        placed = sum(step.time_s <= time_s for step in story.placed)
        if (plans, placed) == self._shown or plans == 0:
            return
        self._shown = plans, placed
        begun_s, plan = story.plans[plans - 1]
        done = sum(begun_s < step.time_s <= time_s for step in story.placed)
        self._footprints.plan(plan, done)
        steps = story.placed[:placed]
        side = np.array([step.side for step in steps], np.int8)
        poses = np.array([step.placed_world for step in steps]).reshape(-1, 4)
        self._footprints.placed(side, poses)
        # Four points a second make a smooth path.
        self._footprints.path(story.recording.qpos[: moment + 1 : 10, :2])
