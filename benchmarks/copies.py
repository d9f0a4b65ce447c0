"""Command lines carried out by copies of this process, which has imported all that they need."""

from __future__ import annotations

import contextlib
import itertools
import os
import resource
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Answer:
    """What a command answered: exit code, None if it was ended; what it wrote; what it took."""

    code: int | None
    out: str
    err: str
    cpu_s: float
    memory_mb: float


def run_copy(function: Callable[[], int], folder: Path, *, accepted_s: float) -> Answer:
    """Runs a function in a copy of this process, in the folder, and ends it after so long.

    The time is that of the processor; a copy that waits is ended after a minute.
    """
    before_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000
    child = start_copy(function, folder)
    ended = False
    began = time.monotonic()
    while True:
        pid, status, used = os.wait4(child, os.WNOHANG)
        if pid:
            break
        if not ended and (time.monotonic() - began > 60 or _cpu_s(child) > accepted_s):
            ended = True
            os.killpg(child, signal.SIGKILL)
        time.sleep(0.002)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)  # what it left behind
    out, err = written(folder)
    answered = None if ended else os.waitstatus_to_exitcode(status)
    cpu_s, memory_mb = used.ru_utime + used.ru_stime, used.ru_maxrss / 1000 - before_mb
    return Answer(answered, out, err, cpu_s, memory_mb)


def start_copy(function: Callable[[], int], folder: Path) -> int:
    """Begins a function in a copy of this process, in the folder; the copy's number.

    The copy leads a process group of its own. What it writes is kept for `written`.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    child = os.fork()
    if child == 0:
        code = 70
        with contextlib.suppress(BaseException):
            _become(folder)
            code = 71
            code = _carry_out(function)
        os._exit(code)
    with contextlib.suppress(OSError):
        os.setpgid(child, child)  # it may be told to end before it has done so itself
    return child


def written(folder: Path) -> tuple[str, str]:
    """What the last copy in the folder wrote to standard output and standard error."""
    out, err = ((folder.parent / name).read_text(errors="replace") for name in ("out", "err"))
    return out, err


def until_interrupted(numbers: Iterable[int]) -> Iterator[int]:
    """The numbers, until Ctrl-C: the one that is at work then is the last, and goes to its end."""
    over: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, frame: over.append(number))
    try:
        yield from itertools.takewhile(lambda _: not over, numbers)
    finally:
        signal.signal(signal.SIGINT, before)


def members(group: int) -> list[int]:
    """The processes of a group that still run."""
    found = []
    for entry in Path("/proc").iterdir():
        with contextlib.suppress(OSError, ValueError, IndexError):
            fields = (entry / "stat").read_text().rsplit(")", 1)[1].split()
            if int(fields[2]) == group and fields[0] not in "ZX":
                found.append(int(entry.name))
    return found


def _cpu_s(process: int) -> float:
    """Processor time of a process that may have ended."""
    with contextlib.suppress(OSError, IndexError):
        fields = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return 0.0


def _become(folder: Path) -> None:
    """Gives this process, the copy, a group, streams and a working folder of its own."""
    with contextlib.suppress(OSError):
        os.setpgid(0, 0)
    # A shell that runs this in the background lets its children ignore Ctrl-C.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.chdir(folder)
    for number, name in ((1, "out"), (2, "err")):
        file = os.open(folder.parent / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(file, number)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)


def _carry_out(function: Callable[[], int]) -> int:
    try:
        return function()
    except SystemExit as leaving:
        return leaving.code if isinstance(leaving.code, int) else 1
    except BaseException:
        traceback.print_exc()
        return 1
    finally:
        with contextlib.suppress(OSError, ValueError):
            sys.stdout.flush()
            sys.stderr.flush()
