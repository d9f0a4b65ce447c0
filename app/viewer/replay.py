"""A walk as one web page that needs no server: robot, map, footprints and a time slider."""

from __future__ import annotations

import base64
import html
import json
import re
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from viser.infra import StateSerializer

from app.navigation.placed import Placed
from app.output import ProgressBar, write_text
from app.pictures.canvas import LEFT, RIGHT, hex_of
from app.pictures.rendering import Recording
from app.viewer.camera import aim_pages, overview
from app.viewer.markers import Footprints, Marker
from app.viewer.scene import (
    DARK,
    LIGHT,
    Palette,
    RobotMeshes,
    RobotScene,
    add_floor,
    add_lights,
    robot_meshes_of,
)
from app.viewer.server import open_server
from maps.grid import OccupancyGrid
from planner.plan import FootstepPlan
from sim.robot import Robot

FRAMES_PER_S = 20.0
# A long walk gets fewer frames, so that the file stays one that can be sent by mail.
MAX_FRAMES = 1600
_PLOTTED = 600  # points of a plot
# Of the window in which it is likely to be watched.
_ASPECT = 1.6
# Shapes of windows, from an upright phone to a wide screen; each has a camera of its own.
_ASPECTS = tuple(np.geomspace(0.4, 2.5, 20).round(3).tolist())


@dataclass(frozen=True, kw_only=True)
class Story:
    """What happened: the walk, the plans with the times at which they were taken up, the steps.

    `title` says who walked where, `outcome` how it ended.
    """

    recording: Recording
    plans: tuple[tuple[float, FootstepPlan], ...]
    placed: tuple[Placed, ...]
    goal: tuple[float, ...]
    title: str = "Footfall"
    outcome: str = ""


def write_replay(path: Path, grid: OccupancyGrid, robot: Robot, story: Story) -> None:
    """Writes the walk as a web page that opens from disk, light or dark as the browser asks for.

    Raises:
        InputError: The file cannot be written.
    """
    meshes, frames = robot_meshes_of(robot), frame_indices(story.recording)
    with ProgressBar("replay, frames", 2 * (len(frames) - 1)) as bar:
        light, dark = (
            _recorded(grid, robot, meshes, story, palette, bar, shown)
            for palette, shown in ((LIGHT, 0), (DARK, len(frames) - 1))
        )
    title = f"<title>{html.escape(story.title)}</title>"
    page = re.sub(r"<title>[^<]*</title>", lambda _: title, light.as_html(), count=1)
    choice = _CHOICE.replace("DARK", base64.b64encode(dark.serialize()).decode())
    cameras = [[aspect, _camera(grid, aspect)] for aspect in _ASPECTS]
    choice = choice.replace("CAMERAS", json.dumps(cameras))
    # After viser's own data, before the script that reads them.
    head, rest = page.split("</head>", 1)
    body, tail = rest.rsplit("</body>", 1)
    write_text(path, f"{head}{choice}</head>{body}{panel_of(story)}</body>{tail}")


def _recorded(
    grid: OccupancyGrid,
    robot: Robot,
    meshes: RobotMeshes,
    story: Story,
    palette: Palette,
    bar: ProgressBar,
    shown: int,
) -> StateSerializer:
    """The walk on a map in these colours; the bar has shown so many frames before."""
    server = open_server(title="Footfall")
    try:
        # Before the recording begins: what comes later moves the camera while the walk plays.
        aim_pages(server, overview(grid, _ASPECT, beside_panel=False))
        add_lights(server.scene)
        add_floor(server.scene, grid, palette)
        goal = Marker(server.scene, "/goal", height_m=lambda pose: float(grid.height_m(pose[:2])))
        goal.show(story.goal)
        stage = _Stage(
            RobotScene(server.scene, meshes), Footprints(server.scene, grid, robot.step_model.foot)
        )
        stage.show(story, 0)
        recorder = server.get_scene_serializer()
        frames, time_s = frame_indices(story.recording), story.recording.time_s
        for number, (before, now) in enumerate(pairwise(frames), start=shown + 1):
            recorder.insert_sleep(float(time_s[now] - time_s[before]))
            stage.show(story, int(now))
            bar.update(number)
        # Time for the last frame to be seen before the player begins anew.
        recorder.insert_sleep(2.0)
        return recorder
    finally:
        server.stop()


def _camera(grid: OccupancyGrid, aspect: float) -> list[float]:
    """Where the camera is, in m, that shows the whole map in a window of this shape."""
    position_m = overview(grid, aspect, beside_panel=False).position_m
    return [round(float(along_m), 3) for along_m in position_m]


def panel_of(story: Story) -> str:
    """The part of the page that tells of the moment shown: numbers, legend and plots over time.

    It follows the player's slider. Lines: height of the pelvis over the ground; bars: how far each
    foot came down from its step, at the time at which it did.
    """
    recording = story.recording
    shown = np.unique(np.linspace(0, len(recording.time_s) - 1, _PLOTTED).round().astype(int))
    ground_m = np.broadcast_to(recording.ground_m, recording.time_s.shape)
    data = {
        "time": recording.time_s[shown].round(2).tolist(),
        "pelvis": (recording.qpos[:, 2] - ground_m)[shown].round(4).tolist(),
        "steps": [[s.time_s, int(s.side), round(100 * s.error_m, 2)] for s in story.placed],
        "end": float(recording.time_s[-1]),
        "outcome": story.outcome,
    }
    # No text in it can end the script.
    text = json.dumps(data).replace("<", "\\u003c")
    left, right = hex_of(LEFT), hex_of(RIGHT)
    filled = _PANEL.replace("TITLE", html.escape(story.title)).replace("DATA", text)
    return filled.replace("LEFT", left).replace("RIGHT", right)


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


