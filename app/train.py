"""The command `train`: a policy from nothing, with progress, checkpoints and a log."""

from __future__ import annotations

import json
import os
from dataclasses import asdict
from pathlib import Path

from app.errors import ExitCode, InputError, as_bad_input
from app.inputs import find_robot
from app.output import make_folder, write_text
from app.progress import ProgressBar, say
from app.train_options import TrainOptions
from controller.env import TaskConfig
from controller.reward import PRESETS
from controller.train import Report, TrainConfig, Trainer, TrainingError


def run(options: TrainOptions) -> int:
    """Carries the command out; returns the exit code."""
    robot = find_robot(options.robot)
    config = TrainConfig(
        robot=robot.name,
        samples=options.samples,
        seed=options.seed,
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


def progress_line(report: Report) -> str:
    """One line on a finished segment."""
    result = report.result.summary
    return (
        f"{report.samples_per_s:.0f} samples/s, "
        f"{report.seconds_left / 60:3.0f} min left | reward {report.reward:.3f} | "
        f"held out: {result['falls']} of {result['episodes']} fell, feet "
        f"{100 * float(result['error_m_median']):.1f} cm median, "
        f"{100 * float(result['error_m_p95']):.1f} cm p95" + (" | best" if report.best else "")
    )


def command_line(options: TrainOptions) -> str:
    """The command that makes the same policy, for the policy's own record."""
    return (
        f"python main.py train --robot {options.robot} --samples {options.samples} "
        f"--seed {options.seed} --reward {options.reward} --out DIR"
    )


def _check_folder(out: Path, *, resume: bool) -> None:
    if not resume and (out / "checkpoint.pt").exists():
        raise InputError(f"--out: {out} holds a run already; add --resume or name another folder")
