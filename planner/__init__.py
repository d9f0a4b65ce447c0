"""Footsteps over occupancy grids; see `planner.planner`.

Importing the package says where numba keeps what it compiles of it.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import time
from pathlib import Path

_PREFIX = "numba-"
_STALE_S = 24 * 3600.0


def use_cache_of_this_code() -> None:
    """Gives every state of the sources a cache of its own, unless the user has named one.

    numba looks only at the file of the function that it is asked for. It would go on using what it
    compiled from an older version of another file that the function calls. Must run before numba is
    imported.
    """
    folder = Path(__file__).parent
    digest = hashlib.sha256()
    for source in sorted(folder.rglob("*.py")):
        digest.update(source.read_bytes())
    cache = folder / "__pycache__" / f"{_PREFIX}{digest.hexdigest()[:12]}"
    if os.access(folder, os.W_OK) and "NUMBA_CACHE_DIR" not in os.environ:
        os.environ["NUMBA_CACHE_DIR"] = str(cache)
        if not cache.is_dir():
            cache.mkdir(parents=True, exist_ok=True)
            _remove_stale(cache)


def _remove_stale(cache: Path) -> None:
    """Removes caches of other states beside this one that nothing was written to for a day.

    Another process may be removing the same, or still run the sources of one: that compiles anew.
    """
    for other in cache.parent.glob(f"{_PREFIX}*"):
        try:
            newest_s = max(path.stat().st_mtime for path in (other, *other.rglob("*")))
        except OSError:
            continue
        if other != cache and time.time() - newest_s > _STALE_S:
            shutil.rmtree(other, ignore_errors=True)


use_cache_of_this_code()
