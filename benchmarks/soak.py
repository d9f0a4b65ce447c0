"""A robot whose world changes: `python -m benchmarks.soak --goals N --seed S`.

The live navigator of the page, without a browser, as fast as it can: random goals, some changed on
the way; boxes put before the robot, on its goal, anywhere, and taken away again; pushes; other
maps. Every so often a box is asked for on the robot itself, which must be refused. The laws:

- No foot is set on a box that stood there before its step began.
- Every goal ends in arrival, or in a reason in words.
- Nothing is raised.
- Memory at the end is what it was after a tenth of the goals, within MEMORY_MB.

Prints how the goals ended and what broke a law, and exits with 1 if anything did; Ctrl-C ends it
early, with the count so far. What the planner answers comes whenever it is ready, so a seed repeats
the questions, not the walks.
"""

from __future__ import annotations

import contextlib
import math
import random
import signal
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro
from shapely import Polygon, box
from shapely.affinity import rotate, translate

from app.controllers import load_walker
from app.navigation.live_navigator import LiveNavigator
from app.navigation.planner_process import place_to_stand, somewhere_to_stand
from app.viewer.obstacles import Obstacle, snapped
from app.viewer.session import Session
from controller.gait import CONTROL_PERIOD_S
from controller.policy import Policy
from maps.map_files import load_map
from planner.plan import Pose
from planner.robot_model import FootShape
from sim.robot import Robot

MAPS = Path(__file__).resolve().parent.parent / "maps"
MEMORY_MB = 10.0
OVERLAP_M2 = 1e-4
PUSH_S = 0.1
# A walk that takes this long, in simulated or real time, has no end.
LONGEST_S, LONGEST_REAL_S = 300.0, 900.0


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """A robot whose world changes.

    goals: how many. seed: of all that is drawn. maps: names of maps that come along, swapped after
    every `per_map` goals. push: the largest push in N s.
    """

    goals: int = 100
    seed: int = 0
    robot: str = "jvrc1"
    maps: tuple[str, ...] = ("room", "office")
    per_map: int = 20
    push: float = 5.0


class Watch:
    """Looks at every control step of a session, in its thread, and notes what breaks a law."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self.broken: list[str] = []
        self.landings = 0
        self.tick = 0
        self._since: dict[Obstacle, int] = {}  # the control step from which each box has stood
        self._push_ends: int | None = None
        ticked, landed = session.history.ticked, session.history.landed

        def on_ticked(navigator: LiveNavigator) -> None:
            ticked(navigator)
            self._ticked(navigator)

        def on_landed(navigator: LiveNavigator) -> None:
            landed(navigator)
            self._landed(navigator)

        session.history.ticked = on_ticked  # type: ignore[method-assign,assignment]
        session.history.landed = on_landed  # type: ignore[method-assign,assignment]

    def set_obstacles(self, obstacles: Sequence[Obstacle]) -> None:
        """Puts these boxes, and no others, on the map."""
        self.session.set_obstacles(obstacles)

        def note() -> None:
            self._since = {box: self._since.get(box, self.tick) for box in obstacles}

        self.session.commands.put(note)

    def push(self, navigator: LiveNavigator, force_n: np.ndarray) -> None:
        """Pushes the pelvis for a moment; called in the session's thread."""
        navigator.walker.sim.push(force_n)
        self._push_ends = self.tick + round(PUSH_S / CONTROL_PERIOD_S)

    def _ticked(self, navigator: LiveNavigator) -> None:
        self.tick += 1
        if self._push_ends is not None and self.tick >= self._push_ends:
            navigator.walker.sim.push(np.zeros((1, 3)))
            self._push_ends = None

    def _landed(self, navigator: LiveNavigator) -> None:
        if not navigator.placed or navigator.has_ended:
            return
        self.landings += 1
        placed, robot = navigator.placed[-1], navigator.robot
        began = self.tick - math.ceil(robot.gait.step_s / CONTROL_PERIOD_S) - 1
        x_m, y_m = navigator.grid.world_to_grid(placed.placed_world[:2])
        yaw_rad = placed.placed_world[3] - navigator.grid.origin[2]
        sole = sole_polygon(robot.step_model.foot, float(x_m), float(y_m), float(yaw_rad))
        for obstacle, since in self._since.items():
            if since < began and sole.intersection(outline(obstacle)).area > OVERLAP_M2:
                self.broken.append(
                    f"a foot at {x_m:.2f}, {y_m:.2f} on box {obstacle}, which had stood there for "
                    f"{(self.tick - since) * CONTROL_PERIOD_S:.2f} s"
                )


