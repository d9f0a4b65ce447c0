"""How a command answers: exit codes, errors of input, files written whole, progress."""

from __future__ import annotations

import contextlib
import dataclasses
import fcntl
import json
import os
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from enum import IntEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from maps.files import written_whole

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

PICTURE_ENDINGS = (".png", ".jpg", ".jpeg", ".bmp")
LINE_EVERY_S = 5.0
LOCK = ".lock"
_WORD, _LINE = 400, 1000  # letters of a word and of a line that are shown of a message


class ExitCode(IntEnum):
    """Exit codes that people and scripts rely on."""

    DONE = 0
    BAD_INPUT = 2
    NO_PLAN = 3
    WALK_FAILED = 4
    INTERRUPTED = 130
    TERMINATED = 143


class InputError(Exception):
    """Something the person gave is wrong: the message names it and says what would be right.

    Not a ValueError, so that nothing between here and the command line takes it for one.
    """


@contextlib.contextmanager
def as_bad_input(*kinds: type[Exception]) -> Iterator[None]:
    """Turns errors of these kinds, raised inside, into an InputError of the same message.

    Name the narrowest kinds that wrong input raises: a ValueError out of a fault in the program
    must stay a traceback.
    """
    try:
        yield
    except kinds as error:
        raise InputError(str(error)) from error


@contextlib.contextmanager
def told_by_one_rank() -> Iterator[None]:
    """Lets an InputError raised inside be told once where `torchrun` runs this many times.

    All those processes have the same command line: the first on each machine tells what is wrong
    with it, the others exit without a word.
    """
    try:
        yield
    except InputError:
        if os.environ.get("LOCAL_RANK", "0") != "0":
            raise SystemExit(ExitCode.BAD_INPUT) from None
        raise


def one_line(message: object) -> str:
    """The message with every run of white space, line ends included, made one blank.

    Of words and lines that are too long to be read the middle is left out.
    """
    return _shortened(" ".join(_shortened(word, _WORD) for word in str(message).split()), _LINE)


def _shortened(text: str, most: int) -> str:
    """The text with its middle left out if it has more than so many letters."""
    half = most // 2 - 3
    return text if len(text) <= most else f"{text[:half]} ... {text[-half:]}"


def refuse_given(options: Any, names: Sequence[str], why: str) -> None:
    """Raises InputError, which says why, if one of these options has been given."""
    for field in dataclasses.fields(options):
        factory = field.default_factory
        default = field.default if factory is dataclasses.MISSING else factory()
        if field.name in names and getattr(options, field.name) != default:
            raise InputError(f"--{field.name.replace('_', '-')} {why}")


def require_writable(path: Path | None, *, option: str, endings: Sequence[str] = ()) -> None:
    """Checks now, before the work, that the file, if there is to be one, can be written later.

    Raises:
        InputError: The folder is missing or not writable, the path is a folder itself, or it has
            none of the endings, if any are given.
    """
    if path is None:
        return
    folder = path.parent
    if endings and path.suffix.lower() not in endings:
        raise InputError(f"{option}: {path} must end in {', '.join(endings)}")
    if path.is_dir():
        raise InputError(f"{option}: {path} is a folder; name a file in it")
    if path.exists() and not path.is_file():
        # Putting a file in its place would take /dev/null from everybody.
        raise InputError(f"{option}: {path} is not a file; name one that may be replaced")
    if not folder.is_dir():
        raise InputError(f"{option}: cannot write {path}: {folder} is not a folder that exists")
    if not os.access(folder, os.W_OK):
        raise InputError(f"{option}: cannot write {path}: {folder} is not writable")


