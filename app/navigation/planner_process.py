"""A planner in a process of its own: while it searches, robot and page go on."""

from __future__ import annotations

import math
import multiprocessing
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from typing import Any, NamedTuple, NotRequired, TypedDict, Unpack

import cv2
import numpy as np

from app.navigation.route import plan_through
from maps.grid import OccupancyGrid
from planner.collision import Terrain, terrain_of
from planner.compilation import compile_ahead
from planner.endpoints import nearest_free_pose, what_blocks
from planner.options import PlannerOptions
from planner.plan import FootstepPlan, PlanStatus, Pose, feet_at, finite_pose, pair_pose
from planner.planner import Planner
from planner.robot_model import Side, StepModel
from planner.search.search_record import SearchRecord

# How long a plan that is there already is improved.
POLISH_S = 1.0
# How long the robot may wait for a plan between two steps; its physics catch up afterwards.
WAIT_LIMIT_S = 0.2
# Longer than any planner takes that is still alive.
_ENDLESS_S = 600.0
# A planner that has died so often before it was ready will not do better.
_MOST_STARTS = 3
# Another pose than the goal must be found soon: so many are tried, so far apart, and so long.
_MOST_TRIED = 6
_APART_M = 0.3
_LONGEST_S = 0.5


class Asked(TypedDict):
    """What a planner is asked, see `plan_through`: from both feet (2, 4) to a pair pose."""

    goal: Sequence[float]
    start_feet_world: np.ndarray
    first_side: Side | None
    via: NotRequired[Sequence[Pose]]
    stands: NotRequired[bool]


@dataclass(frozen=True, kw_only=True)
class Query:
    """A question across the pipe; `number` tells answers apart.

    once: there is one answer, the plan that the world's options make as they stand.
    """

    number: int
    asked: Asked
    once: bool


@dataclass(frozen=True, kw_only=True)
class Answer:
    """A plan for the query of that number; after the first may come one better one.

    A plan that fails on the way has the pose that it does not reach for its goal; `alternative` is
    a pose near by that would do instead of that. `record` tells of the search
    for its last leg, if the options ask for that.
    """

    number: int
    plan: FootstepPlan
    alternative: Pose | None = None
    record: SearchRecord | None = None
    is_last: bool = True


@dataclass(frozen=True, kw_only=True)
class Ready:
    """Says that all is loaded, and compiled if it had to be: a question is answered at once."""


@dataclass(frozen=True, kw_only=True)
class Compiling:
    """Says how many of the planner's functions are compiled, and of how many."""

    done: int
    functions: int


@dataclass(frozen=True, kw_only=True)
class World:
    """What is planned over."""

    grid: OccupancyGrid
    model: StepModel
    options: PlannerOptions


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
                        _warm_up(pipe, message)
                    known = world and (world.model, world.options)
                    if known != (message.model, message.options):
                        planners = None
                    for planner in planners or ():
                        planner.take_map(message.grid)
                    world = message
                else:
                    query = message
            assert world is not None
            planners = planners or _planners(world)
            _answer(pipe, world, planners, query)
    except (EOFError, OSError, KeyboardInterrupt):
        return


def _warm_up(pipe: Connection, world: World) -> None:
    """Plans once where it is easy: loads what has been compiled before the first question."""

    def tell(done: int, functions: int, _name: str) -> None:
        pipe.send(Compiling(done=done, functions=functions))

    compile_ahead(world.model, world.options, tell)
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
    ways = quick, thorough, world.options
    return _Planners(*(Planner(world.grid, world.model, options) for options in ways))


