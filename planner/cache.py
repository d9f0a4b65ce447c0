"""Where the package keeps what takes long to make: compiled code, and the tables of robots.

Every state of the sources has a folder of its own. numba by itself looks only at the file of the
function that it is asked for: it would go on using what it compiled from an older version of
another file that the function calls.
"""

from __future__ import annotations

import contextlib
import hashlib
import multiprocessing
import os
import shutil
import stat
import tempfile
import time
import warnings
from functools import lru_cache
from pathlib import Path

SOURCES = Path(__file__).parent
_PREFIX = "numba-"
_STALE_S = 24 * 3600.0
_ASKED_FOR = "NUMBA_CACHE_DIR"


@lru_cache(maxsize=1)
def source_digest() -> str:
    """Twelve hexadecimal digits that tell this state of the package's sources from all others."""
    digest = hashlib.sha256()
    for source in sorted(SOURCES.rglob("*.py")):
        digest.update(source.read_bytes())
    return digest.hexdigest()[:12]


@lru_cache(maxsize=1)
def cache_folder() -> Path | None:
    """The folder for this state of the sources; None where no place can be written to.

    It lies in the folder that NUMBA_CACHE_DIR names, else beside the sources, else among the user's
    caches, else among temporary files. Warns where that is not the place asked for, or one from
    which it may soon be gone.
    """
    refused = []
    for place in _places():
        folder = place / f"{_PREFIX}{source_digest()}"
        is_new = not folder.is_dir()
        may_use = place != _temporary() or _is_private(place)
        if not (may_use and _is_writable(folder)):
            refused.append(place)
            continue
        if is_new:
            _remove_stale(folder)
        if place == _temporary() or (refused and _ASKED_FOR in os.environ):
            _warn(f"compiled code is kept in {place}: {_not_writable(refused)}")
        return folder
    _warn(f"what is compiled now is compiled again at every start: {_not_writable(refused)}")
    return None


def _places() -> list[Path]:
    """Where caches may lie, the best place first."""
    asked_for = os.environ.get(_ASKED_FOR)
    places = [Path(asked_for).absolute()] if asked_for else []
    places.append(SOURCES / "__pycache__")
    with contextlib.suppress(RuntimeError):  # nobody's home is known
        caches = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        places.append(Path(caches) / "footfall")
    return [*places, _temporary()]


def _temporary() -> Path:
    owner = f"-{os.getuid()}" if hasattr(os, "getuid") else ""
    return Path(tempfile.gettempdir()) / f"footfall{owner}"


def _is_private(folder: Path) -> bool:
    """Whether nobody else can put anything into this folder, which is made if it is missing.

    Compiled code from a folder that others write to would be theirs.
    """
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return False
    if not hasattr(os, "getuid"):
        return True
    return stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o022


def _is_writable(folder: Path) -> bool:
    """Whether files can be written to this folder, which is made if it is missing."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


def _not_writable(places: list[Path]) -> str:
    return f"cannot write to {', '.join(map(str, places))}; {_ASKED_FOR} may name another folder"


def _warn(message: str) -> None:
    # The processes that this one starts find the same; it is said once.
    if multiprocessing.parent_process() is None:
        warnings.warn(message, UserWarning, stacklevel=3)


def _remove_stale(folder: Path) -> None:
    """Removes caches of other states beside this one that nothing was written to for a day.

    Another process may be removing the same, or still run the sources of one: that compiles anew.
    """
    for other in folder.parent.glob(f"{_PREFIX}*"):
        try:
            newest_s = max(path.stat().st_mtime for path in (other, *other.rglob("*")))
        except OSError:
            continue
        if other != folder and time.time() - newest_s > _STALE_S:
            shutil.rmtree(other, ignore_errors=True)
