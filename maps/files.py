"""Files that are written whole or not at all."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Gives a temporary path beside this one; at the end its file takes this one's place.

    Nobody reads half a file. If the block raises, the temporary file goes and `path` stays as it
    was. Through a link it is the file behind it that is replaced. The temporary path has the same
    ending, from which writers of pictures take the format.

    Raises:
        OSError: The file cannot be written.
    """
    path = path.resolve()
    writer = f"{os.getpid()}-{threading.get_ident()}"
    temporary = path.with_name(f".{path.stem}-{writer}{path.suffix}")
    try:
        temporary.touch()  # what cannot be written is told before the work
        yield temporary
        os.replace(temporary, path)
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
