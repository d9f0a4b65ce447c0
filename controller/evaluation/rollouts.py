"""Batches of robots that walk given sequences from a stand, watched tick by tick.

Reports are measured on these walks; training and its assessment have episodes of their own
(controller/env.py). The physics runs at the rate of navigation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from controller.policy import Policy
from controller.step_cursor import StepSequence
from controller.walker import Walker
from sim.robot import Robot
from sim.scene import build_scene

PHYSICS_TIMESTEP_S = 0.001
AT_ONCE = 250
JOINT_NOISE_RAD = 0.02
LONGEST_WAIT_TICKS = 20
# Sets these walks apart from the episodes of training, whose seeds are pairs.
_HELD_OUT = 20_220_712

# Gives robot `row` its sequence; told the random generator, the row and where its feet are (2, 4).
DrawStepSequence = Callable[[np.random.Generator, int, np.ndarray], StepSequence]


@dataclass(frozen=True, kw_only=True)
class ControlStep:
    """What one control step of B robots gave; arrays are (B, ...), left before right.

    Robots that have fallen are not `upright` from then on; they are set down anew and stand, so
    that they cost the others nothing.
    """

    number: int
    upright: np.ndarray
    landed: np.ndarray  # a step's period has just ended, and the robot is upright
    entry: np.ndarray  # of the step under way in its sequence: STANCE + k for step k
    asked_world: np.ndarray  # (B, 4) where that step was asked for
    placed_world: np.ndarray  # (B, 4) where its foot is now
    indicator: np.ndarray  # (B, 2) how much each foot should have borne weight
    cycle_tick: np.ndarray  # control ticks since the right foot's lift-off, -1 while standing


def start_walks(
    robot: Robot,
    draw: DrawStepSequence,
    *,
    count: int,
    seed: int | np.random.SeedSequence,
    threads: int = 1,
    record: tuple[str, ...] = (),
) -> Walker:
    """`count` robots in half-sitting, a little off it, each about to walk its own sequence."""
    scene = build_scene(robot, timestep_s=PHYSICS_TIMESTEP_S)
    walker = Walker(scene, count=count, threads=threads, record=record)
    feet = scene.soles_at(scene.standing_qpos)
    rng = np.random.default_rng(seed)
    for row in range(count):
        qpos = scene.standing_qpos.copy()
        qpos[scene.joint_qpos] += JOINT_NOISE_RAD * rng.uniform(-1, 1, len(robot.joints))
        walker.place(row, qpos)
        wait_ticks = int(rng.integers(LONGEST_WAIT_TICKS + 1))
        walker.follow(row, draw(rng, row, feet), wait_ticks=wait_ticks)
    return walker


def walk(walker: Walker, policy: Policy, ticks: int) -> Iterator[ControlStep]:
    """Let all walk for so many control steps; gives each step when it is done."""
    rows = np.arange(walker.sim.count)
    upright = np.ones(len(rows), dtype=bool)
    cursor = walker.cursor
    for number in range(ticks):
        side, entry, standing = cursor.side, cursor.entry.copy(), cursor.standing.copy()
        cycle_tick = np.where(standing, -1, cursor.tick + cursor.ticks.step * (1 - side))
        asked, indicator = cursor.foot_targets[rows, side], cursor.support_indicator
        ended = walker.act(policy.act(walker.observe()))
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
    """The rows 0 to count - 1 in portions that fit the memory, each with a seed of its own."""
    for first in range(0, count, AT_ONCE):
        rows = range(first, min(first + AT_ONCE, count))
        yield rows, np.random.SeedSequence([_HELD_OUT, seed, first])


def _set_down(walker: Walker, row: int) -> None:
    """A robot that has fallen, standing again where it started."""
    scene = walker.scene
    walker.place(row, scene.standing_qpos)
    feet = scene.soles_at(scene.standing_qpos)
    none = np.zeros(0, dtype=np.int64)
    walker.follow(row, StepSequence.of(feet, none, np.zeros((0, 4))))
