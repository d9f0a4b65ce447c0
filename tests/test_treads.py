"""Ground that differs from simulation to simulation, and is parked again when one is reset."""

from __future__ import annotations

import numpy as np
import pytest

from controller.gait import CONTROL_PERIOD_S
from sim.batch import SimBatch
from sim.robots import get_robot
from sim.scene import build_scene
from sim.terrain import BLOCK_HEIGHT_M, LANDINGS, PARKED_Z_M, TREADS, Ground

POSE = np.array([[0.3, -0.2, 0.5, 1.0]])


@pytest.fixture(scope="module")
def sim():
    scene = build_scene(get_robot("jvrc1"), timestep_s=0.005, treads=True)
    return SimBatch(scene, count=3, control_period_s=CONTROL_PERIOD_S)


def restart(sim, rows):
    sim.reset(np.array(rows), np.tile(sim.scene.standing_qpos, (len(rows), 1)))


def placed(sim):
    """Which mocap bodies (B, n) are not parked; the floor, the first of them, never is."""
    return sim.ground_pose[0][:, :, 2] > PARKED_Z_M + 1


def test_each_simulation_has_its_own_ground_until_it_is_reset(sim):
    restart(sim, [0, 1, 2])
    assert placed(sim).sum(axis=1).tolist() == [1, 1, 1]
    sim.place_ground(0, Ground(floor_z_m=-0.4, treads=POSE))
    sim.place_ground(2, Ground(treads=np.repeat(POSE, 2, axis=0), landings=POSE))
    sim.step(np.tile(sim.scene.robot.half_sitting_rad, (3, 1)))
    assert placed(sim).sum(axis=1).tolist() == [2, 1, 4]
    position, quaternion = sim.ground_pose
    assert position[:, 0, 2].tolist() == [-0.4, 0, 0]
    # The pose is that of the upper face; turned by 1 rad about z.
    tread = np.flatnonzero(placed(sim)[0])[1]
    assert position[0, tread] == pytest.approx([0.3, -0.2, 0.5 - BLOCK_HEIGHT_M / 2])
    assert quaternion[0, tread] == pytest.approx([np.cos(0.5), 0, 0, np.sin(0.5)])
    restart(sim, [0])
    assert placed(sim).sum(axis=1).tolist() == [1, 1, 4]
    assert sim.ground_pose[0][0, 0, 2] == 0


def test_robots_stand_on_treads_and_fall_where_the_floor_is_lower(sim):
    """Free fall for 0.1 s is 4.9 cm; the treads are 0.3 m up, the floor 1 m down."""
    restart(sim, [0, 1, 2])
    feet = sim.scene.soles_at(sim.scene.standing_qpos)
    lifted = sim.scene.standing_qpos.copy()
    lifted[2] += 0.3
    sim.qpos[0] = lifted
    under = np.column_stack([feet[:, 0], feet[:, 1], [0.3, 0.3], [0.0, 0.0]])
    sim.place_ground(0, Ground(floor_z_m=-1.0, treads=under))
    sim.place_ground(2, Ground(floor_z_m=-1.0))
    before = sim.qpos[:, 2].copy()
    for _ in range(4):
        sim.step(np.tile(sim.scene.robot.half_sitting_rad, (3, 1)))
    sunk = before - sim.qpos[:, 2]
    assert sunk[0] == pytest.approx(sunk[1], abs=1e-3)
    assert abs(sunk[1]) < 0.015
    assert sunk[2] == pytest.approx(0.049, abs=0.004)


def test_more_ground_than_the_scene_has_is_refused(sim):
    restart(sim, [0])
    for ground in (
        Ground(treads=np.repeat(POSE, TREADS + 1, axis=0)),
        Ground(landings=np.repeat(POSE, LANDINGS + 1, axis=0)),
    ):
        with pytest.raises(ValueError, match=f"at most {TREADS} and {LANDINGS}"):
            sim.place_ground(0, ground)
    assert placed(sim)[0].sum() == 1


def test_scene_without_treads_has_no_ground_to_place():
    scene = build_scene(get_robot("jvrc1"), timestep_s=0.005)
    plain = SimBatch(scene, count=1, control_period_s=CONTROL_PERIOD_S)
    assert plain.ground_pose is None
    with pytest.raises(ValueError, match="without treads"):
        plain.place_ground(0, Ground())
