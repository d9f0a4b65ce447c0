"""Damaged and absurd input by the thousand: `python -m benchmarks.fuzz --count N --seed S`.

Every try takes something that works (a map, its YAML, a plan, a corpus, a policy, trials to resume,
a command line), damages it and gives it to a command, or to the reader of plans, in a process of
its own that is a copy of this one. Right is: exit code 0, 2, 3 or 4; where it is 2 one line that
begins with `error:`; warnings in one line each; no traceback; at most CPU_S of processor time to
refuse, and MEMORY_MB beyond this process. What is accepted may go on for ACCEPTED_S, and is then
ended. A try depends on the seed and its number alone: `--only NUMBER` repeats it.
Prints what was answered badly, and exits with 1 if anything was.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tyro
from numpy.typing import NDArray

from app.cli import COMMANDS, load_run, main
from app.output import ExitCode
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
# Whether a word is absurd depends on where it stands: each is tried everywhere.
ODD = [
    *(
        "",
        " ",
        "-",
        "--",
        "nan",
        "inf",
        "-inf",
        "1e400",
        "-0.0",
        "1e-320",
        "0",
        "-1",
        "0x10",
        "1_0",
    ),
    *("99999999999999999999", "9" * 400, "1" * 5000, "2,1", "2,1,1.57,0", "nan,0,0", "1e300,0,0"),
    *(
        "1e9,1e9,0",
        "a" * 5000,
        "/",
        ".",
        "..",
        "/dev/null",
        "/dev/full",
        "/proc/self/mem",
        "/root/x",
    ),
    *(
        "~",
        "*",
        "\t",
        "\n",
        "a\nb",
        "é",
        "\udcff",
        "٣",
        "true",
        "none",
        "[]",
        "{}",
        "null",
        "2 1 1",
    ),
    *(
        "file:///etc/passwd",
        "map.png/x",
        "x" * 255 + ".png",
        "a.png",
        "a.npz",
        "--help",
        "%s",
        "$HOME",
    ),
]
WORDS = [
    *ODD,
    "[1, 2]",
    "{a: 1}",
    "&a [*a]",
    "!!python/object:os.system x",
    "1e-2",
    "|",
    ">",
    "? x",
]


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


def damaged(data: bytes, draw: random.Random) -> bytes:
    """The bytes with some changed, cut, put in, doubled, or gone."""
    changed = bytearray(data)
    for _ in range(draw.choice((1, 1, 1, 2, 5, 30))):
        at = (
            draw.randrange(len(changed) + 1)
            if draw.random() < 0.6
            else draw.randrange(1 + min(len(changed), 64))
        )
        how = draw.randrange(6)
        if how == 0 and changed:
            changed[min(at, len(changed) - 1)] ^= 1 << draw.randrange(8)
        elif how == 1 and changed:
            changed[min(at, len(changed) - 1)] = draw.choice((0, 255, draw.randrange(256)))
        elif how == 2 and draw.random() < 0.5:
            del changed[at:]
        elif how == 3:
            del changed[at : at + draw.choice((1, 2, 4, 50))]
        elif how == 4:
            changed[at:at] = draw.randbytes(draw.choice((1, 4, 50)))
        else:
            changed[at:at] = changed[at : at + draw.choice((4, 50, 500))]
    return bytes(changed)


def odd_document(value: object, draw: random.Random) -> object:
    """A JSON document in which one value, somewhere, is another, is gone, or is buried in lists."""
    if isinstance(value, dict) and value and draw.random() < 0.9:
        key = draw.choice(list(value))
        if draw.random() < 0.15:
            return {k: v for k, v in value.items() if k != key}
        return {**value, key: odd_document(value[key], draw)}
    if isinstance(value, list) and value and draw.random() < 0.8:
        at = draw.randrange(len(value))
        if draw.random() < 0.15:
            return value[:at] + value[at + 1 :]
        return [*value[:at], odd_document(value[at], draw), *value[at + 1 :]]
    odd = [
        None,
        True,
        -1,
        0,
        10**30,
        1e308,
        float("nan"),
        float("inf"),
        "",
        [],
        {},
        [value],
        {"a": value},
    ]
    return draw.choice([*odd, draw.choice(ODD), str(value), [[[[]]]], [value] * 1000])


def odd_json(text: str, draw: random.Random) -> bytes:
    """JSON text with its bytes damaged, a value replaced, or nested too deep to read."""
    how = draw.random()
    if how < 0.3:
        return damaged(text.encode(), draw)
    if how < 0.33:
        return b"[" * 100_000
    return json.dumps(odd_document(json.loads(text), draw)).encode("utf-8", "surrogatepass")


def odd_yaml(text: str, draw: random.Random) -> bytes:
    """A map's YAML with lines that are odd, gone, there twice, or damaged."""
    lines = text.splitlines()
    for _ in range(draw.choice((1, 1, 2, 4))):
        at = draw.randrange(len(lines))
        how = draw.randrange(6)
        if how == 0:
            lines.append(lines[at])
        elif how == 1 and len(lines) > 1:
            del lines[at]
        elif how == 2:
            lines[at] = draw.choice(WORDS)
        elif how == 3:
            return damaged("\n".join(lines).encode(), draw)
        else:
            lines[at] = (
                lines[at].split(":")[0] + ":" + draw.choice((" ", "", "\t")) + draw.choice(WORDS)
            )
    if draw.random() < 0.03:
        nested = [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 12)]
        lines = [
            "a0: &a0 x",
            *nested,
            *lines[1:],
            draw.choice(("image", "origin", "negate")) + ": *a11",
        ]
    return "\n".join(lines).encode("utf-8", "surrogatepass")


