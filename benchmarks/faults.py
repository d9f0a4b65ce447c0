"""Commands that are ended while they write: `python -m benchmarks.faults --count N --seed S`.

Every try begins a command that writes (`plan`, `navigate`, `dataset`, `trials`, `evaluate`,
`export`, `train`) in a copy of this process, and at a random moment ends it (`kill` is SIGKILL,
`term` SIGTERM, `int` Ctrl-C), or lets the disk be full for its files (`full`: none may be larger
than a random size). Right is:

- No process of it is alive afterwards. No file has a final name that is not whole.
- After `term`, `int` and `full` no temporary file is left, there is no traceback, and the exit
  code is that of the signal, or 2 with one line that begins with `error:`. On a full disk what was
  there before is still there.
- The same command, begun again, ends with the same bytes as one that nobody ended, but for the
  times that it took, and with no file more.

Prints what was wrong, and exits with 1 if anything was; Ctrl-C ends it early, with the count so
far. A try depends on the seed and its number, and on how fast the machine is: the moment is a share
of the time that the whole command took.
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
import zipfile
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tyro

from app.cli import main
from app.output import ExitCode
from benchmarks.copies import members, start_copy, until_interrupted, written
from benchmarks.short_training import WORDS as TRAIN
from benchmarks.short_training import shorten_training

ROOM = str(Path(__file__).resolve().parent.parent / "maps" / "room.png")
CORPUS = "CORPUS"
TO_GOAL = ["--map", ROOM, "--goal", "0.5,0.5,0"]
TRIALS = ["trials", "--map", ROOM, "--count", "4", "--workers", "2", "--apart", "0.3"]
COMMANDS: Mapping[str, list[str]] = {
    "plan": ["plan", *TO_GOAL, "--out", "plan.json", "--image", "plan.png"],
    "navigate": ["navigate", *TO_GOAL, "--out", ".", "--html", "walk.html"],
    "dataset": ["dataset", "--count", "6", "--workers", "2", "--out", "."],
    "trials": [*TRIALS, "--out", "."],
    "evaluate": ["evaluate", "--sections", "gait,modes", "--episodes", "1", "--out", "."],
    "export": ["export", "--out", "policy.onnx", "--mjcf", "robot.xml"],
    "train": [*TRAIN, "--corpus", CORPUS, "--out", "."],
}
# A run in the folder is gone on with if this file of it is there.
RESUMED_BY = {"trials": "trials.json", "train": "checkpoint.pt"}
SIGNALS = {"kill": signal.SIGKILL, "term": signal.SIGTERM, "int": signal.SIGINT}
HOWS = (*SIGNALS, "full")
CODES = {"term": ExitCode.TERMINATED, "int": ExitCode.INTERRUPTED}
# Keys of documents that tell how long something took.
TIMES = ("time_s", "time_to_first_s", "planning_time_s", "wall_time_s", "compile_time_s")
# Logs that begin anew with a run that goes on, and the state of one, with the times in it.
VARYING = (".pt", ".html")
LOGS = "tensorboard"
# Far more than a process needs that ends with another one: it may import first, slowly.
WAIT_S = 180.0


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Commands that are ended while they write.

    count: tries. seed: of them. only: the number of the one try to repeat. commands, hows: those to
    try, all if none are given.
    """

    count: int = 100
    seed: int = 0
    only: int | None = None
    commands: tuple[str, ...] = ()
    hows: tuple[str, ...] = ()


def words_of(command: str, corpus: Path, folder: Path) -> list[str]:
    """The command line, which goes on with what is in the folder where it can."""
    words = [str(corpus) if word == CORPUS else word for word in COMMANDS[command]]
    goes_on = command in RESUMED_BY and (folder / RESUMED_BY[command]).exists()
    return [*words, "--resume"] if goes_on else words


def contents(folder: Path) -> dict[str, bytes]:
    """What is in a folder under each name, hidden ones too, without the times that it took."""
    files = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.is_file() and LOGS not in path.parts:
            data = b"" if path.suffix in VARYING else path.read_bytes()
            files[name] = timeless(data) if path.suffix == ".json" else data
    return files


