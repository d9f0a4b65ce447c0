"""The training run, in segments that a killed run resumes exactly.

A segment is a fixed number of updates. It begins by drawing new episodes and seeding torch from
(seed, segment), and ends with a checkpoint; so a resumed run gives the policy that the
uninterrupted one gives, whatever the number of physics threads.

With several ranks (`controller/ranks.py`) each has its share of the robots, all do the same
updates, and rank 0 alone reads and writes the folder.
"""

from __future__ import annotations

import contextlib
import subprocess
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch

from controller.assessment import ModeResult, assess_stage, score
from controller.checkpoint import (
    Checkpoint,
    TrainingError,
    read_checkpoint,
    require_room,
    write_checkpoint,
)
from controller.curriculum import Stage
from controller.env import Transition, WalkTask
from controller.policy import Policy, policy_for, save_policy
from controller.ppo import (
    RslWalkEnv,
    TrainConfig,
    load_learner,
    make_ppo,
    plain_layers,
    set_progress,
)
from controller.ranks import Ranks
from controller.step_sequences import PlannedSteps
from sim.robot import Robot


@dataclass
class SegmentStatistics:
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

    @classmethod
    def joined(cls, parts: Sequence[SegmentStatistics]) -> SegmentStatistics:
        """Those of ranks with as many robots each: their means averaged, their counts added."""
        totals = {
            name: sum(getattr(part, name) for part in parts)
            for name in ("ended", "fallen", "stairs_ended", "stairs_fallen", "failed")
        }
        return cls(
            reward=sum(part.reward for part in parts) / len(parts),
            steps=parts[0].steps,
            errors=[errors for part in parts for errors in part.errors],
            terms=_mean_of([part.terms for part in parts]),
            **totals,
        )

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


def _mean_of(parts: Sequence[dict[str, float]]) -> dict[str, float]:
    """The mean of each number over documents with the same keys."""
    return {name: sum(part[name] for part in parts) / len(parts) for name in parts[0]}


@dataclass(frozen=True, kw_only=True)
class SegmentReport:
    """Results of a segment, for the progress display."""

    samples: int
    samples_total: int
    samples_per_s: float
    seconds_left: float
    reward: float
    blended: float
    landing_error_m: float
    falls_per_episode: float
    result: ModeResult
    stage: Stage
    stairs: tuple[ModeResult, ...]
    best: bool


def git_revision() -> str:
    """Git revision of the code, or 'unknown' outside a checkout."""
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