def _answer(pipe: Connection, world: World, planners: _Planners, query: Query) -> None:
    asked, number = query.asked, query.number
    if query.once:
        pipe.send(Answer(number=number, plan=plan_through(planners.plain, **asked)))
        return
    plan = plan_through(planners.quick, **asked)
    improvable = plan.found and len(plan) > 0 and plan.epsilon > world.options.final_epsilon
    alternative = None
    if not plan.found:
        failed = _as_far_as(asked, plan.goal)
        alternative = _alternative(world, planners.quick, failed, plan.status)
    record = planners.quick.record
    answer = Answer(number=number, plan=plan, alternative=alternative, record=record)
    pipe.send(replace(answer, is_last=not improvable))
    if improvable and not pipe.poll():
        better = plan_through(planners.thorough, **asked)
        # Off the lattice the better start may come out dearer.
        if better.found and better.cost_m <= plan.cost_m:
            plan = replace(better, time_to_first_s=plan.time_s)
        pipe.send(Answer(number=number, plan=plan, record=planners.thorough.record))


def _as_far_as(asked: Asked, pose: Pose) -> Asked:
    """The question for the way to that pose alone, which is the goal or on the way there."""
    via = asked.get("via", ())
    before = [finite_pose(other) for other in via]
    if pose in before:
        via = via[: before.index(pose)]
    return {**asked, "goal": pose, "via": via}


def _alternative(world: World, planner: Planner, asked: Asked, status: PlanStatus) -> Pose | None:
    """A pose that would do instead of the goal, if there is one near."""
    if status in (PlanStatus.GOAL_BLOCKED, PlanStatus.OFF_MAP):
        terrain = terrain_of(world.grid, world.options.unknown_is_free)
        return nearest_free_pose(world.grid, terrain, world.model, asked["goal"])
    if status is PlanStatus.NO_PATH:
        return _nearest_reachable_pose(world, planner, asked)
    return None


def place_to_stand(world: World, pose: Pose) -> tuple[str, Pose | None]:
    """Why the robot cannot stand at a pose, and the nearest one within 2 m at which it can.

    Empty and None if it can stand there.
    """
    grid, model = world.grid, world.model
    terrain = terrain_of(grid, world.options.unknown_is_free)
    blocked = what_blocks(grid, terrain, model, feet_at(pose, model.stance_width_m))
    return blocked, nearest_free_pose(grid, terrain, model, pose) if blocked else None


def somewhere_to_stand(world: World) -> Pose | None:
    """The free pose nearest to 0,0,0, or one where there is most room if that is not within 2 m."""
    grid, model = world.grid, world.model
    terrain = terrain_of(grid, world.options.unknown_is_free)
    row, col = np.unravel_index(np.argmax(terrain.clearance_m), grid.shape)
    x_m, y_m = grid.cell_to_world((row, col))
    for pose in ((0.0, 0.0, 0.0), (round(float(x_m), 3), round(float(y_m), 3), 0.0)):
        if not grid.contains(pose[:2]):
            continue
        if not what_blocks(grid, terrain, model, feet_at(pose, model.stance_width_m)):
            return pose
        free = nearest_free_pose(grid, terrain, model, pose)
        if free is not None:
            return free
    return None


def _nearest_reachable_pose(world: World, planner: Planner, asked: Asked) -> Pose | None:
    """The pose nearest to a free goal without a way to which there is one.

    Few are tried, and only where a disk as wide as the body can roll from the start.
    """
    grid, model, goal = world.grid, world.model, asked["goal"]
    terrain = terrain_of(grid, world.options.unknown_is_free)
    until_s = time.monotonic() + _LONGEST_S
    tried: list[Pose] = []
    places = _rolled_to(grid, terrain, model, pair_pose(asked["start_feet_world"]))
    for place in places[np.argsort(np.hypot(*(places - goal[:2]).T), kind="stable")]:
        pose = round(float(place[0]), 3), round(float(place[1]), 3), goal[2]
        if len(tried) == _MOST_TRIED or time.monotonic() > until_s:
            return None
        if any(math.dist(pose[:2], other[:2]) < _APART_M for other in tried):
            continue
        if what_blocks(grid, terrain, model, feet_at(pose, model.stance_width_m)):
            continue
        there: Asked = {**asked, "goal": pose}
        if plan_through(planner, **there).found:
            return pose
        tried.append(pose)
    return None


