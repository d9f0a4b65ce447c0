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
from dataclasses import dataclass, field, replace
from functools import cached_property, partial, wraps
from typing import Any, Concatenate, ParamSpec

import numpy as np

from app.navigation.live_navigator import LiveNavigator, Notice, Replanner, WalkHistory
from app.navigation.navigator import FootstepPlanner, Navigator, NavigatorConfig
from app.navigation.planner_process import BlockingPlanner, PlannerProcess, World, place_to_stand
from app.navigation.report import NavigationReport, gait_line
from app.output import InputError
from app.viewer.obstacles import Obstacle, with_obstacles
from controller.evaluation.gait_summary import GaitRecorder
from controller.gait import CONTROL_PERIOD_S
from controller.walker import Controller
from maps.grid import OccupancyGrid
from planner.options import SAMPLING_PLANNERS, PlannerOptions
from planner.plan import FootstepPlan, Pose, finite_pose
from sim.robot import Robot

# Simulated time that is behind real time by more than this is not caught up.
_FORGIVEN_S = 0.5
_MEASURED_OVER_S = 1.0
# A box this near to the middle of the robot would be set down on it.
ROOM_FOR_ROBOT_M = 0.45
_IDLE_WAIT_S = 0.05
_SNAPSHOT_EVERY_S = 1 / 60
_LOADING = "loading the planner"


@dataclass(frozen=True, kw_only=True)
class Snapshot:
    """The robot, its plan and its walk so far; times in s, of the simulation unless said.

    `start` is where a reset puts the robot, `goal` where it walks or has walked to, `requested` a
    goal that is being planned for. `done` steps of `plan` have been taken.
    placed_side (N,), placed_world (N, 4) and foot_error_m (N,) tell of the steps of this walk;
    path_world (T, 2) of the body, four points a second. `speed` is simulated over real time as it
    is reached; `gait` how a walk went that is over; `loading` what there is to wait for before the
    first plan; `answer_s` the real time from question to plan. `walk` counts the walks begun.
    """

    qpos: np.ndarray
    time_s: float = 0.0
    walk: int = 0
    start: Pose = (0.0, 0.0, 0.0)
    goal: Pose | None = None
    requested: Pose | None = None
    plan: FootstepPlan | None = None
    done: int = 0
    placed_side: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int8))
    placed_world: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))
    foot_error_m: np.ndarray = field(default_factory=lambda: np.zeros(0))
    path_world: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    status: str = "standing"
    replans: int = 0
    answer_s: float | None = None
    clearance_m: float | None = None
    goal_error: tuple[float, float] | None = None
    speed: float = 0.0
    gait: str = ""
    loading: str = ""
    notice: Notice | None = None


class SimulationClock:
    """Real-time pacing: when the next tick is due. `factor` is simulated over real time; 0 pauses.

    It may be set from any thread. While `is_idle`, time passes no faster than on the wall.
    """

    def __init__(
        self, factor: float = 1.0, monotonic: Callable[[], float] = time.monotonic
    ) -> None:
        self.factor = factor
        self.is_idle = False
        self.reached = 0.0
        self._monotonic = monotonic
        self._due_s = monotonic()
        self._since_s = monotonic()
        self._passed_s = 0.0

    @property
    def _factor(self) -> float:
        return min(1.0, self.factor) if self.is_idle else self.factor

    def wait_s(self) -> float:
        """Real time until the next tick is due; infinite while paused."""
        factor = self._factor
        if factor <= 0:
            return math.inf
        return 0.0 if math.isinf(factor) else max(0.0, self._due_s - self._monotonic())

    def is_due(self) -> bool:
        """Whether to tick now."""
        self._measure()
        return self.wait_s() <= 0.0

    def ticked(self, period_s: float) -> None:
        """Notes that so much simulated time has passed."""
        self._passed_s += period_s
        now_s = self._monotonic()
        factor = self._factor
        if math.isinf(factor) or factor <= 0:
            self._due_s = now_s
            return
        self._due_s = max(self._due_s + period_s / factor, now_s - _FORGIVEN_S)

    def skip(self) -> None:
        """Notes that there was nothing to tick for: what was missed is not caught up."""
        self._due_s = self._monotonic()
        self._measure()

    def _measure(self) -> None:
        now_s = self._monotonic()
        if now_s - self._since_s >= _MEASURED_OVER_S:
            self.reached = self._passed_s / (now_s - self._since_s)
            self._since_s, self._passed_s = now_s, 0.0


