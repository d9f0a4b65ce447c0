"""How high the ground under a swinging foot is taken to be, between two heights."""

from __future__ import annotations

import numpy as np


def lift_reference_m(sole: np.ndarray, start: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Height (n,) above which a swinging foot is to be lifted, from poses (n, 4) in the world.

    Going up it grows from the start's height to the target's over the first half of the
    horizontal way, since the toe passes the edges ahead of the foot's middle; going down it falls
    over the second half, since the heel clears them late.
    """
    way = target[:, :2] - start[:, :2]
    length_2 = np.maximum(np.sum(way**2, axis=1), 1e-6)
    done = np.clip(np.sum((sole[:, :2] - start[:, :2]) * way, axis=1) / length_2, 0.0, 1.0)
    change = target[:, 2] - start[:, 2]
    share = np.where(change > 0, np.minimum(2 * done, 1.0), np.maximum(2 * done - 1.0, 0.0))
    return np.asarray(start[:, 2] + share * change)
