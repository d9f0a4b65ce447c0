"""One robot on one map, living in a thread of its own: it takes wishes and shows snapshots."""

from __future__ import annotations

import copy
import math
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import replace

from app.errors import InputError
from app.navigation.navigator import Navigator, PlansSteps
from app.viewer.command_queue import Wishes
from app.viewer.live_navigator import Rover
from app.viewer.make_snapshot import look
from app.viewer.obstacles import Obstacle
from app.viewer.planner_process import PatientPlanner, PlanningProcess
from app.viewer.real_time import Pace
from app.viewer.record import Record
from app.viewer.replanning import Guide
from app.viewer.setting import Setting, finite_pose
from app.viewer.snapshot import Notice, Snapshot
from controller.gait import CONTROL_PERIOD_S
from controller.policy import Policy
from maps.grid import OccupancyGrid
from planner.options import SAMPLING_PLANNERS, PlannerOptions
from planner.plan import Pose
from sim.robot import Robot

# A box this near to the middle of the robot would be set down on it.
ROOM_FOR_ROBOT_M = 0.45
_IDLE_WAIT_S = 0.05
_SNAPSHOT_EVERY_S = 1 / 60


class Session:
    """Runs the physics of a robot, and does what people wish.

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
        self._setting = Setting(
            bare_grid=grid,
            robot=robot,
            policy=policy,
            start=finite_pose(start),
            options=options or PlannerOptions(),
            seed=seed,
        )
        self._wishes = Wishes()
        self._ending = threading.Event()
        self._planner = PlanningProcess(self._setting.world)
        self._shown_s, self._shown_answer = -math.inf, -1
        self.pace = Pace()
        self.record = Record()
        self.ended: Navigator | None = None
        rover = self._standing() if goal is None else self._walking(finite_pose(goal))
        self._guide = Guide(self._planner, self.record, rover)
        self.snapshot = self._look()
        self._thread = threading.Thread(target=self._run, name="physics", daemon=True)

    def is_ready(self, wait_s: float) -> bool:
        """Whether a goal would be planned for at once; before `start`, waits for so long."""
        return self._planner.is_ready(wait_s)

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
        return self._setting.bare_grid

    @property
    def robot(self) -> Robot:
        """The one that walks."""
        return self._setting.robot

    @property
    def options(self) -> PlannerOptions:
        """How it plans."""
        return self._setting.options

    @property
    def planner_pid(self) -> int | None:
        """The process that plans."""
        return self._planner.process_id

    def go_to(self, goal: Sequence[float], *, in_the_way: str = "") -> None:
        """Walk to this pose; `in_the_way` names what was seen there, such as "a wall"."""
        self._wishes.add(
            lambda: self._guide.ask(finite_pose(goal), fresh=True, in_the_way=in_the_way)
        )

    def stop(self) -> None:
        """Stand still as soon as possible."""
        self._wishes.add(self._guide.stop)

    def reset(self, start: Sequence[float] | None = None) -> None:
        """Stand at the pose `start`, or where it stood at first, whatever has happened.

        Where it cannot stand it is not put, and the nearest pose that is free is offered.
        """
        self._wishes.add(lambda: self._reset(None if start is None else finite_pose(start)))

    def set_obstacles(self, obstacles: Sequence[Obstacle]) -> None:
        """These boxes stand on the map from now on, for planner and physics."""
        self._wishes.add(lambda: self._set_obstacles(tuple(obstacles)))

    def set_robot(self, robot: Robot, policy: Policy) -> None:
        """Another robot takes the place of this one at the start."""
        self._wishes.add(lambda: self._set_robot(robot, policy))

    def set_options(self, options: PlannerOptions) -> None:
        """Plan like this from now on."""
        self._wishes.add(lambda: self._set_options(options))

    def is_on_robot(self, obstacle: Obstacle) -> bool:
        """Whether there is no room for the box because the robot stands there."""
        x_m, y_m = self.grid.world_to_grid(self.snapshot.qpos[:2])
        return obstacle.distance_m(float(x_m), float(y_m)) < ROOM_FOR_ROBOT_M

    # From here on everything runs in the session's own thread.

    def _run(self) -> None:
        guide = self._guide
        while not self._ending.is_set():
            # A robot in a hurry would be past the place that the planner is thinking of.
            self.pace.is_idle = not guide.rover.going or guide.question is not None
            self._wishes.grant(self._wait_s(), self._try)
            self._try(guide.listen)
            if guide.rover.rests:
                self.pace.skip()
            elif self.pace.is_due():
                self._try(self._tick)
            self._show()

    def _wait_s(self) -> float:
        """How long nothing needs to be done, unless a wish comes."""
        rests, asks = self._guide.rover.rests, self._guide.question is not None
        if rests and not asks:
            return _IDLE_WAIT_S
        # A plan that is on its way is looked for often.
        longest_s = 0.005 if asks else _IDLE_WAIT_S
        return min(math.inf if rests else self.pace.wait_s(), longest_s)

    def _try(self, action: Callable[[], None]) -> None:
        """What cannot be done is told of, and harms nothing; a fault stops the robot until told."""
        try:
            action()
        except (InputError, ValueError) as error:
            self._guide.notice = Notice(text=str(error))
        except Exception as error:
            traceback.print_exc()
            self._guide.rover.idle_s = math.inf
            self._guide.notice = Notice(text=f"a fault of the program: {error}; reset the robot")

    def _tick(self) -> None:
        rover = self._guide.rover
        placed = len(rover.placed)
        rover.tick()
        self.pace.ticked(CONTROL_PERIOD_S)
        self.record.ticked(rover)
        if len(rover.placed) > placed or rover.has_ended:
            self.record.landed(rover)
        if rover.outcome is not None and self.ended is None:
            self.ended = copy.copy(rover)
        self._guide.ticked()

    def _show(self) -> None:
        """Now and then, and as soon as there is an answer."""
        answer = self._guide.answer_of
        if answer != self._shown_answer or time.monotonic() - self._shown_s >= _SNAPSHOT_EVERY_S:
            self._shown_s, self._shown_answer = time.monotonic(), answer
            self.snapshot = self._look()

    def _look(self) -> Snapshot:
        start, speed = self._setting.start, self.pace.reached
        return look(self._guide, self.record, start=start, speed=speed)

    def _reset(self, start: Pose | None) -> None:
        wanted = start or self._setting.start
        stand = self._setting.stand(wanted)
        if stand.blocked:
            text = f"the robot cannot stand there: {stand.blocked}"
            self._guide.notice = Notice(
                text=text, refused=wanted, offer=stand.offer, puts_robot=True
            )
            return
        self._setting = replace(self._setting, start=wanted)
        self._guide.take(self._standing())

    def _set_obstacles(self, obstacles: tuple[Obstacle, ...]) -> None:
        self._setting = replace(self._setting, obstacles=obstacles)
        rover = self._guide.rover
        rover.use_planner(self._planner)
        rover.set_grid(self._setting.grid)
        self._planner.set_world(self._setting.world)
        self._guide.plan_anew()

    def _set_options(self, options: PlannerOptions) -> None:
        self._setting = replace(self._setting, options=options)
        self._planner.set_world(self._setting.world)
        self._guide.plan_anew()

    def _set_robot(self, robot: Robot, policy: Policy) -> None:
        self._setting = replace(self._setting, robot=robot, policy=policy)
        self._planner.set_world(self._setting.world)
        self._guide.take(self._standing())

    def _standing(self) -> Rover:
        """A robot that stands at the start."""
        rover = self._setting.rover(planner=self._planner)
        # Sensors tell of the step before: there must be one.
        rover.tick()
        return rover

    def _walking(self, goal: Pose) -> Rover:
        """A robot with a goal that plans for itself, in this process if that is quick."""
        is_slow = self._setting.options.name in SAMPLING_PLANNERS
        planner: PlansSteps | None = PatientPlanner(self._planner) if is_slow else None
        rover = self._setting.rover(goal=goal, planner=planner)
        rover.going = rover.plan().found
        self.ended = None if rover.going else copy.copy(rover)
        return rover
