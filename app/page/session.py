"""One robot on one map, living in a thread of its own: it takes wishes and shows snapshots."""

from __future__ import annotations

import copy
import math
import queue
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from app.errors import InputError
from app.navigator import Navigator, NavigatorConfig, PlansSteps
from app.page.boxes import Obstacle, with_obstacles
from app.page.offers import place_to_stand
from app.page.pace import Pace
from app.page.planning import Answer, PatientPlanner, PlanningProcess, World
from app.page.record import Record
from app.page.rover import Ahead, Rover
from app.page.snapshot import Notice, Snapshot
from controller.gait import CONTROL_PERIOD_S
from controller.policy import Policy
from maps.grid import OccupancyGrid
from planner.options import SAMPLING_PLANNERS, PlannerOptions
from planner.plan import FootstepPlan, Pose
from sim.robot import Robot

# A box this near to the middle of the robot would be set down on it.
ROOM_FOR_ROBOT_M = 0.45
_IDLE_WAIT_S = 0.05
# A robot that stands is not simulated for longer: its feet would creep, and nobody would gain.
_REST_AFTER_S = 2.0
_SNAPSHOT_EVERY_S = 1 / 60


@dataclass(frozen=True, kw_only=True)
class _Question:
    """What the planner was asked, from which moment, and for which goal.

    in_the_way: what was seen at the goal already when it was pointed at.
    """

    number: int
    ahead: Ahead
    goal: Pose
    fresh: bool
    asked_s: float
    in_the_way: str = ""


