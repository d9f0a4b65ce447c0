"""Writing files so that a reader never meets half of one."""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.errors import InputError

PICTURE_ENDINGS = (".png", ".jpg", ".jpeg", ".bmp")


def require_writable(path: Path, *, option: str, endings: Sequence[str] = ()) -> None:
    """Checks now, before the work, that the file can be written later.

    Raises:
        InputError: The folder is missing or not writable, the path is a folder itself, or it has
            none of the endings, if any are given.
    """
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
    except OSError as error:
        raise InputError(f"{option}: cannot make the folder {path}: {error.strerror}") from error
    if not os.access(path, os.W_OK):
        raise InputError(f"{option}: the folder {path} is not writable")


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Gives a temporary name of the same ending; on leaving, that file becomes `path`.

    If the block raises, the temporary file goes and `path` stays as it was.

    Raises:
        InputError: The file cannot be written.
    """
    temporary = None
    # Through a link it is the file behind it that is replaced, not the link.
    path = path.resolve()
    try:
        # The ending stays: image and film writers take the format from it.
        handle, name = tempfile.mkstemp(
            prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent
        )
        temporary = Path(name)
        os.close(handle)
        yield temporary
        temporary.chmod(0o666 & ~_umask())
        os.replace(temporary, path)
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


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


def _umask() -> int:
    """The mask that new files get; the only way to read it is to set it."""
    mask = os.umask(0)
    os.umask(mask)
    return mask
