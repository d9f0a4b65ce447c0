"""The process that plans: it answers the newest question, until nobody asks any more."""

from __future__ import annotations

from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

import numpy as np

from app.viewer.nearest_pose import free_pose, reachable_pose
from app.viewer.questions import Answer, Query, Ready, World
from maps.grid import OccupancyGrid
from planner.collision import terrain_of
from planner.plan import PlanStatus, Pose, pair_pose
from planner.planner import Planner

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
    offer = None if plan.found else _offer(world, planners.quick, query, plan.status)
    pipe.send(Answer(number=query.number, plan=plan, offer=offer, is_last=not improvable))
    if improvable and not pipe.poll():
        better = planners.thorough.plan(**asked)
        # Off the lattice the better start may come out dearer.
        if better.found and better.cost_m <= plan.cost_m:
            plan = replace(better, time_to_first_s=plan.time_s)
        pipe.send(Answer(number=query.number, plan=plan))


def _offer(world: World, planner: Planner, query: Query, status: PlanStatus) -> Pose | None:
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
