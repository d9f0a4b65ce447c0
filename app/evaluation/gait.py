"""What an evaluation says of the gait: loads, ground forces, contact, pushes, cost of transport."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from app.evaluation.parts import Bench, Part, Results
from controller.evaluation.gait_metrics import (
    contact_agreement,
    cost_of_transport,
    distance_m,
    duration_s,
    in_contact,
    joint_loads,
    mechanical_work_j,
    over_cycle,
    peak_weights,
    posture,
    swing_lags,
)
from controller.evaluation.gait_record import Step, WalkRecord, record_walk
from controller.evaluation.push_recovery import DIRECTIONS, WALK_S, push_recovery
from controller.gait import GaitTicks
from controller.step_sequences import kept_within

RECORDED_S = 10.0
RECORDED = 16
CYCLE_BINS = 110
# Pushes by what they change of the robot's speed, so that heavy robots are pushed harder.
PUSH_SPEEDS_M_S = (0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6)


def gait_parts(bench: Bench) -> list[Part]:
    """Loads of the joints, ground forces and contact in a straight walk with the longest step."""
    model, robot = bench.robot.step_model, bench.robot
    step = (model.limits.most_x_m(model.stance_width_m), model.stance_width_m, 0.0)
    count = min(RECORDED, 2 * bench.episodes)

    def measure(results: Results) -> dict[str, Any]:
        record = _recorded(bench, step, count)
        head = {"step_m": step[0], "walks": count, "falls": int(count - record.upright.sum())}
        if not record.upright.any():
            return head
        whole = record.of_upright()
        ticks = GaitTicks.of(robot.gait)
        steady = whole.steady(ticks)
        weights = steady.ground_force_n / (robot.mass_kg * 9.81)
        contact = in_contact(steady, robot.mass_kg).astype(float)
        asked = np.repeat(steady.indicator, steady.substeps, axis=1)
        standing_m = robot.pelvis_height_m
        lift_s, touch_s = swing_lags(steady, robot.mass_kg, ticks)
        curves = {"force": weights, "contact": contact, "indicator": asked}
        cycles = {k: over_cycle(steady, v, ticks, bins=CYCLE_BINS) for k, v in curves.items()}
        return {
            **head,
            "joints": joint_loads(whole, robot),
            "posture": posture(steady) | {"pelvis_m_standing": standing_m},
            "cycle_time_s": cycles["force"].time_s.tolist(),
            **{f"{k}_mean": cycle.mean.T.tolist() for k, cycle in cycles.items()},
            "force_low": cycles["force"].low.T.tolist(),
            "force_high": cycles["force"].high.T.tolist(),
            "force_peak": peak_weights(steady, robot.mass_kg),
            "contact_agreement": contact_agreement(steady, robot.mass_kg),
            "lift_off_lag_s": lift_s,
            "touch_down_lag_s": touch_s,
        }

    seconds = count * RECORDED_S
    return [Part(section="gait", name="gait", robot_seconds=seconds, measure=measure)]


def _recorded(bench: Bench, step: Step, count: int) -> WalkRecord:
    """Walks of one step, as `record_walk` records them."""
    return record_walk(
        bench.robot,
        bench.policy,
        step,
        count=count,
        seconds=RECORDED_S,
        seed=bench.seed,
        threads=bench.threads,
    )


def energy_parts(bench: Bench) -> list[Part]:
    """Cost of transport and speed of walks forward, backward and sideways."""
    count = min(RECORDED // 2, 2 * bench.episodes)

    def measure(results: Results, step: Step, kind: str) -> dict[str, Any]:
        record = _recorded(bench, step, count)
        falls = int(count - record.upright.sum())
        row = {"kind": kind, "step": list(step), "walks": count, "falls": falls}
        if not record.upright.any():
            return {**row, "speed_m_s": None, "cost_of_transport": None, "power_w": None}
        steady = record.of_upright().steady(GaitTicks.of(bench.robot.gait))
        work_j, way_m = mechanical_work_j(steady), distance_m(steady)
        cost = cost_of_transport(work_j, bench.robot.mass_kg, way_m)
        return {
            **row,
            "speed_m_s": float(way_m.mean() / duration_s(steady)),
            "cost_of_transport": float(cost.mean()),
            "power_w": float(work_j.mean() / duration_s(steady)),
        }

    return [
        Part(
            section="energy",
            name=f"energy-{kind}-{number}",
            robot_seconds=count * RECORDED_S,
            measure=partial(measure, step=step, kind=kind),
        )
        for number, (kind, step) in enumerate(_walks_to_weigh(bench))
    ]


def _walks_to_weigh(bench: Bench) -> list[tuple[str, Step]]:
    """Kinds of walk and their steps, within the limits that the robot's file states."""
    model = bench.robot.step_model
    limits, width_m = model.limits, model.stance_width_m
    ahead_m, back_m = limits.most_x_m(width_m), limits.most_x_m(width_m, backward=True)
    forward = [("forward", (s * ahead_m, width_m, 0.0)) for s in (0.25, 0.5, 0.75, 1.0)]
    backward = [("backward", (s * back_m, width_m, 0.0)) for s in (0.5, 1.0)]
    widest = kept_within(np.array([[0.0, limits.y_m[1], 0.0]]), limits, width_m)[0]
    return [*forward, *backward, ("sideways", (0.0, float(widest[1]), 0.0))]


def push_parts(bench: Bench) -> list[Part]:
    """Success against impulse, a part for each direction."""
    mass_kg, count = bench.robot.mass_kg, bench.share(10)
    impulses_ns = [round(mass_kg * speed, 1) for speed in PUSH_SPEEDS_M_S]

    def measure(results: Results, direction: str) -> dict[str, Any]:
        success = push_recovery(
            bench.robot,
            bench.policy,
            direction,
            impulses_ns,
            count=count,
            seed=bench.seed,
            threads=bench.threads,
        )
        return {
            "direction": direction,
            "walks": count,
            "impulses_ns": impulses_ns,
            "success": success,
        }

    return [
        Part(
            section="push",
            name=f"push-{direction.replace(' ', '-')}",
            robot_seconds=count * len(impulses_ns) * WALK_S,
            measure=partial(measure, direction=direction),
        )
        for direction in DIRECTIONS
    ]
