"""A recorded walk as a film (H.264 in an MP4 file) and as a strip of moments (PNG)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import av
import cv2
import numpy as np

from app.output import ProgressBar, replacing, write_picture
from app.pictures.canvas import INK, Picture
from app.pictures.rendering import FOLLOW, SIDE, Footmark, Recording, View, drawing

if TYPE_CHECKING:
    import mujoco


FRAMES_PER_S = 20


def write_film(
    path: Path,
    model: mujoco.MjModel,
    recording: Recording,
    *,
    width: int = 640,
    height: int = 480,
    marks: Sequence[Footmark] = (),
) -> int:
    """Writes the walk as a film that runs at the speed of the walk; returns the count of frames.

    Width and height are even numbers: H.264 takes no others. `marks` are as in `drawing`.

    Raises:
        NoGlError: No GL library works here.
        InputError: The file cannot be written.
    """
    first_s, last_s = recording.time_s[[0, -1]]
    count = int((last_s - first_s) * FRAMES_PER_S) + 1
    moments = recording.nearest(first_s + np.arange(count) / FRAMES_PER_S)
    with (
        drawing(model, recording, FOLLOW, width=width, height=height, marks=marks) as drawer,
        replacing(path) as temporary,
        ProgressBar("film", count) as bar,
        av.open(str(temporary), "w", format="mp4") as film,
    ):
        stream = film.add_stream("libx264", rate=FRAMES_PER_S)
        stream.width, stream.height = width, height
        stream.pix_fmt = "yuv420p"
        stream.options = {"preset": "veryfast", "crf": "22"}
        for number, moment in enumerate(moments):
            frame = av.VideoFrame.from_ndarray(drawer.draw(int(moment)), format="rgb24")
            film.mux(stream.encode(frame))
            bar.update(number + 1)
        film.mux(stream.encode())
    return count


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
    with drawing(
        model, recording, view, width=width, height=height, fine=True, marks=marks
    ) as drawer:
        tiles = [np.ascontiguousarray(drawer.draw(int(k))) for k in recording.nearest(times_s)]
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
