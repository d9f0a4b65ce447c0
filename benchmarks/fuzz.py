"""Damaged and absurd input by the thousand: `python -m benchmarks.fuzz --count N --seed S`.

Every try takes something that works (a map, its YAML, a plan, a corpus, a policy, trials or a
training run to resume, a command line), damages it and gives it to a command, or to the reader of
plans, in a process of its own that is a copy of this one. Right is: exit code 0, 2, 3 or 4; where
it is 2 one line that begins with `error:`; warnings in one line each; no traceback; at most CPU_S
of processor time to refuse, and MEMORY_MB beyond this process. What is accepted may go on for
ACCEPTED_S, and is then ended. A try depends on the seed and its number alone: `--only NUMBER`
repeats it.
Prints what was answered badly, and exits with 1 if anything was. Ctrl-C ends it early, with the
count so far.
"""

from __future__ import annotations

import contextlib
import io
import os
import random
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import cv2
import numpy as np
import torch
import tyro

from app.cli import COMMANDS, load_run, main
from app.output import ExitCode
from benchmarks.copies import Answer, run_copy, start_copy, until_interrupted, written
from benchmarks.damage import ODD, damaged, odd_json, odd_picture, odd_state, odd_yaml
from benchmarks.short_training import WORDS as TRAIN
from benchmarks.short_training import shorten_training
from controller.policy import POLICY_FOLDER
from planner.plan import FootstepPlan

