"""Assessment of a controller: falls and foot errors over held-out episodes of one mode."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from controller.curriculum import Stage
from controller.env import TaskConfig, WalkTask
from controller.observation import rotate_xy
from controller.policy import Policy
from controller.randomization import DomainRandomization
from controller.stairs import STAIR_MODES
from controller.walker import Controller
from sim.engines import MUJOCO, Engine
from sim.robot import Robot

if TYPE_CHECKING:
    # Only `train` needs the libraries that it loads.
    from controller.ppo import TrainConfig
    from controller.ranks import Ranks

ASSESS_SEED = 987_654_321
# Disturbances, at level 1, of the held-out stair episodes that have any.
ROUGH = {"tread_error_m": 0.03, "joint_noise_deg": 3.0}
# An episode strays once a foot lands farther than this from its step, in 3D.
STRAYED_M = 0.25
_PER_LANDING = ("landing_error_m", "landing_heading_error_rad", "landing_offset_m")


@dataclass(frozen=True, kw_only=True)
class ModeResult:
    """Falls and foot errors over the episodes of one mode.

    `episode_ticks` (episodes,) is the length of each. Per landing (N,): horizontal distance from
    the step, absolute heading error, and `landing_offset_m` (N, 2), from the step to the foot,
    along and left of the step's heading. `strayed` counts the episodes without a fall in which a
    foot landed farther than `STRAYED_M` from its step, for example before a stair.
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
        arrays = ("episode_ticks", *_PER_LANDING)
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
    controller: Controller,
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
    engine: Engine = MUJOCO,
) -> ModeResult:
    """Run `episodes` held-out episodes at once, of a policy without exploration.

    Nothing is shared with training, and nothing is randomized but the arguments.

    Args:
        robot: the robot.
        controller: what walks it; a policy acts on what noisy sensors tell.
        mode: one of `MODES`, `STAIR_MODES` or `standing`; None is a mix of the flat ones.
        episodes: number of episodes.
        seed: of the steps, the ground and the noise.
        threads: for the physics; the result does not depend on it.
        config: rates, rewards and lengths; its stairs, pace and randomization are not used.
        rise_m: of every step of the stairs.
        tread_error_m: amplitude of the uniform error of each tread's height.
        joint_noise_deg: amplitude of the uniform noise on joint positions; that on joint speeds
            is as in training (`DomainRandomization.joint_speed_noise_per_s`).
        step_s: duration of every step; None: that of the robot's gait.
        engine: what simulates.
    """
    config = config or TaskConfig()
    noise = {"joint_noise_deg": joint_noise_deg, "tread_error_m": tread_error_m}
    config = replace(
        config,
        stairs_share=0.0,
        exact_rise=True,
        paced_share=0.0 if step_s is None else 1.0,
        step_s=config.step_s if step_s is None else (step_s, step_s),
        randomization=DomainRandomization.exactly(**noise),
    )
    stage = Stage(
        rise_m=rise_m if mode in STAIR_MODES else 0.0,
        disturbance_level=1.0 if any(value > 0 for value in noise.values()) else 0.0,
    )
    task = WalkTask(
        robot,
        count=episodes,
        seed=seed,
        threads=threads,
        mode=mode,
        config=config,
        stage=stage,
        engine=engine,
    )
    return _run_episodes(task, controller)


def _run_episodes(task: WalkTask, controller: Controller) -> ModeResult:
    """The first episode of each robot of a task."""
    rows = np.arange(task.count)
    alive = np.ones(task.count, dtype=bool)
    fell, strayed = ~alive, ~alive
    ticks = np.zeros(task.count, dtype=np.int64)
    landings: dict[str, list[np.ndarray]] = {name: [] for name in _PER_LANDING}
    observation = task.observe()
    task.walker.noise = task.sense
    act = controller.start(task.walker)
    for _ in range(task.config.episode_ticks):
        foot = rows, task.walker.cursor.side
        target = task.walker.cursor.foot_targets[foot]
        if isinstance(controller, Policy):
            step = task.step(controller.act(task.unscaled(observation)))
        else:
            step = task.advance(act)
        observation = step.observation
        ticks += alive
        counted = alive & step.landed
        distance_m = np.hypot(step.landing_error_m, step.landing_height_error_m)
        strayed |= counted & (distance_m > STRAYED_M)
        # The sensors are those of the step, also where a new episode has begun after it.
        offset = (task.walker.soles_world()[foot] - target)[:, :2]
        landings["landing_error_m"].append(step.landing_error_m[counted])
        landings["landing_heading_error_rad"].append(step.landing_heading_error_rad[counted])
        landings["landing_offset_m"].append(rotate_xy(offset, -target[:, 3])[counted])
        fell |= alive & step.terminated
        alive &= ~step.terminated & ~step.truncated
    return ModeResult(
        mode=task.mode or "mixed",
        episodes=task.count,
        falls=int(fell.sum()),
        strayed=int((strayed & ~fell).sum()),
        episode_ticks=ticks,
        **{name: np.concatenate(values) for name, values in landings.items()},
    )


def at_navigation_rate(config: TaskConfig | None = None) -> TaskConfig:
    """The task at the 1 kHz physics of navigation."""
    return replace(config or TaskConfig(), timestep_s=0.001)


def assess_stage(
    robot: Robot,
    policy: Policy,
    config: TrainConfig,
    stage: Stage,
    *,
    threads: int,
    ranks: Ranks,
) -> tuple[ModeResult, ...]:
    """Results at a stage: flat, then, if it has stairs, stairs without and with disturbances.

    The disturbances scale with the stage's level. The episodes are divided among the results. Of
    several `ranks` each walks its share of them, of its own seed, and all get the results of all.
    """
    cases: list[tuple[str | None, dict[str, Any]]] = [(None, {})]
    if stage.rise_m > 0:
        rough = {name: stage.disturbance_level * value for name, value in ROUGH.items()}
        cases += [("stairs", {"rise_m": stage.rise_m, **extra}) for extra in ({}, rough)]
    episodes = ranks.share(-(-config.assess_episodes // len(cases)))
    mine = [
        assess_mode(
            robot,
            policy,
            mode,
            episodes=episodes,
            seed=ASSESS_SEED + ranks.rank,
            threads=threads,
            config=config.task,
            **settings,
        )
        for mode, settings in cases
        if episodes
    ]
    # A rank beyond the number of episodes has walked none.
    parts = [results for results in ranks.gathered(mine) if results]
    return tuple(ModeResult.joined(case) for case in zip(*parts, strict=True))


def score(
    stage: Stage, results: tuple[ModeResult, ...], reward: float
) -> tuple[float, float, float]:
    """A tuple that is greater for the better of two policies.

    It compares the rise, then the failures, of which one in each result is left to chance, then
    the reward: how the robot walks. With some 40 episodes a single failure would otherwise decide
    which of two gaits is kept.
    """
    failures = sum(max(result.falls + result.strayed - 1, 0) for result in results)
    return stage.rise_m, -failures, reward
