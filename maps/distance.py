"""Distance field: how far each cell's centre is from the nearest blocked ground."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

_FAR_CELLS = 1000  # as far as squares of the transform are good to less than a half


def distance_field(blocked: NDArray[np.bool_], resolution_m: float) -> NDArray[np.float32]:
    """Lower bound (H, W) in metres on the distance from each cell's centre to blocked ground.

    Everything outside the map counts as blocked. Blocked cells are 0. The nearest point of a
    blocked cell is at most half a cell's diagonal nearer than its centre, and never nearer than
    half a cell; so the value never exceeds the true distance to the blocked squares. The same map
    has the same field to the bit.
    """
    rows, cols = blocked.shape
    free = np.zeros((rows + 2, cols + 2), np.uint8)
    free[1:-1, 1:-1] = ~blocked
    # Distances between centres, in cells. The last bits of OpenCV's exact transform differ from one
    # call to the next; the squares are whole numbers, so to round them makes it exact.
    near = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    cells = np.sqrt(np.rint(np.square(np.minimum(near, np.float32(_FAR_CELLS)))))
    nearest = np.maximum(cells - np.float32(np.sqrt(0.5) + 1e-4), np.float32(0.5))
    metres = np.where(blocked, np.float32(0.0), nearest * np.float32(resolution_m))
    result: NDArray[np.float32] = np.ascontiguousarray(metres.astype(np.float32))
    return result
