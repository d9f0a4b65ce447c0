"""Draws the project's own maps: `python -m maps.make_maps` writes them beside this file.

Furniture is listed in metres of the map frame, so a wall is where its numbers say.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

Box = tuple[float, float, float, float]
Disc = tuple[float, float, float]
HEIGHT_PER_GREY_M = 0.0025


@dataclass(frozen=True, kw_only=True)
class FloorPlan:
    """Boxes (x0, y0, x1, y1) and discs (x, y, radius) that stand on a floor, in metres.

    bounds: x0, y0, x1, y1 of the picture, along which run outer walls of outline_m. treads: boxes
    and the height of the floor in each; of two that overlap the later counts, elsewhere it is 0.
    """

    name: str
    bounds: Box
    resolution_m: float
    furniture: tuple[Box, ...]
    walls: tuple[Box, ...] = ()
    outline_m: float = 0.1
    discs: tuple[Disc, ...] = ()
    treads: tuple[tuple[Box, float], ...] = ()


ROOM = FloorPlan(
    name="room",
    bounds=(-2.0, -2.5, 6.0, 3.5),
    resolution_m=0.025,
    furniture=(
        # Two bookcases divide the room; the 0.9 m between them is the short way at the top.
        (0.85, -0.7, 1.2, 2.0),
        (0.85, 2.9, 1.2, 3.4),
        (-1.9, 1.3, -0.95, 3.3),  # bed
        (-1.9, -2.2, -1.3, -0.95),  # desk
        (-1.2, -1.8, -0.8, -1.4),  # its chair
        (1.9, -2.4, 3.7, -1.6),  # sofa
        (3.0, -0.25, 4.2, 1.15),  # dining table and three chairs
        (3.4, 1.25, 3.8, 1.6),
        (4.3, 0.0, 4.55, 0.35),
        (4.3, 0.6, 4.55, 0.95),
        (5.4, -0.9, 5.9, 1.3),  # cupboard, 0.85 m from the chairs
        (2.3, 2.85, 3.9, 3.4),  # sideboard
        (4.9, -2.4, 5.9, -1.75),  # chest
    ),
    discs=((5.4, 2.9, 0.28), (0.3, -2.05, 0.2)),
)

OFFICE = FloorPlan(
    name="office",
    bounds=(-2.0, -6.0, 14.0, 6.0),
    resolution_m=0.05,
    outline_m=0.15,
    walls=(
        # North side of the corridor (y 1.0), doors 1.0 m wide at x -0.2, 4.4 and 9.8.
        (-2.0, 1.0, -0.2, 1.15),
        (0.8, 1.0, 4.4, 1.15),
        (5.4, 1.0, 9.8, 1.15),
        (10.8, 1.0, 14.0, 1.15),
        # South side (y -1.0), doors at x 2.0 (0.95 m) and 8.0; the hall in the east is open.
        (-2.0, -1.15, 2.0, -1.0),
        (2.95, -1.15, 8.0, -1.0),
        (9.0, -1.15, 10.5, -1.0),
        # Between the northern rooms, with one door through to the middle room.
        (2.6, 1.0, 2.75, 3.4),
        (2.6, 4.35, 2.75, 6.0),
        (7.6, 1.0, 7.75, 6.0),
        # Between the southern rooms.
        (5.0, -6.0, 5.15, -3.2),
        (5.0, -2.2, 5.15, -1.0),
        (10.35, -6.0, 10.5, -4.4),
        (10.35, -3.4, 10.5, -1.0),
    ),
    furniture=(
        (-1.85, 2.2, -1.1, 3.8),  # north-west: desk, chair, shelf
        (-1.0, 2.8, -0.55, 3.25),
        (-0.6, 5.4, 2.0, 5.85),
        (4.2, 3.0, 6.2, 4.2),  # north: meeting table with chairs
        (4.4, 4.35, 4.8, 4.75),
        (5.5, 4.35, 5.9, 4.75),
        (4.4, 2.4, 4.8, 2.8),
        (5.5, 2.4, 5.9, 2.8),
        (7.75, 4.9, 9.6, 5.85),  # north-east: two desks, two shelves
        (12.4, 4.9, 13.85, 5.85),
        (9.4, 2.3, 11.0, 3.1),
        (13.4, 1.4, 13.85, 3.4),
        (-1.85, -5.85, -0.4, -5.2),  # south-west: cupboards and a table
        (-1.85, -3.6, -1.3, -1.8),
        (0.9, -4.4, 2.5, -3.3),
        (3.9, -5.85, 4.9, -5.3),
        (6.3, -3.4, 7.9, -2.6),  # south: desks back to back
        (6.3, -4.6, 7.9, -4.1),
        (9.6, -5.85, 10.35, -4.9),
        (12.9, -2.8, 13.85, -0.4),  # hall: counter, bench, pillar
        (11.2, -5.85, 13.0, -5.4),
        (11.7, -3.6, 12.1, -3.2),
        (3.4, 0.75, 4.1, 1.0),  # cabinets in the corridor
        (6.6, -1.0, 7.4, -0.75),
    ),
    discs=((11.6, 0.5, 0.2), (2.2, 1.5, 0.22), (7.2, 1.6, 0.25), (-1.5, -0.6, 0.2)),
)


STAIRS = FloorPlan(
    name="stairs",
    bounds=(-2.0, -2.5, 10.0, 2.5),
    resolution_m=0.025,
    # Two rooms, and between them nothing but the stairs, 2.4 m wide.
    furniture=((2.0, -2.4, 6.2, -1.2), (2.0, 1.2, 6.2, 2.4)),
    # Six steps of 10 cm up, run 0.30 m, a landing of 1.2 m, and six down. Walls stand on the
    # treads, so the picture of heights says so there as well.
    treads=tuple(
        ((2.0 + 0.3 * i, -2.5, 6.2 - 0.3 * i, 2.5), round(0.1 * (i + 1), 1)) for i in range(6)
    ),
)

SILLS = FloorPlan(
    name="sills",
    bounds=(-2.0, -2.0, 7.0, 3.0),
    resolution_m=0.025,
    walls=(
        # Three rooms, with doors of 1.3 m at y -0.5 and 1.0.
        (1.5, -2.0, 1.6, -0.5),
        (1.5, 0.8, 1.6, 3.0),
        (4.5, -2.0, 4.6, 1.0),
        (4.5, 2.3, 4.6, 3.0),
    ),
    furniture=((-1.9, 1.9, -0.6, 2.9), (2.6, -1.9, 3.6, -1.2), (6.2, -1.9, 6.9, -0.8)),
    # A sill in either door and a cable duct between them, all 5 cm wide and 5 cm high.
    treads=(
        ((1.525, -0.5, 1.575, 0.8), 0.05),
        ((4.525, 1.0, 4.575, 2.3), 0.05),
        ((3.0, -2.0, 3.05, 3.0), 0.05),
    ),
)


def draw(plan: FloorPlan) -> NDArray[np.uint8]:
    """Picture of a floor plan: white floor, black obstacles; row 0 is the top."""
    (x0, y0, x1, y1), t = plan.bounds, plan.outline_m
    cols, rows = round((x1 - x0) / plan.resolution_m), round((y1 - y0) / plan.resolution_m)
    image = np.full((rows, cols), 254, np.uint8)
    outer = (x0, y0, x1, y0 + t), (x0, y1 - t, x1, y1), (x0, y0, x0 + t, y1), (x1 - t, y0, x1, y1)
    for box in (*outer, *plan.walls, *plan.furniture):
        _fill(image, plan, box, 0)
    x_m = x0 + (np.arange(cols) + 0.5) * plan.resolution_m
    y_m = y1 - (np.arange(rows) + 0.5) * plan.resolution_m
    for x, y, radius in plan.discs:
        image[np.hypot(x_m[None, :] - x, y_m[:, None] - y) <= radius] = 0
    return image


def draw_heights(plan: FloorPlan) -> NDArray[np.uint8]:
    """Picture of the heights of a floor plan, HEIGHT_PER_GREY_M metres per grey value."""
    image = np.zeros_like(draw(plan))
    for box, height_m in plan.treads:
        _fill(image, plan, box, round(height_m / HEIGHT_PER_GREY_M))
    return image


def _fill(image: NDArray[np.uint8], plan: FloorPlan, box: Box, value: int) -> None:
    x0, _, _, y1 = plan.bounds
    left, right = (round((x - x0) / plan.resolution_m) for x in (box[0], box[2]))
    top, bottom = (round((y1 - y) / plan.resolution_m) for y in (box[3], box[1]))
    image[top:bottom, left:right] = value


def write(plan: FloorPlan, folder: Path) -> None:
    """Writes NAME.png and NAME.yaml of a floor plan, and NAME_height.png if it has treads."""
    smallest = [cv2.IMWRITE_PNG_COMPRESSION, 9]
    cv2.imwrite(str(folder / f"{plan.name}.png"), draw(plan), smallest)
    heights = ""
    if plan.treads:
        cv2.imwrite(str(folder / f"{plan.name}_height.png"), draw_heights(plan), smallest)
        heights = f"elevation: {plan.name}_height.png\nelevation_scale: {HEIGHT_PER_GREY_M}\n"
    (folder / f"{plan.name}.yaml").write_text(
        f"image: {plan.name}.png\n"
        f"resolution: {plan.resolution_m}\n"
        f"origin: [{plan.bounds[0]}, {plan.bounds[1]}, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\nmode: trinary\n" + heights,
        encoding="utf-8",
    )


if __name__ == "__main__":
    for floor_plan in (ROOM, OFFICE, STAIRS, SILLS):
        write(floor_plan, Path(__file__).parent)
