"""The animation at the top of the README: a film of `navigate --video`, quicker and smaller.

    python -m docs.make.animation --out docs/images/walk.webp

walks through maps/room.png, films and converts; `--film walk.mp4` converts a film that is there
already. Needs a GL library, as films do.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import av
import cv2
import numpy as np
from PIL import Image

from app.output import replacing

ROOT = Path(__file__).resolve().parents[2]


def main() -> None:
    """Films a walk if there is no film yet, and writes the animation."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="such as docs/images/walk.webp")
    parser.add_argument("--film", type=Path, help="such as walk.mp4; none: one is made")
    parser.add_argument("--map", default="maps/room.png")
    parser.add_argument("--goal", default="2,1,1.57")
    parser.add_argument("--speed", type=float, default=2.0, help="times real time")
    parser.add_argument("--frames-per-s", type=float, default=12.0)
    parser.add_argument("--width", type=int, default=480, help="pixels")
    parser.add_argument("--quality", type=int, default=60, help="0 to 100")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        film = options.film or filmed(Path(folder), options.map, options.goal)
        step_s = options.speed / options.frames_per_s
        pictures = [
            Image.fromarray(smaller(picture, options.width)) for picture in frames(film, step_s)
        ]
    write(options.out, pictures, 1000 / options.frames_per_s, options.quality)
    kilobytes = options.out.stat().st_size / 1000
    print(f"{options.out}: {len(pictures)} frames of {pictures[0].size}, {kilobytes:.0f} kB")


def filmed(folder: Path, map_file: str, goal: str) -> Path:
    """A film of the walk, by the command of everybody."""
    film = folder / "walk.mp4"
    words = [sys.executable, "main.py", "navigate", "--map", map_file, "--goal", goal]
    words += ["--out", str(folder), "--video", str(film)]
    subprocess.run(words, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
    return film


def frames(film: Path, step_s: float) -> Iterator[np.ndarray]:
    """Every picture (height, width, 3), red green blue, that is this much later than the last."""
    due_s = 0.0
    with av.open(str(film)) as container:
        for frame in container.decode(video=0):
            if frame.time is not None and frame.time >= due_s - 1e-6:
                due_s += step_s
                yield frame.to_ndarray(format="rgb24")


def smaller(picture: np.ndarray, width: int) -> np.ndarray:
    """The picture at this width, its proportions kept."""
    height = round(picture.shape[0] * width / picture.shape[1])
    return cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)


def write(path: Path, pictures: list[Image.Image], frame_ms: float, quality: int) -> None:
    """Writes an animation that begins anew when it is over; the last picture stays for a second."""
    shown_ms = [round(frame_ms)] * (len(pictures) - 1) + [1000]
    with replacing(path) as temporary:
        pictures[0].save(
            temporary,
            format="WEBP",
            save_all=True,
            append_images=pictures[1:],
            duration=shown_ms,
            loop=0,
            quality=quality,
            method=4,
        )


if __name__ == "__main__":
    main()
