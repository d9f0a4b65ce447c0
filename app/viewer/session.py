"""One robot on one map in a physics thread of its own: it takes commands and gives snapshots."""

from __future__ import annotations

import contextlib
import copy
import math
import queue
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial, wraps
from typing import Any, Concatenate, ParamSpec

from app.navigation.live_navigator import LiveNavigator, Notice, WalkHistory
from app.navigation.navigator import Navigator, NavigatorConfig
from app.navigation.planner_process import BlockingPlanner, PlannerProcess, World, place_to_stand
from app.navigation.replanner import Replanner
from app.navigation.report import gait_line
from app.navigation.route import FootstepPlanner, Waypoint
from app.output import InputError
from app.viewer.obstacles import Obstacle, with_obstacles
from app.viewer.scenario import EditHistory, Scenario
from app.viewer.simulation_clock import SimulationClock
from app.viewer.snapshot import Snapshot
from controller.evaluation.gait_summary import GaitRecorder
from controller.gait import CONTROL_PERIOD_S
from controller.walker import Controller
from maps.grid import OccupancyGrid
from planner.options import SAMPLING_PLANNERS, PlannerOptions
from planner.plan import Pose, finite_pose
from sim.robot import Robot

# A box this near to the middle of the robot would be set down on it.
ROOM_FOR_ROBOT_M = 0.45
_IDLE_WAIT_S = 0.05
_SNAPSHOT_EVERY_S = 1 / 60
_LOADING = "loading the planner"
MOST_WAYPOINTS = 50


@dataclass(frozen=True, kw_only=True)
class WalkSetup:
    """All that a walk depends on besides its goal; `dataclasses.replace` makes another one.

    bare_grid: the map without the boxes, of the name map_name. start: where the robot is put.
    """

    bare_grid: OccupancyGrid
    robot: Robot
    policy: Controller
    start: Pose
    options: PlannerOptions
    seed: int
    obstacles: tuple[Obstacle, ...] = ()
    map_name: str = ""

    @cached_property
    def grid(self) -> OccupancyGrid:
        """The map with the boxes."""
        return with_obstacles(self.bare_grid, self.obstacles)

    @property
    def world(self) -> World:
        """What is planned over."""
        return World(grid=self.grid, model=self.robot.step_model, options=self.options)

    def navigator(self, goal: Pose, planner: FootstepPlanner | None) -> LiveNavigator:
        """A robot that stands at the start; without a planner it plans in this process."""
        return LiveNavigator(
            self.grid,
            self.robot,
            self.policy,
            start=self.start,
            goal=goal,
            seed=self.seed,
            config=NavigatorConfig(planner=self.options),
            planner=planner,
        )


P = ParamSpec("P")


def _queued(
    command: Callable[Concatenate[Session, P], None],
) -> Callable[Concatenate[Session, P], None]:
    """The command carried out by the session's thread; a call from any thread returns at once."""

    @wraps(command)
    def queued(session: Session, /, *args: P.args, **kwargs: P.kwargs) -> None:
        session.commands.put(partial(command, session, *args, **kwargs))

    return queued