@dataclass(frozen=True, kw_only=True)
class WalkSetup:
    """All that a walk depends on besides its goal; `dataclasses.replace` makes another one.

    bare_grid: the map without the boxes. start: where the robot is put.
    """

    bare_grid: OccupancyGrid
    robot: Robot
    policy: Controller
    start: Pose
    options: PlannerOptions
    seed: int
    obstacles: tuple[Obstacle, ...] = ()

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
    keeps what the plots show; `ended` is the first walk, once it is over; `failure` is why there is
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
    ) -> None:
        """A robot that stands at the start, or with a `goal` one that walks as in `navigate`."""
        self.setup = WalkSetup(
            bare_grid=grid,
            robot=robot,
            policy=policy,
            start=finite_pose(start),
            options=options or PlannerOptions(),
            seed=seed,
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
        navigator = self._standing() if goal is None else self._walking(finite_pose(goal))
        self._replanner = Replanner(self._planner, self.history, navigator)
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
        """Walk to this pose; `in_the_way` names what was seen there, such as "a wall"."""
        self._replanner.ask(finite_pose(goal), fresh=True, in_the_way=in_the_way)

    @_queued
    def stop(self) -> None:
        """Stand still as soon as possible."""
        self._replanner.stop()

    @_queued
    def reset(self, start: Sequence[float] | None = None) -> None:
        """Stand at the pose `start`, or where it stood at first, whatever has happened.

        Where it cannot stand it is not put, and the nearest pose that is free is offered.
        """
        wanted = self.setup.start if start is None else finite_pose(start)
        blocked, alternative = place_to_stand(self.setup.world, wanted)
        if blocked:
            text = f"the robot cannot stand there: {blocked}"
            self._replanner.notice = Notice(
                text=text, refused=wanted, alternative=alternative, puts_robot=True
            )
            return
        self.setup = replace(self.setup, start=wanted)
        self._replanner.take(self._standing())

    @_queued
    def set_obstacles(self, obstacles: Sequence[Obstacle]) -> None:
        """These boxes stand on the map from now on, for planner and physics."""
        self._change(obstacles=tuple(obstacles))
        self._replanner.navigator.set_grid(self.setup.grid, self._planner)
        self._replanner.plan_anew()

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

    def report(self) -> NavigationReport | None:
        """What the walk came to; None while it goes on, and where there was none."""
        navigator = copy.copy(self._replanner.navigator)
        return None if navigator.outcome is None else navigator.report()

    def is_on_robot(self, obstacle: Obstacle) -> bool:
        """Whether there is no room for the box because the robot stands there."""
        x_m, y_m = self.setup.bare_grid.world_to_grid(self.snapshot.qpos[:2])
        return obstacle.distance_m(float(x_m), float(y_m)) < ROOM_FOR_ROBOT_M

    def _run(self) -> None:
        replanner = self._replanner
        while not self._ending.is_set():
            # A robot in a hurry would be past the place that the planner is thinking of.
            self.clock.is_idle = not replanner.navigator.going or replanner.question is not None
            self._run_commands(self._wait_s())
            self._try(replanner.listen)
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
            self._try(self.commands.get(block=wait_s > 0, timeout=wait_s))
            while True:
                self._try(self.commands.get_nowait())

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
        if navigator.outcome is not None and self.ended is None:
            self.ended = copy.copy(navigator)
        self._replanner.ticked()

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
        has_goal = navigator.plans and not navigator.halted
        return Snapshot(
            qpos=navigator.qpos[-1],
            time_s=navigator.time_s,
            walk=history.walk,
            start=self.setup.start,
            goal=finite_pose(navigator.goal) if has_goal else None,
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
        )

    def _gait(self, navigator: Navigator) -> str:
        """How the walk went; empty while it goes on, and where it was too short to tell."""
        if navigator.outcome is None:
            return ""
        if self._gait_of is None or self._gait_of[0] is not navigator.gait:
            gait = navigator.gait.summary()
            self._gait_of = navigator.gait, "" if gait is None else gait_line(gait)
        return self._gait_of[1]

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
