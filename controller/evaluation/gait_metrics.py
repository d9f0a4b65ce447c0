"""Gait metrics of recorded walks: joint loads, symmetry, ground forces, jerk, transport cost.

Metrics are pure functions of a `WalkRecord` without the robots that fell (`of_upright`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from controller.evaluation.gait_summary import (
    CONTACT_WEIGHTS,
    GaitRecorder,
    GaitSummary,
    summary_of,
)
from controller.evaluation.rollouts import LONGEST_WAIT_TICKS, chained, start_walks, walk
from controller.gait import CONTROL_PERIOD_S, GaitTicks
from controller.walker import Controller, Walker
from planner.robot_model import Side
from sim.engines import MUJOCO, Engine
from sim.robot import GRAVITY_M_S2, Robot

Step = tuple[float, float, float]
# How long a walk is recorded.
RECORDED_S = 10.0


@dataclass(frozen=True, kw_only=True)
class WalkRecord:
    """B robots over T control steps of S physics steps each; N = T * S.

    torque_nm, joint_speed_rad_s (B, N, J): of the servos and of the joints they turn.
    ground_force_n (B, N, 2): vertical force on each foot, left then right.
    indicator (B, T, 2), cycle_tick (B, T): as in `controller.evaluation.rollouts.ControlStep`.
    pelvis_xy_world (B, T, 2); upright (B,): did not fall.
    """

    timestep_s: float
    torque_nm: np.ndarray
    joint_speed_rad_s: np.ndarray
    ground_force_n: np.ndarray
    indicator: np.ndarray
    cycle_tick: np.ndarray
    pelvis_xy_world: np.ndarray
    upright: np.ndarray

    @property
    def substeps(self) -> int:
        """S, physics steps in a control step."""
        return self.torque_nm.shape[1] // self.indicator.shape[1]

    def of_upright(self) -> WalkRecord:
        """The walks without a fall."""
        chosen = {name: getattr(self, name)[self.upright] for name in _PER_ROBOT}
        return WalkRecord(timestep_s=self.timestep_s, **chosen)

    def steady(self, ticks: GaitTicks) -> WalkRecord:
        """The walks after three steps, over whole gait cycles, in which the body's sway cancels."""
        start, cycle = 3 * ticks.step, 2 * ticks.step
        end = start + (self.indicator.shape[1] - 1 - start) // cycle * cycle + 1
        every = self.substeps
        cut = {n: getattr(self, n)[:, start * every : end * every] for n in _PER_PHYSICS_STEP}
        cut |= {name: getattr(self, name)[:, start:end] for name in _PER_CONTROL_STEP}
        return WalkRecord(timestep_s=self.timestep_s, upright=self.upright, **cut)


_PER_PHYSICS_STEP = ("torque_nm", "joint_speed_rad_s", "ground_force_n")
_PER_CONTROL_STEP = ("indicator", "cycle_tick", "pelvis_xy_world")
_PER_ROBOT = (*_PER_PHYSICS_STEP, *_PER_CONTROL_STEP, "upright")


def record_walk(
    robot: Robot,
    controller: Controller,
    step: Step,
    *,
    count: int,
    seed: int,
    threads: int = 1,
    engine: Engine = MUJOCO,
) -> WalkRecord:
    """`count` robots that repeat one step for 10 s, half of them beginning with the left foot.

    The step is (x_m, y_m, yaw_rad) of the swing foot in the support foot's frame, y and yaw
    outward, as in `StepModel.steps`. In sideways and turning walks one foot takes the step and
    the other follows to the stance width.
    """
    relative = repeat_step(
        step, robot.step_model.stance_width_m, int(RECORDED_S / robot.gait.step_s) + 2
    )
    walker = _start(robot, relative, count, seed, threads, engine)
    sensors, joints = walker.scene.sensors, walker.scene.joint_qvel
    torque, speed, force, indicator, cycle_tick, pelvis = [], [], [], [], [], []
    upright = np.ones(count, dtype=bool)
    for tick in walk(walker, controller, round(RECORDED_S / CONTROL_PERIOD_S)):
        read = walker.sim.sensors
        torque.append(read[:, :, sensors.joint_torque])
        force.append(read[:, :, sensors.ground_force_world[:, 2]])
        speed.append(walker.sim.recorded["qvel"][:, :, joints])
        pelvis.append(read[:, -1, sensors.pelvis_pos_world[:2]])
        indicator.append(tick.indicator)
        cycle_tick.append(tick.cycle_tick)
        upright = tick.upright
    return WalkRecord(
        timestep_s=float(walker.scene.model.opt.timestep),
        torque_nm=np.concatenate(torque, axis=1),
        joint_speed_rad_s=np.concatenate(speed, axis=1),
        ground_force_n=np.concatenate(force, axis=1),
        indicator=np.stack(indicator, axis=1),
        cycle_tick=np.stack(cycle_tick, axis=1),
        pelvis_xy_world=np.stack(pelvis, axis=1),
        upright=upright,
    )


