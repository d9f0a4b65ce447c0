"""What planning may count on: step limits that a policy keeps, margins of foot and body, rises.

The limits are a box of steps cut back until the walks within it succeed; the margins are measured
on walks within those limits.
"""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from app.evaluation.parts import EvaluationSetup, Part, Results
from controller.evaluation.rollouts import start_walks, walk
from controller.evaluation.step_limits import (
    LIMITS_WALK_S,
    BodySway,
    LimitTrial,
    StepWalks,
    search_limits,
    step_grid,
    step_map,
    walk_within,
)
from controller.gait import CONTROL_PERIOD_S
from controller.step_cursor import StepSequence
from controller.tracking_limits import TrackingLimits, limits_from, planning_model
from maps.grid import OccupancyGrid
from planner.lattice.steps import allowed
from planner.options import PlannerOptions
from planner.robot_model import FootShape, StepLimits

SUCCESS = 0.99
# An episode on stairs climbs more steps than most flights have.
STAIRS_SUCCESS = 0.98
PLANNED_S = 16.0
REACH_EVERY_TICKS = 2
FLOOR_HALF_M = 4.0
GOAL_WITHIN_M = 1.5


def limits_parts(setup: EvaluationSetup) -> list[Part]:
    """A map of all kinds of steps, limits within which all succeed, and margins within those."""
    robot = setup.robot
    trained = replace(robot.step_model, limits=robot.training_model.limits)
    kinds = step_grid(trained.limits, trained.stance_width_m, lambda steps: allowed(steps, trained))
    each, planned = setup.share(40), min(setup.share(8), 125)

    def measure_map(results: Results) -> dict[str, Any]:
        cells = step_map(robot, setup.controller, kinds, **setup.draws(each))
        return {"walks_each": each, "kinds": cells}

    def measure_region(results: Results) -> dict[str, Any]:
        walks: StepWalks

        def walk_limits(limits: StepLimits) -> LimitTrial:
            nonlocal walks
            steps = tuple(step for step in robot.step_model.steps if limits.contain(step))
            model = replace(robot.step_model, limits=limits, steps=steps)
            walks, trial = walk_within(
                robot,
                setup.controller,
                limits,
                lambda steps: allowed(steps, model),
                **setup.draws(setup.episodes),
                falls_at_most=math.floor((1 - SUCCESS) * setup.episodes + 1e-9),
            )
            return trial

        trials = search_limits(trained, trained.limits, walk_limits, success=SUCCESS)
        errors = sole_errors_m(walks, robot.step_model.foot)
        return {
            "walks_each": len(walks.upright),
            "tried": [{"limits": asdict(t.limits), "success": t.success} for t in trials],
            "found": trials[-1].success >= SUCCESS,
            "landings": len(errors),
            "sole_error_m_p99": float(np.percentile(errors, 99)) if len(errors) else None,
        }

    def measure_sway(results: Results) -> dict[str, Any]:
        region = results["limits-region"]
        if not region["found"]:
            return {"walks": 0, "body_beyond_box_m": {}}
        limits = limits_from(region["tried"][-1]["limits"])
        return {"walks": planned, "body_beyond_box_m": _sway_m(setup, limits, planned)}

    map_s, region_s = each * len(kinds) * LIMITS_WALK_S, 3 * setup.episodes * LIMITS_WALK_S
    return [
        Part(name="limits-map", robot_seconds=map_s, measure=measure_map),
        Part(name="limits-region", robot_seconds=region_s, measure=measure_region),
        Part(
            name="limits-sway",
            robot_seconds=planned * PLANNED_S,
            measure=measure_sway,
            needs=("limits-region",),
        ),
    ]


def sole_errors_m(walks: StepWalks, foot: FootShape) -> np.ndarray:
    """How far (N,) any point of a sole may have come down from its place.

    A sole that is off by e and turned by a moves no point farther than e + r a, with r from its
    centre to its corner.
    """
    corner_m = math.hypot(foot.length_m, foot.width_m) / 2
    return np.asarray(walks.error_m + corner_m * walks.heading_error_rad)


