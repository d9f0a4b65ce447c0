"""Files that are written whole or not at all, and JSON that strangers wrote."""

from __future__ import annotations

import contextlib
import json
import os
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any


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
        with temporary.open("rb") as file:
            os.fsync(file.fileno())  # a name must not outlive a power cut that the data did not
        os.replace(temporary, path)
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def from_json(text: str | bytes) -> Any:
    """The document that JSON text holds; bytes are read as UTF-8.

    Raises:
        ValueError: It is no JSON, or is nested too deep to be read.
    """
    try:
        return json.loads(text if isinstance(text, str) else text.decode("utf-8"))
    except RecursionError:
        raise ValueError("nested too deep") from None