def walk_and_stand(
    robot: Robot,
    controller: Controller,
    step: Step,
    *,
    count: int,
    seed: int,
    seconds: float = RECORDED_S,
    rest_s: float = 2.0,
    threads: int = 1,
    engine: Engine = MUJOCO,
) -> GaitSummary | None:
    """The gait of `count` robots that repeat one step, set their feet side by side and stand.

    They walk for about `seconds` and stand for at least `rest_s`; the pelvis's height at rest is
    the median over robots at the end. Robots that fell are left out; None where too few are left.
    """
    width_m = robot.step_model.stance_width_m
    steps = int(seconds / robot.gait.step_s)
    relative = np.vstack([repeat_step(step, width_m, steps), (0.0, width_m, 0.0)])
    walker = _start(robot, relative, count, seed, threads, engine)
    longest_s = LONGEST_WAIT_TICKS * CONTROL_PERIOD_S + (steps + 2) * robot.gait.step_s + rest_s
    recorders = [GaitRecorder(walker, row) for row in range(count)]
    upright, cursor = np.ones(count, dtype=bool), walker.cursor
    sides, walking = cursor.side.copy(), ~cursor.standing
    for tick in walk(walker, controller, round(longest_s / CONTROL_PERIOD_S)):
        upright = tick.upright
        for row in np.flatnonzero(upright):
            recorders[row].ticked(
                walker,
                Side(int(sides[row])),
                walking=bool(walking[row]),
                landed=bool(tick.landed[row]),
            )
        sides, walking = cursor.side.copy(), ~cursor.standing
    return summary_of([recorders[row] for row in np.flatnonzero(upright)])


def _start(
    robot: Robot, relative: np.ndarray, count: int, seed: int, threads: int, engine: Engine
) -> Walker:
    """Robots that take these steps (n, 3), every other one with the left foot first."""
    return start_walks(
        robot,
        lambda rng, row, feet: chained(feet, row % 2, relative),
        count=count,
        seed=seed,
        threads=threads,
        engine=engine,
        record=("qvel",),
    )


def repeat_step(step: Step, stance_width_m: float, steps: int) -> np.ndarray:
    """Steps (steps, 3) of a walk that repeats one step; see `record_walk`."""
    x_m, y_m, yaw_rad = step
    follows = (x_m, stance_width_m, 0.0) if y_m != stance_width_m or yaw_rad else step
    return np.array([(step, follows)[k % 2] for k in range(steps)])


def joint_loads(record: WalkRecord, robot: Robot) -> list[dict[str, Any]]:
    """Per joint: peak and root mean square of torque and speed over all walks, and its limits."""
    torque, speed = record.torque_nm, record.joint_speed_rad_s
    return [
        {
            "joint": joint.name,
            "peak_torque_nm": float(np.abs(torque[..., k]).max()),
            "rms_torque_nm": float(np.sqrt(np.mean(torque[..., k] ** 2))),
            "torque_limit_nm": joint.torque_limit_nm,
            "peak_speed_rad_s": float(np.abs(speed[..., k]).max()),
            "rms_speed_rad_s": float(np.sqrt(np.mean(speed[..., k] ** 2))),
            "speed_limit_rad_s": joint.speed_limit_rad_s,
        }
        for k, joint in enumerate(robot.joints)
    ]


def asymmetry(left: float, right: float) -> float:
    """Difference of the two sides over their mean: 0 for equal, 2 if one is zero."""
    mean = (left + right) / 2
    return abs(left - right) / mean if mean else 0.0


@dataclass(frozen=True, kw_only=True)
class GaitCycleCurves:
    """A quantity of each foot over the gait cycle, which begins at the right foot's lift-off.

    time_s (n,): middles of the bins. mean, low, high (n, 2): left then right; low and high are
    the 5th and 95th percentiles over cycles and robots.
    """

    time_s: np.ndarray
    mean: np.ndarray
    low: np.ndarray
    high: np.ndarray


def gait_cycle_curves(
    record: WalkRecord, values: np.ndarray, ticks: GaitTicks, *, bins: int
) -> GaitCycleCurves:
    """Values (B, N, 2) at the physics rate, binned by the phase of the gait.

    Each cycle, also an incomplete one, counts once per bin, with its mean there.
    """
    substeps = record.substeps
    walking = record.cycle_tick >= 0
    start = record.cycle_tick[..., None] * substeps + np.arange(substeps)
    phase = start.reshape(len(start), -1)
    cycle = 2 * ticks.step * substeps
    bin_of = phase * bins // cycle
    # A new cycle begins where the phase falls back.
    number = np.cumsum(np.diff(phase, axis=1, prepend=phase[:, :1]) < 0, axis=1)
    chosen = np.repeat(walking, substeps, axis=1)
    curves = np.full((2, 3, bins), np.nan)
    most = int(number.max(initial=0)) + 1
    robot = np.arange(len(phase))[:, None]
    key = ((robot * most + number) * bins + bin_of)[chosen]
    size = len(phase) * most * bins
    count = np.bincount(key, minlength=size)
    for side in Side:
        total = np.bincount(key, weights=values[..., side][chosen], minlength=size)
        with np.errstate(invalid="ignore"):
            means = (total / count).reshape(-1, bins)
        for bin_ in range(bins):
            there = means[~np.isnan(means[:, bin_]), bin_]
            if len(there):
                curves[side, :, bin_] = there.mean(), *np.percentile(there, [5, 95])
    middles = (np.arange(bins) + 0.5) * 2 * ticks.step * CONTROL_PERIOD_S / bins
    mean, low, high = np.moveaxis(curves, 1, 0).swapaxes(1, 2)
    return GaitCycleCurves(time_s=middles, mean=mean, low=low, high=high)


