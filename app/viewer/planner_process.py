"""A planner in a process of its own: while it searches, robot and page go on."""

from __future__ import annotations

import math
import multiprocessing
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

import numpy as np

from app.viewer.nearest_pose import free_pose, reachable_pose
from maps.grid import OccupancyGrid
from planner.collision import terrain_of
from planner.options import PlannerOptions
from planner.plan import FootstepPlan, PlanStatus, Pose, pair_pose
from planner.planner import Planner
from planner.robot_model import Side, StepModel

# What robot and planner tell each other across the pipe between their processes.


@dataclass(frozen=True, kw_only=True)
class Query:
    """What is asked: from both feet (2, 4) to a pair pose; `number` tells answers apart.

    once: there is one answer, the plan that the world's options make as they stand.
    """

    number: int
    goal: Pose
    start_feet_world: np.ndarray
    first_side: Side | None
    once: bool


@dataclass(frozen=True, kw_only=True)
class Answer:
    """A plan for the query of that number; after the first may come one better one.

    `alternative` is a pose near by that would do when the goal of the query does not.
    """

    number: int
    plan: FootstepPlan
    alternative: Pose | None = None
    is_last: bool = True


@dataclass(frozen=True, kw_only=True)
class Ready:
    """Says that all is loaded, and compiled if it had to be: a question is answered at once."""


@dataclass(frozen=True, kw_only=True)
class World:
    """What is planned over."""

    grid: OccupancyGrid
    model: StepModel
    options: PlannerOptions


# The process that plans: it answers the newest question, until nobody asks any more.

# How long a plan that is there already is improved.
POLISH_S = 1.0


def answer_questions(pipe: Connection) -> None:
    """Answers the newest question, until the pipe closes."""
    world: World | None = None
    planners: _Planners | None = None
    try:
        while True:
            query: Query | None = None
            while query is None or pipe.poll():
                if world is not None and planners is None and not pipe.poll():
                    # Nobody waits yet: the first question shall not have to.
                    planners = _planners(world)
                    pipe.send(Ready())
                message = pipe.recv()
                if isinstance(message, World):
                    if world is None:
                        _warm_up(message)
                    if planners is not None and _differs_in_map_only(world, message):
                        for planner in planners:
                            planner.take_map(message.grid)
                    else:
                        planners = None
                    world = message
                else:
                    query = message
            assert world is not None
            planners = planners or _planners(world)
            _answer(pipe, world, planners, query)
    except (EOFError, OSError, KeyboardInterrupt):
        return


def _differs_in_map_only(world: World | None, other: World) -> bool:
    """Whether planners over the one may go on over the other, with what they know."""
    return world is not None and (world.model, world.options) == (other.model, other.options)


def _warm_up(world: World) -> None:
    """Plans once where it is easy: loads what has been compiled before the first question."""
    floor = OccupancyGrid(cells=np.zeros((60, 60), np.uint8), resolution_m=0.05)
    Planner(floor, world.model, world.options).plan(start=(1.0, 1.5, 0.0), goal=(1.5, 1.5, 0.0))


class _Planners(NamedTuple):
    """One content with the first plan, one that goes on for a while, and one as it is asked for."""

    quick: Planner
    thorough: Planner
    plain: Planner


def _planners(world: World) -> _Planners:
    quick = replace(world.options, stop_at_first=True)
    thorough = replace(world.options, time_limit_s=POLISH_S)
    return _Planners(
        *(Planner(world.grid, world.model, o) for o in (quick, thorough, world.options))
    )


def _answer(pipe: Connection, world: World, planners: _Planners, query: Query) -> None:
    asked: dict[str, Any] = {
        "goal": query.goal,
        "start_feet_world": query.start_feet_world,
        "first_side": query.first_side,
    }
    if query.once:
        pipe.send(Answer(number=query.number, plan=planners.plain.plan(**asked)))
        return
    plan = planners.quick.plan(**asked)
    improvable = plan.found and len(plan) > 0 and plan.epsilon > world.options.final_epsilon
    alternative = None if plan.found else _alternative(world, planners.quick, query, plan.status)
    pipe.send(
        Answer(number=query.number, plan=plan, alternative=alternative, is_last=not improvable)
    )
    if improvable and not pipe.poll():
        better = planners.thorough.plan(**asked)
        # Off the lattice the better start may come out dearer.
        if better.found and better.cost_m <= plan.cost_m:
            plan = replace(better, time_to_first_s=plan.time_s)
        pipe.send(Answer(number=query.number, plan=plan))


def _alternative(world: World, planner: Planner, query: Query, status: PlanStatus) -> Pose | None:
    """A pose that would do instead of the goal, if there is one near."""
    terrain = terrain_of(world.grid, world.options.unknown_is_free)
    if status in (PlanStatus.GOAL_BLOCKED, PlanStatus.OFF_MAP):
        return free_pose(world.grid, terrain, world.model, query.goal)
    if status is not PlanStatus.NO_PATH:
        return None

    def has_way(pose: Pose) -> bool:
        feet, first = query.start_feet_world, query.first_side
        return planner.plan(goal=pose, start_feet_world=feet, first_side=first).found

    start = pair_pose(query.start_feet_world)
    return reachable_pose(world.grid, terrain, world.model, start, query.goal, has_way)


