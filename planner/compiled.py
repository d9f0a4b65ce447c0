"""Where numba keeps what it compiled of this package."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path


def use_cache_of_this_code() -> None:
    """Gives every state of the sources a cache of its own, unless the user has named one.

    numba looks only at the file of the function that it is asked for. It would go on using what it
    compiled from an older version of another file that the function calls. Must run before numba is
    imported.
    """
    folder = Path(__file__).parent
    digest = hashlib.sha256()
    for source in sorted(folder.glob("*.py")):
        digest.update(source.read_bytes())
    cache = folder / "__pycache__" / f"numba-{digest.hexdigest()[:12]}"
    if os.access(folder, os.W_OK):
        os.environ.setdefault("NUMBA_CACHE_DIR", str(cache))