def sole_polygon(foot: FootShape, x_m: float, y_m: float, yaw_rad: float) -> Polygon:
    """The sole on the floor."""
    half_x, half_y = foot.length_m / 2, foot.width_m / 2
    sole = box(-half_x, -half_y, half_x, half_y)
    return translate(rotate(sole, yaw_rad, origin=(0, 0), use_radians=True), x_m, y_m)


def outline(obstacle: Obstacle) -> Polygon:
    """What a box covers of the floor."""
    half_x, half_y = obstacle.size_x_m / 2, obstacle.size_y_m / 2
    x_m, y_m = obstacle.x_m, obstacle.y_m
    return box(x_m - half_x, y_m - half_y, x_m + half_x, y_m + half_y)


class Soak:
    """Goals and changes for one session after another."""

    def __init__(self, arguments: Arguments) -> None:
        self.arguments = arguments
        self.draw = random.Random(arguments.seed)
        self.robot, self.policy = load_walker(arguments.robot)
        self.ended: Counter[str] = Counter()
        self.changes: Counter[str] = Counter()
        self.broken: list[str] = []
        self.memory_mb: list[float] = []
        self.landings = 0

    def run(self) -> None:
        """Walks to all goals, on one map after another."""
        left = self.arguments.goals
        while left > 0:
            for name in self.arguments.maps:
                goals = min(left, self.arguments.per_map)
                if goals:
                    self._walk_on(name, goals, self.robot, self.policy)
                left -= goals

    def _walk_on(self, name: str, goals: int, robot: Robot, policy: Policy) -> None:
        grid = load_map(MAPS / f"{name}.yaml")
        session = Session(grid, robot, policy, seed=self.draw.randrange(2**31))
        start = somewhere_to_stand(session.setup.world)
        assert start is not None
        session.clock.factor = math.inf
        watch = Watch(session)
        session.start()
        session.reset(start)
        try:
            for _ in range(goals):
                self._walk(session, watch)
                self.memory_mb.append(memory_mb())
        finally:
            session.close()
            self.broken += watch.broken
            self.landings += watch.landings

    def _walk(self, session: Session, watch: Watch) -> None:
        """One goal and what happens on the way; notes how it ended."""
        boxes: list[Obstacle] = list(session.setup.obstacles)
        if session.snapshot.status.startswith(("fell", "collided")):
            self._stand_again(session, watch)
            boxes = []
        self._say_goal(session)
        until_s, began_s = time.monotonic() + LONGEST_REAL_S, watch.tick
        while True:
            self._await(session, watch, self.draw.uniform(1.0, 8.0), until_s)
            how = self._end_of(session)
            if how is not None:
                self.ended[how] += 1
                return
            walked_s = (watch.tick - began_s) * CONTROL_PERIOD_S
            if walked_s > LONGEST_S or time.monotonic() > until_s:
                self.broken.append(f"a goal without an end: {session.snapshot.status}")
                session.stop()
                self._await(session, watch, 5.0, time.monotonic() + LONGEST_REAL_S)
                return
            self._happen(session, watch, boxes)

    def _happen(self, session: Session, watch: Watch, boxes: list[Obstacle]) -> None:
        """Something changes."""
        what = self.draw.choice(("before", "goal", "anywhere", "away", "push", "new goal", "robot"))
        self.changes[what] += 1
        x_m, y_m, yaw_rad = where(session)
        grid, draw = session.setup.bare_grid, self.draw
        if what == "new goal":
            self._say_goal(session)
        elif what == "push":
            force_n = draw.uniform(0, self.arguments.push) / PUSH_S
            angle = draw.uniform(-math.pi, math.pi)
            force = force_n * np.array([[math.cos(angle), math.sin(angle), 0.0]])
            session.commands.put(lambda: watch.push(session._replanner.navigator, force))
        elif what == "away":
            boxes[:] = boxes[draw.randrange(len(boxes) + 1) :]
            watch.set_obstacles(boxes)
        else:
            goal = session.snapshot.goal
            if what == "before":
                away_m, angle = draw.uniform(0.5, 1.5), yaw_rad + draw.uniform(-0.5, 0.5)
                x_m, y_m = x_m + away_m * math.cos(angle), y_m + away_m * math.sin(angle)
            elif what == "goal" and goal is not None:
                x_m, y_m = goal[:2]
            elif what == "anywhere":
                x0, y0, x1, y1 = grid.bounds_world()
                x_m, y_m = draw.uniform(x0, x1), draw.uniform(y0, y1)
            x_m, y_m = grid.world_to_grid((x_m, y_m))
            obstacle = Obstacle(
                number=len(boxes),
                x_m=float(x_m),
                y_m=float(y_m),
                size_x_m=draw.uniform(0.1, 0.8),
                size_y_m=draw.uniform(0.1, 0.8),
            )
            obstacle = snapped(obstacle, grid)
            if session.is_on_robot(obstacle):
                self.changes["refused"] += 1
                return
            if what == "robot":
                self.broken.append("a box on the robot was not refused")
            boxes.append(obstacle)
            del boxes[:-8]
            watch.set_obstacles(boxes)

    def _say_goal(self, session: Session) -> None:
        """Sends the robot to a pose at which it can stand."""
        session.go_to(self._free_pose(session))

    def _free_pose(self, session: Session) -> Pose:
        x0, y0, x1, y1 = session.setup.bare_grid.bounds_world()
        while True:
            pose = (
                self.draw.uniform(x0, x1),
                self.draw.uniform(y0, y1),
                self.draw.uniform(-math.pi, math.pi),
            )
            if not place_to_stand(session.setup.world, pose)[0]:
                return pose

    def _stand_again(self, session: Session, watch: Watch) -> None:
        """Puts a robot that has fallen on its feet, on a map without boxes."""
        watch.set_obstacles([])
        bare = replace(session.setup, obstacles=())
        start = somewhere_to_stand(bare.world)
        session.reset(start)
        self._await(session, watch, 1.0, time.monotonic() + LONGEST_REAL_S)

    def _await(self, session: Session, watch: Watch, walked_s: float, until_s: float) -> None:
        """Lets so much simulated time go by, less where the goal has ended."""
        until = watch.tick + round(walked_s / CONTROL_PERIOD_S)
        while watch.tick < until and time.monotonic() < until_s:
            time.sleep(0.02)
            if self._end_of(session) is not None:
                return

    def _end_of(self, session: Session) -> str | None:
        """How the last goal ended; None while it goes on."""
        if not session.commands.empty():
            return None
        snapshot = session.snapshot
        notice = snapshot.notice.text if snapshot.notice is not None else ""
        if notice.startswith("a fault"):
            self.broken.append(notice)
            return "fault"
        if session.failure is not None:
            raise session.failure
        if snapshot.status in ("planning", "walking", "stopping") or snapshot.requested is not None:
            return None
        if snapshot.status == "standing" and not notice:
            return None  # the question is still to be asked
        how = snapshot.status.partition(":")[0]
        if how in ("standing", "stopped"):
            return "no plan" if notice else None
        if how != "reached" and ":" not in snapshot.status:
            self.broken.append(f"{how} without a reason")
        return how


