"""Films of a recorded walk: H.264 in an MP4 file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import av
import numpy as np

from app.output import replacing
from app.pictures.footmarks import Footmarks
from app.pictures.rendering import FOLLOW, Recording, View, drawing
from app.progress import ProgressBar

if TYPE_CHECKING:
    import mujoco


def write_film(
    path: Path,
    model: mujoco.MjModel,
    recording: Recording,
    *,
    view: View = FOLLOW,
    frames_per_s: int = 20,
    width: int = 640,
    height: int = 480,
    fine: bool = False,
    marks: Footmarks | None = None,
) -> int:
    """Writes the walk as a film that runs at the speed of the walk; returns the count of frames.

    Width and height are even numbers: H.264 takes no others. `fine` and `marks` are as in
    `drawing`.

    Raises:
        NoGlError: No GL library works here.
        InputError: The file cannot be written.
    """
    first_s, last_s = recording.time_s[[0, -1]]
    count = int((last_s - first_s) * frames_per_s) + 1
    moments = recording.nearest(first_s + np.arange(count) / frames_per_s)
    with (
        drawing(
            model, recording, view, width=width, height=height, fine=fine, marks=marks
        ) as drawer,
        replacing(path) as temporary,
        ProgressBar("film", count) as bar,
        av.open(str(temporary), "w", format="mp4") as film,
    ):
        stream = film.add_stream("libx264", rate=frames_per_s)
        stream.width, stream.height = width, height
        stream.pix_fmt = "yuv420p"
        stream.options = {"preset": "veryfast", "crf": "22"}
        for number, moment in enumerate(moments):
            frame = av.VideoFrame.from_ndarray(drawer.draw(int(moment)), format="rgb24")
            film.mux(stream.encode(frame))
            bar.update(number + 1)
        film.mux(stream.encode())
    return count
