"""Flights of stairs for training and evaluation: step sequences and the ground under them.

A flight is a chain of places, one tread run apart, each with its height; the first places are level
with the start, those after the last riser with its top. The feet take one place per step, or both
stand on each place. Edges lie midway between places of different height.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from controller.observation import rotate_xy
from controller.step_cursor import StepSequence
from planner.plan import relative_step
from planner.robot_model import Side, StepModel
from sim.terrain import LANDING_DEPTH_M, TREAD_DEPTH_M, TREADS, Ground

STAIR_MODES = ("stairs_up", "stairs_down", "stairs_over", "stairs_curved", "stairs")
# How often each kind is drawn in the mode `stairs`.
KIND_SHARES: Mapping[str, float] = {
    "stairs_up": 0.35,
    "stairs_down": 0.35,
    "stairs_over": 0.14,
    "stairs_curved": 0.16,
}
RUN_M = (0.25, 0.30)
EDGE_MARGIN_M = 0.005
TRIES = 20
# Flights on which both feet stand on each place. The second foot down is the hardest to learn: the
# step that it sees is level with the other foot, and its heel has to pass the edge behind it.
BOTH_FEET_SHARE = 0.6


@dataclass(frozen=True, kw_only=True)
class _Shape:
    """Geometry of the steps on a flight; lengths in m."""

    run_m: float
    approach_m: float
    turn_rad: float
    width_m: float
    slack_m: float
    skew_rad: float


def draw_stairs(
    rng: np.random.Generator,
    model: StepModel,
    start_feet_world: np.ndarray,
    *,
    mode: str,
    rise_m: float,
    steps: int,
    tread_error_m: float = 0.0,
) -> tuple[StepSequence, Ground]:
    """A sequence of `steps` (at least 4) steps over a flight, and the true ground.

    Args:
        rng: the random generator.
        model: the robot's step model; every step keeps its limits.
        start_feet_world: both feet (2, 4), left then right, side by side.
        mode: one of `STAIR_MODES`; `stairs` is a mix.
        rise_m: height of every step of the flight, positive.
        steps: number of steps.
        tread_error_m: amplitude of each tread's height error; limited to half the rise, so that no
            tread covers another.
    """
    if mode == "stairs":
        kinds = list(KIND_SHARES)
        mode = str(rng.choice(kinds, p=np.array(list(KIND_SHARES.values()))))
    both_feet = bool(rng.uniform() < BOTH_FEET_SHARE) and steps >= 6
    step = np.arange(steps)
    place = np.where(step < steps - 1, step // 2 if both_feet else step, steps - 2) + 1
    if both_feet:
        place[-1] = place[-2]
    places = int(place[-1])
    heights = _heights(rng, mode, places, rise_m)
    start = start_feet_world.mean(axis=0)
    side = (int(rng.integers(2)) + step) % 2
    for attempt in range(TRIES + 1):
        shape = _draw_shape(rng, model, plain=attempt == TRIES, curved=mode == "stairs_curved")
        centres = _centres(start, heights, shape)
        poses = _foot_poses(rng, centres, place, side, shape)
        sequence = StepSequence.of(start_feet_world, side, poses)
        if _within_limits(model, sequence):
            break
    return sequence, _ground(rng, centres, min(tread_error_m, rise_m / 2))


def _heights(rng: np.random.Generator, mode: str, places: int, rise_m: float) -> np.ndarray:
    """Height (places + 1,) of each place over the start's."""
    before = int(rng.integers(min(3, places)))
    after = int(rng.integers(min(3, places - before)))
    risers = min(places - before - after, TREADS + 1)
    change = np.zeros(places + 1)
    if mode == "stairs_over" and risers >= 3:  # up to two level places or more, and down again
        up = int(rng.integers(1, (risers - 1) // 2 + 1))
        level = min(risers - 2 * up, int(rng.integers(1, 4)))
        change[before + 1 : before + 1 + up] = 1.0
        change[before + 1 + up + level : before + 1 + 2 * up + level] = -1.0
    else:
        goes_up = mode in ("stairs_up", "stairs_over") or (
            mode == "stairs_curved" and rng.uniform() < 0.5
        )
        change[before + 1 : before + risers + 1] = 1.0 if goes_up else -1.0
    return np.cumsum(change) * rise_m


def _draw_shape(rng: np.random.Generator, model: StepModel, *, plain: bool, curved: bool) -> _Shape:
    """The shape of a flight; a `plain` one keeps every limit by itself."""
    limits, foot = model.limits, model.foot
    ahead_m = limits.most_x_m(model.stance_width_m)
    length_m = foot.length_m
    low_m = max(RUN_M[0], length_m + 0.04)
    high_m = max(low_m, min(RUN_M[1], ahead_m - 0.01))
    run_m = min(rng.uniform(low_m, high_m), ahead_m)
    width_m = rng.uniform(limits.y_m[0] + 0.01, limits.y_m[0] + 0.08)
    approach_m = rng.uniform(0.1, run_m)
    slack_share = rng.uniform() if rng.uniform() < 0.5 else 0.0
    skew_rad = rng.uniform(-0.06, 0.06) if rng.uniform() < 0.5 else 0.0
    turn_rad = rng.choice([-1.0, 1.0]) * rng.uniform(0.03, 0.15) if curved else 0.0
    # Room between a foot and the edges; a turn reduces it at the outer corner of the foot.
    toe_m = (length_m * math.cos(skew_rad) + foot.width_m * abs(math.sin(skew_rad))) / 2
    room_m = max(0.0, run_m / 2 - toe_m - EDGE_MARGIN_M)
    reach_m = (width_m + foot.width_m) / 2
    turn_rad = math.copysign(min(abs(turn_rad), room_m / reach_m), turn_rad)
    slack_m = slack_share * (room_m - abs(turn_rad) * reach_m)
    if plain:
        width_m, slack_m, skew_rad, turn_rad = model.stance_width_m, 0.0, 0.0, 0.0
    return _Shape(
        run_m=run_m,
        approach_m=approach_m,
        turn_rad=turn_rad,
        width_m=width_m,
        slack_m=slack_m,
        skew_rad=skew_rad,
    )


def _centres(start: np.ndarray, heights: np.ndarray, shape: _Shape) -> np.ndarray:
    """Poses (places + 1, 4) of the places in the world."""
    centres = np.empty((len(heights), 4))
    x, y, z, yaw = start
    first = int(np.flatnonzero(heights)[0])
    for k in range(len(heights)):
        if k:
            level = k < first
            turn = 0.0 if level else shape.turn_rad
            length_m = shape.approach_m if level else shape.run_m
            x += length_m * math.cos(yaw + turn / 2)
            y += length_m * math.sin(yaw + turn / 2)
            yaw += turn
        centres[k] = x, y, z + heights[k], yaw
    return centres


def _foot_poses(
    rng: np.random.Generator,
    centres: np.ndarray,
    place: np.ndarray,
    side: np.ndarray,
    shape: _Shape,
) -> np.ndarray:
    """World poses (N, 4) of feet of the `side` (N,) at the `place` (N,) in the chain."""
    along_m = shape.slack_m * rng.uniform(-1, 1, len(place))
    if len(place) > 1:
        along_m[-1] = along_m[-2]
    left_m = (1 - 2 * side) * shape.width_m / 2
    poses = centres[place]
    poses[:, :2] += rotate_xy(np.stack([along_m, left_m], axis=1), poses[:, 3])
    poses[:, 3] += shape.skew_rad
    return poses


def _within_limits(model: StepModel, sequence: StepSequence) -> bool:
    steps = [
        relative_step(
            sequence.pose_world[k - 1], sequence.pose_world[k], Side(int(sequence.side[k]))
        )
        for k in range(2, len(sequence.side))
    ]
    return bool(model.limits.contain(np.array(steps), tolerance=1e-6).all())


def _ground(rng: np.random.Generator, centres: np.ndarray, error_m: float) -> Ground:
    """The floor at the lower end, a landing at every upper end, and a tread at each place between.

    Each block's face ends exactly at the edge to the next lower one.
    """
    z = centres[:, 2]
    rises = np.flatnonzero(np.diff(z)) + 1
    first, last = int(rises[0]), int(rises[-1])
    floor_z = min(z[0], z[-1])
    errors = error_m * rng.uniform(-1, 1, len(centres))
    errors[:first] = 0.0
    for k in range(first + 1, len(centres)):
        if z[k] == z[k - 1]:  # level places overlap: they are one slab
            errors[k] = errors[k - 1]
    treads = []
    for k in range(first, last):
        if abs(z[k] - floor_z) > 1e-9:
            block = _block(centres, k, TREAD_DEPTH_M)
            block[2] += errors[k]
            treads.append(block)
    landings = []
    if z[0] > floor_z + 1e-9:
        landings.append(_block(centres, first - 1, LANDING_DEPTH_M, forward=False))
    if z[-1] > floor_z + 1e-9:
        block = _block(centres, last, LANDING_DEPTH_M, forward=True)
        block[2] += errors[last]
        landings.append(block)
    elif z[0] > floor_z + 1e-9:
        floor_z += errors[last]
    return Ground(
        floor_z_m=float(floor_z),
        treads=np.array(treads).reshape(-1, 4),
        landings=np.array(landings).reshape(-1, 4),
    )


def _block(
    centres: np.ndarray, k: int, depth_m: float, *, forward: bool | None = None
) -> np.ndarray:
    """Pose (4,) of the block under place k; `forward` says to which end a landing reaches."""
    x, y, z, yaw = centres[k]
    behind = forward is not False and centres[k - 1, 2] < z - 1e-9
    ahead = forward is not True and k + 1 < len(centres) and centres[k + 1, 2] < z - 1e-9
    shift = 0.0
    if behind and not ahead:
        shift = depth_m / 2 - math.dist(centres[k - 1, :2], (x, y)) / 2
    elif ahead and not behind:
        shift = math.dist(centres[k + 1, :2], (x, y)) / 2 - depth_m / 2
    return np.array([x + shift * math.cos(yaw), y + shift * math.sin(yaw), z, yaw])