class Trainer:
    """One training run in one folder: checkpoint, log, and the best policy so far.

    `threads` are those of the physics of this rank; the networks are on the `device`.

    Raises:
        TrainingError: the robots do not divide among the ranks.
    """

    def __init__(
        self,
        robot: Robot,
        config: TrainConfig,
        out: Path,
        *,
        threads: int,
        command: str,
        planned: PlannedSteps | None = None,
        ranks: Ranks | None = None,
        device: torch.device | str = "cpu",
    ):
        self.ranks = ranks or Ranks()
        self.ranks.require_equal_shares(config.ppo.robots)
        self.robot, self.config, self.out = robot, config, out
        self.threads, self.command = threads, command
        self._revision = git_revision()  # of the code that runs, not of what is committed later
        self._learner_threads = self.ranks.learner_threads(config.ppo.learner_threads)
        torch.set_num_threads(self._learner_threads)
        torch.manual_seed(config.seed)
        task = WalkTask(
            robot,
            count=self.ranks.share(config.ppo.robots),
            seed=config.seed,
            threads=threads,
            config=config.task,
            planned=planned,
        )
        self.env = RslWalkEnv(task, device)
        self.ppo = make_ppo(self.env, config.ppo, self.ranks.multi_gpu)
        self.segment = 0
        self.stage = config.curriculum.first()
        self.blended = 0.0 if config.warm_up else 1.0  # of the rewards, the first into the last
        self.best_score: tuple[float, ...] = (-np.inf,)
        self.history: list[dict[str, Any]] = []

    def run(self, progress: Callable[[SegmentReport], None]) -> None:
        """Train to the end from the present segment; the best policy is saved in the folder.

        `progress` is called after each segment, at every rank.

        Raises:
            TrainingError: the folder cannot be written, say because the disk is full.
        """
        try:
            with self._writer() as writer:
                while self.segment < self.config.segments:
                    if self.ranks.is_first:
                        require_room(self.out)
                    report = self._run_segment(writer)
                    if self.ranks.is_first:
                        # Before the checkpoint, so that a resumed run finds the best policy.
                        if report.best:
                            save_policy(self._policy(), self.out / f"{self.robot.name}.safetensors")
                        self.save_checkpoint()
                    progress(report)
            self.ranks.gathered(None)  # none ends well before the first has written all
        except OSError as error:
            raise TrainingError(
                f"cannot write in {self.out}: {error.strerror or error}; "
                "make room and go on with --resume"
            ) from error

    def _writer(self) -> contextlib.AbstractContextManager[Any]:
        """TensorBoard's, at rank 0; None at the others."""
        if not self.ranks.is_first:
            return contextlib.nullcontext()
        from torch.utils.tensorboard import SummaryWriter

        return SummaryWriter(log_dir=str(self.out / "tensorboard"))

    def _run_segment(self, writer: Any) -> SegmentReport:
        config = self.config
        segment_seed = self.ranks.seed_sequence(config.seed, self.segment)
        torch.manual_seed(int(segment_seed.generate_state(1)[0]))  # rsl-rl draws from it
        self.env.task.restart(segment_seed, stage=self.stage)
        self.env.task.weights = config.rewards.at(self.blended)
        started, statistics = time.perf_counter(), SegmentStatistics()
        observation = self.env.get_observations()
        losses: dict[str, float] = {}
        for update in range(config.updates_per_segment):
            done = self.segment + update / config.updates_per_segment
            set_progress(self.ppo, config.ppo, done / config.segments)
            observation = self._sample(observation, statistics)
            torch.set_num_threads(self._learner_threads)
            losses = self.ppo.update()
        statistics = SegmentStatistics.joined(self.ranks.gathered(statistics))
        losses = _mean_of(self.ranks.gathered(losses))
        seconds = time.perf_counter() - started
        self.segment += 1
        results = assess_stage(
            self.robot,
            self._policy(),
            config,
            self.stage,
            threads=self.threads,
            ranks=self.ranks,
        )
        return self._note(writer, statistics.summary(), losses, results, seconds)

    def _sample(self, observation: Any, statistics: SegmentStatistics) -> Any:
        """One rollout with the present policy; returns the observation after it."""
        torch.set_num_threads(1)  # the physics has the cores
        with torch.inference_mode():
            for _ in range(self.config.ppo.ticks_per_update):
                actions = self.ppo.act(observation)
                observation, rewards, dones, extras = self.env.step(actions)
                self.ppo.process_env_step(observation, rewards, dones, extras)
                statistics.add(extras["transition"])
            self.ppo.compute_returns(observation)
        return observation

    def _note(
        self,
        writer: Any,
        summary: dict[str, float],
        losses: dict[str, float],
        results: tuple[ModeResult, ...],
        seconds: float,
    ) -> SegmentReport:
        """Log the segment, append it to the history and update best score and stage.

        All ranks do it alike; `writer` is None at those that write nothing.
        """
        config, stage, (flat, *stairs) = self.config, self.stage, results
        samples = self.segment * config.samples_per_segment
        assessed = flat.summary
        assessed_stairs = [result.summary for result in stairs]
        if writer is not None:
            self._log(writer, summary, losses, results)
        walks = config.rewards.walks(
            success=flat.success, error_m=float(assessed["error_m_median"])
        )
        # Of policies that walk, those trained under more of the last reward count as better.
        blended = self.blended
        now = (walks, blended, *score(stage, results, summary["reward"]))
        best = now > self.best_score
        self.best_score = max(now, self.best_score)
        line = {"samples": samples, "seconds": seconds, "rise_m": stage.rise_m, **summary}
        self.history.append({**line, "assess": assessed, "assess_stairs": assessed_stairs})
        self.blended = config.rewards.after(blended, share=1 / config.segments, walks=walks)
        self.stage = config.curriculum.after(
            stage,
            updates=self.segment * config.updates_per_segment,
            flat_success=flat.success,
            stairs_success=stairs[0].success if stairs else 0.0,
        )
        return SegmentReport(
            samples=samples,
            samples_total=config.segments * config.samples_per_segment,
            samples_per_s=config.samples_per_segment / seconds,
            seconds_left=(config.segments - self.segment) * seconds,
            reward=summary["reward"],
            blended=blended,
            landing_error_m=summary["landing_error_m"],
            falls_per_episode=summary["falls_per_episode"],
            result=flat,
            stage=stage,
            stairs=tuple(stairs),
            best=best,
        )

    def _log(
        self,
        writer: Any,
        summary: dict[str, float],
        losses: dict[str, float],
        results: tuple[ModeResult, ...],
    ) -> None:
        """Write the numbers of the segment for TensorBoard."""
        samples = self.segment * self.config.samples_per_segment
        for name, value in {**summary, **{f"loss/{k}": v for k, v in losses.items()}}.items():
            writer.add_scalar(f"train/{name}", value, samples)
        writer.add_scalar("train/rise_m", self.stage.rise_m, samples)
        writer.add_scalar("train/reward_blended", self.blended, samples)
        groups = zip(("assess", "stairs", "rough_stairs"), results, strict=False)
        for group, result in groups:
            for name, number in result.summary.items():
                if not isinstance(number, str):
                    writer.add_scalar(f"{group}/{name}", number, samples)
        writer.flush()

    def _policy(self) -> Policy:
        config = self.config
        return policy_for(
            self.robot,
            plain_layers(self.ppo.actor.mlp),
            mujoco_version=mujoco.__version__,
            trained={
                "command": self.command,
                "seed": config.seed,
                "samples": self.segment * config.samples_per_segment,
                "git_revision": self._revision,
                "assessed": self.history[-1]["assess"] if self.history else None,
                "assessed_stairs": self.history[-1]["assess_stairs"] if self.history else None,
                "rise_m": self.history[-1]["rise_m"] if self.history else 0.0,
                "config": asdict(config),
            },
        )

    def save_checkpoint(self) -> None:
        """Write the state needed to resume.

        Raises:
            OSError: it cannot be written; the one that was there stays.
        """
        state = Checkpoint(
            segment=self.segment,
            stage=self.stage,
            blended=self.blended,
            best_score=self.best_score,
            history=self.history,
            learner=self.ppo.save(),
        )
        write_checkpoint(self.out, self.config, self.robot, state)

    def resume(self) -> None:
        """Resume from the folder's checkpoint.

        Raises:
            TrainingError: there is none, it cannot be read, or it is of another configuration.
        """
        state = self.ranks.from_first(
            lambda: read_checkpoint(self.out, self.config, self.robot),
        )
        try:
            load_learner(self.ppo, state.learner)
        except FloatingPointError as error:
            raise TrainingError(f"the checkpoint in {self.out} is damaged: {error}") from error
        except (ValueError, LookupError, TypeError, AttributeError, RuntimeError) as error:
            raise TrainingError(
                f"the checkpoint in {self.out} is from another layout: its networks do not fit "
                f"{self.robot.name} as it is now"
            ) from error
        self.segment, self.stage, self.blended = state.segment, state.stage, state.blended
        self.best_score, self.history = state.best_score, state.history
