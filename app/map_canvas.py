"""A map as a picture to draw on in metres: polygons, lines, arrows, and a legend below."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from maps.grid import Cell, OccupancyGrid

FloatArray = NDArray[np.float64]
Picture = NDArray[np.uint8]
Colour = tuple[int, int, int]

INK: Colour = (45, 48, 54)
PAPER: Colour = (255, 255, 255)
FREE: Colour = (247, 247, 244)
UNKNOWN: Colour = (205, 208, 213)
OCCUPIED: Colour = (74, 79, 88)

LEAST_LONG_SIDE_PX, MOST_LONG_SIDE_PX = 1280, 3000
LONG_SIDE_PX_PER_M = 60.0
MOST_PX_PER_M = 400.0
LEAST_WIDTH_PX = 640
LINE_HEIGHT_PX = 26
# OpenCV takes positions in fractions of a pixel as whole numbers of 1/16.
_SHIFT = 4
_FAR_PX = 30_000.0


@dataclass(frozen=True, kw_only=True)
class Swatch:
    """One entry of the legend; filled or as an outline."""

    colour: Colour
    text: str
    filled: bool = True


class MapCanvas:
    """The map drawn with its own x to the right and y upward; everything else is put on it.

    Positions are in metres of the world; what lies outside the picture is cut off. Colours are
    red, green, blue from 0 to 255.
    """

    def __init__(self, grid: OccupancyGrid) -> None:
        self._grid = grid
        width_m, height_m = grid.size_m
        long_m = max(width_m, height_m)
        long_px = np.clip(LONG_SIDE_PX_PER_M * long_m, LEAST_LONG_SIDE_PX, MOST_LONG_SIDE_PX)
        self.px_per_m = float(min(long_px / long_m, MOST_PX_PER_M))
        self._picture = self._map_picture()

    def _map_picture(self) -> Picture:
        colours = np.empty((3, 3), np.uint8)
        colours[[Cell.FREE, Cell.OCCUPIED, Cell.UNKNOWN]] = FREE, OCCUPIED, UNKNOWN
        cells = colours[self._grid.cells[::-1]]
        width_m, height_m = self._grid.size_m
        size = (
            max(1, round(width_m * self.px_per_m)),
            max(1, round(height_m * self.px_per_m)),
        )
        smaller = size[0] < cells.shape[1]
        how = cv2.INTER_AREA if smaller else cv2.INTER_NEAREST
        return np.asarray(cv2.resize(cells, size, interpolation=how), np.uint8)

    def fill(
        self, polygons_world: Sequence[ArrayLike], colour: Colour, *, alpha: float = 1.0
    ) -> None:
        """Fills polygons (n, 2), see-through by 1 - alpha."""
        if not polygons_world:
            return
        over = self._picture.copy()
        for polygon in polygons_world:
            cv2.fillPoly(over, [self._fixed(polygon)], colour, cv2.LINE_AA, _SHIFT)
        cv2.addWeighted(over, alpha, self._picture, 1 - alpha, 0.0, self._picture)

    def outline(self, polygons_world: Sequence[ArrayLike], colour: Colour, width_px: int) -> None:
        """Draws the borders of polygons (n, 2)."""
        points = [self._fixed(polygon) for polygon in polygons_world]
        cv2.polylines(self._picture, points, True, colour, width_px, cv2.LINE_AA, _SHIFT)

    def line(self, points_world: ArrayLike, colour: Colour, width_px: int) -> None:
        """Draws a line through points (n, 2)."""
        points = [self._fixed(points_world)]
        cv2.polylines(self._picture, points, False, colour, width_px, cv2.LINE_AA, _SHIFT)

    def arrow(self, pose_world: ArrayLike, length_m: float, colour: Colour, width_px: int) -> None:
        """Draws a ring at a pose x_m, y_m, yaw_rad with an arrow that points along its heading."""
        x_m, y_m, yaw_rad = np.asarray(pose_world, dtype=float)
        along = np.array([np.cos(yaw_rad), np.sin(yaw_rad)])
        across = np.array([-along[1], along[0]])
        place = np.array([x_m, y_m])
        tip = place + length_m * along
        barbs = [tip - length_m * (0.3 * along - side * 0.2 * across) for side in (-1, 1)]
        self.line([place + 0.35 * length_m * along, tip], colour, width_px)
        self.line([barbs[0], tip, barbs[1]], colour, width_px)
        turn = np.linspace(0.0, 2 * np.pi, 33)[:, None]
        ring = place + 0.35 * length_m * (np.cos(turn) * along + np.sin(turn) * across)
        self.line(ring, colour, width_px)

    def finished(self, title: str, legend: Sequence[Swatch]) -> Picture:
        """The picture (H, W, 3) with title and legend below the map."""
        width_px = max(LEAST_WIDTH_PX, self._picture.shape[1])
        lines = textwrap.wrap(title, width_px // 10) or [""]
        rows = _legend_rows(legend, width_px)
        band = np.full(((len(lines) + len(rows)) * LINE_HEIGHT_PX + 12, width_px, 3), PAPER)
        below = np.ascontiguousarray(band, np.uint8)
        for number, line in enumerate(lines):
            _write(below, line, 12, (number + 1) * LINE_HEIGHT_PX - 4)
        for number, row in enumerate(rows, start=len(lines)):
            for left_px, swatch in row:
                _draw_swatch(below, swatch, left_px, number * LINE_HEIGHT_PX + 7)
        map_part = np.full((self._picture.shape[0], width_px, 3), PAPER, np.uint8)
        map_part[:, : self._picture.shape[1]] = self._picture
        return np.vstack([map_part, below])

    def _fixed(self, points_world: ArrayLike) -> NDArray[np.int32]:
        """Points (n, 2) in OpenCV's fixed-point pixels, what is far away brought near."""
        x_m, y_m = np.moveaxis(self._grid.world_to_grid(points_world), -1, 0)
        column = x_m * self.px_per_m - 0.5
        row = self._picture.shape[0] - y_m * self.px_per_m - 0.5
        pixels = np.clip(np.stack([column, row], axis=-1), -_FAR_PX, _FAR_PX)
        return np.asarray(np.rint(pixels * (1 << _SHIFT)), np.int32)


def _legend_rows(legend: Sequence[Swatch], width_px: int) -> list[list[tuple[int, Swatch]]]:
    """The entries in rows that fit the width, each with where it begins."""
    rows: list[list[tuple[int, Swatch]]] = [[]]
    left_px = 12
    for swatch in legend:
        needed_px = 50 + 9 * len(swatch.text)
        if rows[-1] and left_px + needed_px > width_px:
            rows.append([])
            left_px = 12
        rows[-1].append((left_px, swatch))
        left_px += needed_px
    return rows


def _draw_swatch(picture: Picture, swatch: Swatch, left_px: int, top_px: int) -> None:
    corners = (left_px, top_px), (left_px + 22, top_px + 11)
    cv2.rectangle(picture, *corners, swatch.colour, -1 if swatch.filled else 2, cv2.LINE_AA)
    _write(picture, swatch.text, left_px + 30, top_px + 12)


def _write(picture: Picture, text: str, left_px: int, base_px: int) -> None:
    place = (left_px, base_px)
    cv2.putText(picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, INK, 1, cv2.LINE_AA)
