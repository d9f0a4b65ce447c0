"""A robot, its policy and a hall to walk in."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from controller.policy import load_policy
from maps.grid import OccupancyGrid
from sim.robots import get_robot

ROBOT = get_robot("jvrc1")
POLICY = load_policy(ROBOT)
# An empty hall of 8 by 6 m, with the start near its left end.
HALL = OccupancyGrid(cells=np.zeros((120, 160), np.uint8), resolution_m=0.05, origin=(-2, -3, 0))
WAIT_LIMIT_S = 300.0
T = TypeVar("T")


def wait_until(wanted: Callable[[], T], what: str = "") -> T:
    """What `wanted` returns as soon as that is true; fails after long."""
    until_s = time.monotonic() + WAIT_LIMIT_S
    while not (found := wanted()):
        assert time.monotonic() < until_s, f"waited {WAIT_LIMIT_S} s in vain {what}"
        time.sleep(0.01)
    return found