def timeless(document: bytes) -> bytes:
    """A JSON document without what depends on the clock."""

    def without(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: without(part) for key, part in value.items() if key not in TIMES}
        return [without(part) for part in value] if isinstance(value, list) else value

    try:
        return json.dumps(without(json.loads(document))).encode()
    except ValueError:  # half of one
        return document


def is_hidden(name: str) -> bool:
    """Whether a file or a folder above it is a temporary one, or a claim on a folder."""
    return any(part.startswith(".") for part in Path(name).parts)


def half_written(folder: Path) -> list[str]:
    """Files under final names that are not whole."""
    return [
        str(path.relative_to(folder))
        for path in folder.rglob("*")
        if path.is_file() and not is_hidden(str(path.relative_to(folder))) and not is_whole(path)
    ]


def is_whole(path: Path) -> bool:
    """Whether a file can be read to its end."""
    data = path.read_bytes()
    if LOGS in path.parts:
        return True  # it grows as the run goes on
    try:
        if path.suffix == ".json":
            json.loads(data)
        elif path.suffix == ".png":
            return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) is not None
        elif path.suffix in (".npz", ".pt"):
            return zipfile.ZipFile(io.BytesIO(data)).testzip() is None
        elif path.suffix == ".html":
            return data.rstrip().endswith(b"</html>")
    except (ValueError, zipfile.BadZipFile, cv2.error):
        return False
    return bool(data)


def carried_out(words: list[str], limit_bytes: int | None = None) -> int:
    """Runs a command line; Ctrl-C before or after it is none of its faults."""
    try:
        if limit_bytes is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit_bytes, limit_bytes))
        return main(words)
    except KeyboardInterrupt:
        return ExitCode.INTERRUPTED


def finish(child: int) -> int:
    """Waits for a copy and all that it began; its exit code. Ends what is left after a while."""
    _, status = os.waitpid(child, 0)
    until = time.monotonic() + WAIT_S
    while members(child) and time.monotonic() < until:
        time.sleep(0.01)
    return os.waitstatus_to_exitcode(status)


