"""Files that are written whole or not at all, and files that strangers wrote."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import os
import re
import shutil
import threading
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any

import yaml

# Documents take twenty times their bytes as lists and numbers.
MOST_JSON_BYTES = 40_000_000
# The reader of YAML takes a second for so many.
MOST_YAML_BYTES = 100_000
# Archives of this project are not compressed; small ones may be.
MOST_UNPACKED_BYTES = 100_000_000
_DEEPEST_YAML, _MOST_BITS = 32, 1024


@contextlib.contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Gives a temporary path beside this one; at the end its file takes this one's place.

    Nobody reads half a file. If the block raises, the temporary file goes and `path` stays as it
    was; what a killed process left goes with the next one that writes the same file. Through a
    link it is the file behind it that is replaced. The temporary path has the same ending, from
    which writers of pictures take the format.

    Raises:
        OSError: The file cannot be written.
    """
    path = path.resolve()
    with _temporary(path, Path.touch) as temporary:  # what cannot be written is told at once
        yield temporary
        with temporary.open("rb") as file:
            os.fsync(file.fileno())  # a name must not outlive a power cut that the data did not
        os.replace(temporary, path)


@contextlib.contextmanager
def folder_beside(path: Path) -> Iterator[Path]:
    """Gives a new temporary folder beside a path, which goes at the end with what is in it.

    What a killed process left goes with the next one that asks for a folder beside this path.

    Raises:
        OSError: It cannot be made.
    """
    with _temporary(path.resolve(), Path.mkdir) as folder:
        yield folder


@contextlib.contextmanager
def _temporary(path: Path, make: Callable[[Path], None]) -> Iterator[Path]:
    """A new file or folder of this process beside a path, removed at the end if it is there.

    It is locked, by which those that a killed process left are told from those in use.
    """
    _remove_left(path)
    writer = f"{os.getpid()}-{threading.get_ident()}"
    temporary = path.with_name(f".{path.stem}-{writer}{path.suffix}")
    lock = _made_and_locked(temporary, make)
    try:
        yield temporary
    finally:
        with contextlib.suppress(OSError):
            _remove(temporary)
        os.close(lock)


def _remove_left(path: Path) -> None:
    """Removes the temporary files or folders beside a path that no process has locked."""
    name = re.compile(rf"\.{re.escape(path.stem)}-\d+-\d+{re.escape(path.suffix)}")
    with contextlib.suppress(OSError):
        for left in filter(name.fullmatch, os.listdir(path.parent)):
            lock = os.open(path.with_name(left), os.O_RDONLY)
            try:
                with contextlib.suppress(BlockingIOError):
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    _remove(path.with_name(left))
            finally:
                os.close(lock)


def _made_and_locked(path: Path, make: Callable[[Path], None]) -> int:
    """The open file or folder that was made under this path."""
    while True:
        make(path)
        try:
            lock = os.open(path, os.O_RDONLY)
        except FileNotFoundError:  # somebody took it for one that was left, before it was locked
            continue
        with contextlib.suppress(OSError):  # some file systems know no locks
            fcntl.flock(lock, fcntl.LOCK_EX)
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(lock), os.stat(path)):
                return lock
        os.close(lock)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def from_json(text: str | bytes) -> Any:
    """The document that JSON text holds; bytes are read as UTF-8.

    Raises:
        ValueError: It is no JSON, or is nested too deep to be read.
    """
    try:
        return json.loads(text if isinstance(text, str) else text.decode("utf-8"))
    except RecursionError:
        raise ValueError("nested too deep") from None


def read_json(path: Path) -> Any:
    """The document in a JSON file.

    Raises:
        OSError: It cannot be read, or is far larger than any document of this project.
        ValueError: It is no JSON, or is nested too deep to be read.
    """
    return from_json(read_limited(path, MOST_JSON_BYTES))


def read_limited(path: Path, most_bytes: int) -> bytes:
    """What a file holds.

    Raises:
        OSError: It cannot be read, or has more bytes; then nothing of it is read.
    """
    with path.open("rb") as file:
        if os.fstat(file.fileno()).st_size > most_bytes:
            raise OSError(errno.EFBIG, f"larger than {most_bytes / 1e6:g} MB", str(path))
        return file.read()


def check_unpacked(archive: IO[bytes]) -> None:
    """Checks that a zip archive, as npz files and checkpoints are, is not far larger unpacked.

    Raises:
        ValueError: It is.
        OSError, zipfile.BadZipFile: It is no archive that can be read.
    """
    with zipfile.ZipFile(archive) as file:
        unpacked = sum(member.file_size for member in file.infolist())
    packed = archive.seek(0, os.SEEK_END)
    if unpacked > max(packed, MOST_UNPACKED_BYTES):
        raise ValueError(
            f"{packed / 1e6:.3g} MB that unpack to {unpacked / 1e6:.3g} MB: write it uncompressed"
        )


def from_yaml(text: str) -> Any:
    """The document that YAML text holds, without aliases or keys that are there twice.

    Raises:
        ValueError: It is no such YAML; the message is one line, with the number of the line.
    """
    try:
        return yaml.load(text, _YamlLoader)
    except yaml.MarkedYAMLError as error:
        line = "" if error.problem_mark is None else f"line {error.problem_mark.line + 1}: "
        raise ValueError(f"{line}not valid YAML ({error.problem})") from None
    except (yaml.YAMLError, ValueError) as error:  # such as a date of 13 months
        raise ValueError(f"not valid YAML ({' '.join(str(error).split())})") from None


class _YamlLoader(yaml.SafeLoader):
    """Refuses what makes documents that are far larger or deeper than their text.

    Also a key that is there twice, of which YAML's own loader would take the last.
    """

    def fetch_alias(self) -> None:
        raise self._refused("an alias: write the value itself")

    def fetch_flow_collection_start(self, token_class: type[yaml.Token]) -> None:
        super().fetch_flow_collection_start(token_class)
        self._check_depth()

    def add_indent(self, column: int) -> bool:
        is_deeper = super().add_indent(column)
        self._check_depth()
        return is_deeper

    def _check_depth(self) -> None:
        if self.flow_level + len(self.indents) > _DEEPEST_YAML:
            raise self._refused("nested too deep")

    def _refused(self, problem: str) -> yaml.MarkedYAMLError:
        return yaml.MarkedYAMLError(problem=problem, problem_mark=self.get_mark())

    def construct_yaml_int(self, node: yaml.ScalarNode) -> int:
        value = super().construct_yaml_int(node)
        if value.bit_length() > _MOST_BITS:
            raise yaml.MarkedYAMLError(
                problem=f"a whole number of more than {_MOST_BITS} bits",
                problem_mark=node.start_mark,
            )
        return value

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                continue
            if key.value in seen:
                raise yaml.MarkedYAMLError(
                    problem=f"key `{key.value}` is there twice", problem_mark=key.start_mark
                )
            seen.add(key.value)
        return super().construct_mapping(node, deep)


_YamlLoader.add_constructor("tag:yaml.org,2002:int", _YamlLoader.construct_yaml_int)
