"""A band below a picture that says what it shows: a title and what the colours mean."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]
Colour = tuple[int, int, int]

INK: Colour = (54, 48, 45)
PAPER: Colour = (255, 255, 255)
_PALE, _OUTLINE = 230, (170, 170, 170)  # what is paler than this shows on paper by its outline
LEAST_WIDTH_PX = 640
LINE_HEIGHT_PX = 26


@dataclass(frozen=True, kw_only=True)
class Swatch:
    """One entry of the legend; filled or as an outline. Colours are blue, green, red."""

    colour: Colour
    text: str
    filled: bool = True


def with_legend(picture: Picture, title: str, legend: Sequence[Swatch]) -> Picture:
    """The picture (H, W, 3) with title and legend below; narrow ones get paper to the right."""
    width_px = max(LEAST_WIDTH_PX, picture.shape[1])
    lines = textwrap.wrap(title, width_px // 10)
    rows = _rows(legend, width_px)
    height_px = picture.shape[0]
    band_px = (len(lines) + len(rows)) * LINE_HEIGHT_PX + 12
    whole = np.full((height_px + band_px, width_px, 3), PAPER, np.uint8)
    whole[:height_px, : picture.shape[1]] = picture
    for number, line in enumerate(lines):
        _write(whole, line, 12, height_px + (number + 1) * LINE_HEIGHT_PX - 4)
    for number, row in enumerate(rows, start=len(lines)):
        for left_px, swatch in row:
            _draw_swatch(whole, swatch, left_px, height_px + number * LINE_HEIGHT_PX + 7)
    return whole


def _rows(legend: Sequence[Swatch], width_px: int) -> list[list[tuple[int, Swatch]]]:
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
    if swatch.filled and min(swatch.colour) > _PALE:
        cv2.rectangle(picture, *corners, _OUTLINE, 1, cv2.LINE_AA)
    _write(picture, swatch.text, left_px + 30, top_px + 12)


def _write(picture: Picture, text: str, left_px: int, base_px: int) -> None:
    place = (left_px, base_px)
    cv2.putText(picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, INK, 1, cv2.LINE_AA)