def _rolled_to(
    grid: OccupancyGrid, terrain: Terrain, model: StepModel, start: np.ndarray
) -> np.ndarray:
    """Centres (n, 2) in the world of cells to which the narrowest disk in the body can roll."""
    radius_m = min(model.body.length_m, model.body.width_m) / 2
    wide = (np.asarray(terrain.clearance_m) > radius_m).astype(np.uint8)
    row, col = (int(value) for value in grid.world_to_cell(start[:2]))
    rows, cols = grid.shape
    if not (0 <= row < rows and 0 <= col < cols):
        return np.zeros((0, 2))
    _, labels = cv2.connectedComponents(wide, connectivity=8)
    # Whoever stands too near to a wall is in the nearest room.
    near = max(1, math.ceil(radius_m / grid.resolution_m))
    window = labels[max(0, row - near) : row + near + 1, max(0, col - near) : col + near + 1]
    counts = np.bincount(window[window > 0])
    if not len(counts):
        return np.zeros((0, 2))
    label = labels[row, col] or int(counts.argmax())
    return grid.cell_to_world(np.argwhere(labels == label))


class PlannerProcess:
    """Asks a planner in another process; used from one thread.

    `ask` and `answers` never wait. `plan` waits for at most WAIT_LIMIT_S, and says that time ran
    out when there is nothing by then. `number` is that of the last question, whoever asked it,
    `compiling` is how far that is, where the planner was not compiled.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self.number = 0
        self._open: Query | None = None
        self._kept: list[Answer] = []
        self._is_ready = False
        self.compiling: Compiling | None = None
        self._starts = 0
        self._start()

    def _start(self) -> None:
        self._starts += 1
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self.process = context.Process(
            target=answer_questions, args=(theirs,), daemon=True, name="planner"
        )
        self.process.start()
        theirs.close()
        self._send(self._world)

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

    def ask(self, *, once: bool = False, **asked: Unpack[Asked]) -> int:
        """Asks for a plan; returns the number of its answers. Older questions are dropped."""
        self.number += 1
        self._open = Query(number=self.number, asked=asked, once=once)
        self._send(self._open)
        return self.number

    def answers(self) -> list[Answer]:
        """The answers that came since the last call, to the last question only."""
        self._receive(0.0)
        kept, self._kept = self._kept, []
        return kept

    def plan(self, *, once: bool = False, **asked: Unpack[Asked]) -> FootstepPlan:
        """The best plan that is there in time; status TIMED_OUT if none is.

        once: the plan that the world's options make as they stand, however long it takes.
        """
        wait_limit_s = _ENDLESS_S if once else WAIT_LIMIT_S
        began = time.monotonic()
        self.ask(once=once, **asked)
        best: FootstepPlan | None = None
        while (left_s := wait_limit_s - (time.monotonic() - began)) > 0:
            self._receive(left_s)
            for answer in self.answers():
                best = answer.plan
                if answer.is_last:
                    return best
        if best is not None:
            return best
        feet = asked["start_feet_world"]
        return FootstepPlan(
            start_feet_world=feet,
            start=finite_pose(pair_pose(feet).tolist()),
            goal=finite_pose(asked["goal"]),
            status=PlanStatus.TIMED_OUT,
            reason=f"no plan within {wait_limit_s:g} s",
            epsilon=math.inf,
            time_s=time.monotonic() - began,
        )

    def close(self) -> None:
        """Ends the process."""
        self._pipe.close()
        self.process.terminate()
        self.process.join(timeout=5.0)

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
                if isinstance(answer, Compiling):
                    self.compiling = answer
                    continue
                # One that was asked while it loaded answers without a word before.
                self._is_ready = True
                if not isinstance(answer, Ready) and answer.number == self.number:
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
        self.process.join(timeout=1.0)
        self._start()


@dataclass(frozen=True)
class BlockingPlanner:
    """Waits for a planner that in this process would hold Python's global lock, and so the page."""

    process: PlannerProcess

    def plan(self, **asked: Unpack[Asked]) -> FootstepPlan:
        """The plan, however long it takes."""
        return self.process.plan(once=True, **asked)