class Bench:
    """A place for tries: what each command writes when nobody ends it, and how long that takes."""

    def __init__(self, scratch: Path, commands: tuple[str, ...]) -> None:
        self.scratch = scratch
        self.corpus = scratch / "corpus"
        self.expected: dict[str, dict[str, bytes]] = {}
        self.took_s: dict[str, float] = {}
        with contextlib.redirect_stdout(sys.stderr):
            if any(CORPUS in COMMANDS[command] for command in commands):
                main(["dataset", "--count", "4", "--workers", "1", "--out", str(self.corpus)])
            import controller.runner  # noqa: F401  that is torch, for all copies

            for command in commands:  # compiles
                # Where torch has begun threads of its own, copies would wait for them for ever.
                if command != "train":
                    with contextlib.chdir(self.folder()):
                        main(words_of(command, self.corpus, Path.cwd()))
        for command in commands:
            folder = self.folder()
            began = time.monotonic()
            code = self.run(command, folder)
            self.took_s[command] = time.monotonic() - began
            assert code == ExitCode.DONE, written(folder)
            self.expected[command] = contents(folder)
            print(f"{command}: {self.took_s[command]:.1f} s", file=sys.stderr)

    def folder(self) -> Path:
        """A new, empty folder."""
        folder = self.scratch / "try"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        return folder

    def run(self, command: str, folder: Path) -> int:
        """Runs a command to its end; its exit code."""
        words = words_of(command, self.corpus, folder)
        return finish(start_copy(lambda: carried_out(words), folder))

    def attempt(self, command: str, how: str, draw: random.Random) -> list[str]:
        """Ends a command, looks at what it left, and begins it again; what was wrong."""
        folder, expected = self.folder(), self.expected[command]
        words, limit = words_of(command, self.corpus, folder), None
        if how == "full":
            largest = max(map(len, expected.values()))
            limit = round(2000 * (max(largest, 4000) / 2000) ** draw.random())
            if draw.random() < 0.5:  # there is something already
                assert self.run(command, folder) == ExitCode.DONE
                words = words_of(command, self.corpus, folder)
        before = contents(folder)
        child = start_copy(lambda: carried_out(words, limit), folder)
        if how in SIGNALS:
            time.sleep(draw.random() * self.took_s[command])
            with contextlib.suppress(ProcessLookupError):
                os.kill(child, SIGNALS[how])
        code = finish(child)
        return [
            *self._left(child),
            *self._wrong_at_once(folder, how, code, before),
            *self._wrong_again(command, folder),
        ]

    def _left(self, child: int) -> list[str]:
        left = members(child)
        if not left:
            return []
        told = []
        for process in left:
            with contextlib.suppress(OSError):
                words = Path(f"/proc/{process}/cmdline").read_bytes().split(b"\0")
                told.append(b" ".join(words).decode(errors="replace")[:200])
        os.killpg(child, signal.SIGKILL)
        return [f"left after {WAIT_S:g} s: {process}" for process in told]

    def _wrong_at_once(
        self, folder: Path, how: str, code: int, before: dict[str, bytes]
    ) -> list[str]:
        wrong = [f"{name} is half written" for name in half_written(folder)]
        if how == "kill" or code < 0:  # a signal that came before it was looked for
            return wrong
        _, err = written(folder)
        lines = err.splitlines()
        if any("Traceback" in line for line in lines):
            wrong.append(f"traceback: {err[-600:]}")
        if code not in (ExitCode.DONE, CODES.get(how, ExitCode.BAD_INPUT)):
            wrong.append(f"exit code {code}: {err[-300:]}")
        if code == ExitCode.BAD_INPUT and sum(line.startswith("error: ") for line in lines) != 1:
            wrong.append(f"not one line of error: {err[-300:]}")
        after = contents(folder)
        wrong += [f"left {name}" for name in after if is_hidden(name)]
        wrong += [f"lost {name}" for name in before.keys() - after.keys()]
        return wrong

    def _wrong_again(self, command: str, folder: Path) -> list[str]:
        expected = self.expected[command]
        code = self.run(command, folder)
        if code != ExitCode.DONE:
            return [f"begun again: exit code {code}: {written(folder)[1][-600:]}"]
        found = contents(folder)
        return [
            *(f"begun again: {name} is missing" for name in expected.keys() - found.keys()),
            *(f"begun again: {name} is left" for name in found.keys() - expected.keys()),
            *(
                f"begun again: {name} differs"
                for name in expected.keys() & found.keys()
                if expected[name] != found[name]
            ),
        ]


def faults(arguments: Arguments) -> int:
    """Runs the tries and prints what was wrong; with how many something was."""
    commands = arguments.commands or tuple(COMMANDS)
    hows = arguments.hows or HOWS
    numbers = range(arguments.count) if arguments.only is None else [arguments.only]
    bad, tried = 0, Counter[tuple[str, str]]()
    cv2.setNumThreads(1)
    shorten_training()
    with tempfile.TemporaryDirectory() as scratch:
        bench = Bench(Path(scratch), commands)
        for number in until_interrupted(numbers):
            draw = random.Random(f"{arguments.seed} {number}")
            command = commands[number % len(commands)]
            how = hows[number // len(commands) % len(hows)]
            wrong = bench.attempt(command, how, draw)
            tried[command, how] += 1
            bad += bool(wrong)
            for line in wrong:
                print(f"{number} {command} {how}: {line}", flush=True)
    for command in commands:
        print(f"{command}: " + ", ".join(f"{how}: {tried[command, how]}" for how in hows))
    print(f"{bad} of {tried.total()} were not as they should be")
    return bad


if __name__ == "__main__":
    sys.exit(1 if faults(tyro.cli(Arguments, description=__doc__)) else 0)
