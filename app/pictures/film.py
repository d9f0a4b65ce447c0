"""A recorded walk as a film (MP4) and as a strip of moments (PNG)."""

from __future__ import annotations

import contextlib
import importlib.util
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from app.output import InputError, ProgressBar, replacing, say, write_picture
from app.pictures.canvas import INK, LEFT, RIGHT, Picture
from app.pictures.rendering import (
    FOLLOW,
    SIDE,
    Footmark,
    Recording,
    View,
    drawing,
    resampled,
    shade,
)

if TYPE_CHECKING:
    import mujoco


FRAMES_PER_S = 30
WIDTH, HEIGHT = 1280, 720
# Smaller films than this have no room for words.
_LEAST_HEIGHT = 240


def write_film(
    path: Path,
    model: mujoco.MjModel,
    recording: Recording,
    *,
    title: str = "",
    width: int = WIDTH,
    height: int = HEIGHT,
    frames_per_s: int = FRAMES_PER_S,
    marks: Sequence[Footmark] = (),
) -> int:
    """Writes the walk as a film that runs at the speed of the walk; returns the count of frames.

    It carries title, time and legend. Width and height are even numbers: H.264 takes no others.
    `marks` are as in `drawing`. Where the extra `film` is missing the film is in VP9, and a line
    says so.

    Raises:
        NoGlError: No GL library works here.
        InputError: The file cannot be written.
    """
    first_s, last_s = recording.time_s[[0, -1]]
    count = int((last_s - first_s) * frames_per_s) + 1
    shown = resampled(recording, first_s + np.arange(count) / frames_per_s)
    with (
        drawing(model, shown, FOLLOW, width=width, height=height, marks=marks) as drawer,
        replacing(path) as temporary,
        ProgressBar("film", count) as bar,
        encoder(temporary, width, height, frames_per_s) as add,
    ):
        for number, time_s in enumerate(shown.time_s):
            add(captioned(drawer.draw(number), title, f"{time_s:.1f} s"))
            bar.update(number + 1)
    return count


def encoder(
    path: Path, width: int, height: int, frames_per_s: int
) -> contextlib.AbstractContextManager[Callable[[Picture], object]]:
    """Gives what adds a picture (H, W, 3), red green blue, to a film, which is whole on leaving.

    H.264 plays everywhere and comes with PyAV, 0.1 GB, which few need. OpenCV is there anyway and
    has VP9, which browsers play and some other players do not, and which takes some 0.1 s a frame.
    """
    if importlib.util.find_spec("av") is not None:
        return _h264(path, width, height, frames_per_s)
    say(
        "the film is in VP9, for browsers; the extra `film` is for H.264, which plays everywhere: "
        "python -m pip install -e '.[film]'"
    )
    return _vp9(path, width, height, frames_per_s)


@contextlib.contextmanager
def _h264(
    path: Path, width: int, height: int, frames_per_s: int
) -> Iterator[Callable[[Picture], object]]:
    import av

    with av.open(str(path), "w", format="mp4") as film:
        stream = film.add_stream("libx264", rate=frames_per_s)
        stream.width, stream.height = width, height
        stream.pix_fmt = "yuv420p"
        stream.options = {"preset": "veryfast", "crf": "22"}
        yield lambda picture: film.mux(
            stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24"))
        )
        film.mux(stream.encode())


@contextlib.contextmanager
def _vp9(
    path: Path, width: int, height: int, frames_per_s: int
) -> Iterator[Callable[[Picture], object]]:
    codec = cv2.VideoWriter.fourcc(*"vp09")
    film = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, codec, frames_per_s, (width, height))
    if not film.isOpened():
        raise InputError(
            "this OpenCV writes no films; the extra `film` does: python -m pip install -e '.[film]'"
        )
    try:
        yield lambda picture: film.write(np.ascontiguousarray(picture[:, :, ::-1]))
    finally:
        film.release()


