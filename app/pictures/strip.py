"""Picture strips: moments of a recorded walk side by side in one PNG."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from app.output import write_picture
from app.pictures.footmarks import Footmarks
from app.pictures.rendering import SIDE, Picture, Recording, View, drawing

if TYPE_CHECKING:
    import mujoco

INK = (40, 40, 40)


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
    marks: Footmarks | None = None,
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
        tiles = [
            _labelled(drawer.draw(int(moment)), f"{time_s:.2f} s")
            for moment, time_s in zip(recording.nearest(times_s), times_s, strict=True)
        ]
    write_picture(path, tile(tiles, columns or frames)[:, :, ::-1])


def tile(pictures: list[Picture], columns: int) -> Picture:
    """The pictures, all of one size, in rows of so many; what is left of the last row is white."""
    blank = np.full_like(pictures[0], 255)
    pictures = pictures + [blank] * (-len(pictures) % columns)
    rows = [np.hstack(pictures[at : at + columns]) for at in range(0, len(pictures), columns)]
    return np.vstack(rows)


def _labelled(picture: Picture, text: str) -> Picture:
    labelled = np.ascontiguousarray(picture)
    cv2.putText(labelled, text, (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, INK, 1, cv2.LINE_AA)
    return labelled
