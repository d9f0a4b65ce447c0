"""A robot dressed for pictures is the same robot to the physics."""

from __future__ import annotations

import numpy as np
import pytest

from sim.robot import VISUAL_GROUP
from sim.robots import get_robot, robot_names
from sim.scene import build_scene


@pytest.mark.parametrize("name", robot_names())
def test_looks_change_nothing_in_the_physics(name):
    robot = get_robot(name)
    plain = build_scene(robot, timestep_s=0.001)
    dressed = build_scene(robot, timestep_s=0.001, visuals=True)
    for field in ("body_mass", "body_inertia", "body_ipos", "body_iquat", "body_pos", "body_quat"):
        np.testing.assert_array_equal(getattr(plain.model, field), getattr(dressed.model, field))
    np.testing.assert_array_equal(plain.standing_qpos, dressed.standing_qpos)
    added = np.flatnonzero(dressed.model.geom_group == VISUAL_GROUP)
    assert dressed.model.ngeom == plain.model.ngeom + len(added)
    assert not dressed.model.geom_contype[added].any()
    assert not dressed.model.geom_conaffinity[added].any()
    assert dressed.model.ntex == 2


def test_jvrc1_wears_all_its_parts_where_its_shapes_are():
    scene = build_scene(get_robot("jvrc1"), timestep_s=0.001, visuals=True)
    assert scene.model.nmesh == 35
    assert (scene.model.geom_group == VISUAL_GROUP).sum() == 35
    # The mesh of each foot reaches down to the sole: vertices in the world, standing.
    import mujoco

    data = mujoco.MjData(scene.model)
    data.qpos[:] = scene.standing_qpos
    mujoco.mj_kinematics(scene.model, data)
    for prefix, side in (("L", "left"), ("R", "right")):
        mesh = next(
            index
            for index in range(scene.model.nmesh)
            if scene.model.mesh(index).name.startswith(f"{prefix}_ANKLE_P_S")
        )
        geom = int(np.flatnonzero(scene.model.geom_dataid == mesh)[0])
        first, count = scene.model.mesh_vertadr[mesh], scene.model.mesh_vertnum[mesh]
        local = scene.model.mesh_vert[first : first + count]
        world = local @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        assert abs(world[:, 2].min()) < 0.005
        sole = data.site(f"{side}_sole").xpos
        assert np.all(np.abs(world[:, :2].mean(axis=0) - sole[:2]) < 0.06)
