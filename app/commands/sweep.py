"""The command `sweep`: many training runs from one YAML file, and the table of what came out."""

from __future__ import annotations

import contextlib
import itertools
import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import tyro

from app.cluster import ClusterOption
from app.commands import train
from app.commands.train import TrainOptions
from app.options import FolderOption, WorkersOption, find_robot, parse_options, text
from app.output import (
    ExitCode,
    InputError,
    claim_folder,
    make_folder,
    one_line,
    release_folder,
    say,
    to_json,
    write_text,
)
from app.workers import in_order
from maps.files import MOST_YAML_BYTES, from_yaml, read_json, read_limited
from planner.corpus.corpus import MANIFEST

FORMAT = "training-sweep/1"
RUN_FORMAT = "training-sweep-run/1"
SWEEP, RUN, LOG, CHECKPOINT = "sweep.json", "run.json", "train.log", "checkpoint.pt"
TRAINED, FAILED, MISSING = "trained", "failed", "missing"
# Columns of the table: of the best policy, on held-out episodes.
HEADS = ("run", "best at", "fell", "feet, median / p95", "rise", "stairs, plain / rough")
# Options of `train` that the sweep sets itself.
OWN_OPTIONS = ("out", "resume", "workers")
# A training keeps about two cores busy: the physics and the networks take turns.
CORES_EACH = 2
MOST_RUNS = 1000


@dataclass(frozen=True, kw_only=True)
class SweepOptions:
    """Train many policies: every combination of the values in a YAML file, each in its folder.

    The keys of the file are options of `train`, such as robot, seed, reward and samples; a key with
    a list has each of its values in turn. What is finished is kept when the sweep is cut off: the
    same command goes on with what is missing, and with runs that were begun. docs/scale.md has an
    example.
    """

    file: Annotated[Path, text("FILE", Path), tyro.conf.Positional]
    """YAML file that says what to train, such as sweep.yaml."""

    out: FolderOption = Path("runs/sweep")
    """Folder for sweep.json and a folder for each run, such as runs/sweep; made when missing."""

    workers: WorkersOption = 0
    """Runs at the same time, such as 4; 0 for one on every two cores."""

    cluster: ClusterOption = None
    """Ray cluster that trains, the folder on a disk of all, such as auto; none: no cluster."""

    json: bool = False
    """Print sweep.json on standard output, and nothing else there."""


@dataclass(frozen=True, kw_only=True)
class Run:
    """One training run: its name, which is that of its folder, and the options of `train`.

    `settings` are those options that the file gives, as they would be typed.
    """

    name: str
    settings: Mapping[str, str]
    options: TrainOptions