RIGHT = {ExitCode.DONE, ExitCode.BAD_INPUT, ExitCode.NO_PLAN, ExitCode.WALK_FAILED}
CPU_S = 2.0
ACCEPTED_S = 4.0
MEMORY_MB = 1000
MOST_LETTERS = 1500
# What may stand beside an error. A map without YAML gets the lines to write, below the error's own.
NO_ERRORS = ("warning: ", "compiling")
FOUR = "these four lines"
MAPS = Path(__file__).resolve().parent.parent / "maps"
GOAL = ["--goal", "0.4,0.1,0"]
STEP_MODEL = """format: step-model/1
name: small
foot: {length_m: 0.2, width_m: 0.1}
body: {length_m: 0.24, width_m: 0.36}
limits:
  x_m: [-0.15, 0.3]
  y_m: [0.15, 0.35]
  yaw_rad: [-0.2, 0.4]
steps: [[0, 0.2, 0], [0.2, 0.2, 0], [-0.1, 0.2, 0], [0, 0.3, 0], [0.1, 0.2, 0.3]]
stance_width_m: 0.2
step_cost_m: 0.1
cell_m: 0.05
headings: 64
"""
OLD_STEPS = """footsteps:
  x: [0.0, 0.2, -0.1, 0.0, 0.1]
  y: [0.2, 0.2, 0.2, 0.3, 0.2]
  theta: [0.0, 0.0, 0.0, 0.0, 0.3]
step_range: {x: [0.3, 0.3, -0.15, -0.15], y: [0.15, 0.35, 0.35, 0.15]}
"""
OLD_PARAMETERS = """planner_type: ARAPlanner
accuracy:
  collision_check: 2
  cell_size: 0.05
  num_angle_bins: 64
step_cost: 0.1
foot:
  size: {x: 0.2, y: 0.1, z: 0.015}
  separation: 0.2
  origin_shift: {x: 0.0, y: 0.0}
  max: {step: {x: 0.3, y: 0.35, theta: 0.4}, inverse: {step: {x: -0.15, y: 0.15, theta: -0.2}}}
"""


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Damaged and absurd input by the thousand.

    count: tries. seed: of them. only: the number of the one try to repeat. kinds: those to try,
    all if none. keep: folder to which the files of what was answered badly go.
    """

    count: int = 1000
    seed: int = 0
    only: int | None = None
    kinds: tuple[str, ...] = ()
    keep: Path | None = None


def try_picture(folder: Path, draw: random.Random) -> list[str]:
    """`plan` on a damaged picture."""
    name, data = odd_picture(draw)
    (folder / name).write_bytes(data)
    (folder / "map.yaml").write_text(
        f"image: {name}\nresolution: 0.05\norigin: [-1, -1, 0]\nnegate: 0\n"
    )
    return ["plan", "--map", str(folder / draw.choice((name, "map.yaml"))), *GOAL]


def try_yaml(folder: Path, draw: random.Random) -> list[str]:
    """`plan` on a map with an odd YAML."""
    name = draw.choice(("room", "stairs"))
    for file in MAPS.glob(f"{name}*.png"):
        shutil.copy(file, folder)
    yaml = folder / f"{name}.yaml"
    yaml.write_bytes(odd_yaml((MAPS / yaml.name).read_text(), draw))
    return ["plan", "--map", str(draw.choice((yaml, yaml.with_suffix(".png")))), *GOAL]


def try_step_model(folder: Path, draw: random.Random) -> list[str]:
    """`plan` with an odd step model, in this project's format or the old package's."""
    if draw.random() < 0.5:
        name, files = "model.yaml", {"model.yaml": STEP_MODEL}
    else:
        files = {"footsteps_r.yaml": OLD_STEPS, "planning_params_r.yaml": OLD_PARAMETERS}
        name = draw.choice(list(files))
    odd = draw.choice(list(files))
    for file, text in files.items():
        data = odd_yaml(text, draw) if file == odd else text.encode()
        (folder / file).write_bytes(data)
    room = ["--map", str(MAPS / "room.png"), *GOAL]
    return ["plan", *room, "--step-model", str(folder / name)]


def try_policy(folder: Path, draw: random.Random) -> list[str]:
    """`export`, or a short walk, of a damaged policy."""
    weights, about = (POLICY_FOLDER / f"jvrc1{suffix}" for suffix in (".safetensors", ".json"))
    data, facts = weights.read_bytes(), about.read_text().encode()
    if draw.random() < 0.4:
        data = damaged(data, draw)
    else:
        facts = odd_json(facts.decode(), draw)
    if draw.random() < 0.05:
        data = (10**9).to_bytes(8, "little") + data[8:]
    (folder / "jvrc1.safetensors").write_bytes(data)
    (folder / "jvrc1.json").write_bytes(facts)
    policy = ["--policy", str(folder / "jvrc1.safetensors")]
    if draw.random() < 0.3:
        return ["export", *policy, "--out", str(folder / "policy.onnx")]
    room = ["--map", str(MAPS / "room.png"), *GOAL]
    if draw.random() < 0.3:
        return ["plan", *room, *policy]
    return ["navigate", *room, *policy, "--out", str(folder / "walk")]


def try_plan(folder: Path, draw: random.Random) -> list[str]:
    """The reader of plans on an odd one."""
    (folder / "plan.json").write_bytes(odd_json(_kept("plan.json").decode(), draw))
    return ["(plan)", str(folder / "plan.json")]


def try_corpus(folder: Path, draw: random.Random) -> list[str]:
    """`dataset check` of a damaged corpus."""
    plans, manifest = _kept("plans.npz"), _kept("manifest.json")
    how = draw.randrange(3)
    if how == 0:
        plans = damaged(plans, draw)
    elif how == 1:
        arrays = dict(np.load(io.BytesIO(plans)))
        name = draw.choice(list(arrays))
        odd = [
            arrays[name][:-1],
            arrays[name][None],
            arrays[name].astype(np.str_),
            np.zeros(0),
            np.array(1.0),
        ]
        arrays[name] = draw.choice(
            [*odd, np.full(arrays[name].shape, draw.choice((np.nan, 1e300, -1)))]
        )
        file = io.BytesIO()
        np.savez(file, **arrays)
        plans = file.getvalue()
    else:
        manifest = odd_json(manifest.decode(), draw)
    (folder / "plans.npz").write_bytes(plans)
    (folder / "manifest.json").write_bytes(manifest)
    return ["dataset", "check", str(folder), "--workers", "1"]


def try_trials(folder: Path, draw: random.Random) -> list[str]:
    """`trials` that go on with an odd file of trials."""
    (folder / "trials.json").write_bytes(odd_json(_kept("trials.json").decode(), draw))
    return [*TRIALS, "--out", str(folder), "--resume"]


def try_checkpoint(folder: Path, draw: random.Random) -> list[str]:
    """`train` that goes on with a damaged checkpoint, or with one of another robot."""
    checkpoint = _kept("checkpoint.pt")
    if draw.random() < 0.4:
        checkpoint = damaged(checkpoint, draw)
    else:
        document = torch.load(io.BytesIO(checkpoint), weights_only=True)
        for _ in range(draw.choice((1, 1, 1, 3))):
            document = odd_state(document, draw)
        file = io.BytesIO()
        torch.save(document, file)
        checkpoint = file.getvalue()
    (folder / "run").mkdir()
    (folder / "corpus").mkdir()
    (folder / "run" / "checkpoint.pt").write_bytes(checkpoint)
    for name in ("plans.npz", "manifest.json"):
        (folder / "corpus" / name).write_bytes(_kept(name))
    robot = "hrp5p" if draw.random() < 0.05 else "jvrc1"
    places = ["--corpus", str(folder / "corpus"), "--out", str(folder / "run")]
    return [*TRAIN, "--robot", robot, *places, "--resume"]


TRIALS = [
    "trials",
    "--map",
    str(MAPS / "room.png"),
    "--count",
    "2",
    "--workers",
    "1",
    "--apart",
    "0.2",
]


def try_words(folder: Path, draw: random.Random) -> list[str]:
    """An example of the overview with an odd word in the place of another, or more of them."""
    words = draw.choice([command.example for command in COMMANDS.values()]).split()
    if words[0] == "serve":
        words = [*words, "--port", "0"]
    for n, word in enumerate(words):
        if word.startswith("maps/"):
            words[n] = str(MAPS / word[5:])
    name = " ".join(words[:2]) if " ".join(words[:2]) in COMMANDS else words[0]
    options = [f"--{field.name.replace('_', '-')}" for field in fields(load_run(name)[1])]
    for _ in range(draw.choice((1, 1, 2, 3))):
        how = draw.randrange(4)
        if how == 0:
            words[draw.randrange(len(words))] = draw.choice(ODD)
        elif how == 1:
            words.insert(draw.randrange(len(words) + 1), draw.choice(ODD))
        else:
            words += [draw.choice(options), draw.choice(ODD)]
    return words


KINDS: dict[str, Callable[[Path, random.Random], list[str]]] = {
    "picture": try_picture,
    "yaml": try_yaml,
    "step model": try_step_model,
    "policy": try_policy,
    "plan": try_plan,
    "corpus": try_corpus,
    "trials": try_trials,
    "checkpoint": try_checkpoint,
    "words": try_words,
}
_KEPT: dict[str, bytes] = {}


def _kept(name: str) -> bytes:
    return _KEPT[name]


FILES = (
    "plan.json",
    "corpus/plans.npz",
    "corpus/manifest.json",
    "trials/trials.json",
    "run/checkpoint.pt",
)


def prepare(folder: Path) -> None:
    """Makes what is damaged later, and lets the copies of this process find all imported."""
    import controller.runner  # noqa: F401  that is torch

    cv2.setNumThreads(1)
    shorten_training()
    room = ["--map", str(MAPS / "room.png"), *GOAL]
    with contextlib.redirect_stdout(sys.stderr):
        main(["plan", *room, "--out", str(folder / "plan.json")])
        main(["navigate", *room, "--out", str(folder / "walk")])
        main(["dataset", "--count", "6", "--out", str(folder / "corpus"), "--workers", "1"])
        main(["dataset", "check", str(folder / "corpus"), "--workers", "1"])
        main([*TRIALS, "--out", str(folder / "trials")])
        main(["export", "--out", str(folder / "policy.onnx")])
    # In a copy: where torch has begun threads of its own, copies would wait for them for ever.
    run_folder = folder / "run"
    train = [*TRAIN, "--corpus", str(folder / "corpus"), "--out", str(run_folder)]
    run_folder.mkdir()
    _, status = os.waitpid(start_copy(lambda: main(train), run_folder), 0)
    assert status == 0, written(run_folder)
    for file in FILES:
        _KEPT[Path(file).name] = (folder / file).read_bytes()


def run(words: Sequence[str], folder: Path) -> Answer:
    """What a copy of this process answers to a command line, or to a plan, in the folder."""
    if words[0] == "(plan)":
        return run_copy(lambda: read_plan(Path(words[1])), folder, accepted_s=ACCEPTED_S)
    return run_copy(lambda: main(words), folder, accepted_s=ACCEPTED_S)


def read_plan(path: Path) -> int:
    """Reads a plan as programs do, and tells of it as a command would."""
    try:
        FootstepPlan.from_json(path.read_bytes().decode("utf-8", "replace"))
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return ExitCode.BAD_INPUT
    return ExitCode.DONE


def fault(answer: Answer) -> str:
    """What is wrong with an answer; empty if nothing."""
    if "Traceback" in answer.err:
        return answer.err.strip().splitlines()[-1][:300]
    if answer.memory_mb > MEMORY_MB:
        return f"took {answer.memory_mb:.0f} MB"
    if answer.code is None:
        return ""
    if answer.code not in RIGHT:
        return f"exit code {answer.code}: {answer.err[-300:]}"
    if answer.code == ExitCode.BAD_INPUT and not answer.out:
        lines = [line for line in answer.err.splitlines() if not line.startswith(NO_ERRORS)]
        if (
            not lines
            or not lines[0].startswith("error: ")
            or len(lines) > 1 + 4 * (FOUR in lines[0])
        ):
            return f"not one line of error: {answer.err[-500:]!r}"
        if len(lines[0]) > MOST_LETTERS:
            return f"a line of {len(lines[0])} letters: {lines[0][:200]!r}"
        if answer.cpu_s > CPU_S:
            return f"took {answer.cpu_s:.1f} s to refuse: {lines[0][:200]}"
    return ""


def fuzz(arguments: Arguments) -> int:
    """Runs the tries and prints what was answered badly; how many that were."""
    kinds = arguments.kinds or tuple(KINDS)
    numbers = range(arguments.count) if arguments.only is None else [arguments.only]
    codes: Counter[tuple[str, int | None]] = Counter()
    bad = 0
    with tempfile.TemporaryDirectory() as scratch:
        prepared = Path(scratch, "prepared")
        prepared.mkdir()
        prepare(prepared)
        for number in until_interrupted(numbers):
            draw = random.Random(f"{arguments.seed} {number}")
            kind = kinds[number % len(kinds)]
            folder = Path(scratch, "try")
            folder.mkdir()
            words = KINDS[kind](folder, draw)
            answer = run(words, folder)
            codes[kind, answer.code] += 1
            wrong = fault(answer)
            if wrong or arguments.only is not None:
                bad += bool(wrong)
                shown = " ".join(word[:80] for word in words).replace(str(folder), "TRY")
                print(f"{number} {kind}: {shown!r}\n    {wrong or answer}", flush=True)
                if arguments.keep is not None:
                    shutil.copytree(folder, arguments.keep / str(number), dirs_exist_ok=True)
            shutil.rmtree(folder)
    for kind in kinds:
        told = {code: n for (of, code), n in sorted(codes.items(), key=str) if of == kind}
        print(
            f"{kind}: " + ", ".join(f"{'ended' if c is None else c}: {n}" for c, n in told.items())
        )
    print(f"{bad} of {codes.total()} answered badly")
    return bad


if __name__ == "__main__":
    sys.exit(1 if fuzz(tyro.cli(Arguments, description=__doc__)) else 0)
