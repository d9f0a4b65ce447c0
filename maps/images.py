"""Image files of maps: read with OpenCV, once it is known how much there is to unpack."""

from __future__ import annotations

import contextlib
import io
import math
import os
import re
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from maps.files import read_limited

# A map of so many cells takes 100 MB for them alone. 500 m x 500 m at 5 cm a pixel.
MOST_PIXELS = 100_000_000
MOST_BYTES = 4 * MOST_PIXELS
# Columns, rows and white of a binary PGM or PPM, up to its first byte of pixels.
_PNM = re.compile(rb"P[56]" + 3 * rb"(?:\s+#[^\n]*)*\s+(\d{1,9})" + rb"\s")


class ImageError(ValueError):
    """An image that cannot be read; the message is one line that names the file."""


def read_image(file: Path) -> NDArray[np.generic]:
    """Picture (H, W) or (H, W, channels BGR or BGRA), uint8 or uint16. Raises ImageError.

    White is the type's largest value: binary PGM files name their own white.
    """
    image, data = _decode(file)
    header = _PNM.match(data) if data.startswith(b"P5") else None
    full = np.iinfo(image.dtype).max
    white = int(header[3]) if header else full
    if white in (0, full):
        return image
    return np.rint(np.minimum(image, white) * (full / white)).astype(image.dtype)


def read_grey_values(file: Path) -> NDArray[Any]:
    """Grey values (H, W) as they are in the file, uint8 or uint16. Raises ImageError."""
    return grey_and_opaque(_decode(file)[0])[0]


def grey_and_opaque(image: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.bool_] | None]:
    """Luminance (H, W) in the image's own range, and which pixels are fully opaque; None: all."""
    opaque = None
    channels = 1 if image.ndim == 2 else image.shape[2]
    if channels in (2, 4):
        opaque = image[..., -1] == np.iinfo(image.dtype).max
    if channels >= 3:
        grey = cv2.cvtColor(np.ascontiguousarray(image[..., :3]), cv2.COLOR_BGR2GRAY)
    else:
        grey = image.reshape(*image.shape[:2], -1)[..., 0]
    return grey, opaque


def _decode(file: Path) -> tuple[NDArray[Any], bytes]:
    """Picture as it is in a file, uint8 or uint16, and the file's bytes. Raises ImageError."""
    try:
        data = read_limited(file, MOST_BYTES)
    except FileNotFoundError:
        raise ImageError(f"map image {file}: no such file") from None
    except OSError as error:
        raise ImageError(f"map image {file}: cannot be read ({error.strerror})") from None
    if data.startswith(b"\x89PNG") and b"IEND\xaeB`\x82" not in data[-64:]:
        raise ImageError(f"map image {file}: the PNG is cut off; copy the file again")
    if data.startswith(b"\xff\xd8") and b"\xff\xd9" not in data[-64:]:
        raise ImageError(f"map image {file}: the JPEG is cut off; copy the file again")
    pixels = _announced_pixels(data)
    if pixels > MOST_PIXELS:
        side = math.isqrt(MOST_PIXELS)
        raise ImageError(
            f"map image {file}: too many pixels; at most {MOST_PIXELS}, such as {side} x {side}, "
            "are read: cut the map, or make its pixels coarser"
        )
    if len(data) < _announced_bytes(data):
        kind = "PGM" if data.startswith(b"P") else "BMP"
        raise ImageError(f"map image {file}: the {kind} is cut off; copy the file again")
    image = None
    if pixels:
        with contextlib.suppress(cv2.error), _silent_libraries():
            image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None or image.dtype not in (np.uint8, np.uint16):
        raise ImageError(f"map image {file}: not an image that can be read (PNG, PGM, BMP, JPEG)")
    return image, data


def _announced_pixels(data: bytes) -> float:
    """How many pixels a picture has by its own header; 0 where that is none.

    OpenCV would take the memory for them first, up to 2**30 pixels.
    """
    if data.startswith(b"\x89PNG"):
        return int.from_bytes(data[16:20], "big") * int.from_bytes(data[20:24], "big")
    if header := _PNM.match(data):
        return int(header[1]) * int(header[2])
    # Here and not above: the usual formats need not wait for it.
    from PIL import Image

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of large pictures
        try:
            cols, rows = Image.open(io.BytesIO(data)).size
        except Image.DecompressionBombError:
            return math.inf
        except Exception:  # its readers raise whatever damaged bytes make them meet
            return 0
    return cols * rows


def _announced_bytes(data: bytes) -> int:
    """How long a binary PGM or PPM, or a BMP, is by its own header; 0 for others."""
    if data.startswith(b"BM"):
        return int.from_bytes(data[2:6], "little")
    if header := _PNM.match(data):
        cols, rows, white = map(int, header.groups())
        samples = cols * rows * (3 if data.startswith(b"P6") else 1)
        return header.end() + samples * (2 if white > 255 else 1)
    return 0


@contextlib.contextmanager
def _silent_libraries() -> Iterator[None]:
    """Keeps out of standard error what the image libraries write there by themselves."""
    sys.stderr.flush()
    try:
        kept = os.dup(2)
    except OSError:  # it is closed
        yield
        return
    try:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
