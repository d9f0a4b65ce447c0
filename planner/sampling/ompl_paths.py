"""Paths of the body in SE(2) by OMPL's sampling planners; the only file that imports OMPL.

The limits are counts of OMPL's own iterations, so a seed gives the same path every time. `solve`
holds Python's global lock: to continue meanwhile, plan in another process. OMPL's objects stay
inside functions, because those left at the end of a program print complaints.

All poses are x_m, y_m, yaw_rad in the grid frame.
"""

from __future__ import annotations

import heapq
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from ompl import base, geometric, util

from planner.collision import Terrain, box_free, point_clearance, radius_of
from planner.compiled import njit_inner, njit_no_refcount
from planner.lattice.steps import MICRO
from planner.robot_model import RoundedBox, StepModel, rounded_box

FloatArray = NDArray[np.float64]
_RANGE_M = 2.0  # longest motion that extends a tree
_SHORTCUTS = 200  # attempts to shorten the path
_CHECK_M = 0.03  # between checks of a motion near obstacles; footsteps are checked exactly


class Outline(NamedTuple):
    """Boxes of a robot that stands at a pair pose, widened by their margins.

    body: centred on the pose. feet: each half_stance_m beside it. climb_um: how far one step may
    fall and rise.
    """

    body: RoundedBox
    feet: RoundedBox
    half_stance_m: float
    climb_um: tuple[int, int]


def outline_of(model: StepModel) -> Outline:
    """The outline of a step model."""
    return Outline(
        body=rounded_box(model.body, model.body_margin_m),
        feet=rounded_box(model.foot, model.foot_margin_m),
        half_stance_m=model.stance_width_m / 2,
        climb_um=(round(model.limits.z_m[0] * MICRO), round(model.limits.z_m[1] * MICRO)),
    )


@njit_no_refcount
def can_stand(terrain: Terrain, outline: Outline, x: float, y: float, yaw: float) -> bool:
    """Whether body and both feet are free at a pair pose."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    if not box_free(terrain, x, y, cos, sin, outline.body):
        return False
    dx, dy = -sin * outline.half_stance_m, cos * outline.half_stance_m
    return box_free(terrain, x + dx, y + dy, cos, sin, outline.feet) and box_free(
        terrain, x - dx, y - dy, cos, sin, outline.feet
    )


@njit_no_refcount
def can_move(
    terrain: Terrain,
    outline: Outline,
    start: tuple[float, float, float],
    end: tuple[float, float, float],
) -> bool:
    """Whether the body is free along a straight motion that turns evenly the shorter way.

    Checks are as far apart as the clearance allows. On uneven floors they are close everywhere, and
    between two of them the floor may rise no more than in a step.
    """
    turn = (end[2] - start[2] + math.pi) % (2 * math.pi) - math.pi
    radius = radius_of(outline.body)
    length = max(math.hypot(end[0] - start[0], end[1] - start[1]), abs(turn) * radius)
    done = 0.0
    uneven = len(terrain.height_um) > 0
    below = _height(terrain, start[0], start[1]) if uneven else 0
    while True:
        share = done / length if length > 0.0 else 1.0
        x, y = start[0] + share * (end[0] - start[0]), start[1] + share * (end[1] - start[1])
        room = point_clearance(terrain, x, y) - radius
        if room <= 0.0:
            yaw = start[2] + share * turn
            if not box_free(terrain, x, y, math.cos(yaw), math.sin(yaw), outline.body):
                return False
        if uneven:
            height = _height(terrain, x, y)
            if height - below < outline.climb_um[0] or height - below > outline.climb_um[1]:
                return False
            below = height
        if done >= length:
            return True
        done = min(length, done + (_CHECK_M if uneven else max(room, _CHECK_M)))


@njit_inner
def _height(terrain: Terrain, x: float, y: float) -> int:
    """Height of the floor in micrometres at a point; at the edge's cell off the map."""
    rows, cols = terrain.blocked.shape
    row = min(max(math.floor(y / terrain.resolution_m), 0), rows - 1)
    col = min(max(math.floor(x / terrain.resolution_m), 0), cols - 1)
    return terrain.height_um[row, col]


def nearest_standing(
    terrain: Terrain, outline: Outline, pose: NDArray[np.float64], reach_m: float
) -> NDArray[np.float64] | None:
    """The pose nearest to one (3,), with the same heading, at which the robot can stand.

    Searched on rings up to reach_m; None if there is none.
    """
    x, y, yaw = (float(v) for v in pose)
    for radius_m in np.arange(0.0, reach_m + 1e-9, 0.05):
        for angle in np.arange(16) * (math.pi / 8) if radius_m else (0.0,):
            there = x + radius_m * math.cos(angle), y + radius_m * math.sin(angle), yaw
            if can_stand(terrain, outline, *there):
                return np.array(there)
    return None


