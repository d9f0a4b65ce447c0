"""Step sequences drawn for training and evaluation, one walking mode or a mix of them.

A step is drawn as (x_m, y_m, yaw_rad) of the swing foot in the support foot's frame, y and yaw
outward, and kept within the robot's step limits; then steps are chained into the world.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from controller.step_cursor import StepSequence
from planner.corpus.corpus import Corpus
from planner.robot_model import Side, StepLimits, StepModel

MAX_STEPS = 12

# Draws the next step, given whether the swing foot is the outer one of the motion.
DrawStep = Callable[[bool], tuple[float, float, float]]


def _straight(
    rng: np.random.Generator, limits: StepLimits, low_m: float, high_m: float
) -> DrawStep:
    length_m, width_m = rng.uniform(low_m, high_m), _stance_width(rng, limits)
    return lambda outer: (length_m, width_m, 0.0)


def _forward(rng: np.random.Generator, model: StepModel) -> DrawStep:
    limits = model.limits
    return _straight(rng, limits, 0.08, limits.x_m[1])


def _backward(rng: np.random.Generator, model: StepModel) -> DrawStep:
    limits = model.limits
    return _straight(rng, limits, limits.x_m[0], -0.05)


def _in_place(rng: np.random.Generator, model: StepModel) -> DrawStep:
    limits = model.limits
    return _straight(rng, limits, 0.0, 0.0)


def _sideways(rng: np.random.Generator, model: StepModel) -> DrawStep:
    limits = model.limits
    width_m = _stance_width(rng, limits)
    out_m = rng.uniform(0.03, max(0.03, limits.y_m[1] - width_m))
    return lambda outer: (0.0, width_m + out_m if outer else width_m, 0.0)


def _curved(rng: np.random.Generator, model: StepModel) -> DrawStep:
    limits = model.limits
    length_m, width_m = rng.uniform(0.05, 0.3), _stance_width(rng, limits)
    out_rad, in_rad = rng.uniform(0.05, limits.yaw_rad[1]), rng.uniform(0.0, 0.1)
    return lambda outer: (length_m, width_m, out_rad if outer else -in_rad)


def _turning(rng: np.random.Generator, model: StepModel) -> DrawStep:
    limits = model.limits
    width_m, out_rad = _stance_width(rng, limits), rng.uniform(0.1, limits.yaw_rad[1])
    back_rad = rng.choice([0.0, min(0.5 * out_rad, -limits.yaw_rad[0])])
    return lambda outer: (0.0, width_m, out_rad if outer else -back_rad)


def _diagonal(rng: np.random.Generator, model: StepModel) -> DrawStep:
    limits = model.limits
    length_m = rng.uniform(0.6 * limits.x_m[0], 0.7 * limits.x_m[1])
    width_m = _stance_width(rng, limits)
    out_m = rng.uniform(0.03, max(0.03, 0.8 * (limits.y_m[1] - width_m)))
    return lambda outer: (length_m, width_m + out_m if outer else width_m, 0.0)


def _arbitrary(rng: np.random.Generator, model: StepModel) -> DrawStep:
    """Every step drawn anew, anywhere within the limits or near a step of the planner's set.

    Plans mix all kinds of steps, and the policy must learn the changes between kinds.
    """
    low, high = _bounds(model.limits)

    def draw(outer: bool) -> tuple[float, float, float]:
        step = rng.uniform(low, high)
        while not model.limits.contain(step):
            step = rng.uniform(low, high)
        if rng.uniform() < 0.5:
            near = rng.normal(model.steps[rng.integers(len(model.steps))], (0.03, 0.02, 0.06))
            step = np.clip(near, low, high)
        x, y, yaw = step
        return float(x), float(y), float(yaw)

    return draw


def _stance_width(rng: np.random.Generator, limits: StepLimits) -> float:
    return rng.uniform(limits.y_m[0] + 0.01, limits.y_m[0] + 0.08)


MODES: Mapping[str, Callable[[np.random.Generator, StepModel], DrawStep]] = {
    "forward": _forward,
    "backward": _backward,
    "sideways": _sideways,
    "curved": _curved,
    "turning": _turning,
    "in_place": _in_place,
    "diagonal": _diagonal,
    "arbitrary": _arbitrary,
}
# How often each mode is drawn in training; the rest of the episodes only stand.
MODE_SHARES: Mapping[str, float] = {
    "forward": 0.14,
    "backward": 0.08,
    "sideways": 0.12,
    "curved": 0.12,
    "turning": 0.10,
    "in_place": 0.04,
    "diagonal": 0.06,
    "arbitrary": 0.30,
}


def chain_steps(
    start_feet_world: np.ndarray, first: Side, relative: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Sides (N,) and world poses (N, 4) of steps (N, 3) each given in the support foot's frame."""
    side = (int(first) + np.arange(len(relative))) % 2
    poses = np.empty((len(relative), 4))
    support = start_feet_world[1 - int(first)]
    for k, (x, y, yaw) in enumerate(relative):
        outward = 1 - 2 * side[k]
        cos, sin = np.cos(support[3]), np.sin(support[3])
        poses[k] = (
            support[0] + cos * x - sin * outward * y,
            support[1] + sin * x + cos * outward * y,
            support[2],
            support[3] + outward * yaw,
        )
        support = poses[k]
    return side, poses


