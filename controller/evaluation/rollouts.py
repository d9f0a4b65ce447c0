"""Rollouts for evaluation: batches of robots that follow given step sequences from a stand.

The physics runs at the rate of navigation. Training and its assessment have their own episodes
(controller/env.py).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from controller.step_cursor import StepSequence
from controller.step_sequences import chain_steps
from controller.walker import Controller, Walker
from planner.robot_model import Side
from sim.engines import MUJOCO, Engine
from sim.hardware import HardwareErrors
from sim.robot import Robot
from sim.scene import build_scene

PHYSICS_TIMESTEP_S = 0.001
AT_ONCE = 250
JOINT_NOISE_RAD = 0.02
LONGEST_WAIT_TICKS = 20
# Makes the seeds differ from those of training, which are pairs.
_HELD_OUT = 20_220_712

# Draws the sequence of robot `row` from a generator, the row and the start feet (2, 4).
DrawStepSequence = Callable[[np.random.Generator, int, np.ndarray], StepSequence]


@dataclass(frozen=True, kw_only=True)
class ControlStep:
    """Results of one control step of B robots; arrays are (B, ...), left before right.

    Robots that have fallen are not `upright` from then on; they are reset and stand.
    """

    number: int
    upright: np.ndarray
    landed: np.ndarray  # a step's period has just ended, and the robot is upright
    entry: np.ndarray  # of the step under way in its sequence: STANCE + k for step k
    asked_world: np.ndarray  # (B, 4) target of that step
    placed_world: np.ndarray  # (B, 4) its foot now
    indicator: np.ndarray  # (B, 2) support indicator
    cycle_tick: np.ndarray  # control ticks since the right foot's lift-off, -1 while standing


def chained(feet: np.ndarray, first: int, relative: np.ndarray) -> StepSequence:
    """The sequence from feet (2, 4) of steps (n, 3), each in the frame of the support foot."""
    side, poses = chain_steps(feet, Side(first), relative)
    return StepSequence.of(feet, side, poses)


def start_walks(
    robot: Robot,
    draw: DrawStepSequence,
    *,
    count: int,
    seed: int | np.random.SeedSequence,
    threads: int = 1,
    engine: Engine = MUJOCO,
    record: tuple[str, ...] = (),
    hardware: HardwareErrors | None = None,
    mirrored: bool = False,
) -> Walker:
    """`count` robots near half-sitting, each before its own sequence.

    With `mirrored` they stand as the mirror images of those without; their sequences are up to
    `draw`.
    """
    scene = build_scene(robot, timestep_s=PHYSICS_TIMESTEP_S)
    rng = np.random.default_rng(seed)
    drawn = 0 if hardware is None else int(rng.integers(2**31))
    walker = Walker(
        scene,
        count=count,
        threads=threads,
        record=record,
        engine=engine,
        hardware=hardware,
        seed=drawn,
    )
    feet = scene.soles_at(scene.standing_qpos)
    for row in range(count):
        qpos = scene.standing_qpos.copy()
        noise_rad = JOINT_NOISE_RAD * rng.uniform(-1, 1, len(robot.joints))
        if mirrored:
            index, sign = robot.mirror_joints
            noise_rad = sign * noise_rad[index]
        qpos[scene.joint_qpos] += noise_rad
        walker.place(row, qpos)
        wait_ticks = int(rng.integers(LONGEST_WAIT_TICKS + 1))
        walker.follow(row, draw(rng, row, feet), wait_ticks=wait_ticks)
    return walker


def walk(walker: Walker, controller: Controller, ticks: int) -> Iterator[ControlStep]:
    """Run `ticks` control steps and yield the results of each."""
    rows = np.arange(walker.sim.count)
    upright = np.ones(len(rows), dtype=bool)
    cursor, act = walker.cursor, controller.start(walker)
    for number in range(ticks):
        side, entry, standing = cursor.side, cursor.entry.copy(), cursor.standing.copy()
        cycle_tick = np.where(standing, -1, cursor.tick + cursor.ticks.step * (1 - side))
        asked, indicator = cursor.foot_targets[rows, side], cursor.support_indicator
        ended = act()
        down = upright & walker.fallen()
        upright = upright & ~down
        yield ControlStep(
            number=number,
            upright=upright,
            landed=ended & upright,
            entry=entry,
            asked_world=asked,
            placed_world=walker.soles_world()[rows, side],
            indicator=indicator,
            cycle_tick=cycle_tick,
        )
        for row in np.flatnonzero(down):
            _set_down(walker, int(row))


def portions(count: int, seed: int) -> Iterator[tuple[range, np.random.SeedSequence]]:
    """Rows 0 to count - 1 in portions of `AT_ONCE`, each with its own seed."""
    for first in range(0, count, AT_ONCE):
        rows = range(first, min(first + AT_ONCE, count))
        yield rows, np.random.SeedSequence([_HELD_OUT, seed, first])


def _set_down(walker: Walker, row: int) -> None:
    """Reset a fallen robot to standing at its start."""
    scene = walker.scene
    walker.place(row, scene.standing_qpos)
    feet = scene.soles_at(scene.standing_qpos)
    none = np.zeros(0, dtype=np.int64)
    walker.follow(row, StepSequence.of(feet, none, np.zeros((0, 4))))
