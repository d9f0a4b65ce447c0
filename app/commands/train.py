"""The command `train`: a policy from nothing, with progress, checkpoints and a log."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from app.options import (
    CountOption,
    FolderOption,
    Interval,
    OptionalFolder,
    OptionalLength,
    RobotName,
    SeedOption,
    WorkersOption,
    choice,
    find_robot,
    whole_number,
)
from app.output import (
    ExitCode,
    InputError,
    ProgressBar,
    as_bad_input,
    claim_folder,
    say,
    told_by_one_rank,
    write_text,
)
from controller.curriculum import PRESETS as CURRICULA
from controller.curriculum import Curriculum
from planner.corpus.corpus import Corpus, CorpusError
from sim.robot import Robot

if TYPE_CHECKING:
    from controller.ranks import Ranks
    from controller.runner import SegmentReport
    from controller.step_sequences import PlannedSteps


@dataclass(frozen=True, kw_only=True)
class TrainOptions:
    """Train the step follower from nothing, with PPO in many simulations at once.

    The folder gets a checkpoint after every segment, a TensorBoard log, and the best policy so
    far. A run that was stopped, however it was, goes on with --resume to the same result. Some
    episodes walk plans of the planner: without --corpus the folder gets a corpus of its own, made
    as `dataset --count 1000 --seed 0` makes it. Started by `torchrun`, ranks on one machine or
    several share the simulations: docs/scale.md.
    """

    out: FolderOption
    """Folder of the run, such as runs/train."""

    robot: RobotName = "jvrc1"
    """Which robot, such as jvrc1."""

    samples: CountOption = 20_000_000
    """Control steps of single robots to train on, such as 20000000."""

    seed: SeedOption = 0
    """Seed of the run, such as 0."""

    reward: Annotated[str, choice("quiet", "precise", "paper")] = "quiet"
    """Which reward: upright and quiet, the precise one of old, or the paper's, such as quiet."""

    without: Annotated[str, choice("none", "periodic", "symmetry", "offset")] = "none"
    """What to leave out, to see what it is for, such as symmetry: docs/training.md."""

    curriculum: Annotated[str, choice("measured", "paper", "flat")] = "measured"
    """When stairs come: with success, on the paper's schedule, or never, such as measured."""

    rise: OptionalLength = None
    """Highest rise of the stairs to train on in metres, such as 0.15; none: all the robot can."""

    corpus: OptionalFolder = None
    """Corpus of `dataset` to train on, such as runs/corpus; none: makes one in DIR/corpus."""

    simulations: Annotated[int, whole_number(at_least=1, at_most=1_000_000)] = 256
    """Robots simulated at once, of all ranks together, such as 256; a segment grows with them."""

    device: Annotated[str, choice("auto", "cpu", "cuda")] = "cpu"
    """Where the networks are, such as cpu; auto: on a GPU if torch finds one."""

    workers: WorkersOption = 0
    """Threads for the physics, such as 2; 0 for all cores. The result does not depend on it."""

    resume: bool = False
    """Go on with the run in the folder."""


# Modules of the extra `train`.
LEARNER = ("torch", "rsl_rl", "tensorboard")
# A robot that may not step so high climbs no stairs.
LEAST_RISE_M = 0.02
OWN_CORPUS = "corpus"
CORPUS_PLANS = 1000


def run(options: TrainOptions) -> int:
    """Carries the command out; returns the exit code."""
    with told_by_one_rank():
        require_learner()
    from controller.checkpoint import TrainingError
    from controller.ranks import joined_ranks

    with as_bad_input(TrainingError), joined_ranks(options.device) as ranks:
        train(options, ranks)
    return ExitCode.DONE