class Effort(NamedTuple):
    """Limits on iterations, in all and past the first path, and a time.perf_counter() or None."""

    most: int
    more: int
    until_s: float | None = None


# First paths of the star planners are poor, and each of their iterations checks many motions. FMT*
# draws all samples at once: most and least.
EFFORTS = {
    "rrtconnect": Effort(40_000, 0),
    "rrtstar": Effort(20_000, 1_500),
    "informed-rrtstar": Effort(20_000, 1_500),
    "bitstar": Effort(100_000, 3_000),
    "prmstar": Effort(20_000, 1_000),
    "fmt": Effort(16_000, 1_000),
}


@dataclass(frozen=True, kw_only=True)
class BodyQuery:
    """A path to be found from one pose (3,) to another."""

    terrain: Terrain
    outline: Outline
    start: FloatArray
    goal: FloatArray


@dataclass(frozen=True, kw_only=True)
class SampledPath:
    """Corners (n, 3) of the path, none if no path was found."""

    corners: FloatArray
    iterations: int


def find_path(name: str, query: BodyQuery, effort: Effort, seed: int) -> SampledPath:
    """The path that the planner of that name finds, shortened."""
    util.setLogLevel(util.LOG_NONE)
    util.RNG.setSeed(seed + 1)  # 0 is no seed
    task = _OmplProblem(query)
    stop = _Termination(effort)
    if name == "prmstar":
        corners = _roadmap(task, stop)
    elif name == "fmt":
        corners = _fast_marching(task, stop)
    else:
        corners = _tree(name, task, stop)
    if corners is not None:
        corners = _shortened(task, corners)
    return SampledPath(
        corners=np.zeros((0, 3)) if corners is None else corners, iterations=stop.iterations
    )


class _Termination:
    """Counts iterations and says when to stop; OMPL calls it once an iteration."""

    def __init__(self, effort: Effort) -> None:
        self.effort = effort
        self.iterations = 0
        self.is_solved: Callable[[], bool] = lambda: False
        self._first: int | None = None

    def __call__(self) -> bool:
        """Whether to stop."""
        self.iterations += 1
        if self._first is None and self.is_solved():
            self._first = self.iterations
        if self._first is not None and self.iterations - self._first >= self.effort.more:
            return True
        return self.iterations >= self.effort.most or self.is_late()

    def is_late(self) -> bool:
        """Whether the time limit is reached."""
        until_s = self.effort.until_s
        return until_s is not None and time.perf_counter() >= until_s


class _Motions(base.MotionValidator):  # type: ignore[misc]
    """Checks a whole motion at once."""

    def __init__(self, information: Any, query: BodyQuery) -> None:
        super().__init__(information)
        self._ground = query.terrain, query.outline

    def checkMotion(self, start: Any, end: Any) -> bool:
        """Whether the body is free from start to end."""
        return can_move(*self._ground, _pose(start), _pose(end))


class _OmplProblem:
    """A query as objects of OMPL."""

    def __init__(self, query: BodyQuery) -> None:
        rows, cols = query.terrain.blocked.shape
        bounds = base.RealVectorBounds(2)
        for axis, cells in enumerate((cols, rows)):
            bounds.setLow(axis, 0.0)
            bounds.setHigh(axis, cells * query.terrain.resolution_m)
        self.space = base.SE2StateSpace()
        self.space.setBounds(bounds)
        self.information = base.SpaceInformation(self.space)
        ground = query.terrain, query.outline
        self.information.setStateValidityChecker(lambda state: can_stand(*ground, *_pose(state)))
        self._motions = _Motions(self.information, query)
        self.information.setMotionValidator(self._motions)
        self.information.setup()
        self.start, self.goal = self._state(query.start), self._state(query.goal)

    def _state(self, pose: FloatArray) -> Any:
        state = self.space.allocState()
        state.setX(float(pose[0]))
        state.setY(float(pose[1]))
        state.setYaw(math.remainder(float(pose[2]), 2 * math.pi))
        return state

    def problem(self) -> Any:
        """A problem without solutions yet: the shortest path from start to goal."""
        problem = base.ProblemDefinition(self.information)
        problem.setStartAndGoalStates(self.start, self.goal)
        problem.setOptimizationObjective(base.PathLengthOptimizationObjective(self.information))
        return problem