def _sway_m(setup: EvaluationSetup, limits: StepLimits, count: int) -> dict[str, list[float]]:
    """Each shape's reach beyond its box on planned walks: 99th percentile and most, most last."""
    from planner.planner import Planner  # the compiled search takes a second to load

    provisional = TrackingLimits(
        robot=setup.robot.name,
        policy_sha256="",
        limits=limits,
        foot_margin_m=0.0,
        body_margin_m=0.0,
    )
    model = planning_model(setup.robot.step_model, provisional)
    cells = np.zeros((round(2 * FLOOR_HALF_M / 0.05),) * 2, np.uint8)
    corner = (-FLOOR_HALF_M, -FLOOR_HALF_M, 0.0)
    floor = OccupancyGrid(cells=cells, resolution_m=0.05, origin=corner)
    planner = Planner(floor, model, PlannerOptions(refine=False))

    def draw(rng: np.random.Generator, row: int, feet: np.ndarray) -> StepSequence:
        far = GOAL_WITHIN_M
        goal = rng.uniform((-far, -far, -math.pi), (far, far, math.pi))
        plan = planner.plan(goal=goal.tolist(), start_feet_world=feet, first_side=None)
        return StepSequence.of(feet, plan.side.astype(np.int64), plan.pose_world)

    walker = start_walks(setup.robot, draw, **setup.draws(count))
    reach = BodySway(walker.scene, model.body)
    beyond = []
    stances = walker.cursor.stances
    for tick in walk(walker, setup.controller, round(PLANNED_S / CONTROL_PERIOD_S)):
        if tick.number % REACH_EVERY_TICKS == 0:
            rows = np.flatnonzero(tick.upright)
            beyond += [reach.beyond_m(walker.sim.qpos[row], stances[row]) for row in rows]
        stances = walker.cursor.stances
    p99, most = np.percentile(beyond, 99, axis=0), np.max(beyond, axis=0)
    return {reach.names[k]: [float(p99[k]), float(most[k])] for k in np.argsort(most)}


def measured_of(setup: EvaluationSetup, results: Results) -> TrackingLimits | None:
    """What planning is to know; None where it was not measured or the policy is not up to it."""
    region, sway = results.get("limits-region"), results.get("limits-sway")
    if region is None or sway is None:
        return None
    if not region["found"] or region["sole_error_m_p99"] is None:
        return None
    found = region["tried"][-1]
    climb_m, stairs = _climb_m(setup, results)
    limits = limits_from(found["limits"])
    *_, (shape, (_, most_m)) = sway["body_beyond_box_m"].items()
    return TrackingLimits(
        robot=setup.robot.name,
        policy_sha256=setup.who["policy_sha256"] or "",
        limits=replace(limits, z_m=climb_m),
        foot_margin_m=_millimetres_up(region["sole_error_m_p99"]),
        body_margin_m=_millimetres_up(max(most_m, 0.0)),
        evidence={
            "episodes": setup.episodes,
            "seed": setup.seed,
            "success_within_limits": found["success"],
            "landings": region["landings"],
            "planned_walks": sway["walks"],
            "widest_shape": shape,
            "success_on_stairs": stairs,
        },
    )


def _climb_m(
    setup: EvaluationSetup, results: Results
) -> tuple[tuple[float, float], dict[str, float]]:
    """How far a step may fall and rise, and the successes that say so.

    No farther than the robot's file states, nor than stairs were walked; as stated where stairs
    were not measured.
    """
    stated = setup.robot.step_model.limits.z_m
    rows = [row for name, row in results.items() if name.startswith("stairs-")]
    plain = [row for row in rows if row["noise_kind"] == "none"]
    if not plain:
        return stated, {}
    told = {f"{row['way']} {row['rise_m']:g} m": float(row["success"]) for row in plain}
    level_m = StepLimits(x_m=(0, 0), y_m=(0, 0), yaw_rad=(0, 0)).z_m[1]

    def most_m(way: str) -> float:
        climbed = [row for row in plain if row["success"] >= STAIRS_SUCCESS]
        return max((row["rise_m"] for row in climbed if row["way"] == way), default=level_m)

    return (max(stated[0], -most_m("down")), min(stated[1], most_m("up"))), told


def _millimetres_up(length_m: float) -> float:
    return math.ceil(round(1000 * length_m, 6)) / 1000