def train(options: TrainOptions, ranks: Ranks) -> None:
    """Trains as one of the ranks; the first of them reads, writes and tells.

    Raises:
        InputError: the options do not go together, or the folder or the corpus cannot be used.
        TrainingError: there is no such device, no checkpoint to resume from, or no room.
    """
    from controller.env import TaskConfig
    from controller.ppo import PpoConfig, TrainConfig
    from controller.ranks import find_device
    from controller.rewards import PERIODIC, PRECISE, PRESETS
    from controller.runner import Trainer

    robot = find_robot(options.robot)
    curriculum = chosen_curriculum(options, robot)
    device = find_device(options.device, ranks)
    ranks.require_equal_shares(options.simulations)

    def prepare() -> PlannedSteps:
        check_folder(options.out, resume=options.resume)
        return read_corpus(options, robot)

    planned = ranks.from_first(prepare)
    dropped = PERIODIC if options.without == "periodic" else ()

    def weights(preset: Mapping[str, float]) -> dict[str, float]:
        return {term: weight for term, weight in preset.items() if term not in dropped}

    config = TrainConfig(
        robot=robot.name,
        samples=options.samples,
        seed=options.seed,
        corpus=planned.digest,
        curriculum=curriculum,
        task=TaskConfig(reward=weights(PRESETS[options.reward])),
        warm_up=weights(PRECISE) if options.reward == "quiet" else None,
        ppo=PpoConfig(
            robots=options.simulations,
            symmetric=options.without != "symmetry",
            half_sitting_offset=options.without != "offset",
        ),
    )
    trainer = Trainer(
        robot,
        config,
        options.out,
        threads=options.workers or ranks.physics_threads,
        command=command_line(options, ranks.count),
        planned=planned,
        ranks=ranks,
        device=device,
    )
    if options.resume:
        trainer.resume()
    if not ranks.is_first:
        trainer.run(lambda report: None)
        return
    if options.resume:
        say(f"going on after segment {trainer.segment} of {config.segments}")
    write_text(options.out / "config.json", json.dumps(asdict(config), indent=1) + "\n")
    total = config.segments * config.samples_per_segment
    with ProgressBar("training", total, line_every_s=0.0) as bar:
        trainer.run(lambda report: bar.update(report.samples, progress_line(report)))
    say(f"the best policy is {options.out / robot.name}.safetensors")


def require_learner() -> None:
    """Checks that the libraries of the learner, which no other command needs, are installed.

    Raises:
        InputError: they are not; the message says what to install.
    """
    missing = [name for name in LEARNER if importlib.util.find_spec(name) is None]
    if missing:
        raise InputError(
            f"train needs {', '.join(missing)}, which the extra `train` installs: "
            "python -m pip install -e '.[train]'"
        )


def chosen_curriculum(options: TrainOptions, robot: Robot) -> Curriculum:
    """The preset, with the highest rise that was asked for, or else the robot's.

    Raises:
        InputError: the robot cannot climb so high, or stairs are asked for and not wanted.
    """
    preset, highest_m = CURRICULA[options.curriculum], robot.training_model.limits.z_m[1]
    can_climb = highest_m >= LEAST_RISE_M
    if options.rise is None:
        top_m = min(preset.top_rise_m, highest_m)
        return replace(preset, top_rise_m=top_m if can_climb else 0.0)
    if options.curriculum == "flat":
        raise InputError(f"--rise: {options.rise:g} m of rise and --curriculum flat: drop one")
    if not can_climb:
        raise InputError(
            f"--rise: {robot.title} has no stairs in its step limits (z_m of training_limits, in "
            "its file); leave --rise away to train it on flat ground"
        )
    if not LEAST_RISE_M <= options.rise <= highest_m:
        raise InputError(
            f"--rise: {options.rise:g} m is not from {LEAST_RISE_M:g} to {highest_m:g} m, what "
            f"{robot.title}'s step limits to train on allow"
        )
    return replace(preset, top_rise_m=options.rise)