def captioned(picture: Picture, title: str, time: str) -> Picture:
    """The picture (H, W, 3), red green blue, with title and time above and the legend below.

    What does not fit is left out; pictures of few rows stay as they are.
    """
    height, width = picture.shape[:2]
    if height < _LEAST_HEIGHT:
        return picture
    picture = picture.copy()
    font, size = cv2.FONT_HERSHEY_SIMPLEX, max(0.4, 0.6 * height / HEIGHT)
    text_h = cv2.getTextSize("Xy", font, size, 1)[0][1]
    band = 2 * text_h + 4
    for rows in (slice(0, band), slice(height - band, height)):
        picture[rows] = picture[rows] // 4 + np.uint8(191)
    base = band // 2 + text_h // 2

    def write(text: str, left: int, row: int) -> int:
        """Writes a text and gives the column where it ends."""
        cv2.putText(picture, text, (left, row), font, size, INK[::-1], 1, cv2.LINE_AA)
        return left + int(cv2.getTextSize(text, font, size, 1)[0][0])

    time_at = width - int(cv2.getTextSize(time, font, size, 1)[0][0]) - band // 2
    write(time, time_at, base)
    if band + int(cv2.getTextSize(title, font, size, 1)[0][0]) < time_at:
        write(title, band // 2, base)
    left, row = band // 2, height - band + base
    for text, colour, is_pale in _LEGEND:
        ends = left + text_h + 8 + int(cv2.getTextSize(text, font, size, 1)[0][0])
        if ends > width:
            break
        ink = shade(colour, is_pale=is_pale)[::-1]
        cv2.rectangle(picture, (left, row - text_h), (left + text_h, row), ink, -1)
        left = write(text, left + text_h + 8, row) + band
    return picture


# Text, colour in blue, green, red, and whether it is pale.
_LEGEND = (
    ("left foot as placed", LEFT, False),
    ("right foot as placed", RIGHT, False),
    ("left as planned", LEFT, True),
    ("right as planned", RIGHT, True),
)


def write_strip(
    path: Path,
    model: mujoco.MjModel,
    recording: Recording,
    *,
    frames: int = 8,
    start_s: float | None = None,
    end_s: float | None = None,
    columns: int | None = None,
    view: View = SIDE,
    width: int = 280,
    height: int = 420,
    marks: Sequence[Footmark] = (),
) -> None:
    """Writes `frames` moments, evenly spread from start_s to end_s, each with its time.

    Without start or end it is the whole walk. With `columns` the strip is broken into rows.
    The footprints `marks` lie on the floor.

    Raises:
        NoGlError: No GL library works here.
        InputError: The file cannot be written.
    """
    if frames < 1:
        raise ValueError(f"frames {frames} must be at least 1")
    first_s = recording.time_s[0] if start_s is None else start_s
    last_s = recording.time_s[-1] if end_s is None else end_s
    times_s = np.linspace(first_s, last_s, frames)
    moments = recording.nearest(times_s).tolist()
    size = {"width": width, "height": height}
    with drawing(model, recording, view, fine=True, marks=marks, moments=moments, **size) as drawer:
        tiles = [np.ascontiguousarray(drawer.draw(k)) for k in moments]
    font, ink = cv2.FONT_HERSHEY_SIMPLEX, INK[::-1]
    for picture, time_s in zip(tiles, times_s, strict=True):
        cv2.putText(picture, f"{time_s:.2f} s", (8, 20), font, 0.5, ink, 1, cv2.LINE_AA)
    write_picture(path, tile(tiles, columns or frames)[:, :, ::-1])


def tile(pictures: list[Picture], columns: int) -> Picture:
    """The pictures, all of one size, in rows of so many; what is left of the last row is white."""
    blank = np.full_like(pictures[0], 255)
    pictures = pictures + [blank] * (-len(pictures) % columns)
    rows = [np.hstack(pictures[at : at + columns]) for at in range(0, len(pictures), columns)]
    return np.vstack(rows)