def make_folder(path: Path, *, option: str) -> None:
    """Makes the folder, with those above it, and checks that files can be put there.

    Raises:
        InputError: It cannot be made or is not writable.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise InputError(f"{option}: cannot make the folder {path}: a file is in the way") from None
    except OSError as error:
        raise InputError(f"{option}: cannot make the folder {path}: {error.strerror}") from error
    if not os.access(path, os.W_OK):
        raise InputError(f"{option}: the folder {path} is not writable")


_CLAIMED: dict[Path, int] = {}  # of this process: the open lock file of each folder


def claim_folder(path: Path, *, option: str) -> None:
    """Makes the folder and keeps other processes from claiming it until `release_folders`.

    The claim is a lock on the file `.lock` in it. It goes with the process, however that ends.

    Raises:
        InputError: It cannot be made or written, or another process has it.
    """
    make_folder(path, option=option)
    path = path.resolve()
    while path not in _CLAIMED:
        lock = os.open(path / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            owner = os.read(lock, 20).decode(errors="replace").strip()
            os.close(lock)
            raise InputError(
                f"{option}: process {owner} is writing to {path}; wait for it, end it, or name "
                "another folder"
            ) from None
        try:
            is_there = os.path.samestat(os.fstat(lock), os.stat(path / LOCK))
        except FileNotFoundError:
            is_there = False
        if not is_there:  # its owner has just taken it away
            os.close(lock)
            continue
        os.truncate(lock, 0)
        os.write(lock, f"{os.getpid()}\n".encode())
        _CLAIMED[path] = lock


def release_folder(path: Path) -> None:
    """Gives up a folder that this process has claimed."""
    lock = _CLAIMED.pop(path.resolve())
    with contextlib.suppress(OSError):
        os.unlink(path / LOCK)
    os.close(lock)


def release_folders() -> None:
    """Gives up all folders that this process has claimed."""
    for path in list(_CLAIMED):
        release_folder(path)


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Gives a temporary name of the same ending; on leaving, that file becomes `path`.

    If the block raises, the temporary file goes and `path` stays as it was.

    Raises:
        InputError: The file cannot be written.
    """
    try:
        with written_whole(path) as temporary:
            yield temporary
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}") from error


def write_text(path: Path, text: str) -> None:
    """Writes the text as UTF-8, whole or not at all.

    Raises:
        InputError: The file cannot be written.
    """
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def to_json(document: Mapping[str, Any]) -> str:
    """The document as JSON text with a line end.

    Raises:
        ValueError: A number is not finite: JSON has no word for that.
    """
    return json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def write_picture(path: Path, picture: NDArray[np.uint8]) -> None:
    """Writes a picture (H, W, 3), blue green red, in the format that the name ends in.

    Raises:
        InputError: The file cannot be written.
    """
    # Here and not above: what writes only text need not wait for it.
    import cv2

    with replacing(path) as temporary:
        try:
            written = cv2.imwrite(str(temporary), picture)
        except cv2.error:
            written = False
        if not written:
            raise OSError(f"an image must end in {', '.join(PICTURE_ENDINGS)}")


class ProgressBar:
    """Progress on standard error: a bar on a terminal, elsewhere a line every few seconds.

    A context manager. Without a total the bar moves on its own and shows the time. Standard output
    is never touched: it belongs to results.
    """

    def __init__(
        self, title: str, total: float | None, *, line_every_s: float = LINE_EVERY_S
    ) -> None:
        self._title = title
        self._total = total
        self._line_every_s = line_every_s
        self._line_at_s, self._line = 0.0, ""
        self._bar: Progress | None = None
        self._task: TaskID

    def __enter__(self) -> Self:
        # Here and not above: a run in which nothing takes long need not wait for it.
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        self._line_at_s = time.monotonic() + self._line_every_s
        console = Console(stderr=True)
        if console.is_terminal:
            self._bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                TextColumn("{task.fields[amount]} {task.fields[note]}"),
                TimeElapsedColumn(),
                console=console,
                transient=True,
            )
            self._task = self._bar.add_task(
                self._title, total=self._total, amount=self._amount(0), note=""
            )
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    def update(self, done: float, note: str = "") -> None:
        """Tells how much of the total is done, with a short remark; no line twice in a row."""
        if self._bar is not None:
            self._bar.update(self._task, completed=done, amount=self._amount(done), note=note)
        elif time.monotonic() >= self._line_at_s:
            line = " ".join(filter(None, (f"{self._title}:", self._amount(done), note)))
            if line != self._line:
                self._line_at_s, self._line = time.monotonic() + self._line_every_s, line
                say(line)

    def _amount(self, done: float) -> str:
        return "" if self._total is None else f"{done:g}/{self._total:g}"


def say(line: str) -> None:
    """One line of news on standard error."""
    print(line, file=sys.stderr, flush=True)