def check_folder(out: Path, *, resume: bool) -> None:
    """Makes the folder of a new run, or finds that of an old one, with room to write.

    Raises:
        InputError: there is a run where none should be, or none where one should; or no room.
    """
    from controller.checkpoint import TrainingError, require_room

    began = (out / "checkpoint.pt").is_file()
    if resume and not began:
        raise InputError(f"--resume: {out} holds no checkpoint.pt to resume from")
    if began and not resume:
        raise InputError(f"--out: {out} holds a run already; add --resume or name another folder")
    claim_folder(out, option="--out")
    with as_bad_input(TrainingError):
        require_room(out)


def read_corpus(options: TrainOptions, robot: Robot) -> PlannedSteps:
    """The plans to train on; a new run without a corpus makes its own first.

    Its plans turn to all sides, go around obstacles and are refined: their steps are anything that
    the limits allow, where a plain search takes them from a set that the task draws anyway.

    Raises:
        InputError: there is no corpus, or it is not for this robot.
    """
    from controller.step_sequences import PlannedSteps

    folder = options.corpus or options.out / OWN_CORPUS
    if options.corpus is None and not options.resume:
        make_corpus(folder, robot.option, options.workers)
    elif options.corpus is None and not folder.is_dir():
        raise InputError(
            f"--corpus: the run in {options.out} has no {OWN_CORPUS} of its own: "
            "name the one that it began with"
        )
    with as_bad_input(CorpusError):
        corpus = Corpus.load(folder)
    try:
        return PlannedSteps.of(corpus, robot.name, robot.training_model)
    except CorpusError as error:
        raise InputError(
            f"--corpus: {folder}: {error}; make one by `dataset --robot {robot.option} --out DIR`"
        ) from None


def make_corpus(folder: Path, robot: str, workers: int = 0, *, cluster: str | None = None) -> None:
    """Makes the corpus that runs train on which name no other."""
    # Here and not above: it brings the planner along, which training does without.
    from app.commands import dataset
    from app.commands.dataset import DatasetOptions

    dataset.run(
        DatasetOptions(
            out=folder,
            count=CORPUS_PLANS,
            robot=robot,
            goal_x=Interval(-1.0, 3.0),
            goal_y=Interval(-2.0, 2.0),
            goal_yaw=Interval(-3.14, 3.14),
            obstacles=4,
            refine=True,
            workers=workers,
            cluster=cluster,
        )
    )


def progress_line(report: SegmentReport) -> str:
    """One line on a finished segment."""
    result = report.result.summary
    stairs = ""
    if report.stairs:
        shares = " / ".join(f"{100 * result.success:.0f}" for result in report.stairs)
        stairs = f" | stairs of {100 * report.stage.rise_m:.1f} cm, plain / rough: {shares} %"
    warm_up = "" if report.blended == 1 else f", {100 * (1 - report.blended):.0f} % warm-up"
    return (
        f"{report.samples_per_s:.0f} samples/s, "
        f"{report.seconds_left / 60:3.0f} min left | reward {report.reward:.3f}{warm_up} | "
        f"held out: {result['falls']} of {result['episodes']} fell, feet "
        f"{100 * float(result['error_m_median']):.1f} cm median, "
        f"{100 * float(result['error_m_p95']):.1f} cm p95"
        + stairs
        + (" | best" if report.best else "")
    )


def command_line(options: TrainOptions, ranks: int = 1) -> str:
    """The command that makes the same policy, for the policy's own record."""
    return (
        ("python" if ranks == 1 else f"torchrun --nproc-per-node {ranks}")
        + f" main.py train --robot {options.robot} --samples {options.samples} "
        f"--seed {options.seed} --reward {options.reward} --curriculum {options.curriculum}"
        + ("" if options.without == "none" else f" --without {options.without}")
        + ("" if options.rise is None else f" --rise {options.rise:g}")
        + ("" if options.simulations == 256 else f" --simulations {options.simulations}")
        + ("" if options.corpus is None else " --corpus CORPUS")
        + " --out DIR"
    )
