"""Push recovery: the share of walking robots that stay upright after a push at the pelvis."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from controller.evaluation.rollouts import chained, portions, start_walks, walk
from controller.gait import CONTROL_PERIOD_S
from controller.recovery import SHORTEST_SWING_S, change_steps, step_change
from controller.step_cursor import StepSequence
from controller.walker import Controller
from sim.engines import MUJOCO, Engine
from sim.robot import Robot

# In the frame of the walk: x forward, y left.
DIRECTIONS: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "from behind": (1.0, 0.0),
        "from the front": (-1.0, 0.0),
        "from the right": (0.0, 1.0),
        "from the left": (0.0, -1.0),
    }
)
PUSH_S = 0.1
EARLIEST_S = 2.0
PUSH_WALK_S = 8.0
PUSH_EVERY_S = (3.0, 5.0)


@dataclass(frozen=True, kw_only=True)
class Push:
    """One push: an impulse in N s along a direction (x, y), and when it begins."""

    impulse_ns: float
    direction: tuple[float, float]
    begins_tick: int

    @property
    def force_world_n(self) -> tuple[float, float, float]:
        """The force that gives the impulse in `PUSH_S`."""
        force_n = self.impulse_ns / PUSH_S
        return force_n * self.direction[0], force_n * self.direction[1], 0.0

    def acts(self, tick: int) -> bool:
        """Whether it pushes during control step `tick`."""
        return self.begins_tick <= tick and not self.is_over(tick)

    def is_over(self, tick: int) -> bool:
        """Whether it has ended before control step `tick`."""
        return tick - self.begins_tick >= round(PUSH_S / CONTROL_PERIOD_S)


def push_recovery(
    robot: Robot,
    controller: Controller,
    direction: str,
    impulses_ns: Sequence[float],
    *,
    count: int,
    seed: int,
    threads: int = 1,
    engine: Engine = MUJOCO,
    moves_steps: bool = True,
) -> list[float]:
    """Share of `count` robots that are upright at the end, per impulse.

    All walk straight along the world's x and are pushed once, at a time uniform over a gait cycle.
    Those pushed from the left are the mirror images of those pushed from the right, so that the two
    shares differ by no more than the robot and its controller do. With `moves_steps` their steps
    change as `navigate` changes them on free ground.
    """
    rng = np.random.default_rng(seed)
    cycle_s = 2 * robot.gait.step_s
    pushes = [
        Push(
            impulse_ns=impulse_ns,
            direction=DIRECTIONS[direction],
            begins_tick=round((EARLIEST_S + rng.uniform(0, cycle_s)) / CONTROL_PERIOD_S),
        )
        for impulse_ns in impulses_ns
        for _ in range(count)
    ]
    stayed = []
    for rows, part_seed in portions(len(pushes), seed):
        part = [pushes[row] for row in rows]
        stayed.append(
            _walk_pushed(robot, controller, part, part_seed, threads, engine, moves_steps)
        )
    shares = np.concatenate(stayed).reshape(len(impulses_ns), count).mean(axis=1)
    return [float(share) for share in shares]


def _walk_pushed(
    robot: Robot,
    controller: Controller,
    pushes: Sequence[Push],
    seed: np.random.SeedSequence,
    threads: int,
    engine: Engine,
    moves_steps: bool,
) -> np.ndarray:
    """Which robots (B,) are upright at the end of the walk."""
    steps = int(PUSH_WALK_S / SHORTEST_SWING_S) + 2
    mirrored = any(push.direction == DIRECTIONS["from the left"] for push in pushes)
    width_m = robot.step_model.stance_width_m
    ahead_m = robot.step_model.limits.most_x_m(width_m)

    def draw(rng: np.random.Generator, row: int, feet: np.ndarray) -> StepSequence:
        length_m = rng.uniform(0.5, 1.0) * ahead_m
        relative = np.tile((length_m, width_m, 0.0), (steps, 1))
        first = int(rng.integers(2))
        return chained(feet, 1 - first if mirrored else first, relative)

    walker = start_walks(
        robot,
        draw,
        count=len(pushes),
        seed=seed,
        threads=threads,
        engine=engine,
        mirrored=mirrored,
    )
    still = (0.0, 0.0, 0.0)
    upright = np.ones(len(pushes), dtype=bool)
    for tick in walk(walker, controller, round(PUSH_WALK_S / CONTROL_PERIOD_S)):
        upright, coming = tick.upright, tick.number + 1
        forces = [push.force_world_n if push.acts(coming) else still for push in pushes]
        walker.sim.push(np.array(forces))
        if moves_steps:
            change_steps(walker, step_change(walker))
    return upright


def random_pushes(impulse_ns: float, rng: np.random.Generator) -> Iterator[Push]:
    """One push after the other, from anywhere, every 3 to 5 seconds; none of no impulse."""
    time_s = 0.0
    while impulse_ns > 0:
        time_s += rng.uniform(*PUSH_EVERY_S)
        angle_rad = rng.uniform(-math.pi, math.pi)
        yield Push(
            impulse_ns=impulse_ns,
            direction=(math.cos(angle_rad), math.sin(angle_rad)),
            begins_tick=round(time_s / CONTROL_PERIOD_S),
        )