# How long the robot may wait for a plan between two steps; its physics catch up afterwards.
WAIT_LIMIT_S = 0.2
# Longer than any planner takes that is still alive.
_ENDLESS_S = 600.0
# A planner that has died so often before it was ready will not do better.
_MOST_STARTS = 3


class PlannerProcess:
    """Asks a planner in another process; used from one thread.

    `ask` and `answers` never wait. `plan` waits for at most `wait_limit_s`, and says that time ran
    out when there is nothing by then.
    """

    def __init__(self, world: World, *, wait_limit_s: float = WAIT_LIMIT_S) -> None:
        self.wait_limit_s = wait_limit_s
        self._world = world
        self._number = 0
        self._open: Query | None = None
        self._kept: list[Answer] = []
        self._is_ready = False
        self._starts = 0
        self._start()

    def _start(self) -> None:
        self._starts += 1
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(
            target=answer_questions, args=(theirs,), daemon=True, name="planner"
        )
        self._process.start()
        theirs.close()
        self._send(self._world)

    @property
    def number(self) -> int:
        """Of the last question, whoever asked it."""
        return self._number

    @property
    def process_id(self) -> int | None:
        """Of the process that plans."""
        return self._process.pid

    def is_ready(self, wait_s: float = 0.0) -> bool:
        """Whether the first question would be answered at once; waits for that for so long."""
        if not self._is_ready:
            self._receive(wait_s)
        return self._is_ready

    def set_world(self, world: World) -> None:
        """Plans from now on over another map, or for another robot."""
        self._world = world
        self._kept.clear()
        self._send(world)

    def ask(
        self,
        *,
        goal: Sequence[float],
        start_feet_world: np.ndarray,
        first_side: Side | None,
        once: bool = False,
    ) -> int:
        """Asks for a plan; returns the number of its answers. Older questions are dropped."""
        self._number += 1
        x_m, y_m, yaw_rad = (float(value) for value in goal)
        self._open = Query(
            number=self._number,
            goal=(x_m, y_m, yaw_rad),
            start_feet_world=np.array(start_feet_world),
            first_side=first_side,
            once=once,
        )
        self._send(self._open)
        return self._number

    def answers(self) -> list[Answer]:
        """The answers that came since the last call, to the last question only."""
        self._receive(0.0)
        kept, self._kept = self._kept, []
        return kept

    def plan(
        self,
        *,
        goal: Sequence[float],
        start_feet_world: np.ndarray,
        first_side: Side | None,
        once: bool = False,
    ) -> FootstepPlan:
        """The best plan that is there in time; status TIMED_OUT if none is.

        once: the plan that the world's options make as they stand, however long it takes.
        """
        wait_limit_s = _ENDLESS_S if once else self.wait_limit_s
        began = time.monotonic()
        self.ask(goal=goal, start_feet_world=start_feet_world, first_side=first_side, once=once)
        best: FootstepPlan | None = None
        while (left_s := wait_limit_s - (time.monotonic() - began)) > 0:
            self._receive(left_s)
            for answer in self.answers():
                best = answer.plan
                if answer.is_last:
                    return best
        if best is not None:
            return best
        start, end = pair_pose(start_feet_world), [float(value) for value in goal]
        return FootstepPlan(
            start_feet_world=start_feet_world,
            start=(start[0], start[1], start[2]),
            goal=(end[0], end[1], end[2]),
            status=PlanStatus.TIMED_OUT,
            reason=f"no plan within {wait_limit_s:g} s",
            epsilon=math.inf,
            time_s=time.monotonic() - began,
        )

    def close(self) -> None:
        """Ends the process."""
        self._pipe.close()
        self._process.terminate()
        self._process.join(timeout=5.0)

    def _send(self, message: Any) -> None:
        try:
            self._pipe.send(message)
        except OSError:
            self._restart()
            self._pipe.send(message)

    def _receive(self, wait_s: float) -> None:
        try:
            while self._pipe.poll(wait_s):
                answer = self._pipe.recv()
                wait_s = 0.0
                if isinstance(answer, Ready):
                    self._is_ready = True
                elif answer.number == self._number:
                    self._open = None
                    self._kept.append(answer)
        except (EOFError, OSError):
            self._restart()
            # Once more, but not for ever: this may be what it died of.
            query, self._open = self._open, None
            if query is not None:
                self._send(query)

    def _restart(self) -> None:
        """A planner that died, out of memory say, must not take the robot with it.

        Raises:
            RuntimeError: It dies whenever it is started.
        """
        self._pipe.close()
        if self._starts >= _MOST_STARTS and not self._is_ready:
            raise RuntimeError(f"the planner's process has died {self._starts} times at its start")
        self._process.join(timeout=1.0)
        self._start()


class BlockingPlanner:
    """Asks a planner in another process and waits until it is done, as if it were in this one.

    For planners that would hold Python's global lock, and so the page, for as long as they plan.
    """

    def __init__(self, process: PlannerProcess) -> None:
        self._process = process

    def plan(
        self, *, goal: Sequence[float], start_feet_world: np.ndarray, first_side: Side | None
    ) -> FootstepPlan:
        """The plan, however long it takes."""
        return self._process.plan(
            goal=goal, start_feet_world=start_feet_world, first_side=first_side, once=True
        )