class Session:
    """Runs the physics of a robot, and carries out commands from the page.

    The public methods may be called from any thread; `commands` are those that its own thread has
    yet to carry out. `snapshot` is what is seen now; `setup` is what the walk depends on; `history`
    keeps what the plots show; `on_tick`, if set before the start, is called after each tick, by the
    session's thread; `ended` is the first walk, once it is over; `failure` is why there is
    no planner, if it dies whenever it is started.
    """

    def __init__(
        self,
        grid: OccupancyGrid,
        robot: Robot,
        policy: Controller,
        *,
        start: Sequence[float] = (0.0, 0.0, 0.0),
        goal: Sequence[float] | None = None,
        options: PlannerOptions | None = None,
        seed: int = 0,
        map_name: str = "",
    ) -> None:
        """A robot that stands at the start, or with a `goal` one that walks as in `navigate`."""
        self.setup = WalkSetup(
            bare_grid=grid,
            robot=robot,
            policy=policy,
            start=finite_pose(start),
            options=options or PlannerOptions(),
            seed=seed,
            map_name=map_name,
        )
        self.commands: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._ending = threading.Event()
        self._gait_of: tuple[GaitRecorder, str] | None = None
        self._loading = _LOADING
        self._planner = PlannerProcess(self.setup.world)
        self._shown_s, self._shown_answer = -math.inf, -1
        self.clock = SimulationClock()
        self.history = WalkHistory()
        self.ended: Navigator | None = None
        self.failure: RuntimeError | None = None
        self.on_tick: Callable[[Replanner], None] | None = None
        navigator = self._standing() if goal is None else self._walking(finite_pose(goal))
        self._replanner = Replanner(self._planner, self.history, navigator)
        self._edits, self._is_edited, self._restores = EditHistory(self._scenario), False, 0
        self.snapshot = self._take_snapshot()
        self._thread = threading.Thread(target=self._run, name="physics", daemon=True)

    def start(self) -> None:
        """Begins to live."""
        self._thread.start()

    def close(self) -> None:
        """Ends the thread and the planner."""
        self._ending.set()
        if self._thread.is_alive():
            self._thread.join(timeout=5.0)
        self._planner.close()

    @property
    def planner_pid(self) -> int | None:
        """The process that plans."""
        return self._planner.process.pid

    @_queued
    def go_to(self, goal: Sequence[float], *, in_the_way: str = "") -> None:
        """Walk to this pose; `in_the_way` names what was seen there, such as "a box"."""
        self._is_edited = True
        self._replanner.ask(finite_pose(goal), fresh=True, in_the_way=in_the_way)

    @_queued
    def stop(self) -> None:
        """Stand still as soon as possible."""
        self._is_edited = True
        self._replanner.stop()

    @_queued
    def reset(self, start: Sequence[float] | None = None) -> None:
        """Stand at the pose `start`, or where it stood at first, whatever has happened.

        Where it cannot stand it is not put, and the nearest pose that is free is offered.
        """
        self._is_edited = True
        self._put(self.setup.start if start is None else finite_pose(start))

    @_queued
    def set_obstacles(self, obstacles: Sequence[Obstacle]) -> None:
        """These boxes stand on the map from now on, for planner and physics."""
        self._is_edited = True
        self._set_obstacles(tuple(obstacles))

    @_queued
    def set_waypoints(self, waypoints: Sequence[Waypoint]) -> None:
        """The way to the goal leads through these from now on, in their order."""
        self._is_edited = True
        self._set_waypoints(tuple(waypoints))

    @_queued
    def add_waypoint(self, waypoint: Waypoint) -> None:
        """The way to the goal leads through this one too, after the others."""
        self._is_edited = True
        self._set_waypoints((*self._replanner.waypoints, waypoint))

    @_queued
    def move_waypoint(self, waypoint: Waypoint, pose: Pose, goal: Pose) -> None:
        """Puts a waypoint that is ahead elsewhere, and walks to the goal through it."""
        self._is_edited, moved = True, replace(waypoint, pose=pose)
        ahead = self._replanner.waypoints
        self._set_waypoints(tuple(moved if other == waypoint else other for other in ahead))
        self._replanner.ask(goal, fresh=True)

    @_queued
    def undo(self) -> None:
        """Takes the last edit of start, goal, waypoints or boxes back."""
        self._restore(self._edits.undo(), "undo")

    @_queued
    def redo(self) -> None:
        """Makes the edit again that was taken back last."""
        self._restore(self._edits.redo(), "redo")

    @_queued
    def set_robot(self, robot: Robot, policy: Controller) -> None:
        """Another robot takes the place of this one at the start."""
        self._change(robot=robot, policy=policy)
        self._replanner.take(self._standing())

    @_queued
    def set_options(self, options: PlannerOptions) -> None:
        """Plan like this from now on."""
        self._change(options=options)
        self._replanner.plan_anew()

    def walk(self) -> Navigator:
        """The walk so far, as it is now; it stays so while the robot goes on."""
        walk = copy.copy(self._replanner.navigator)
        walk.plans, walk.placed = list(walk.plans), list(walk.placed)
        walk.followed, walk.qpos = list(walk.followed), list(walk.qpos)
        return walk

    def is_on_robot(self, obstacle: Obstacle, stood: Sequence[float] | None = None) -> bool:
        """Whether there is no room for the box because the robot stands there, or at a pose."""
        place = self.snapshot.qpos if stood is None else stood
        x_m, y_m = self.setup.bare_grid.world_to_grid(place[:2])
        return obstacle.distance_m(float(x_m), float(y_m)) < ROOM_FOR_ROBOT_M

    def _run(self) -> None:
        replanner = self._replanner
        while not self._ending.is_set():
            # A robot in a hurry would be past the place that the planner is thinking of.
            self.clock.is_idle = not replanner.navigator.going or replanner.question is not None
            self._run_commands(self._wait_s())
            self._try(replanner.listen)
            self._note_edits()
            self._look_for_planner()
            if replanner.navigator.rests:
                self.clock.skip()
            elif self.clock.is_due():
                self._try(self._tick)
            self._show()

    def _look_for_planner(self) -> None:
        """Notes what there is to wait for before a goal can be planned for."""
        if not self._loading or self.failure is not None:
            return
        try:
            compiling = self._planner.compiling
            if self._planner.is_ready():
                self._loading = ""
            elif compiling is not None:
                count = f"{compiling.done} of {compiling.functions} functions"
                self._loading = f"compiling the planner, once: {count}"
        except RuntimeError as error:
            self.failure = error

    def _run_commands(self, wait_s: float) -> None:
        """Carries out all that are there; waits for one for so long."""
        with contextlib.suppress(queue.Empty):
            self._carry_out(self.commands.get(block=wait_s > 0, timeout=wait_s))
            while True:
                self._carry_out(self.commands.get_nowait())

    def _carry_out(self, command: Callable[[], None]) -> None:
        self._try(command)
        self._note_edits()

    def _wait_s(self) -> float:
        """How long nothing needs to be done, unless a command comes."""
        rests, asks = self._replanner.navigator.rests, self._replanner.question is not None
        if rests and not asks:
            return _IDLE_WAIT_S
        # A plan that is on its way is looked for often.
        longest_s = 0.005 if asks else _IDLE_WAIT_S
        return min(math.inf if rests else self.clock.wait_s(), longest_s)

    def _try(self, action: Callable[[], None]) -> None:
        """What cannot be done is told of, and harms nothing; a fault stops the robot until told."""
        try:
            action()
        except (InputError, ValueError) as error:
            self._replanner.notice = Notice(text=str(error))
        except Exception as error:
            traceback.print_exc()
            self._replanner.navigator.idle_s = math.inf
            text = f"a fault of the program: {error}; reset the robot"
            self._replanner.notice = Notice(text=text)

    def _tick(self) -> None:
        navigator = self._replanner.navigator
        placed = len(navigator.placed)
        navigator.tick()
        self.clock.ticked(CONTROL_PERIOD_S)
        self.history.ticked(navigator)
        if len(navigator.placed) > placed or navigator.has_ended:
            self.history.landed(navigator)
        self._replanner.ticked()
        has_ended = navigator.outcome is not None and not self._replanner.goes_on
        if has_ended and self.ended is None:
            self.ended = copy.copy(navigator)
        if self.on_tick is not None:
            self.on_tick(self._replanner)

    def _show(self) -> None:
        """Now and then, and as soon as there is an answer."""
        answer, now_s = self._replanner.answer_of, time.monotonic()
        if answer != self._shown_answer or now_s - self._shown_s >= _SNAPSHOT_EVERY_S:
            self._shown_s, self._shown_answer = now_s, answer
            self.snapshot = self._take_snapshot()

    def _take_snapshot(self) -> Snapshot:
        """The robot, its plan and its walk so far."""
        replanner, history = self._replanner, self.history
        navigator = replanner.navigator
        plan, done = replanner.shown_plan
        return Snapshot(
            qpos=navigator.qpos[-1],
            time_s=navigator.time_s,
            walk=history.walk,
            start=self.setup.start,
            goal=replanner.goal,
            requested=replanner.requested,
            plan=plan,
            done=done,
            placed_side=history.placed_side,
            placed_world=history.placed_world,
            foot_error_m=history.foot_error_m,
            path_world=history.path_world,
            status=navigator.status(is_asking=replanner.question is not None),
            replans=navigator.replans,
            answer_s=replanner.answer_s,
            clearance_m=history.clearance_m,
            goal_error=navigator.goal_error if navigator.plans else None,
            speed=self.clock.reached,
            gait=self._gait(navigator),
            loading=self._loading,
            notice=replanner.notice,
            obstacles=self.setup.obstacles,
            restores=self._restores,
            waypoints=replanner.waypoints,
            answer=replanner.answer,
        )

    def _gait(self, navigator: Navigator) -> str:
        """How the walk went; empty while it goes on, and where it was too short to tell."""
        if navigator.outcome is None:
            return ""
        if self._gait_of is None or self._gait_of[0] is not navigator.gait:
            gait = navigator.gait.summary()
            self._gait_of = navigator.gait, "" if gait is None else gait_line(gait)
        return self._gait_of[1]

    @property
    def _scenario(self) -> Scenario:
        return Scenario(
            start=self.setup.start,
            goal=self._replanner.wanted,
            waypoints=self._replanner.waypoints,
            obstacles=self.setup.obstacles,
        )

    def _note_edits(self) -> None:
        """Notes what people have set, and what has become of it."""
        self._edits.note(self._scenario, is_edit=self._is_edited)
        self._is_edited = False

    def _restore(self, wanted: Scenario | None, what: str) -> None:
        """Lets this scenario hold; a walk whose start it changes, or that failed, begins anew."""
        if wanted is None:
            self._replanner.notice = Notice(text=f"there is nothing to {what}")
            return
        self._restores += 1
        now = self._scenario
        begins_anew = wanted.start != now.start or self._replanner.navigator.has_ended
        if wanted.obstacles != now.obstacles:
            self._set_obstacles(wanted.obstacles)
        if begins_anew:
            self._put(wanted.start)
        is_other_way = wanted.waypoints != now.waypoints
        self._replanner.waypoints = wanted.waypoints
        has_other_goal = begins_anew or wanted.goal != now.goal
        if wanted.goal is None and has_other_goal and not begins_anew:
            self._replanner.stop()
        elif wanted.goal is not None and has_other_goal:
            self._replanner.ask(wanted.goal, fresh=True)
        elif is_other_way:
            self._replanner.plan_anew()

    def _put(self, wanted: Pose) -> None:
        blocked, alternative = place_to_stand(self.setup.world, wanted)
        if blocked:
            text = f"the robot cannot stand there: {blocked}"
            self._replanner.notice = Notice(
                text=text, refused=wanted, alternative=alternative, puts_robot=True
            )
            return
        self.setup = replace(self.setup, start=wanted)
        self._replanner.take(self._standing())

    def _set_obstacles(self, obstacles: tuple[Obstacle, ...]) -> None:
        self._change(obstacles=obstacles)
        self._replanner.navigator.set_grid(self.setup.grid, self._planner)
        self._replanner.plan_anew()

    def _set_waypoints(self, waypoints: tuple[Waypoint, ...]) -> None:
        if len(waypoints) > MOST_WAYPOINTS:
            raise InputError(f"{MOST_WAYPOINTS} waypoints are as many as there can be")
        self._replanner.waypoints = tuple(
            replace(waypoint, pose=finite_pose(waypoint.pose)) for waypoint in waypoints
        )
        self._replanner.plan_anew()

    def _change(self, **changes: Any) -> None:
        self.setup = replace(self.setup, **changes)
        self._planner.set_world(self.setup.world)

    def _standing(self) -> LiveNavigator:
        """A robot that stands at the start."""
        navigator = self.setup.navigator(self.setup.start, self._planner)
        # Sensors tell of the step before: there must be one.
        navigator.tick()
        return navigator

    def _walking(self, goal: Pose) -> LiveNavigator:
        """A robot with a goal that plans for itself, in this process if that is quick."""
        is_slow = self.setup.options.name in SAMPLING_PLANNERS
        planner = BlockingPlanner(self._planner) if is_slow else None
        navigator = self.setup.navigator(goal, planner)
        navigator.going = navigator.plan().found
        self.ended = None if navigator.going else copy.copy(navigator)
        return navigator
