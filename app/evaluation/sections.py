"""The sections of an evaluation, in the order in which they are measured and told."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from functools import partial
from typing import Any

import numpy as np

from app.evaluation.hardware import HARDWARE
from app.evaluation.limits import limits_parts
from app.evaluation.parts import EvaluationSetup, Part, Results
from controller.assessment import ModeResult, assess_mode, at_navigation_rate
from controller.evaluation import gait_metrics as metrics
from controller.evaluation.push_recovery import DIRECTIONS, PUSH_WALK_S, push_recovery
from controller.evaluation.rollouts import AT_ONCE, portions, start_walks, walk
from controller.gait import CONTROL_PERIOD_S, GaitTicks
from controller.policy import Policy
from controller.step_sequences import MODES, clip_to_limits, draw_sequence
from sim.robot import GaitTiming

EPISODE_S = 10.0
LONG_WALK_S = 60.0
STAIR_RISES_M = (0.10, 0.15)
TREAD_NOISE_M = (0.01, 0.02, 0.03, 0.04, 0.05, 0.06)
JOINT_NOISE_DEG = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
RECORDED = 16
CYCLE_BINS = 110
QUICK_STEPS_S = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5)
# Pushes by what they change of the robot's speed, so that heavy robots are pushed harder.
PUSH_SPEEDS_M_S = (0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6)


def modes_parts(setup: EvaluationSetup) -> list[Part]:
    """Falls and foot errors of every flat mode."""

    def measure(results: Results, mode: str | None) -> dict[str, Any]:
        return mode_row(_assess(setup, mode, setup.episodes))

    return [
        Part(
            name=f"modes-{mode or 'mixed'}",
            robot_seconds=setup.episodes * EPISODE_S,
            measure=partial(measure, mode=mode),
        )
        for mode in (*MODES, "standing", None)
    ]


def _assess(
    setup: EvaluationSetup, mode: str | None, episodes: int, **settings: float
) -> ModeResult:
    """Episodes of one mode, in portions that fit the memory."""
    return ModeResult.joined(
        [
            assess_mode(
                setup.robot,
                setup.controller,
                mode,
                episodes=min(AT_ONCE, episodes - first),
                seed=setup.seed + 1000 * number,
                threads=setup.threads,
                engine=setup.engine,
                config=at_navigation_rate(),
                **settings,
            )
            for number, first in enumerate(range(0, episodes, AT_ONCE))
        ]
    )


def mode_row(result: ModeResult) -> dict[str, Any]:
    """A mode's numbers; None where no foot was set down.

    `error_m_quantiles` are the foot error's 0, 2, ... 100 % quantiles.
    """
    row: dict[str, Any] = dict(result.summary)
    landed = len(result.landing_error_m) > 0
    for axis, name in enumerate(("along", "across")):
        off_m = np.abs(result.landing_offset_m[:, axis])
        for share, suffix in ((50, "median"), (95, "p95")):
            key = f"{name}_m_{suffix}"
            row[key] = float(np.percentile(off_m, share)) if landed else None
    shares = np.arange(0, 101, 2)
    row["error_m_quantiles"] = (
        np.percentile(result.landing_error_m, shares).tolist() if landed else None
    )
    return row


def stairs_parts(setup: EvaluationSetup) -> list[Part]:
    """Stairs up and down: without noise, then with noise on treads and on joints."""
    few = setup.share(5)
    cases = [(rise_m, "none", 0.0, setup.episodes) for rise_m in STAIR_RISES_M]
    cases += [(STAIR_RISES_M[0], "tread", noise_m, few) for noise_m in TREAD_NOISE_M]
    cases += [(STAIR_RISES_M[0], "joint", noise_deg, few) for noise_deg in JOINT_NOISE_DEG]

    def measure(results: Results, way: str, rise_m: float, kind: str, noise: float, n: int) -> Any:
        amplitudes = {"tread": {"tread_error_m": noise}, "joint": {"joint_noise_deg": noise}}
        settings = {"rise_m": rise_m, **amplitudes.get(kind, {})}
        result = _assess(setup, f"stairs_{way}", n, **settings)
        return {
            "way": way,
            "rise_m": rise_m,
            "noise_kind": kind,
            "noise": noise,
            "length_s_mean": float(result.episode_ticks.mean()) * CONTROL_PERIOD_S,
            **mode_row(result),
        }

    return [
        Part(
            name=f"stairs-{way}-{100 * rise_m:g}cm-{kind}-{noise:g}",
            robot_seconds=episodes * EPISODE_S,
            measure=partial(measure, way=way, rise_m=rise_m, kind=kind, noise=noise, n=episodes),
        )
        for rise_m, kind, noise, episodes in cases
        for way in ("up", "down")
    ]


def long_parts(setup: EvaluationSetup) -> list[Part]:
    """A minute of walking in all flat modes, changing from one to the next."""
    count = setup.share(4)
    steps = int(LONG_WALK_S / setup.robot.gait.step_s) + 2

    def draw(rng: np.random.Generator, row: int, feet: np.ndarray) -> Any:
        while True:
            sequence = draw_sequence(rng, setup.robot.training_model, feet, steps=steps)
            if len(sequence.side) > steps:  # not one of those that only stand
                return sequence

    def measure(results: Results) -> dict[str, Any]:
        survived: list[int] = []
        ticks = round(LONG_WALK_S / CONTROL_PERIOD_S)
        for rows, seed in portions(count, setup.seed):
            settings = setup.draws(len(rows)) | {"seed": seed}
            walker = start_walks(setup.robot, draw, **settings)
            lasted = np.zeros(len(rows), dtype=np.int64)
            for tick in walk(walker, setup.controller, ticks):
                lasted += tick.upright
            survived += lasted.tolist()
        falls = sum(lasted < ticks for lasted in survived)
        fallen_s = sorted(lasted * CONTROL_PERIOD_S for lasted in survived if lasted < ticks)
        return {"walks": count, "seconds": LONG_WALK_S, "falls": falls, "fell_at_s": fallen_s}

    seconds = count * LONG_WALK_S
    return [Part(name="long", robot_seconds=seconds, measure=measure)]


def gait_parts(setup: EvaluationSetup) -> list[Part]:
    """Loads of the joints, ground forces and contact in a straight walk with the longest step."""
    robot, width_m = setup.robot, setup.robot.step_model.stance_width_m
    step = (robot.step_model.limits.most_x_m(width_m), width_m, 0.0)
    count = min(RECORDED, 2 * setup.episodes)

    def measure(results: Results) -> dict[str, Any]:
        record = metrics.record_walk(robot, setup.controller, step, **setup.draws(count))
        head = {"step_m": step[0], "walks": count, "falls": int(count - record.upright.sum())}
        if not record.upright.any():
            return head
        whole = record.of_upright()
        ticks = GaitTicks.of(robot.gait)
        steady = whole.steady(ticks)
        summary = metrics.walk_and_stand(robot, setup.controller, step, **setup.draws(count))
        lift_s, touch_s = metrics.swing_lags(steady, robot.mass_kg, ticks)
        cycles = {
            name: metrics.gait_cycle_curves(steady, values, ticks, bins=CYCLE_BINS)
            for name, values in (
                ("force", steady.ground_force_n / robot.weight_n),
                ("contact", metrics.in_contact(steady, robot.mass_kg).astype(float)),
                ("indicator", np.repeat(steady.indicator, steady.substeps, axis=1)),
            )
        }
        return {
            **head,
            "joints": metrics.joint_loads(whole, robot),
            "joint_jerk_rad_s3": metrics.joint_jerk_rad_s3(whole),
            "pelvis_standing_m": robot.pelvis_height_m,
            "walk": None if summary is None else asdict(summary),
            "cycle_time_s": cycles["force"].time_s.tolist(),
            **{f"{k}_mean": cycle.mean.T.tolist() for k, cycle in cycles.items()},
            "force_low": cycles["force"].low.T.tolist(),
            "force_high": cycles["force"].high.T.tolist(),
            "force_peak": metrics.peak_weights(steady, robot.mass_kg),
            "contact_agreement": metrics.contact_agreement(steady, robot.mass_kg),
            "lift_off_lag_s": lift_s,
            "touch_down_lag_s": touch_s,
        }

    seconds = 2 * count * metrics.RECORDED_S
    return [Part(name="gait", robot_seconds=seconds, measure=measure)]


def energy_parts(setup: EvaluationSetup) -> list[Part]:
    """Cost of transport and speed of walks forward, backward and sideways.

    Their steps are within the limits that the robot's file states.
    """
    count = min(RECORDED // 2, 2 * setup.episodes)
    limits, width_m = setup.robot.step_model.limits, setup.robot.step_model.stance_width_m
    ahead_m, back_m = limits.most_x_m(width_m), limits.most_x_m(width_m, backward=True)
    widest = clip_to_limits(np.array([[0.0, limits.y_m[1], 0.0]]), limits, width_m)[0]
    walks: list[tuple[str, metrics.Step]] = [
        *(("forward", (share * ahead_m, width_m, 0.0)) for share in (0.25, 0.5, 0.75, 1.0)),
        *(("backward", (share * back_m, width_m, 0.0)) for share in (0.5, 1.0)),
        ("sideways", (0.0, float(widest[1]), 0.0)),
    ]

    def measure(results: Results, step: metrics.Step, kind: str) -> dict[str, Any]:
        record = metrics.record_walk(setup.robot, setup.controller, step, **setup.draws(count))
        falls = int(count - record.upright.sum())
        row = {"kind": kind, "step": list(step), "walks": count, "falls": falls}
        if not record.upright.any():
            return {**row, "speed_m_s": None, "cost_of_transport": None, "power_w": None}
        steady = record.of_upright().steady(GaitTicks.of(setup.robot.gait))
        work_j, way_m = metrics.mechanical_work_j(steady), metrics.distance_m(steady)
        cost = metrics.cost_of_transport(work_j, setup.robot.mass_kg, way_m)
        return {
            **row,
            "speed_m_s": float(way_m.mean() / metrics.duration_s(steady)),
            "cost_of_transport": float(cost.mean()),
            "power_w": float(work_j.mean() / metrics.duration_s(steady)),
        }

    return [
        Part(
            name=f"energy-{kind}-{number}",
            robot_seconds=count * metrics.RECORDED_S,
            measure=partial(measure, step=step, kind=kind),
        )
        for number, (kind, step) in enumerate(walks)
    ]


def pace_parts(setup: EvaluationSetup) -> list[Part]:
    """Falls and speed of straight walks with the longest step, by the duration of a step."""
    robot, width_m = setup.robot, setup.robot.step_model.stance_width_m
    step = (robot.step_model.limits.most_x_m(width_m), width_m, 0.0)
    count = min(RECORDED // 2, 2 * setup.episodes)
    own_s = robot.gait.step_s
    quicker_s = [step_s for step_s in QUICK_STEPS_S if step_s < own_s]

    def measure(results: Results, step_s: float) -> dict[str, Any]:
        ticks = GaitTicks.of(robot.gait).for_durations(np.array(step_s))
        gait = GaitTiming(
            single_support_s=float(ticks.swing) * CONTROL_PERIOD_S,
            double_support_s=float(ticks.double_support) * CONTROL_PERIOD_S,
        )
        paced = replace(robot, gait=gait)
        record = metrics.record_walk(paced, setup.controller, step, **setup.draws(count))
        falls = int(count - record.upright.sum())
        row = {"step_s": step_s, "step_m": step[0], "walks": count, "falls": falls}
        if not record.upright.any():
            return {**row, "speed_m_s": None}
        steady = record.of_upright().steady(ticks)
        way_m = metrics.distance_m(steady)
        return {**row, "speed_m_s": float(way_m.mean() / metrics.duration_s(steady))}

    return [
        Part(
            name=f"pace-{step_s:g}s",
            robot_seconds=count * metrics.RECORDED_S,
            measure=partial(measure, step_s=step_s),
        )
        for step_s in (own_s, *(quicker_s if setup.controller.is_paced else ()))
    ]


def hardware_parts(setup: EvaluationSetup) -> list[Part]:
    """Falls and foot errors of mixed walks, by how robot and ground differ from the model.

    MuJoCo alone can hold that, and a controller by a model has its own servos.
    """
    if setup.engine.about is not None or not isinstance(setup.controller, Policy):
        return []
    count, steps = setup.share(10), int(EPISODE_S / setup.robot.gait.step_s) + 2

    def draw(rng: np.random.Generator, row: int, feet: np.ndarray) -> Any:
        return draw_sequence(rng, setup.robot.training_model, feet, steps=steps)

    def measure(results: Results, what: str, value: float) -> dict[str, Any]:
        errors = HARDWARE[what].errors(value, setup.robot)
        upright, missed_m = 0, []
        for rows, seed in portions(count, setup.seed):
            settings = setup.draws(len(rows)) | {"seed": seed}
            walker = start_walks(setup.robot, draw, hardware=errors, **settings)
            for tick in walk(walker, setup.controller, round(EPISODE_S / CONTROL_PERIOD_S)):
                off_m = np.linalg.norm((tick.placed_world - tick.asked_world)[:, :2], axis=1)
                missed_m.append(off_m[tick.landed])
            upright += int(tick.upright.sum())
        all_m = np.concatenate(missed_m)
        median, p95 = np.percentile(all_m, (50, 95)).tolist() if len(all_m) else (None, None)
        return {
            "what": what,
            "value": value,
            "unit": HARDWARE[what].unit,
            "walks": count,
            "falls": count - upright,
            "error_m_median": median,
            "error_m_p95": p95,
        }

    return [
        Part(
            name=f"hardware-{what.replace(' ', '_')}-{value:g}",
            robot_seconds=count * EPISODE_S,
            measure=partial(measure, what=what, value=value),
        )
        for what, kind in HARDWARE.items()
        for value in kind.values
    ]


def push_parts(setup: EvaluationSetup) -> list[Part]:
    """Success against impulse, a part for each direction."""
    mass_kg, count = setup.robot.mass_kg, setup.share(10)
    impulses_ns = [round(mass_kg * speed, 1) for speed in PUSH_SPEEDS_M_S]

    def measure(results: Results, direction: str) -> dict[str, Any]:
        success = push_recovery(
            setup.robot, setup.controller, direction, impulses_ns, **setup.draws(count)
        )
        row = {"direction": direction, "walks": count}
        return {**row, "impulses_ns": impulses_ns, "success": success}

    return [
        Part(
            name=f"push-{direction.replace(' ', '-')}",
            robot_seconds=count * len(impulses_ns) * PUSH_WALK_S,
            measure=partial(measure, direction=direction),
        )
        for direction in DIRECTIONS
    ]


SECTIONS: Mapping[str, Callable[[EvaluationSetup], list[Part]]] = {
    "modes": modes_parts,
    "stairs": stairs_parts,
    "gait": gait_parts,
    "push": push_parts,
    "energy": energy_parts,
    "pace": pace_parts,
    "hardware": hardware_parts,
    "long": long_parts,
    "limits": limits_parts,
}


def parts_of(setup: EvaluationSetup) -> list[Part]:
    """All parts of an evaluation, section by section."""
    return [part for section in SECTIONS.values() for part in section(setup)]


def measure_part(setup: EvaluationSetup, known: Results, name: str) -> dict[str, Any]:
    """The result of the part of that name, given those that it needs; for another process."""
    part = next(part for part in parts_of(setup) if part.name == name)
    return part.measure(known)
