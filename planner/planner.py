"""Footstep planning: `plan_footsteps`, `Planner` to plan again, `plan_through` for via poses."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from maps.grid import OccupancyGrid
from planner.collision import heights_below, resting_heights, terrain_of
from planner.compiled import on_compiling
from planner.endpoints import suggestion, what_blocks, what_obstructs
from planner.heuristics.heuristic import tables_of
from planner.lattice.goal_region import GoalRegion
from planner.lattice.lattice import build_lattice
from planner.options import SAMPLING_PLANNERS, PlannerOptions
from planner.plan import (
    FootstepPlan,
    PlanStatus,
    PlanWaypoint,
    Pose,
    feet_at,
    finite_pose,
    from_frame,
    pair_pose,
    to_frame,
    wrap_angle,
)
from planner.refinement.refine import refine
from planner.robot_model import Side, StepModel
from planner.search.ad_star import plan_adstar
from planner.search.ara_star import coarse_model, plan_ara, plan_astar, plan_backward
from planner.search.first_part import soon_found
from planner.search.passages import narrow_place
from planner.search.problem import GoalContext, Request, Result, out_of_time
from planner.search.r_star import plan_rstar
from planner.search.search_record import SearchRecord
from planner.time_limit import OutOfTime, time_left_s, within
from planner.verify import violations

FloatArray = NDArray[np.float64]
# Takes the request, the options and the time.perf_counter() of the request's arrival.
Backend = Callable[[Request, PlannerOptions, float], Result]
_ALREADY_THERE_M = 1e-6
# What of a limited time is kept for refinement, or for the first part of a plan if there is none,
# and for the check of each refined step.
_KEPT_SHARE, _KEPT_S, _CHECK_S = 0.3, 0.2, 5e-4
_ROUNDING = 1e-9


def backend(name: str) -> Backend:
    """The search of that name, one of `PLANNERS`. OMPL is loaded only for those that use it."""
    if name in SAMPLING_PLANNERS:
        from planner.sampling.sampling_planner import plan_by_sampling

        return plan_by_sampling
    return {
        "ara": plan_ara,
        "astar": plan_astar,
        "backward": plan_backward,
        "adstar": plan_adstar,
        "rstar": plan_rstar,
    }[name]


class Planner:
    """Plans over one map for one robot; keeps lattice, checks and heuristic of the last goal.

    Make one and use it for every replan to the same goal.

    record: how the last search went, if the options ask for it; expanded cells in the world.
    compile_time_s: how long all plans so far waited for what was not compiled yet.
    """

    def __init__(
        self, grid: OccupancyGrid, model: StepModel, options: PlannerOptions | None = None
    ) -> None:
        self.grid = grid
        self.model = model
        self.options = options or PlannerOptions()
        self._backend = backend(self.options.name)
        self._terrain = terrain_of(grid, self.options.unknown_is_free)
        self._tables = tables_of(model)
        self._coarse = coarse_model(model)
        reach = self.options.goal_reach_m, self.options.goal_reach_rad
        # Sampling planners end at the goal itself.
        self._region = (
            GoalRegion() if self.options.name in SAMPLING_PLANNERS else GoalRegion(*reach)
        )
        self._context: tuple[Pose, GoalContext] | None = None
        self.record: SearchRecord | None = None
        self.compile_time_s = 0.0

    def take_map(self, grid: OccupancyGrid) -> None:
        """Plans over a changed map from now on; keeps what holds on both."""
        old, self.grid = self.grid, grid
        self._terrain = terrain_of(grid, self.options.unknown_is_free)
        if self._context is None:
            return
        goal, context = self._context
        has_same_frame = (
            old.cells.shape == grid.cells.shape
            and old.resolution_m == grid.resolution_m
            and old.origin == grid.origin
            and context.lattice.terrain.is_flat == self._terrain.is_flat
        )
        self._context = (goal, context.over(self._terrain)) if has_same_frame else None

    def plan(
        self,
        *,
        goal: ArrayLike,
        start: ArrayLike | None = None,
        start_feet_world: ArrayLike | None = None,
        first_side: Side | None = None,
    ) -> FootstepPlan:
        """Plan from a pair pose or from both feet as they stand to a pair pose, all in the world.

        goal, start: x_m, y_m, yaw_rad. start_feet_world (2, 4): x_m, y_m, z_m, yaw_rad of the left
        and right foot; then the feet and the body are where they are, so margins do not count at
        the start itself, nor for the body in the first step if the start is too near already.
        first_side: the foot that must step first; the search chooses if not given. Empty if the
        feet already stand at the goal.
        Raises ValueError for numbers that are not finite or for both or neither kind of start.
        """
        if (start is None) == (start_feet_world is None):
            raise ValueError("give either start or start_feet_world")
        began = time.perf_counter()
        with on_compiling() as compiling, within(self.options.time_limit_s or math.inf):
            plan = self._plan(goal, start, start_feet_world, first_side, began)
        self.compile_time_s += compiling.taken_s
        # What had to be compiled belongs to the first plan of a new installation only.
        return replace(plan, time_s=time.perf_counter() - began - compiling.taken_s)

    def _plan(
        self,
        goal: ArrayLike,
        start: ArrayLike | None,
        start_feet_world: ArrayLike | None,
        first_side: Side | None,
        began: float,
    ) -> FootstepPlan:
        """As `plan`, but for its `time_s`."""
        goal_pose = finite_pose(_finite("goal", goal, (3,)))
        if start_feet_world is None:
            start_pose = finite_pose(_finite("start", start, (3,)))
            feet = self._feet_at(start_pose)
        else:
            feet = _finite("start_feet_world", start_feet_world, (2, 4))
            start_pose = finite_pose(pair_pose(feet))
        plan = FootstepPlan(
            start_feet_world=feet,
            start=start_pose,
            goal=goal_pose,
            planner=self.options.name,
            epsilon=math.inf,
        )
        status, reason = self._refusal(plan, stands=start is None)
        if status is not None:
            plan = replace(plan, status=status, reason=reason)
        elif self._is_there(plan):
            plan = replace(plan, epsilon=1.0)
        else:
            plan = self._search(plan, start is None, first_side, began)
        return plan

    def _refusal(self, plan: FootstepPlan, stands: bool) -> tuple[PlanStatus | None, str]:
        """Status and reason if start or goal are off the map or blocked; None if they are free.

        stands: the robot is at the start already.
        """
        for name, pose in (("start", plan.start), ("goal", plan.goal)):
            if not self.grid.contains(pose[:2]):
                x0, y0, x1, y1 = self.grid.bounds_world()
                return PlanStatus.OFF_MAP, (
                    f"{name} {pose[0]:g},{pose[1]:g} is off the map, which reaches from "
                    f"{x0:g},{y0:g} to {x1:g},{y1:g}"
                )
        for status, name, feet, margins in (
            (PlanStatus.START_BLOCKED, "start", plan.start_feet_world, not stands),
            (PlanStatus.GOAL_BLOCKED, "goal", self._feet_at(plan.goal), True),
        ):
            blocked = what_blocks(self.grid, self._terrain, self.model, feet, margins)
            has_other_ends = name == "goal" and not self._region.is_point
            if blocked and not (has_other_ends and len(self.goal_context(plan.goal).ends)):
                near = suggestion(self.grid, self._terrain, self.model, pair_pose(feet))
                return status, f"{name}: {blocked}{near}"
        return None, ""

    def _feet_at(self, pose: ArrayLike) -> FloatArray:
        """Feet (2, 4) of a robot that stands at a pair pose, on the ground."""
        feet = feet_at(pose, self.model.stance_width_m)
        feet[:, 2] = heights_below(self.grid, self._terrain, self.model, feet)[:, 1]
        return feet

    def _is_there(self, plan: FootstepPlan) -> bool:
        """Whether the feet stand side by side at a pose of the goal region."""
        pose, goal, region = plan.start, plan.goal, self._region
        if (
            math.dist(pose[:2], goal[:2]) > region.reach_m
            or abs(wrap_angle(pose[2] - goal[2])) > region.reach_rad
        ):
            pose = goal
        off = plan.start_feet_world - feet_at(pose, self.model.stance_width_m)
        off[:, 3] = wrap_angle(off[:, 3])
        return bool(np.abs(off[:, [0, 1, 3]]).max() < _ALREADY_THERE_M)

    def goal_context(self, goal: ArrayLike) -> GoalContext:
        """Lattice and heuristic of a goal pose (3,), kept until another one is asked for."""
        pose = finite_pose(_finite("goal", goal, (3,)))
        if self._context is None or self._context[0] != pose:
            coarse = None if self._coarse is None else self._laid_out(pose, self._coarse)
            self._context = pose, replace(self._laid_out(pose, self.model), coarse=coarse)
        return self._context[1]

    def _laid_out(self, goal: Pose, model: StepModel) -> GoalContext:
        tables = tables_of(model)
        lattice = build_lattice(self.grid, self._terrain, model, tables.steps, goal)
        return GoalContext(
            lattice=lattice,
            model=model,
            tables=tables,
            region=self._region,
            heuristic_name=self.options.heuristic,
        )

    def _search(
        self, plan: FootstepPlan, stands: bool, first_side: Side | None, began: float
    ) -> FootstepPlan:
        """The plan with steps, or why there are none. stands: the robot is at the start already."""
        ground, feet = (self.grid, self._terrain, self.model), plan.start_feet_world
        request = Request(
            context=self.goal_context(plan.goal),
            feet_lattice=to_frame(feet[:, [0, 1, 3]], plan.goal),
            feet_m=resting_heights(*ground, feet),
            # It may leave a place where it stands nearer to an obstacle than the margins allow.
            stands=stands and bool(what_obstructs(*ground, feet)),
            first_side=first_side,
        )
        result = self._result(request, began)
        self.record = _in_world(result.record, plan.goal)
        plan = replace(
            plan,
            status=result.status,
            reason=result.reason,
            expansions=result.expansions,
            time_to_first_s=result.time_to_first_s,
        )
        if result.status in (PlanStatus.NO_PATH, PlanStatus.TIMED_OUT):
            plan = self._with_narrow_place(plan)
        if result.status is PlanStatus.NO_PATH and not self._terrain.is_flat:
            low_m, high_m = self.model.limits.z_m
            return replace(plan, reason=f"{plan.reason}; steps go from {low_m:g} to {high_m:g} m")
        if len(result.side) and result.status is not PlanStatus.FOUND:
            plan = self._with_steps(plan, result)
            x_m, y_m, _ = pair_pose(plan.pose_world[-2:])
            part = f"the first {len(plan)} steps end at {x_m:z.2f},{y_m:z.2f}"
            return replace(plan, reason=f"{plan.reason}; {part}")
        if result.status is not PlanStatus.FOUND:
            return plan
        plan = replace(self._with_steps(plan, result), epsilon=result.epsilon)
        return self._refined(plan, request, result) if self.options.refine else plan

    def _result(self, request: Request, began: float) -> Result:
        """What the search finds in the time that it has."""
        left_s, options = time_left_s(), self.options
        keeps = options.refine or options.partial
        kept_s = min(_KEPT_SHARE * left_s, _KEPT_S) if keeps else 0.0
        try:
            with within(left_s - kept_s):
                result = self._backend(request, options, began)
        except OutOfTime:
            assert options.time_limit_s is not None
            result = out_of_time(request, options.time_limit_s)
        if options.partial and result.status is PlanStatus.TIMED_OUT and not len(result.side):
            return soon_found(request, result)
        return result

    def _with_narrow_place(self, plan: FootstepPlan) -> FootstepPlan:
        """The plan with the narrow place of the widest way, if the robot cannot walk through.

        Without it where there is no time to look for it.
        """
        start, goal = self._cell(plan.start), self._cell(plan.goal)
        place = None
        with contextlib.suppress(OutOfTime):
            place = narrow_place(self._terrain, self.model, start, goal)
        if place is None:
            return plan
        x_m, y_m = (float(v) for v in self.grid.grid_to_world((place.x, place.y)))
        place = replace(place, x=x_m, y=y_m)
        return replace(plan, narrow_place=place, reason=f"{plan.reason}; {place}")

    def _cell(self, pose: Pose) -> tuple[int, int]:
        """Row and column of the map's cell in which a pose lies."""
        x_m, y_m = (float(v) for v in self.grid.world_to_grid(pose[:2]))
        return int(y_m // self.grid.resolution_m), int(x_m // self.grid.resolution_m)

    def _refined(self, plan: FootstepPlan, request: Request, result: Result) -> FootstepPlan:
        """The refined plan; the plan itself if that is no cheaper or `violations` finds a fault."""
        plan = replace(plan, cost_before_refinement_m=plan.cost_m)
        with within(time_left_s() - _CHECK_S * len(plan)):
            moved = refine(request, result)
        if moved is result:
            return plan
        refined = self._with_steps(plan, moved)
        try:
            wrong = violations(
                refined,
                self.grid,
                self.model,
                unknown_is_free=self.options.unknown_is_free,
                stood_freely=not request.stands,
                goal_reach=(self._region.reach_m, self._region.reach_rad),
            )
        except OutOfTime:
            return plan
        return plan if wrong else refined

    def _with_steps(self, plan: FootstepPlan, result: Result) -> FootstepPlan:
        """The plan with steps in the world; the last two are the feet of a pair pose to the bit."""
        goal = plan.goal
        poses = np.insert(from_frame(result.pose_lattice, goal), 2, result.z_m, axis=1)
        end = pair_pose(poses[-2:])
        is_goal = np.abs([*(end[:2] - goal[:2]), wrap_angle(end[2] - goal[2])]).max() < _ROUNDING
        feet = self._feet_at(goal if is_goal else end)
        poses[-2:] = feet[result.side[-2:]]
        return replace(plan, side=result.side, pose_world=poses, cost_m=result.cost_m)


def plan_footsteps(
    grid: OccupancyGrid,
    model: StepModel,
    *,
    goal: ArrayLike,
    start: ArrayLike | None = None,
    start_feet_world: ArrayLike | None = None,
    first_side: Side | None = None,
    options: PlannerOptions | None = None,
) -> FootstepPlan:
    """One plan; see `Planner.plan`. Make a `Planner` to plan more than once on a map."""
    return Planner(grid, model, options).plan(
        goal=goal, start=start, start_feet_world=start_feet_world, first_side=first_side
    )


def _in_world(record: SearchRecord | None, goal: Pose) -> SearchRecord | None:
    """The record with its expanded cells in the world."""
    if record is None:
        return None
    cells = from_frame(record.expanded * (1, 1, 0), goal)
    return replace(record, expanded=np.column_stack([cells[:, :2], record.expanded[:, 2]]))


def _finite(name: str, values: ArrayLike | None, shape: tuple[int, ...]) -> FloatArray:
    array = np.asarray(values, dtype=float)
    if array.shape != shape or not np.all(np.isfinite(array)):
        raise ValueError(f"{name} {values!r} must be finite numbers of shape {shape}")
    return array


def plan_through(planner: Planner, *, start: ArrayLike, poses: Sequence[ArrayLike]) -> FootstepPlan:
    """A plan from a pair pose by way of poses, standing with both feet at each of them.

    start, poses: x_m, y_m, yaw_rad in the world. One search a leg, each from the feet at which the
    last one ended. epsilon is the largest of any leg. If a leg has no plan there is none; where
    it does not end at the last pose, the reason names the waypoint.
    Raises ValueError for no pose, or numbers that are not finite.
    """
    if not len(poses):
        raise ValueError("poses is empty: give at least the goal")
    began = time.perf_counter()
    legs: list[FootstepPlan] = []
    with within(planner.options.time_limit_s or math.inf):
        for pose in poses:
            if legs and not legs[-1].found:
                break
            # The legs that are still to come get as much of the time that is left.
            with within(time_left_s() / (len(poses) - len(legs))):
                leg = _next_leg(planner, legs, pose, start)
            legs.append(leg)
            if not leg.found and len(legs) < len(poses):
                reason = f"waypoint {len(legs)}: {leg.reason.removeprefix('goal: ')}"
                legs[-1] = replace(leg, reason=reason)
    last = legs[-1]
    is_part = planner.options.partial and last.status is PlanStatus.TIMED_OUT
    walked = legs if last.found or is_part else []
    # None where the robot stands at the pose already, so that nothing was there to refine.
    before_m = [leg.cost_before_refinement_m for leg in walked]
    refined = any(cost_m is not None for cost_m in before_m)
    reached = np.cumsum([len(leg) for leg in walked])[:-1].tolist()
    return replace(
        last,
        waypoints=tuple(
            PlanWaypoint(pose=finite_pose(np.asarray(pose)), step=step)
            for pose, step in zip(poses, reached, strict=False)
        ),
        start_feet_world=legs[0].start_feet_world,
        start=legs[0].start,
        goal=finite_pose(np.asarray(poses[-1])),
        side=np.concatenate([leg.side for leg in walked] or [np.zeros(0, np.int8)]),
        pose_world=np.concatenate([leg.pose_world for leg in walked] or [np.zeros((0, 4))]),
        cost_m=sum(leg.cost_m for leg in walked),
        cost_before_refinement_m=sum(cost_m or 0.0 for cost_m in before_m) if refined else None,
        epsilon=max(leg.epsilon for leg in legs),
        expansions=sum(leg.expansions for leg in legs),
        time_to_first_s=sum(leg.time_to_first_s for leg in legs),
        time_s=time.perf_counter() - began,
    )


def _next_leg(
    planner: Planner, legs: Sequence[FootstepPlan], pose: ArrayLike, start: ArrayLike
) -> FootstepPlan:
    """The leg to a pose from the feet at which the legs end, or from the start if there are none.

    The last swing foot stands first.
    """
    if not legs:
        return planner.plan(goal=pose, start=start)
    feet = legs[0].start_feet_world.copy()
    first_side = None
    for leg in legs:
        for side in Side:
            placed = leg.pose_world[leg.side == side]
            if len(placed):
                feet[side] = placed[-1]
        if len(leg):
            first_side = Side(int(leg.side[-1])).other
    return planner.plan(goal=pose, start_feet_world=feet, first_side=first_side)
