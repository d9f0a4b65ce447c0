"""Step limits of a controller: success per kind of step, widest limits it keeps, and body sway.

Walks are 10 s long. Steps are (x_m, y_m, yaw_rad) in the support foot's frame, y and yaw outward.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from controller.evaluation.rollouts import chained, portions, start_walks, walk
from controller.gait import CONTROL_PERIOD_S
from controller.step_cursor import STANCE, StepSequence
from controller.step_sequences import clip_to_limits
from controller.walker import Controller
from planner.plan import pair_pose, wrap_angle
from planner.robot_model import BodyShape, StepLimits, StepModel
from sim.engines import MUJOCO, Engine
from sim.robot import PHYSICS_GROUP, Robot
from sim.scene import Scene

AXES = ("x_m", "y_m", "yaw_rad")
CUT = {"x_m": 0.02, "y_m": 0.01, "yaw_rad": 0.03}
MOST_CUTS = 30


@dataclass(frozen=True, kw_only=True)
class LimitTrial:
    """Results of walks within limits: `fell` (8,) of `walked` (8,) that touched each corner.

    Corners are in the order of `limit_corners`.
    """

    limits: StepLimits
    success: float
    walked: np.ndarray
    fell: np.ndarray

    @property
    def worst_corner(self) -> int:
        """The corner with the greatest share of falls."""
        return int(np.argmax(self.fell / np.maximum(self.walked, 1)))


def limit_corners(limits: StepLimits) -> np.ndarray:
    """The corners (8, 3) of the limits; low before high, the last axis changes fastest."""
    return np.array(list(itertools.product(limits.x_m, limits.y_m, limits.yaw_rad)))


def search_limits(
    model: StepModel,
    widest: StepLimits,
    walk: Callable[[StepLimits], LimitTrial],
    *,
    success: float,
) -> list[LimitTrial]:
    """All trials; the last has the required success unless nothing is left to cut.

    While too many walks fall, the corner with the most falls is cut back by one step of `CUT`.

    Args:
        model: its step set is kept as far as possible, its stance stays inside.
        widest: the first limits tried.
        walk: runs walks within limits.
        success: required share of walks without a fall.
    """
    trials = [walk(widest)]
    while trials[-1].success < success and len(trials) <= MOST_CUTS:
        narrower = cut_back(trials[-1].limits, trials[-1].worst_corner, model)
        if narrower is None:
            break
        trials.append(walk(narrower))
    return trials


def cut_back(limits: StepLimits, corner: int, model: StepModel) -> StepLimits | None:
    """The limits with one side of a corner moved inwards; None where the corner is the stance.

    The side is the one that loses the fewest steps of the set, then the smallest share of its
    range.
    """
    stance = (0.0, model.stance_width_m, 0.0)
    options: list[tuple[int, float, StepLimits]] = []
    for axis, name in enumerate(AXES):
        ends = list(getattr(limits, name))
        high = corner >> (2 - axis) & 1
        room = abs(ends[high] - stance[axis])
        if room < 1e-9:
            continue
        cut = min(CUT[name], room)
        span = ends[1] - ends[0]
        ends[high] = round(ends[high] + (-cut if high else cut), 3)
        narrower = replace(limits, **{name: (ends[0], ends[1])})
        lost = sum(limits.contain(step) and not narrower.contain(step) for step in model.steps)
        if any(narrower.contain(step) for step in model.steps):
            options.append((int(lost), cut / span, narrower))
    return min(options, key=lambda option: option[:2])[2] if options else None


LIMITS_WALK_S = 10.0
# Whether the feet can stand in each step of (n, 3).
IsFeasible = Callable[[np.ndarray], np.ndarray]
# Draws n steps (n, 3) of one walk from a generator, n and the robot's row; and which of them count.
DrawSteps = Callable[[np.random.Generator, int, int], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True, kw_only=True)
class StepWalks:
    """Results of B walks: robots that stayed `upright` (B,), and each landing that counts.

    Per landing (N,): `robot`, horizontal `error_m`, `heading_error_rad` (not negative).
    """

    upright: np.ndarray
    robot: np.ndarray
    error_m: np.ndarray
    heading_error_rad: np.ndarray


def walk_steps(
    robot: Robot,
    controller: Controller,
    draw_steps: DrawSteps,
    *,
    count: int,
    seed: int,
    threads: int = 1,
    engine: Engine = MUJOCO,
    falls_at_most: int | None = None,
) -> StepWalks:
    """Let `count` robots walk steps that are drawn anew for each.

    They walk in portions; once more than `falls_at_most` have fallen, the rest is skipped.
    """
    parts: list[StepWalks] = []
    for rows, part_seed in portions(count, seed):
        parts.append(_walk_portion(robot, controller, draw_steps, rows, part_seed, threads, engine))
        falls = sum(int((~part.upright).sum()) for part in parts)
        if falls_at_most is not None and falls > falls_at_most:
            break
    names = ("upright", "robot", "error_m", "heading_error_rad")
    return StepWalks(**{n: np.concatenate([getattr(part, n) for part in parts]) for n in names})


def _walk_portion(
    robot: Robot,
    controller: Controller,
    draw_steps: DrawSteps,
    rows: range,
    seed: np.random.SeedSequence,
    threads: int,
    engine: Engine,
) -> StepWalks:
    steps = int(LIMITS_WALK_S / robot.gait.step_s) + 2
    counting = np.zeros((len(rows), steps), dtype=bool)

    def draw(rng: np.random.Generator, row: int, feet: np.ndarray) -> StepSequence:
        relative, counting[row] = draw_steps(rng, steps, rows[row])
        return chained(feet, int(rng.integers(2)), relative)

    walker = start_walks(robot, draw, count=len(rows), seed=seed, threads=threads, engine=engine)
    upright = np.ones(len(rows), dtype=bool)
    who, error_m, heading = [], [], []
    for tick in walk(walker, controller, round(LIMITS_WALK_S / CONTROL_PERIOD_S)):
        upright = tick.upright
        landed = np.flatnonzero(tick.landed)
        landed = landed[counting[landed, tick.entry[landed] - STANCE]]
        off = (tick.placed_world - tick.asked_world)[landed]
        who.append(rows[0] + landed)
        error_m.append(np.hypot(off[:, 0], off[:, 1]))
        heading.append(np.abs(wrap_angle(off[:, 3])))
    return StepWalks(
        upright=upright,
        robot=np.concatenate(who),
        error_m=np.concatenate(error_m),
        heading_error_rad=np.concatenate(heading),
    )


def step_map(
    robot: Robot,
    controller: Controller,
    kinds: np.ndarray,
    *,
    count: int,
    seed: int,
    threads: int = 1,
    engine: Engine = MUJOCO,
) -> list[dict[str, float | None]]:
    """Success and 95th percentile of the foot error of each kind of step (K, 3).

    `count` robots a kind take it in every other step on average, at random, and steps of the
    planner's set in between, as plans do.
    """
    among = np.array(robot.step_model.steps)

    def draw(rng: np.random.Generator, steps: int, row: int) -> tuple[np.ndarray, np.ndarray]:
        this = rng.uniform(size=steps) < 0.5
        relative = among[rng.integers(len(among), size=steps)]
        relative[this] = kinds[row // count]
        return relative, this

    walks = walk_steps(
        robot, controller, draw, count=len(kinds) * count, seed=seed, threads=threads, engine=engine
    )
    success = walks.upright.reshape(len(kinds), count).mean(axis=1)
    found: list[dict[str, float | None]] = []
    for k, kind in enumerate(kinds):
        error_m = walks.error_m[walks.robot // count == k]
        found.append(
            {
                "x_m": float(kind[0]),
                "y_m": float(kind[1]),
                "yaw_rad": float(kind[2]),
                "success": float(success[k]),
                "error_m_p95": float(np.percentile(error_m, 95)) if len(error_m) else None,
            }
        )
    return found


def walk_within(
    robot: Robot,
    controller: Controller,
    limits: StepLimits,
    possible: IsFeasible,
    *,
    count: int,
    seed: int,
    threads: int = 1,
    engine: Engine = MUJOCO,
    falls_at_most: int | None = None,
) -> tuple[StepWalks, LimitTrial]:
    """Walks within limits, and their falls at each corner of the limits.

    They begin with two steps at corners, the hardest, which plans also take where they join the
    stance to the lattice; corners are clipped to the polygon. Further steps are half uniform within
    the limits, half of the planner's set.
    """
    corners = clip_to_limits(limit_corners(limits), limits, robot.step_model.stance_width_m)
    usable = np.flatnonzero(possible(corners))
    among = np.array([step for step in robot.step_model.steps if limits.contain(step)])
    low, high = np.array([limits.x_m, limits.y_m, limits.yaw_rad]).T
    touched = np.zeros((count, len(corners)), dtype=bool)

    def anywhere(rng: np.random.Generator) -> np.ndarray:
        while True:
            step = rng.uniform(low, high)
            if possible(step[None])[0]:
                return np.asarray(step)

    def draw(rng: np.random.Generator, steps: int, row: int) -> tuple[np.ndarray, np.ndarray]:
        relative = among[rng.integers(len(among), size=steps)]
        for k in np.flatnonzero(rng.uniform(size=steps) < 0.5):
            relative[k] = anywhere(rng)
        if len(usable):
            first = usable[rng.integers(len(usable), size=2)]
            relative[:2], touched[row, first] = corners[first], True
        return relative, np.ones(steps, dtype=bool)

    walks = walk_steps(
        robot,
        controller,
        draw,
        count=count,
        seed=seed,
        threads=threads,
        engine=engine,
        falls_at_most=falls_at_most,
    )
    done = touched[: len(walks.upright)]
    return walks, LimitTrial(
        limits=limits,
        success=float(walks.upright.mean()),
        walked=done.sum(axis=0),
        fell=done[~walks.upright].sum(axis=0),
    )


def step_grid(limits: StepLimits, stance_width_m: float, possible: IsFeasible) -> np.ndarray:
    """Steps (K, 3) on a grid over the limits that passes through stepping in place."""

    def axis(ends: tuple[float, float], middle: float, below: int, above: int) -> np.ndarray:
        low, high = np.linspace(ends[0], middle, below + 1), np.linspace(middle, ends[1], above + 1)
        return np.unique(np.concatenate([low, high]))

    grid = np.array(
        [
            (x_m, y_m, yaw_rad)
            for yaw_rad in axis(limits.yaw_rad, 0.0, 2, 2)
            for y_m in axis(limits.y_m, stance_width_m, 1, 2)
            for x_m in axis(limits.x_m, 0.0, 2, 3)
        ]
    )
    return grid[possible(grid)]


FEET = ("left_foot", "right_foot")


class BodySway:
    """Measures how far the collision shapes above the feet leave the plan's body boxes.

    The planner keeps a box around each pair of feet `body_margin_m` off the walls, which must cover
    this sway.
    """

    def __init__(self, scene: Scene, body: BodyShape):
        self._model, self._body = scene.model, body
        self._data = mujoco.MjData(scene.model)
        model = scene.model
        self._geoms = [
            k
            for k in range(model.ngeom)
            if model.geom_group[k] == PHYSICS_GROUP and model.geom(k).name not in FEET
        ]
        self.names = [model.geom(k).name for k in self._geoms]
        spheres = [spheres_around(model, k) for k in self._geoms]
        self._centres = np.array([centres for centres, _ in spheres])
        self._radius_m = np.array([radius_m for _, radius_m in spheres])

    def beyond_m(self, qpos: np.ndarray, stances: np.ndarray) -> np.ndarray:
        """Distance (G,) of each shape's farthest point from the nearest box; negative is within.

        Args:
            qpos: the robot's state (nq,).
            stances: both feet (n, 2, 4) of each stance of the plan nearby.
        """
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        rotation = self._data.geom_xmat[self._geoms].reshape(-1, 3, 3)
        centres = self._data.geom_xpos[self._geoms][:, None] + self._centres @ rotation.mT
        half_m = np.array([self._body.length_m, self._body.width_m]) / 2
        beyond_m = [
            beyond_box_m(centres[..., :2], pair_pose(feet), half_m).max(axis=-1) for feet in stances
        ]
        return np.asarray(np.min(beyond_m, axis=0) + self._radius_m)


def beyond_box_m(points: np.ndarray, pose: np.ndarray, half_m: np.ndarray) -> np.ndarray:
    """Distance (...) of points (..., 2) from a box of half extents (2,) at a pose (3,).

    Negative inside: how far it is to the nearest side.
    """
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    beyond_m = np.abs((points - pose[:2]) @ np.array([[cos, -sin], [sin, cos]])) - half_m
    outside_m = np.hypot(*np.moveaxis(np.maximum(beyond_m, 0.0), -1, 0))
    return np.asarray(outside_m + np.minimum(beyond_m.max(axis=-1), 0.0))


def spheres_around(model: mujoco.MjModel, geom: int) -> tuple[np.ndarray, float]:
    """Centres (8, 3) in a shape's own axes and radius of spheres whose hull holds the shape.

    Exactly the shape for spheres, capsules and boxes; of others the bounding box.
    """
    size, kind = model.geom_size[geom], model.geom_type[geom]
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return np.zeros((8, 3)), float(size[0])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return signs * [0.0, 0.0, size[1]], float(size[0])
    centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
    return centre + signs * half, 0.0