def peak_weights(record: WalkRecord, mass_kg: float) -> list[float]:
    """The greatest force under each foot over the robot's weight, left then right."""
    most_n = record.ground_force_n.max(axis=(0, 1))
    return [float(force_n / (mass_kg * GRAVITY_M_S2)) for force_n in most_n]


def in_contact(record: WalkRecord, mass_kg: float) -> np.ndarray:
    """Whether each foot bears weight (B, N, 2)."""
    return np.asarray(record.ground_force_n > CONTACT_WEIGHTS * mass_kg * GRAVITY_M_S2)


def contact_agreement(record: WalkRecord, mass_kg: float) -> float:
    """Share of the time outside the ramps in which contact agrees with the support indicator.

    A foot whose indicator is +1 should be in contact, one at -1 should not (Singh et al. 2022,
    sec. IV-C); nan where there is no such time.
    """
    contact = in_contact(record, mass_kg)
    asked = np.repeat(record.indicator, record.substeps, axis=1)
    settled = np.abs(asked) >= 1.0
    return float(np.mean(contact[settled] == (asked[settled] > 0))) if settled.any() else np.nan


def swing_lags(record: WalkRecord, mass_kg: float, ticks: GaitTicks) -> tuple[float, float]:
    """Median delays, in seconds, of lift-off and touchdown from the gait clock.

    Lift-off is the first moment of a swing without contact, touch-down the first with contact
    after its middle; nan where there is no whole swing.
    """
    contact, substeps = in_contact(record, mass_kg), record.substeps
    period, swing = ticks.step * substeps, ticks.swing * substeps
    lifts, touches = [], []
    for side, begin in ((Side.RIGHT, 0), (Side.LEFT, ticks.step)):
        for row, tick in zip(*np.nonzero(record.cycle_tick == begin), strict=True):
            foot = contact[row, tick * substeps : tick * substeps + period, side]
            if len(foot) < period or foot.all():
                continue
            lifts.append(int(np.argmin(foot)))
            late = foot[swing // 2 :]
            if late.any():
                touches.append(swing // 2 + int(np.argmax(late)) - swing)
    return _median_s(lifts, record.timestep_s), _median_s(touches, record.timestep_s)


def _median_s(steps: list[int], timestep_s: float) -> float:
    return float(np.median(steps)) * timestep_s if steps else np.nan


def joint_jerk_rad_s3(record: WalkRecord) -> float:
    """Root mean square over joints and walks of the joints' jerk, by differences at 40 Hz.

    The mean speed over a control step is the difference of the joint's positions.
    """
    robots, steps, joints = record.joint_speed_rad_s.shape
    split = robots, steps // record.substeps, record.substeps, joints
    speed = record.joint_speed_rad_s.reshape(split).mean(axis=2)
    jerk = np.diff(speed, n=2, axis=1) / CONTROL_PERIOD_S**2
    return float(np.sqrt(np.mean(jerk**2))) if jerk.size else np.nan


def mechanical_work_j(record: WalkRecord) -> np.ndarray:
    """Absolute work (B,) of all servos, braking included, after the first control step."""
    power_w = np.abs(record.torque_nm * record.joint_speed_rad_s).sum(axis=2)
    return np.asarray(power_w[:, record.substeps :].sum(axis=1) * record.timestep_s)


def distance_m(record: WalkRecord) -> np.ndarray:
    """Straight distance (B,) that each pelvis moved."""
    way = record.pelvis_xy_world[:, -1] - record.pelvis_xy_world[:, 0]
    return np.linalg.norm(way, axis=1)


def duration_s(record: WalkRecord) -> float:
    """The time from the end of the first control step to that of the last."""
    return (record.pelvis_xy_world.shape[1] - 1) * CONTROL_PERIOD_S


def cost_of_transport(work_j: np.ndarray, mass_kg: float, way_m: np.ndarray) -> np.ndarray:
    """Work per weight and distance, E / (m g d), without a unit."""
    return np.asarray(work_j / (mass_kg * GRAVITY_M_S2 * way_m))