# What viser's player reads before it begins: which recording, and from the address the camera.
_CHOICE = """
<script>
(() => {
  if (matchMedia('(prefers-color-scheme: dark)').matches) {
    window.__VISER_EMBED_DATA__ = 'DARK';
    window.__VISER_EMBED_CONFIG__ = {darkMode: true};
  }
  const cameras = CAMERAS, aspect = innerWidth / innerHeight, address = new URL(location.href);
  const [, position] = cameras.filter(([least]) => least <= aspect).pop() || cameras[0];
  address.searchParams.set('initialCameraPosition', position.join(','));
  history.replaceState(null, '', address);
})();
</script>
"""
_PANEL = """
<style>
#walk { position: fixed; right: 12px; top: 12px; width: 300px; z-index: 4; padding: 8px 12px;
  font: 13px/1.5 system-ui, sans-serif; color: #2d3036; background: #ffffffe6; border-radius: 6px;
  box-shadow: 0 1px 4px #0003; --told: #6b7078; --behind: #f3f4f6; }
@media (prefers-color-scheme: dark) {
  #walk { color: #e6e8eb; background: #24272ce6; --told: #a3a9b2; --behind: #34383f; }
}
#walk summary { font-weight: 600; cursor: pointer; overflow-wrap: anywhere; }
#walk table { border-spacing: 0; font-variant-numeric: tabular-nums; }
#walk td:first-child { color: var(--told); padding-right: 10px; }
#walk i { display: inline-block; width: 18px; height: 10px; margin-right: 6px; }
#walk svg { width: 100%; height: 56px; background: var(--behind); display: block; }
@media (max-width: 700px) { #walk { width: 200px; font-size: 11px; } }
</style>
<details id="walk" open>
<summary>TITLE</summary>
<table>
<tr><td>time</td><td id="walk-time"></td></tr>
<tr><td>step</td><td id="walk-step"></td></tr>
<tr><td>foot from its step</td><td id="walk-error"></td></tr>
<tr><td>outcome</td><td id="walk-outcome"></td></tr>
</table>
<div><i style="background: LEFT"></i>left foot <i style="background: RIGHT; margin-left: 12px"></i>
right foot<br>pale as planned, full the next two, frames as placed</div>
<div>pelvis over the ground, <span id="walk-pelvis"></span></div><svg id="walk-height"></svg>
<div>feet from their steps, up to <span id="walk-most"></span></div><svg id="walk-errors"></svg>
</details>
<script>
(() => {
  const walk = DATA, at = id => document.getElementById('walk-' + id);
  const width = 276, height = 56, colours = ['LEFT', 'RIGHT'], end = Math.max(walk.end, 1e-9);
  if (innerWidth < 700) document.getElementById('walk').open = false;
  const low = Math.min(...walk.pelvis), high = Math.max(...walk.pelvis);
  const most = Math.max(0.1, ...walk.steps.map(step => step[2]));
  const x = time => (width * time / end).toFixed(1);
  const y = share => (height - 4 - share * (height - 8)).toFixed(1);
  const line = walk.time.map((time, k) =>
    x(time) + ',' + y((walk.pelvis[k] - low) / Math.max(high - low, 1e-3))).join(' ');
  const cursor = '<line class="now" y1="0" y2="' + height + '" stroke="currentColor"/>';
  const bars = walk.steps.map(([time, side, error]) => '<line x1="' + x(time) + '" x2="' + x(time)
    + '" y1="' + y(0) + '" y2="' + y(error / most) + '" stroke-width="4" stroke="'
    + colours[side] + '"/>').join('');
  for (const [id, drawn] of [['height',
    '<polyline fill="none" stroke="#9a6fb0" points="' + line + '"/>'], ['errors', bars]]) {
    at(id).setAttribute('viewBox', '0 0 ' + width + ' ' + height);
    at(id).setAttribute('preserveAspectRatio', 'none');
    at(id).innerHTML = drawn + cursor;
  }
  at('pelvis').textContent = low.toFixed(2) + ' to ' + high.toFixed(2) + ' m';
  at('most').textContent = most.toFixed(1) + ' cm';
  let shown = -1;
  const show = () => {
    const slider = document.querySelector('[role=slider]');
    const time = Math.min(slider ? Number(slider.getAttribute('aria-valuenow')) : 0, walk.end);
    if (time !== shown) {
      shown = time;
      const done = walk.steps.filter(step => step[0] <= time + 1e-6), last = done[done.length - 1];
      at('time').textContent = time.toFixed(1) + ' of ' + walk.end.toFixed(1) + ' s';
      at('step').textContent = done.length + ' of ' + walk.steps.length;
      at('error').textContent = last ? last[2].toFixed(1) + ' cm' : 'none yet';
      at('outcome').textContent = time >= walk.end - 0.05 ? walk.outcome : 'walking';
      for (const now of document.querySelectorAll('#walk .now')) {
        now.setAttribute('x1', x(time)); now.setAttribute('x2', x(time));
      }
    }
    requestAnimationFrame(show);
  };
  show();
})();
</script>
"""
