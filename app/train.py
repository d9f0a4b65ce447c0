"""The command `train`: a policy from nothing, with progress, checkpoints and a log."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, replace
from pathlib import Path

from app.errors import ExitCode, InputError, as_bad_input
from app.inputs import find_robot
from app.output import make_folder, write_text
from app.progress import ProgressBar, say
from app.train_options import TrainOptions
from controller.curriculum import PRESETS as CURRICULA
from controller.curriculum import Curriculum
from controller.env import TaskConfig
from controller.planned import PlannedSteps
from controller.reward import PRESETS
from controller.train import Report, TrainConfig, Trainer, TrainingError
from planner.corpus import Corpus, CorpusError
from sim.robot import Robot

HIGHEST_RISE_M = 0.20


def run(options: TrainOptions) -> int:
    """Carries the command out; returns the exit code."""
    robot = find_robot(options.robot)
    planned = _planned(options, robot)
    config = TrainConfig(
        robot=robot.name,
        samples=options.samples,
        seed=options.seed,
        corpus="" if planned is None else planned.digest,
        curriculum=_curriculum(options),
        task=TaskConfig(reward=dict(PRESETS[options.reward])),
    )
    make_folder(options.out, option="--out")
    _check_folder(options.out, resume=options.resume)
    trainer = Trainer(
        robot,
        config,
        options.out,
        threads=options.workers or os.cpu_count() or 1,
        command=command_line(options),
        planned=planned,
    )
    if options.resume:
        with as_bad_input(TrainingError):
            trainer.resume()
        say(f"going on after segment {trainer.segment} of {config.segments}")
    write_text(options.out / "config.json", json.dumps(asdict(config), indent=1) + "\n")
    total = config.segments * config.samples_per_segment
    with ProgressBar("training", total, line_every_s=0.0) as bar:
        trainer.run(lambda report: bar.update(report.samples, progress_line(report)))
    say(f"the best policy is {options.out / robot.name}.safetensors")
    return ExitCode.DONE


def _planned(options: TrainOptions, robot: Robot) -> PlannedSteps | None:
    if options.corpus is None:
        return None
    with as_bad_input(CorpusError):
        corpus = Corpus.load(options.corpus)
        return PlannedSteps.of(corpus, robot.name, robot.training_model)


def progress_line(report: Report) -> str:
    """One line on a finished segment."""
    result = report.result.summary
    stairs = ""
    if report.stairs:
        shares = " / ".join(f"{100 * result.success:.0f}" for result in report.stairs)
        stairs = f" | stairs of {100 * report.stage.rise_m:.1f} cm, plain / rough: {shares} %"
    return (
        f"{report.samples_per_s:.0f} samples/s, "
        f"{report.seconds_left / 60:3.0f} min left | reward {report.reward:.3f} | "
        f"held out: {result['falls']} of {result['episodes']} fell, feet "
        f"{100 * float(result['error_m_median']):.1f} cm median, "
        f"{100 * float(result['error_m_p95']):.1f} cm p95"
        + stairs
        + (" | best" if report.best else "")
    )


def command_line(options: TrainOptions) -> str:
    """The command that makes the same policy, for the policy's own record."""
    return (
        f"python main.py train --robot {options.robot} --samples {options.samples} "
        f"--seed {options.seed} --reward {options.reward} --curriculum {options.curriculum} "
        f"--rise {options.rise:g} --out DIR"
    )


def _curriculum(options: TrainOptions) -> Curriculum:
    """The preset, with the highest rise where it has stairs."""
    preset = CURRICULA[options.curriculum]
    if options.curriculum == "flat":
        return preset
    if options.rise > HIGHEST_RISE_M:
        raise InputError(f"--rise: {options.rise:g} m is more than {HIGHEST_RISE_M:g} m")
    return replace(preset, top_rise_m=options.rise)


def _check_folder(out: Path, *, resume: bool) -> None:
    if not resume and (out / "checkpoint.pt").exists():
        raise InputError(f"--out: {out} holds a run already; add --resume or name another folder")