class Session:
    """Runs the physics of a robot and brings together what people wish and what the planner says.

    The methods may be called from any thread: they queue a wish and return. `snapshot` is what is
    to be seen now; `record` keeps what the plots show; `ended` is the first walk, once it is over.
    """

    def __init__(
        self,
        grid: OccupancyGrid,
        robot: Robot,
        policy: Policy,
        *,
        start: Sequence[float] = (0.0, 0.0, 0.0),
        goal: Sequence[float] | None = None,
        options: PlannerOptions | None = None,
        seed: int = 0,
    ) -> None:
        """A robot that stands at the start, or with a `goal` one that walks as in `navigate`."""
        self._bare_grid, self._seed = grid, seed
        self._options = options or PlannerOptions()
        self._obstacles: tuple[Obstacle, ...] = ()
        self._robot, self._policy = robot, policy
        self._start = _pose(start)
        self._wishes: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._ending = threading.Event()
        self._planner = PlanningProcess(self._world())
        self._question: _Question | None = None
        self._notice: Notice | None = None
        self._preview: FootstepPlan | None = None
        self._answer_s: float | None = None
        self._answer_of = self._followed_number = -1
        self._shown_s = -math.inf
        self._walk = 0
        self._idle_s = 0.0
        self.pace = Pace()
        self.record = Record()
        self.ended: Navigator | None = None
        self._place(goal)
        self.snapshot = self._look()
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
    def grid(self) -> OccupancyGrid:
        """The map without the boxes."""
        return self._bare_grid

    @property
    def planner_pid(self) -> int | None:
        """The process that plans."""
        return self._planner.process_id

    @property
    def start_pose(self) -> Pose:
        """Where the robot stands after a reset."""
        return self._start

    def go_to(self, goal: Sequence[float], *, in_the_way: str = "") -> None:
        """Walk to this pose; `in_the_way` names what was seen there, such as "a wall"."""
        self._wishes.put(lambda: self._ask(_pose(goal), fresh=True, in_the_way=in_the_way))

    def stop(self) -> None:
        """Stand still as soon as possible."""
        self._wishes.put(self._stop)

    def reset(self, start: Sequence[float] | None = None) -> None:
        """Stand at the pose `start`, or where it stood at first, whatever has happened.

        Where it cannot stand it is not put, and the nearest pose that is free is offered.
        """
        self._wishes.put(lambda: self._reset(None if start is None else _pose(start)))

    def set_obstacles(self, obstacles: Sequence[Obstacle]) -> None:
        """These boxes stand on the map from now on, for planner and physics."""
        self._wishes.put(lambda: self._set_obstacles(tuple(obstacles)))

    def set_robot(self, robot: Robot, policy: Policy) -> None:
        """Another robot takes the place of this one at the start."""
        self._wishes.put(lambda: self._set_robot(robot, policy))

    def set_options(self, options: PlannerOptions) -> None:
        """Plan like this from now on."""
        self._wishes.put(lambda: self._set_options(options))

    def is_on_robot(self, obstacle: Obstacle) -> bool:
        """Whether there is no room for the box because the robot stands there."""
        x_m, y_m = self._bare_grid.world_to_grid(self.snapshot.qpos[:2])
        return obstacle.distance_m(float(x_m), float(y_m)) < ROOM_FOR_ROBOT_M

    # From here on everything runs in the session's own thread.

    def _run(self) -> None:
        while not self._ending.is_set():
            # A robot in a hurry would be past the place that the planner is thinking of.
            self.pace.is_idle = not self._rover.going or self._question is not None
            self._grant(self._wait_s())
            self._try(self._listen)
            if self._rests():
                self.pace.skip()
            elif self.pace.is_due():
                self._try(self._tick)
            if time.monotonic() - self._shown_s >= _SNAPSHOT_EVERY_S:
                self._shown_s = time.monotonic()
                self.snapshot = self._look()

    def _wait_s(self) -> float:
        """How long nothing needs to be done, unless a wish comes."""
        if self._rests() and not self._question:
            return _IDLE_WAIT_S
        # A plan that is on its way is looked for often.
        longest_s = 0.005 if self._question else _IDLE_WAIT_S
        return min(math.inf if self._rests() else self.pace.wait_s(), longest_s)

    def _rests(self) -> bool:
        return self._rover.has_ended or self._idle_s > _REST_AFTER_S

    def _grant(self, wait_s: float) -> None:
        """Fulfils the wishes that are there; waits for one for so long."""
        try:
            wish = self._wishes.get(timeout=wait_s) if wait_s > 0 else self._wishes.get_nowait()
            while True:
                self._try(wish)
                wish = self._wishes.get_nowait()
        except queue.Empty:
            return

    def _try(self, action: Callable[[], None]) -> None:
        """What cannot be done is told of, and harms nothing; a fault stops the robot until told."""
        try:
            action()
        except (InputError, ValueError) as error:
            self._notice = Notice(text=str(error))
        except Exception as error:
            traceback.print_exc()
            self._idle_s = math.inf
            self._notice = Notice(text=f"a fault of the program: {error}; reset the robot")

    def _tick(self) -> None:
        rover = self._rover
        placed = len(rover.placed)
        rover.tick()
        self._idle_s = 0.0 if rover.going else self._idle_s + CONTROL_PERIOD_S
        self.pace.ticked(CONTROL_PERIOD_S)
        self.record.ticked(rover)
        if len(rover.placed) > placed or rover.has_ended:
            self.record.landed(rover)
        if rover.outcome is not None and self.ended is None:
            self.ended = copy.copy(rover)
        if self._question and self._question.number != self._planner.number:
            # The rover asked in between, for want of patience, and got its answer.
            self._ask_again(self._question)

    def _ask_again(self, question: _Question) -> None:
        """Asks anew; a walk that its first plan has begun already goes on."""
        begun = self._followed_number == question.number
        fresh = question.fresh and not begun
        self._ask(question.goal, fresh=fresh, in_the_way=question.in_the_way)

    def _ask(self, goal: Pose, *, fresh: bool, in_the_way: str = "") -> None:
        if self._rover.has_ended:
            self._notice = Notice(text=f"the robot has {self._rover.outcome}: reset it first")
            return
        self._notice = None if fresh else self._notice
        ahead = self._rover.ahead()
        number = self._planner.ask(
            goal=goal, start_feet_world=ahead.feet_world, first_side=ahead.first_side
        )
        self._question = _Question(
            number=number,
            ahead=ahead,
            goal=goal,
            fresh=fresh,
            asked_s=time.monotonic(),
            in_the_way=in_the_way,
        )

    def _listen(self) -> None:
        for answer in self._planner.answers() if self._question else []:
            question = self._question
            if question is not None and answer.number == question.number:
                self._answered(question, answer)

    def _answered(self, question: _Question, answer: Answer) -> None:
        if self._answer_of != question.number:
            self._answer_s = time.monotonic() - question.asked_s
            self._answer_of = question.number
            self._shown_s = -math.inf
        if answer.is_last:
            self._question = None
        if not answer.plan.found:
            self._no_plan(question, answer)
            return
        self._preview = answer.plan
        if question.ahead.first_side is None and not answer.is_last:
            return  # It stands: a moment of thought costs nothing.
        begun = self._followed_number == question.number
        if self._rover.go(
            question.goal, answer.plan, question.ahead, fresh=question.fresh and not begun
        ):
            if begun:
                # The better plan takes the place of the first.
                del self._rover.plans[-2]
            elif question.fresh:
                self._walk += 1
                self.record.begin(self._rover)
            self._followed_number = question.number
            self._idle_s = 0.0
        elif not begun:
            if not question.fresh:
                # Its way may be blocked, and planning takes longer than a step: think first.
                self._rover.halt()
            self._ask(question.goal, fresh=question.fresh)

    def _no_plan(self, question: _Question, answer: Answer) -> None:
        seen, reason = question.in_the_way, answer.plan.reason
        text = f"no plan: {seen} stands there" if seen else f"no plan: {reason}"
        self._notice = Notice(text=text, offer=answer.offer)
        if not question.fresh:
            # The way that it was on is no more.
            self._idle_s = 0.0
            self._rover.halt()
            self._preview = None

    def _stop(self) -> None:
        self._idle_s = 0.0
        self._question, self._preview = None, None
        self._rover.halt()

    def _reset(self, start: Pose | None) -> None:
        wanted = start or self._start
        grid, model = self._world().grid, self._robot.step_model
        stand = place_to_stand(grid, model, self._options.unknown_is_free, wanted)
        if stand.blocked:
            text = f"the robot cannot stand there: {stand.blocked}"
            self._notice = Notice(text=text, offer=stand.offer, puts_robot=True)
            return
        self._start = wanted
        self._place()

    def _set_obstacles(self, obstacles: tuple[Obstacle, ...]) -> None:
        self._obstacles = obstacles
        world = self._world()
        self._rover.use_planner(self._planner)
        self._rover.set_grid(world.grid)
        self._planner.set_world(world)
        self._plan_anew()

    def _set_options(self, options: PlannerOptions) -> None:
        self._options = options
        self._planner.set_world(self._world())
        self._plan_anew()

    def _plan_anew(self) -> None:
        """What was asked is asked again, and what is walked is planned again."""
        if self._question is not None:
            self._ask_again(self._question)
        elif self._rover.going and not (self._rover.halted or self._rover.has_ended):
            self._ask(_pose(self._rover.goal), fresh=False)

    def _set_robot(self, robot: Robot, policy: Policy) -> None:
        self._robot, self._policy = robot, policy
        self._planner.set_world(self._world())
        self._place()

    def _world(self) -> World:
        grid = with_obstacles(self._bare_grid, self._obstacles)
        return World(grid=grid, model=self._robot.step_model, options=self._options)

    def _own_planner(self) -> PlansSteps | None:
        """The planner of a robot with a goal; None for one in this process, if that is quick."""
        return PatientPlanner(self._planner) if self._options.name in SAMPLING_PLANNERS else None

    def _place(self, goal: Sequence[float] | None = None) -> None:
        """A robot that stands at the start, or one with a goal that plans for itself."""
        world = self._world()
        self._rover = Rover(
            world.grid,
            self._robot,
            self._policy,
            start=self._start,
            goal=self._start if goal is None else _pose(goal),
            seed=self._seed,
            config=NavigatorConfig(planner=self._options),
            planner=self._planner if goal is None else self._own_planner(),
        )
        self._idle_s = 0.0
        if goal is None:
            # Sensors tell of the step before: there must be one.
            self._rover.tick()
        else:
            self._rover.going = self._rover.plan().found
            self.ended = None if self._rover.going else copy.copy(self._rover)
        self._question = self._notice = self._preview = self._answer_s = None
        self._walk += 1
        self.record.begin(self._rover)

    def _look(self) -> Snapshot:
        rover = self._rover
        plan, done = self._plan_to_show()
        return Snapshot(
            qpos=rover.qpos[-1],
            time_s=rover.time_s,
            walk=self._walk,
            goal=_pose(rover.goal) if rover.plans else None,
            plan=plan,
            done=done,
            placed_side=self.record.placed_side,
            placed_world=self.record.placed_world,
            foot_error_m=self.record.foot_error_m,
            path_world=self.record.path_world,
            status=rover.status(is_asking=self._question is not None),
            replans=rover.replans,
            answer_s=self._answer_s,
            clearance_m=self.record.clearance_m,
            goal_error=rover.goal_error if rover.plans else None,
            speed=self.pace.reached,
            notice=self._notice,
        )

    def _plan_to_show(self) -> tuple[FootstepPlan | None, int]:
        """The plan to be seen, and how many of its steps have been taken."""
        rover = self._rover
        if rover.waiting is not None:
            return rover.waiting, 0
        if self._question is not None and self._preview is not None and not rover.going:
            return self._preview, 0
        if not rover.followed:
            return None, 0
        begun_s, plan = rover.followed[-1]
        return plan, sum(placed.time_s > begun_s for placed in rover.placed)


def _pose(values: Sequence[float]) -> Pose:
    x_m, y_m, yaw_rad = (float(value) for value in values)
    if not all(map(math.isfinite, (x_m, y_m, yaw_rad))):
        raise ValueError(f"pose {x_m:g},{y_m:g},{yaw_rad:g} must be finite numbers")
    return x_m, y_m, yaw_rad