def draw_sequence(
    rng: np.random.Generator,
    model: StepModel,
    start_feet_world: np.ndarray,
    *,
    mode: str | None = None,
    steps: int = MAX_STEPS,
) -> StepSequence:
    """A sequence of `steps` steps from the feet (2, 4): of one mode, or a mix when `mode` is None.

    The mode `standing` gives a sequence without steps. The last step sets the feet side by side.
    """
    relative: list[tuple[float, float, float]] = []
    first, outer_side = Side(int(rng.integers(2))), int(rng.integers(2))
    if mode == "standing" or (mode is None and rng.uniform() > sum(MODE_SHARES.values())):
        steps = 0
    while len(relative) < steps - 1:
        name = mode or str(rng.choice(list(MODE_SHARES), p=_shares()))
        draw = MODES[name](rng, model)
        for _ in range(steps if mode else int(rng.integers(2, 9))):
            outer = (int(first) + len(relative)) % 2 == outer_side
            relative.append(draw(outer))
        outer_side = int(rng.integers(2))
    del relative[max(steps - 1, 0) :]
    if steps:
        relative.append((0.0, model.stance_width_m, 0.0))
    drawn = np.array(relative).reshape(-1, 3)
    within = clip_to_limits(drawn, model.limits, model.stance_width_m)
    side, poses = chain_steps(start_feet_world, first, within)
    return StepSequence.of(start_feet_world, side, poses)


def clip_to_limits(steps: np.ndarray, limits: StepLimits, stance_width_m: float) -> np.ndarray:
    """The steps (N, 3) clipped to the limits.

    Each number is clipped to its interval; a step outside the polygon is then moved straight
    toward the stance (0, stance_width_m) to the polygon's edge.
    """
    clipped = np.clip(steps, *_bounds(limits))
    planes = limits.half_planes
    if len(planes):
        stance = np.array([0.0, stance_width_m])
        away = (clipped[:, :2] - stance) @ planes[:, :2].T
        room_m = np.maximum(planes[:, 2] - planes[:, :2] @ stance, 0.0)
        share = np.where(away > room_m, room_m / np.maximum(away, 1e-12), 1.0).min(axis=1)
        clipped[:, :2] = stance + share[:, None] * (clipped[:, :2] - stance)
    return np.asarray(clipped)


def _bounds(limits: StepLimits) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest (x, y, yaw) of a step."""
    low, high = np.array([limits.x_m, limits.y_m, limits.yaw_rad]).T
    return low, high


def _shares() -> np.ndarray:
    shares = np.array(list(MODE_SHARES.values()))
    return shares / shares.sum()


@dataclass(frozen=True, kw_only=True)
class PlannedSteps:
    """All steps (m, 3) of n plans in their support foot's frame, y and yaw outward.

    Plan i has the steps offsets[i] to offsets[i + 1]; digest tells one corpus from another.
    """

    offsets: np.ndarray
    relative: np.ndarray
    digest: str

    @classmethod
    def of(cls, corpus: Corpus, robot: str, model: StepModel) -> PlannedSteps:
        """The steps of a corpus that the robot of that name can walk.

        Raises:
            CorpusError: the plans are another robot's, outside the limits, or have no step.
        """
        corpus.require_fit(robot, model)
        return cls(
            offsets=corpus.offsets,
            relative=corpus.relative_steps(model.stance_width_m),
            digest=str(corpus.manifest.get("sha256", "")),
        )

    def draw(
        self, rng: np.random.Generator, start_feet_world: np.ndarray, *, steps: int
    ) -> StepSequence:
        """At most `steps` consecutive steps of one plan, from the feet (2, 4), either foot first.

        The plan is mirrored if the first foot is not its own.
        """
        plan = int(rng.choice(np.flatnonzero(np.diff(self.offsets))))
        first, last = int(self.offsets[plan]), int(self.offsets[plan + 1])
        begin = int(rng.integers(first, max(first, last - steps) + 1))
        foot = Side(int(rng.integers(2)))
        side, poses = chain_steps(
            start_feet_world, foot, self.relative[begin : min(begin + steps, last)]
        )
        return StepSequence.of(start_feet_world, side, poses)
