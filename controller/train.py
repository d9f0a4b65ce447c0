"""Training from nothing to a policy, in segments that a killed run takes up again exactly.

A segment is a fixed number of updates. It begins by drawing new episodes and seeding torch from
(seed, segment), and ends with a checkpoint; so a resumed run gives the policy that the
uninterrupted one gives, whatever the number of physics threads.
"""

from __future__ import annotations

import json
import os
import subprocess
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch

from controller.assess import ModeResult, assess_mode
from controller.curriculum import Curriculum, Stage
from controller.env import TaskConfig, Transition, WalkTask
from controller.planned import PlannedSteps
from controller.policy import Policy, fitting, save_policy
from controller.ppo import (
    PpoConfig,
    RslWalkEnv,
    actor_layers,
    make_ppo,
    set_progress,
)
from sim.robot import Robot

CHECKPOINT_FORMAT = "walk-training/2"
ASSESS_SEED = 987_654_321
# The held-out stair episodes with disturbances: what the follower is to withstand.
ROUGH = {"tread_error_m": 0.03, "joint_noise_deg": 3.0}


class TrainingError(ValueError):
    """The training folder cannot be used as asked."""


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """A whole run. `samples` are control steps of single robots.

    `corpus` is the digest of the planner's corpus that is trained on, empty for none.
    """

    robot: str = "jvrc1"
    samples: int = 16_000_000
    seed: int = 0
    corpus: str = ""
    updates_per_segment: int = 20
    assess_episodes: int = 128
    curriculum: Curriculum = field(default_factory=Curriculum)
    task: TaskConfig = field(default_factory=TaskConfig)
    ppo: PpoConfig = field(default_factory=PpoConfig)

    @property
    def samples_per_segment(self) -> int:
        """Control steps between two checkpoints."""
        return self.updates_per_segment * self.ppo.samples_per_update

    @property
    def segments(self) -> int:
        """Segments of the whole run; the last one may go a little past `samples`."""
        return -(-self.samples // self.samples_per_segment)


@dataclass(frozen=True, kw_only=True)
class Report:
    """What a segment gave; passed to the progress display."""

    samples: int
    samples_total: int
    samples_per_s: float
    seconds_left: float
    reward: float
    landing_error_m: float
    falls_per_episode: float
    result: ModeResult
    stage: Stage
    stairs: tuple[ModeResult, ...]
    best: bool


@dataclass
class Tally:
    """Counts over the transitions of a segment."""

    reward: float = 0.0
    steps: int = 0
    ended: int = 0
    fallen: int = 0
    stairs_ended: int = 0
    stairs_fallen: int = 0
    failed: int = 0
    errors: list[np.ndarray] = field(default_factory=list)
    terms: dict[str, float] = field(default_factory=dict)

    def add(self, step: Transition) -> None:
        """Count one control step of all robots."""
        self.reward += float(step.reward.mean())
        self.steps += 1
        self.ended += int((step.terminated | step.truncated).sum())
        self.fallen += int(step.terminated.sum())
        self.stairs_ended += int((step.stairs & (step.terminated | step.truncated)).sum())
        self.stairs_fallen += int((step.stairs & step.terminated).sum())
        self.failed += int(step.failed.sum())
        self.errors.append(step.landing_error_m[step.landed])
        for name, value in step.terms.items():
            self.terms[name] = self.terms.get(name, 0.0) + value

    def summary(self) -> dict[str, float]:
        """Means over the segment."""
        landings = np.concatenate(self.errors) if self.errors else np.zeros(0)
        return {
            "reward": self.reward / max(self.steps, 1),
            "falls_per_episode": self.fallen / max(self.ended, 1),
            "stairs_falls_per_episode": self.stairs_fallen / max(self.stairs_ended, 1),
            "landing_error_m": float(np.median(landings)) if len(landings) else float("nan"),
            "failed_simulations": float(self.failed),
            **{f"term/{name}": value / self.steps for name, value in self.terms.items()},
        }


class Trainer:
    """One training run in one folder: checkpoint, log, and the best policy so far."""

    def __init__(
        self,
        robot: Robot,
        config: TrainConfig,
        out: Path,
        *,
        threads: int,
        command: str,
        planned: PlannedSteps | None = None,
    ):
        self.robot, self.config, self.out = robot, config, out
        self.threads, self.command = threads, command
        self._revision = git_revision()  # of the code that runs, not of what is committed later
        torch.set_num_threads(config.ppo.learner_threads)
        torch.manual_seed(config.seed)
        task = WalkTask(
            robot,
            count=config.ppo.robots,
            seed=config.seed,
            threads=threads,
            config=config.task,
            planned=planned,
        )
        self.env = RslWalkEnv(task)
        self.ppo = make_ppo(self.env, config.ppo)
        self.segment = 0
        self.stage = config.curriculum.first()
        self.best_score = (-np.inf, -np.inf)
        self.history: list[dict[str, Any]] = []

    def run(self, progress: Callable[[Report], None]) -> Policy:
        """Train to the end, from where the run stands; returns the best policy."""
        from torch.utils.tensorboard import SummaryWriter

        best = self._policy()
        with SummaryWriter(log_dir=str(self.out / "tensorboard")) as writer:
            while self.segment < self.config.segments:
                report = self._run_segment(writer)
                self.save_checkpoint()
                if report.best:
                    best = self._policy()
                    save_policy(best, self.out / f"{self.robot.name}.safetensors")
                progress(report)
        return best

    def _run_segment(self, writer: Any) -> Report:
        config = self.config
        segment_seed = np.random.SeedSequence([config.seed, self.segment])
        torch.manual_seed(int(segment_seed.generate_state(1)[0]))  # rsl-rl draws from it
        self.env.task.restart(segment_seed, stage=self.stage)
        started, tally = time.perf_counter(), Tally()
        observation = self.env.get_observations()
        losses: dict[str, float] = {}
        for update in range(config.updates_per_segment):
            done = self.segment + update / config.updates_per_segment
            set_progress(self.ppo, config.ppo, done / config.segments)
            observation = self._sample(observation, tally)
            torch.set_num_threads(config.ppo.learner_threads)
            losses = self.ppo.update()
        seconds = time.perf_counter() - started
        self.segment += 1
        return self._note(writer, tally.summary(), losses, self._assess(), seconds)

    def _assess(self) -> tuple[ModeResult, ...]:
        """Held-out results at the present stage: flat, then stairs without and with disturbances.

        The disturbances have the share that the stage gives those of training.
        """
        stage, policy = self.stage, self._policy()
        cases: list[tuple[str | None, dict[str, float]]] = [(None, {})]
        if stage.rise_m > 0:
            rough = {name: stage.hardness * value for name, value in ROUGH.items()}
            cases += [("stairs", {"rise_m": stage.rise_m, **extra}) for extra in ({}, rough)]
        return tuple(
            assess_mode(
                self.robot,
                policy,
                mode,
                episodes=-(-self.config.assess_episodes // len(cases)),
                seed=ASSESS_SEED,
                threads=self.threads,
                config=self.config.task,
                **settings,
            )
            for mode, settings in cases
        )

    def _sample(self, observation: Any, tally: Tally) -> Any:
        """One rollout with the present policy; returns the observation after it."""
        torch.set_num_threads(1)  # the physics has the cores
        with torch.inference_mode():
            for _ in range(self.config.ppo.ticks_per_update):
                actions = self.ppo.act(observation)
                observation, rewards, dones, extras = self.env.step(actions)
                self.ppo.process_env_step(observation, rewards, dones, extras)
                tally.add(extras["transition"])
            self.ppo.compute_returns(observation)
        return observation

    def _note(
        self,
        writer: Any,
        summary: dict[str, float],
        losses: dict[str, float],
        results: tuple[ModeResult, ...],
        seconds: float,
    ) -> Report:
        """Log the segment, keep its line of history, and tell whether it is the best so far.

        Of two policies the one that was assessed at the higher rise is better.
        """
        config, stage, (flat, *stairs) = self.config, self.stage, results
        samples = self.segment * config.samples_per_segment
        assessed = flat.summary
        assessed_stairs = [result.summary for result in stairs]
        for name, value in {**summary, **{f"loss/{k}": v for k, v in losses.items()}}.items():
            writer.add_scalar(f"train/{name}", value, samples)
        writer.add_scalar("train/rise_m", stage.rise_m, samples)
        groups = zip(("assess", "stairs", "rough_stairs"), (flat, *stairs), strict=False)
        for group, result in groups:
            for name, number in result.summary.items():
                if not isinstance(number, str):
                    writer.add_scalar(f"{group}/{name}", number, samples)
        writer.flush()
        score = (stage.rise_m, sum(_score(result) for result in results))
        best = score > self.best_score
        self.best_score = max(score, self.best_score)
        line = {"samples": samples, "seconds": seconds, "rise_m": stage.rise_m, **summary}
        self.history.append({**line, "assess": assessed, "assess_stairs": assessed_stairs})
        self.stage = config.curriculum.after(
            stage,
            updates=self.segment * config.updates_per_segment,
            flat_success=flat.success,
            stairs_success=stairs[0].success if stairs else 0.0,
        )
        return Report(
            samples=samples,
            samples_total=config.segments * config.samples_per_segment,
            samples_per_s=config.samples_per_segment / seconds,
            seconds_left=(config.segments - self.segment) * seconds,
            reward=summary["reward"],
            landing_error_m=summary["landing_error_m"],
            falls_per_episode=summary["falls_per_episode"],
            result=flat,
            stage=stage,
            stairs=tuple(stairs),
            best=best,
        )

    def _policy(self) -> Policy:
        config = self.config
        return fitting(
            self.robot,
            actor_layers(self.ppo),
            mujoco_version=mujoco.__version__,
            trained={
                "command": self.command,
                "seed": config.seed,
                "samples": self.segment * config.samples_per_segment,
                "git_revision": self._revision,
                "assessed": self.history[-1]["assess"] if self.history else None,
                "assessed_stairs": self.history[-1]["assess_stairs"] if self.history else None,
                "rise_m": self.stage.rise_m,
                "config": asdict(config),
            },
        )

    def save_checkpoint(self) -> None:
        """Write everything that is needed to go on, under a temporary name first."""
        self.out.mkdir(parents=True, exist_ok=True)
        checkpoint = {
            "format": CHECKPOINT_FORMAT,
            "config": json.dumps(asdict(self.config)),
            "segment": self.segment,
            "stage": asdict(self.stage),
            "best_score": list(self.best_score),
            "history": json.dumps(self.history),
            "learner": self.ppo.save(),
        }
        temporary = self.out / "checkpoint.pt.tmp"
        torch.save(checkpoint, temporary)
        os.replace(temporary, self.out / "checkpoint.pt")

    def resume(self) -> None:
        """Take up the folder's checkpoint.

        Raises:
            TrainingError: there is none, it cannot be read, or it is of another configuration.
        """
        path = self.out / "checkpoint.pt"
        if not path.is_file():
            raise TrainingError(f"{self.out} holds no checkpoint.pt to resume from")
        try:
            checkpoint = torch.load(path, weights_only=True)
        except Exception as error:
            raise TrainingError(f"{path} cannot be read: it is damaged ({error})") from error
        if checkpoint.get("format") != CHECKPOINT_FORMAT:
            raise TrainingError(f"{path} is not a {CHECKPOINT_FORMAT} checkpoint")
        mine, theirs = json.loads(json.dumps(asdict(self.config))), json.loads(checkpoint["config"])
        differing = [key for key in mine if mine[key] != theirs.get(key) and key != "samples"]
        if differing:
            raise TrainingError(
                f"{path} was made with other settings ({', '.join(differing)}): resume with those "
                f"of {self.out / 'config.json'} or choose another folder"
            )
        self.ppo.load(checkpoint["learner"], None, True)
        self.segment = checkpoint["segment"]
        self.stage = Stage(**checkpoint["stage"])
        rise_m, score = checkpoint["best_score"]
        self.best_score = (rise_m, score)
        self.history = json.loads(checkpoint["history"])


def _score(result: ModeResult) -> float:
    """Falls first, then the foot error: a policy that falls less is better."""
    error_m = float(result.summary["error_m_p95"])
    return 100.0 * (result.success - 1.0) - (error_m if np.isfinite(error_m) else 1.0)


def git_revision() -> str:
    """The revision of the code that trains, or 'unknown' outside a checkout."""
    try:
        return subprocess.run(
            ["git", "rev-parse", "--short", "HEAD"],
            cwd=Path(__file__).parent,
            capture_output=True,
            text=True,
            check=True,
        ).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
