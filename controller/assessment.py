"""How well a policy follows steps: falls and foot errors over held-out episodes of one mode."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from controller.curriculum import Stage
from controller.env import TaskConfig, WalkTask
from controller.policy import Policy
from controller.ppo import TrainConfig
from controller.randomization import DomainRandomization
from controller.stairs import STAIR_MODES
from sim.robot import Robot

# A foot that lands farther than this from its step, in space, has left the plan.
STRAYED_M = 0.25
_PER_LANDING = ("error_m", "heading_error_rad", "offset_m")


@dataclass(frozen=True, kw_only=True)
class ModeResult:
    """Episodes of one mode: how many fell, and how far feet came to rest from their steps.

    `episode_ticks` (episodes,) is how long each lasted. Per landing (N,): the horizontal distance,
    the heading error (not negative), and `landing_offset_m` (N, 2), the way from the step to the
    foot along and across (left of) the step's own heading. `strayed` counts the episodes that did
    not fall but put a foot down off the plan, as a robot does that marches on before a stair.
    """

    mode: str
    episodes: int
    falls: int
    episode_ticks: np.ndarray
    landing_error_m: np.ndarray
    landing_heading_error_rad: np.ndarray
    landing_offset_m: np.ndarray
    strayed: int = 0

    @property
    def success(self) -> float:
        """Share of the episodes that neither fell nor strayed."""
        return 1.0 - (self.falls + self.strayed) / self.episodes

    @classmethod
    def joined(cls, parts: Sequence[ModeResult]) -> ModeResult:
        """Several results of one mode as one."""
        arrays = ("episode_ticks", *(f"landing_{name}" for name in _PER_LANDING))
        return cls(
            mode=parts[0].mode,
            episodes=sum(part.episodes for part in parts),
            falls=sum(part.falls for part in parts),
            strayed=sum(part.strayed for part in parts),
            **{name: np.concatenate([getattr(part, name) for part in parts]) for name in arrays},
        )

    @property
    def summary(self) -> dict[str, float | int | str]:
        """Counts, and median, 95th and 99th percentile of the errors."""
        error_m = self.landing_error_m if len(self.landing_error_m) else np.array([np.nan])
        heading = self.landing_heading_error_rad
        heading_deg = np.degrees(heading if len(heading) else np.array([np.nan]))
        return {
            "mode": self.mode,
            "episodes": self.episodes,
            "falls": self.falls,
            "strayed": self.strayed,
            "success": self.success,
            "landings": len(self.landing_error_m),
            "error_m_median": float(np.median(error_m)),
            "error_m_p95": float(np.percentile(error_m, 95)),
            "error_m_p99": float(np.percentile(error_m, 99)),
            "heading_deg_median": float(np.median(heading_deg)),
            "heading_deg_p95": float(np.percentile(heading_deg, 95)),
        }


def assess_mode(
    robot: Robot,
    policy: Policy,
    mode: str | None,
    *,
    episodes: int,
    seed: int,
    threads: int = 1,
    config: TaskConfig | None = None,
    rise_m: float = 0.10,
    tread_error_m: float = 0.0,
    joint_noise_deg: float = 0.0,
    step_s: float | None = None,
) -> ModeResult:
    """Walk `episodes` episodes at once with the deterministic policy.

    The seed is of this run alone: nothing is shared with training. Nothing is disturbed but what
    is asked for here.

    Args:
        robot: who walks.
        policy: how.
        mode: one of `MODES`, `STAIR_MODES` or `standing`; None is a mix of the flat ones.
        episodes: how many.
        seed: of the steps, the ground and the noise.
        threads: for the physics; the result does not depend on it.
        config: rates, rewards and lengths; what it says of stairs and disturbances is left out.
        rise_m: of every step of the stairs.
        tread_error_m: each tread is uniformly up to this much higher or lower than observed.
        step_s: how long every step takes; None: as long as the robot's own gait does.
        joint_noise_deg: amplitude of the uniform noise on observed joint positions; that on
            joint speeds is as in training (`DomainRandomization.joint_speed_noise_per_s`).
    """
    config = replace(
        config or TaskConfig(),
        stairs_share=0.0,
        exact_rise=True,
        paced_share=0.0 if step_s is None else 1.0,
        step_s=(config or TaskConfig()).step_s if step_s is None else (step_s, step_s),
        randomization=DomainRandomization.exactly(
            joint_noise_deg=joint_noise_deg, tread_error_m=tread_error_m
        ),
    )
    disturbed = joint_noise_deg > 0 or tread_error_m > 0
    stage = Stage(
        rise_m=rise_m if mode in STAIR_MODES else 0.0, disturbance_level=1.0 if disturbed else 0.0
    )
    task = WalkTask(
        robot, count=episodes, seed=seed, threads=threads, mode=mode, config=config, stage=stage
    )
    alive = np.ones(episodes, dtype=bool)
    fell, strayed = np.zeros(episodes, dtype=bool), np.zeros(episodes, dtype=bool)
    ticks = np.zeros(episodes, dtype=np.int64)
    errors: list[np.ndarray] = []
    headings: list[np.ndarray] = []
    offsets: list[np.ndarray] = []
    observation, rows = task.observe(), np.arange(episodes)
    for _ in range(task.config.episode_ticks):
        side = task.walker.cursor.side
        asked = task.walker.cursor.foot_targets[rows, side]
        step = task.step(policy.act_scaled(observation))
        observation = step.observation
        ticks += alive
        counted = alive & step.landed
        away_m = np.hypot(step.landing_error_m, step.landing_height_error_m)
        strayed |= counted & (away_m > STRAYED_M)
        errors.append(step.landing_error_m[counted])
        headings.append(step.landing_heading_error_rad[counted])
        # The sensors still show the step, not the new episodes that may have begun after it.
        placed = task.walker.soles_world()[rows, side]
        offsets.append(in_step_frame(asked, placed)[counted])
        fell |= alive & step.terminated
        alive &= ~step.terminated & ~step.truncated
    return ModeResult(
        mode=mode or "mixed",
        episodes=episodes,
        falls=int(fell.sum()),
        strayed=int((strayed & ~fell).sum()),
        episode_ticks=ticks,
        landing_error_m=np.concatenate(errors),
        landing_heading_error_rad=np.concatenate(headings),
        landing_offset_m=np.concatenate(offsets),
    )


def in_step_frame(asked: np.ndarray, placed: np.ndarray) -> np.ndarray:
    """Horizontal way (B, 2) from poses asked for (B, 4) to poses placed, in the frame of asked."""
    dx, dy = (placed - asked)[:, :2].T
    cos, sin = np.cos(asked[:, 3]), np.sin(asked[:, 3])
    return np.stack([cos * dx + sin * dy, cos * dy - sin * dx], axis=1)


def at_navigation_rate(config: TaskConfig | None = None) -> TaskConfig:
    """The task at the 1 kHz physics of navigation."""
    return replace(config or TaskConfig(), timestep_s=0.001)


# The assessment that training makes of itself, in simulations and with a seed of its own.

ASSESS_SEED = 987_654_321
# The held-out stair episodes with disturbances: what the follower is to withstand.
ROUGH = {"tread_error_m": 0.03, "joint_noise_deg": 3.0}


def assess_stage(
    robot: Robot, policy: Policy, config: TrainConfig, stage: Stage, *, threads: int
) -> tuple[ModeResult, ...]:
    """Results at a stage: flat, then, where it has stairs, those without and with disturbances.

    The disturbances have the share that the stage gives those of training. The episodes of the
    configuration are divided among the results.
    """
    cases: list[tuple[str | None, dict[str, float]]] = [(None, {})]
    if stage.rise_m > 0:
        rough = {name: stage.disturbance_level * value for name, value in ROUGH.items()}
        cases += [("stairs", {"rise_m": stage.rise_m, **extra}) for extra in ({}, rough)]
    return tuple(
        assess_mode(
            robot,
            policy,
            mode,
            episodes=-(-config.assess_episodes // len(cases)),
            seed=ASSESS_SEED,
            threads=threads,
            config=config.task,
            **settings,
        )
        for mode, settings in cases
    )


def score(stage: Stage, results: tuple[ModeResult, ...]) -> tuple[float, float]:
    """What tells the better of two policies: the greater tuple.

    The one that was assessed at the higher rise is better; then falls count first, then the foot
    error.
    """
    return stage.rise_m, sum(_score(result) for result in results)


def _score(result: ModeResult) -> float:
    error_m = float(result.summary["error_m_p95"])
    return 100.0 * (result.success - 1.0) - (error_m if np.isfinite(error_m) else 1.0)
