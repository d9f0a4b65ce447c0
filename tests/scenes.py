"""A robot, its policy and a hall to walk in."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from controller.policy import load_policy
from maps.grid import OccupancyGrid
from sim.robots import get_robot
from sim.simulation import Simulation
from sim.terrain import Ground

ROBOT = get_robot("jvrc1")
POLICY = load_policy(ROBOT)
# An empty hall of 8 by 6 m, with the start near its left end.
HALL = OccupancyGrid(cells=np.zeros((120, 160), np.uint8), resolution_m=0.05, origin=(-2, -3, 0))
WAIT_LIMIT_S = 300.0
FREE_FALL_M = 0.049  # in the 0.1 s of `sunk_on_treads`
T = TypeVar("T")


def wait_until(wanted: Callable[[], T], what: str = "") -> T:
    """What `wanted` returns as soon as that is true; fails after long."""
    until_s = time.monotonic() + WAIT_LIMIT_S
    while not (found := wanted()):
        assert time.monotonic() < until_s, f"waited {WAIT_LIMIT_S} s in vain {what}"
        time.sleep(0.01)
    return found


def sunk_on_treads(sim: Simulation) -> np.ndarray:
    """How far each of three standing robots sinks in 0.1 s, (3,).

    Under the first are treads 0.3 m above a floor that lies 1 m down, under the second the floor,
    under the third nothing for 1 m.
    """
    scene = sim.scene
    feet = scene.soles_at(scene.standing_qpos)
    lifted = scene.standing_qpos.copy()
    lifted[2] += 0.3
    sim.qpos[0] = lifted
    under = np.column_stack([feet[:, 0], feet[:, 1], [0.3, 0.3], [0.0, 0.0]])
    sim.place_ground(0, Ground(floor_z_m=-1.0, treads=under))
    sim.place_ground(2, Ground(floor_z_m=-1.0))
    before = sim.qpos[:, 2].copy()
    for _ in range(4):
        sim.step(np.tile(scene.robot.half_sitting_rad, (3, 1)))
    return before - sim.qpos[:, 2]
