"""Writing of a map as an image and the YAML of the ROS map server beside it."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from maps.grid import Cell, OccupancyGrid

# Grey of each cell state, and thresholds that part them without doubt.
_GREY = {Cell.FREE: 254, Cell.OCCUPIED: 0, Cell.UNKNOWN: 205}


def write_map(image: Path, grid: OccupancyGrid) -> None:
    """Writes a PNG and its YAML, which `load_map` reads back as the same cells and numbers.

    Raises OSError where they cannot be written.
    """
    grey = np.zeros(max(_GREY) + 1, np.uint8)
    for cell, value in _GREY.items():
        grey[cell] = value
    if not cv2.imwrite(str(image), grey[grid.cells[::-1]]):
        raise OSError(f"map {image}: cannot be written")
    x_m, y_m, yaw_rad = (repr(float(v)) for v in grid.origin)
    lines = (
        f"image: {image.name}",
        f"resolution: {float(grid.resolution_m)!r}",
        f"origin: [{x_m}, {y_m}, {yaw_rad}]",
        "negate: 0",
        "occupied_thresh: 0.65",
        "free_thresh: 0.1",
    )
    image.with_suffix(".yaml").write_text("\n".join(lines) + "\n", encoding="utf-8")