def odd_picture(draw: random.Random) -> tuple[str, bytes]:
    """A small picture of a room in one of the formats, as a file name and damaged bytes."""
    grey = np.full((60, 80), 254, np.uint8)
    grey[:2], grey[:, :2], grey[20:30, 50:] = 0, 0, 0
    form = draw.choice((".png", ".pgm", ".bmp", ".jpg", ".png", ".ppm", ".tif", ".webp"))
    many = draw.choice(
        (grey, cv2.merge([grey] * 3), cv2.merge([grey] * 4), grey.astype(np.uint16) * 257)
    )
    data = _encoded(form, many) or _encoded(form, grey)
    if form == ".pgm" and draw.random() < 0.3:
        sizes = draw.choice((b"60000 60000", b"999999999 999999999", b"0 0", b"-1 60", b"1 4800"))
        data = data.replace(b"80 60", sizes)
    if form == ".png" and draw.random() < 0.2:
        width = draw.choice((0, 1, 60_000, 2**31 - 1)).to_bytes(4, "big")
        data = data[:16] + width + draw.choice((width, data[20:24])) + data[24:]
    return f"map{form}", data if draw.random() < 0.05 else damaged(data, draw)


def _encoded(form: str, picture: NDArray[Any]) -> bytes:
    """A picture as a file of this form; empty where the form cannot hold it."""
    with contextlib.suppress(cv2.error):
        done, data = cv2.imencode(form, picture)
        return data.tobytes() if done and isinstance(data, np.ndarray) else b""
    return b""


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
    "policy": try_policy,
    "plan": try_plan,
    "corpus": try_corpus,
    "trials": try_trials,
    "words": try_words,
}
_KEPT: dict[str, bytes] = {}


def _kept(name: str) -> bytes:
    return _KEPT[name]


def prepare(folder: Path) -> None:
    """Makes what is damaged later, and lets the copies of this process find all imported."""
    import controller.runner  # noqa: F401  that is torch

    cv2.setNumThreads(1)
    room = ["--map", str(MAPS / "room.png"), *GOAL]
    with contextlib.redirect_stdout(sys.stderr):
        main(["plan", *room, "--out", str(folder / "plan.json")])
        main(["navigate", *room, "--out", str(folder / "walk")])
        main(["dataset", "--count", "6", "--out", str(folder / "corpus"), "--workers", "1"])
        main(["dataset", "check", str(folder / "corpus"), "--workers", "1"])
        main([*TRIALS, "--out", str(folder / "trials")])
        main(["export", "--out", str(folder / "policy.onnx")])
    for file in ("plan.json", "corpus/plans.npz", "corpus/manifest.json", "trials/trials.json"):
        _KEPT[Path(file).name] = (folder / file).read_bytes()


@dataclass(frozen=True)
class Answer:
    """What a command answered: exit code, None if it was ended; what it wrote; what it took."""

    code: int | None
    out: str
    err: str
    cpu_s: float
    memory_mb: float


def run(words: Sequence[str], folder: Path) -> Answer:
    """Runs a command line in a copy of this process, in the folder."""
    sys.stdout.flush()
    sys.stderr.flush()
    before_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000
    child = os.fork()
    if child == 0:
        code = 70
        with contextlib.suppress(BaseException):
            _become(folder)
            code = 71
            code = _carry_out(words)
        os._exit(code)
    ended = False
    began = time.monotonic()
    while True:
        pid, status, used = os.wait4(child, os.WNOHANG)
        if pid:
            break
        if not ended and (time.monotonic() - began > 60 or _cpu_s(child) > ACCEPTED_S):
            ended = True
            os.killpg(child, signal.SIGKILL)
        time.sleep(0.002)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)  # what it left behind
    out, err = ((folder.parent / name).read_text(errors="replace") for name in ("out", "err"))
    code = None if ended else os.waitstatus_to_exitcode(status)
    return Answer(code, out, err, used.ru_utime + used.ru_stime, used.ru_maxrss / 1000 - before_mb)


def _cpu_s(process: int) -> float:
    """Processor time of a process that may have ended."""
    with contextlib.suppress(OSError, IndexError):
        fields = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return 0.0


def _become(folder: Path) -> None:
    """Gives this process, the copy, a group, streams and a working folder of its own."""
    os.setpgid(0, 0)
    os.chdir(folder)
    for number, name in ((1, "out"), (2, "err")):
        file = os.open(folder.parent / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(file, number)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)


def _carry_out(words: Sequence[str]) -> int:
    try:
        if words[0] == "(plan)":
            try:
                FootstepPlan.from_json(Path(words[1]).read_bytes().decode("utf-8", "replace"))
            except ValueError as error:
                print(f"error: {error}", file=sys.stderr)
                return 2
            return 0
        return main(words)
    except SystemExit as leaving:
        return leaving.code if isinstance(leaving.code, int) else 1
    except BaseException:
        import traceback

        traceback.print_exc()
        return 1
    finally:
        with contextlib.suppress(OSError, ValueError):
            sys.stdout.flush()
            sys.stderr.flush()


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
        for number in numbers:
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
    print(f"{bad} of {len(numbers)} answered badly")
    return bad


if __name__ == "__main__":
    sys.exit(1 if fuzz(tyro.cli(Arguments, description=__doc__)) else 0)
