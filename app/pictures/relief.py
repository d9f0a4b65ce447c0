"""How pictures show the height of the floor: darker is higher, with a line along every edge."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from maps.grid import Cell, OccupancyGrid

Image = NDArray[np.uint8]
FloatArray = NDArray[np.float64]
Colour = tuple[int, int, int]

# Blue, green, red.
_LOWEST, _HIGHEST, _EDGE = (250, 250, 250), (172, 204, 222), (140, 166, 182)
_EDGE_M = 0.02  # a rise of more than this from cell to cell gets a line


def height_range(grid: OccupancyGrid) -> tuple[float, float]:
    """Lowest and highest free floor of a map in metres."""
    if grid.elevation_m is None:
        return 0.0, 0.0
    heights = grid.elevation_m[grid.cells == Cell.FREE]
    return (float(heights.min()), float(heights.max())) if heights.size else (0.0, 0.0)


def height_colour(height_m: float, extremes_m: tuple[float, float]) -> Colour:
    """The colour of floor at a height on a map whose floor is within these extremes."""
    blue, green, red = (int(v) for v in _shades(np.array([height_m]), extremes_m)[0])
    return blue, green, red


def _shades(heights_m: FloatArray, extremes_m: tuple[float, float]) -> Image:
    """Colours (..., 3) of floor at heights (...)."""
    low_m, high_m = extremes_m
    share = np.clip((heights_m - low_m) / max(high_m - low_m, 1e-9), 0, 1)[..., None]
    return np.rint((1 - share) * _LOWEST + share * np.array(_HIGHEST)).astype(np.uint8)


def shade_floor(
    image: Image,
    elevation_m: FloatArray,
    free: NDArray[np.bool_],
    extremes_m: tuple[float, float],
) -> None:
    """Colours the free floor of a picture (h, w, 3) by the heights of its cells (H, W).

    Both have their first row at the top.
    """
    size = image.shape[1], image.shape[0]
    shown = cv2.resize(free.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    heights = cv2.resize(elevation_m, size, interpolation=cv2.INTER_NEAREST).astype(np.float64)
    image[shown] = _shades(heights, extremes_m)[shown]
    for axis in (0, 1):
        edge = np.zeros(shown.shape, bool)
        inner = (slice(None),) * axis + (slice(1, None),)
        outer = (slice(None),) * axis + (slice(None, -1),)
        steep = np.abs(np.diff(heights, axis=axis)) > _EDGE_M
        edge[inner] = steep & shown[inner] & shown[outer]
        if image.shape[0] > 2 * len(free):
            # One pixel is hard to see where a cell has several.
            edge |= np.roll(edge, 1, axis=axis)
        image[edge & shown] = _EDGE