def run(options: SweepOptions) -> int:
    """Carries the command out; returns the exit code."""
    train.require_learner()
    options = replace(options, out=options.out.resolve())
    runs = runs_of(options.file, read_sweep(options.file), options.out)
    claim_folder(options.out, option="--out")
    results = {one.name: result for one in runs if (result := finished(one)) is not None}
    missing = [one for one in runs if one.name not in results]
    if results:
        say(f"{len(results)} of {len(runs)} runs are there already")
    threads, at_once = CORES_EACH, options.workers
    if options.cluster is None:
        cores = os.cpu_count() or 1
        at_once = min(at_once or max(1, cores // CORES_EACH), max(1, len(missing)))
        threads = max(1, cores // at_once)
    jobs = [
        replace(one, options=replace(one.options, workers=threads))
        for one in with_corpora(missing, options)
    ]
    if jobs:
        say(f"training {len(jobs)} runs; their progress is in {options.out}/NAME/{LOG}")
    write_sweep(options.out, runs, results)
    trained = in_order(train_one, jobs, at_once, cluster=options.cluster, cpus=threads)
    try:
        for one, result in zip(missing, trained, strict=True):
            results[one.name] = result
            write_sweep(options.out, runs, results)
            say(f"{len(results)}/{len(runs)} {one.name}: {'; '.join(cells(result))}")
    except KeyboardInterrupt:
        say("the same command goes on with what is missing")
        raise
    document = write_sweep(options.out, runs, results)
    print(to_json(document) if options.json else table(document["runs"]), end="")
    has_failed = any(result["outcome"] == FAILED for result in results.values())
    return ExitCode.BAD_INPUT if has_failed else ExitCode.DONE


def read_sweep(file: Path) -> dict[str, str | list[str]]:
    """The values of each option, as they would be typed; a list where the file has one.

    Raises:
        InputError: The file cannot be read, or holds something else.
    """
    try:
        document = from_yaml(read_limited(file, MOST_YAML_BYTES).decode("utf-8"))
    except OSError as error:
        raise InputError(f"{file} cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise InputError(f"{file} is no YAML: {one_line(error)}") from None
    if not isinstance(document, dict) or not document:
        raise InputError(f"{file} must hold options of train, such as the line seed: [0, 1, 2]")
    values: dict[str, str | list[str]] = {}
    for key, value in document.items():
        if key in OWN_OPTIONS:
            raise InputError(f"{file}: {key} is for the sweep to set; leave it out")
        several = value if isinstance(value, list) else [value]
        if not several or not all(type(one) in (str, int, float) for one in several):
            raise InputError(
                f"{file}: {key} must be a word, a number, or a list of them, not {value!r}"
            )
        words = [str(one) for one in several]
        if len(set(words)) < len(words):
            raise InputError(f"{file}: {key} has a value twice: {', '.join(words)}")
        values[str(key)] = words if isinstance(value, list) else words[0]
    return values


def runs_of(file: Path, values: Mapping[str, str | list[str]], out: Path) -> list[Run]:
    """A run for every combination of the values, named by the options that have a list.

    Raises:
        InputError: `train` would refuse the options of one of them, or there are too many.
    """
    runs: list[Run] = []
    choices = [value if isinstance(value, list) else [value] for value in values.values()]
    if (count := math.prod(map(len, choices))) > MOST_RUNS:
        raise InputError(f"{file} asks for {count} runs, at most {MOST_RUNS}: give fewer values")
    for words in itertools.product(*choices):
        settings = dict(zip(values, words, strict=True))
        listed = [f"{key}-{settings[key]}" for key in values if isinstance(values[key], list)]
        name = re.sub(r"[^\w.+-]", "_", "_".join(listed)) or "run"
        typed = [f"--{key.replace('_', '-')}={word}" for key, word in settings.items()]
        try:
            options = parse_options(
                TrainOptions,
                [*typed, "--out", str(out / name)],
                program="python main.py train",
                example="train --out runs/train",
            )
            train.chosen_curriculum(options, find_robot(options.robot))
        except InputError as error:
            raise InputError(f"{file}: {error}") from None
        if any(name == other.name for other in runs):
            raise InputError(f"{file}: two runs would have the folder {name}: change a value")
        runs.append(Run(name=name, settings=settings, options=options))
    return runs


def finished(one: Run) -> dict[str, Any] | None:
    """What a run of the same settings left when it had ended; None if it has not."""
    try:
        document = read_json(one.options.out / RUN)
    except (OSError, ValueError):
        return None
    ours = {"format": RUN_FORMAT, "settings": dict(one.settings)}
    if not isinstance(document, dict) or document | ours != document:
        return None
    result = document.get("result")
    return result if isinstance(result, dict) and result.get("outcome") == TRAINED else None


def with_corpora(runs: Sequence[Run], options: SweepOptions) -> Iterator[Run]:
    """The runs with the corpus of their robot, which is made once, unless they name one."""
    for one in runs:
        corpus = one.options.corpus
        if corpus is None:
            corpus = options.out / f"corpus-{one.options.robot}"
            if not (corpus / MANIFEST).is_file():
                train.make_corpus(
                    corpus, one.options.robot, options.workers, cluster=options.cluster
                )
        yield replace(one, options=replace(one.options, corpus=corpus.resolve()))


def train_one(one: Run) -> dict[str, Any]:
    """Trains, or goes on with what was begun; the result. News go to the log in the folder."""
    folder = one.options.out
    make_folder(folder, option="--out")
    begun = (folder / CHECKPOINT).is_file()
    with (
        (folder / LOG).open("a", encoding="utf-8", buffering=1) as log,
        contextlib.redirect_stderr(log),
    ):
        try:
            train.run(replace(one.options, resume=begun))
        except InputError as error:
            say(f"error: {one_line(error)}")
            return {"outcome": FAILED, "reason": one_line(error)}
        finally:
            with contextlib.suppress(KeyError):  # it has not come so far as to claim it
                release_folder(folder)
    result = result_of(one)
    document = {"format": RUN_FORMAT, "settings": dict(one.settings), "result": result}
    write_text(folder / RUN, to_json(document))
    return result


def result_of(one: Run) -> dict[str, Any]:
    """What is known of the best policy in the folder of a run that has ended."""
    from app.evaluation.parts import finite

    about = read_json(one.options.out / f"{one.options.robot}.json")["trained"]
    names = ("samples", "rise_m", "assessed", "assessed_stairs")
    return {
        "outcome": TRAINED,
        "policy": f"{one.name}/{one.options.robot}.safetensors",
        **{name: finite(about[name]) for name in names},
    }


def write_sweep(
    out: Path, runs: Sequence[Run], results: Mapping[str, Mapping[str, Any]]
) -> dict[str, Any]:
    """Writes sweep.json, and returns what is in it: the runs with what is known of each."""
    rows = [
        {
            "name": one.name,
            "settings": dict(one.settings),
            **results.get(one.name, {"outcome": MISSING}),
        }
        for one in runs
    ]
    document = {"format": FORMAT, "runs": rows}
    write_text(out / SWEEP, to_json(document))
    return document


def cells(row: Mapping[str, Any]) -> tuple[str, ...]:
    """What is shown of a run beside its name: HEADS says what."""
    if row["outcome"] != TRAINED:
        return (row.get("reason") or row["outcome"],)
    flat, stairs = row["assessed"], row["assessed_stairs"]

    def cm(name: str) -> str:
        return "-" if flat[name] is None else f"{100 * flat[name]:.1f} cm"

    return (
        f"{row['samples'] / 1e6:.2f} M",
        f"{flat['falls']} of {flat['episodes']}",
        f"{cm('error_m_median')} / {cm('error_m_p95')}",
        f"{100 * row['rise_m']:.1f} cm",
        " / ".join(f"{100 * one['success']:.0f} %" for one in stairs) or "-",
    )


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """The runs for people, a line each."""
    lines = [HEADS, *((row["name"], *cells(row)) for row in rows)]
    widths = [
        max(len(line[k]) for line in lines if len(line) == len(HEADS)) for k in range(len(HEADS))
    ]
    widths[0] = max(len(line[0]) for line in lines)
    return "".join(
        "  ".join(f"{cell:<{w}}" for cell, w in zip(line, widths, strict=False)).rstrip() + "\n"
        for line in lines
    )