def where(session: Session) -> Pose:
    """Where the robot's pelvis is, and its heading."""
    x_m, y_m, _, w, x, y, z = session.snapshot.qpos[:7]
    yaw_rad = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return float(x_m), float(y_m), yaw_rad


def memory_mb() -> float:
    """Memory of this process that is not shared with files."""
    for told in Path("/proc/self/status").read_text().splitlines():
        if told.startswith("RssAnon:"):
            return int(told.split()[1]) / 1000
    return 0.0


def main(arguments: Arguments) -> int:
    """Runs the soak and prints how it went; how often a law was broken."""
    soak = Soak(arguments)
    began_s = time.monotonic()
    # A shell that runs this in the background lets it ignore Ctrl-C.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with contextlib.suppress(KeyboardInterrupt):
        soak.run()
    first_mb, last_mb = soak.memory_mb[len(soak.memory_mb) // 10], soak.memory_mb[-1]
    if last_mb > first_mb + MEMORY_MB:
        soak.broken.append(f"memory grew from {first_mb:.0f} to {last_mb:.0f} MB")
    for told in soak.broken:
        print(told)
    print(
        f"{soak.ended.total()} goals: {dict(soak.ended)}; {soak.changes.total()} changes: "
        f"{dict(soak.changes)}; {soak.landings} steps; {first_mb:.0f} to {last_mb:.0f} MB; "
        f"{time.monotonic() - began_s:.0f} s"
    )
    print(f"{len(soak.broken)} times a law was broken")
    return len(soak.broken)


if __name__ == "__main__":
    sys.exit(1 if main(tyro.cli(Arguments, description=__doc__)) else 0)