def _pose(state: Any) -> tuple[float, float, float]:
    return state.getX(), state.getY(), state.getYaw()


def _tree(name: str, task: _OmplProblem, stop: _Termination) -> FloatArray | None:
    """Corners (n, 3) by a planner that grows trees."""
    kinds = {
        "rrtconnect": geometric.RRTConnect,
        "rrtstar": geometric.RRTstar,
        "informed-rrtstar": geometric.InformedRRTstar,
        "bitstar": geometric.BITstar,
    }
    planner, problem = kinds[name](task.information), task.problem()
    if hasattr(planner, "setRange"):
        planner.setRange(_RANGE_M)
    planner.setProblemDefinition(problem)
    planner.setup()
    if hasattr(planner, "bestCost"):
        stop.is_solved = lambda: math.isfinite(planner.bestCost().value())
    planner.solve(base.PlannerTerminationCondition(stop))
    stop.is_solved = lambda: False
    return _solution(problem)


def _solution(problem: Any) -> FloatArray | None:
    """Corners of a path that reaches the goal; None for one that only comes near."""
    if not problem.hasExactSolution():
        return None
    return np.array([_pose(state) for state in problem.getSolutionPath().getStates()])


def _fast_marching(task: _OmplProblem, stop: _Termination) -> FloatArray | None:
    """Corners by FMT*, which runs again with twice the samples until it finds a path."""
    most = stop.effort.most
    samples = min(stop.effort.more, most)
    while samples <= most and not stop.is_late():
        planner, problem = geometric.FMT(task.information), task.problem()
        planner.setNumSamples(samples)
        planner.setExtendedFMT(False)  # which would go on drawing for ever
        planner.setProblemDefinition(problem)
        planner.setup()
        planner.solve(base.PlannerTerminationCondition(stop.is_late))
        stop.iterations += samples
        corners = _solution(problem)
        if corners is not None:
            return corners
        samples *= 2
    return None


def _roadmap(task: _OmplProblem, stop: _Termination) -> FloatArray | None:
    """Corners by PRM*.

    Its own `solve` searches for the path in a second thread, so its result depends on timing. Here
    the roadmap grows in this thread, and the path over it is found afterwards.
    """
    planner = geometric.PRMstar(task.information)
    planner.setProblemDefinition(task.problem())
    planner.setup()
    # Stops at once, but takes up start and goal.
    planner.solve(base.plannerAlwaysTerminatingCondition())
    until = stop.effort.more
    while True:
        planner.growRoadmapPtc(_until(stop, until))
        corners = _shortest(task, planner)
        if corners is not None or stop.iterations >= stop.effort.most or stop.is_late():
            return corners
        until *= 2


def _until(stop: _Termination, iterations: int) -> Any:
    return base.PlannerTerminationCondition(lambda: stop() or stop.iterations >= iterations)


def _shortest(task: _OmplProblem, planner: Any) -> FloatArray | None:
    """Corners of the shortest path over a roadmap."""
    roadmap = base.PlannerData(task.information)
    planner.getPlannerData(roadmap)
    if not (roadmap.numStartVertices() and roadmap.numGoalVertices()):
        return None
    start, goal = roadmap.getStartIndex(0), roadmap.getGoalIndex(0)
    states = [roadmap.getVertex(i).getState() for i in range(roadmap.numVertices())]
    before, done = {start: start}, set()
    cost_m = {start: 0.0}
    heap = [(0.0, start)]
    while heap and goal not in done:
        here_m, vertex = heapq.heappop(heap)
        if vertex in done:
            continue
        done.add(vertex)
        for near in roadmap.getEdges(vertex):
            there_m = here_m + task.information.distance(states[vertex], states[near])
            if there_m < cost_m.get(near, math.inf):
                cost_m[near], before[near] = there_m, vertex
                heapq.heappush(heap, (there_m, near))
    if goal not in done:
        return None
    path = [goal]
    while path[-1] != start:
        path.append(before[path[-1]])
    return np.array([_pose(states[vertex]) for vertex in reversed(path)])


def _shortened(task: _OmplProblem, corners: FloatArray) -> FloatArray:
    """The corners after OMPL's shortcuts, which keep start and goal."""
    path = geometric.PathGeometric(task.information)
    for corner in corners:
        path.append(task._state(corner))
    simplifier = geometric.PathSimplifier(task.information)
    simplifier.reduceVertices(path)
    simplifier.partialShortcutPath(path, _SHORTCUTS, _SHORTCUTS)
    simplifier.reduceVertices(path)
    return np.array([_pose(state) for state in path.getStates()])
