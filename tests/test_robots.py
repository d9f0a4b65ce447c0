"""Laws of the robot models and of the batched simulation; every robot in the registry runs them."""

from __future__ import annotations

import itertools
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from maps.boxes import Terraces
from sim.batch import SimBatch
from sim.robot import PHYSICS_GROUP
from sim.robots import get_robot, robot_names
from sim.scene import WALL_HEIGHT_M, Scene, build_scene, min_clearance_m
from sim.sensors import SIDES
from sim.terrain import BLOCK_HEIGHT_M, LANDINGS, PARKED_Z_M, TREADS, Ground
from tests.scenes import mirrored_qpos, mirrored_qvel, posture_over, reach_m, standing

CONTROL_PERIOD_S = 0.025


@pytest.fixture(scope="module", params=robot_names())
def scene(request) -> Scene:
    return build_scene(get_robot(request.param), timestep_s=0.001)


def test_unknown_robot_is_named_with_those_there_are():
    with pytest.raises(ValueError, match=r"no robot 'r2d2': choose one of .*jvrc1"):
        get_robot("r2d2")


def test_mass_and_joints_are_those_the_robot_states(scene):
    assert scene.model.body_mass.sum() == pytest.approx(scene.robot.mass_kg, abs=0.05)
    assert scene.model.nv == 6 + len(scene.robot.joints)
    assert scene.model.nu == len(scene.robot.joints)


def test_half_sitting_stands_flat_and_at_its_height(scene):
    soles = scene.soles_at(scene.standing_qpos)
    assert soles[:, 2] == pytest.approx(0.0, abs=2e-4)
    assert soles.mean(axis=0)[:2] == pytest.approx(0.0, abs=1e-9)
    assert soles[0, 1] == pytest.approx(-soles[1, 1])
    assert scene.standing_qpos[2] == pytest.approx(scene.robot.pelvis_height_m, abs=2e-3)
    data = standing(scene)
    for side in ("left", "right"):
        up = data.site(f"{side}_sole").xmat.reshape(3, 3)[:, 2]
        assert up == pytest.approx([0, 0, 1], abs=2e-3)


def test_half_sitting_lies_within_the_joint_ranges(scene):
    for joint in scene.robot.joints:
        low, high = scene.model.joint(joint.name).range
        assert low < joint.half_sitting_rad < high


def test_nothing_touches_in_half_sitting_but_the_soles_the_floor(scene):
    data = standing(scene, sunk_m=0.001)
    names = {
        frozenset(scene.model.geom(geom).name for geom in contact.geom) for contact in data.contact
    }
    assert names == {frozenset({"floor", f"{side}_foot"}) for side in ("left", "right")}


def test_planner_foot_is_the_sole_box_and_the_site_its_centre(scene):
    foot = scene.robot.step_model.foot
    for side in ("left", "right"):
        geom, site = scene.model.geom(f"{side}_foot"), scene.model.site(f"{side}_sole")
        assert 2 * geom.size[:2] == pytest.approx([foot.length_m, foot.width_m])
        assert site.pos[:2] == pytest.approx(geom.pos[:2])
        assert site.pos[2] == pytest.approx(geom.pos[2] - geom.size[2])


def test_planner_body_box_holds_the_upper_body(scene):
    """In half-sitting every collision shape but legs and feet lies inside the box."""
    data = standing(scene)
    body = scene.robot.step_model.body
    looked_at = 0
    for geom in range(scene.model.ngeom):
        if scene.model.geom_contype[geom] or not scene.model.geom_conaffinity[geom]:
            continue
        reach = np.abs(data.geom_xpos[geom]) + reach_m(scene, data, geom)
        assert reach[0] <= body.length_m / 2 + 1e-6, scene.model.geom(geom).name
        assert reach[1] <= body.width_m / 2 + 1e-6, scene.model.geom(geom).name
        looked_at += 1
    assert looked_at >= 3


def test_mirroring_twice_is_the_identity(scene):
    rng = np.random.default_rng(1)
    qpos, qvel = rng.normal(size=scene.model.nq), rng.normal(size=scene.model.nv)
    assert not np.allclose(mirrored_qpos(scene, qpos), qpos)
    assert mirrored_qpos(scene, mirrored_qpos(scene, qpos)) == pytest.approx(qpos)
    assert mirrored_qvel(scene, mirrored_qvel(scene, qvel)) == pytest.approx(qvel)


def test_the_mirrored_robot_moves_as_the_mirror_image(scene):
    """Off the ground, where no contact solver breaks the symmetry: the model itself is mirrored."""
    robot, rng = scene.robot, np.random.default_rng(2)
    index, sign = robot.mirror_joints
    qpos = scene.standing_qpos.copy()
    qpos[2] += 0.5
    qvel = 0.3 * rng.normal(size=scene.model.nv)
    targets = robot.half_sitting_rad + 0.2 * rng.normal(size=len(robot.joints))
    sim = SimBatch(scene, count=2, control_period_s=CONTROL_PERIOD_S)
    sim.reset(
        np.arange(2),
        np.stack([qpos, mirrored_qpos(scene, qpos)]),
        np.stack([qvel, mirrored_qvel(scene, qvel)]),
    )
    for _ in range(4):
        sim.step(np.stack([targets, sign * targets[index]]))
    # The URDF's own inertias differ between left and right in the sixth digit.
    assert sim.qpos[1] == pytest.approx(mirrored_qpos(scene, sim.qpos[0]), abs=1e-4)
    assert not np.allclose(sim.qpos[0], sim.qpos[1], atol=1e-2)


def test_sensors_agree_with_what_mujoco_computes(scene):
    """Ground force against the sum over contacts, the rest against sites and bodies."""
    model, sensors = scene.model, scene.sensors
    data = mujoco.MjData(model)
    data.qpos[:] = scene.standing_qpos
    data.ctrl[:] = scene.robot.half_sitting_rad
    for _ in range(60):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    read = data.sensordata
    for k, side in enumerate(("left", "right")):
        site = data.site(f"{side}_sole")
        assert read[sensors.sole_pos_world[k]] == pytest.approx(site.xpos)
        assert read[sensors.sole_x_axis_world[k]] == pytest.approx(site.xmat[[0, 3, 6]])
        assert read[sensors.sole_z_axis_world[k]] == pytest.approx(site.xmat[[2, 5, 8]])
        total = np.zeros(3)
        for c, contact in enumerate(data.contact):
            if model.geom(f"{side}_foot").id in contact.geom:
                wrench = np.zeros(6)
                mujoco.mj_contactForce(model, data, c, wrench)
                towards = 1 if contact.geom[1] == model.geom(f"{side}_foot").id else -1
                total += towards * contact.frame.reshape(3, 3).T @ wrench[:3]
        assert total[2] > 100
        assert read[sensors.ground_force_world[k]] == pytest.approx(total)
    assert read[sensors.head_pos_world] == pytest.approx(data.site("head").xpos)
    assert read[sensors.joint_torque] == pytest.approx(data.actuator_force)
    assert read[sensors.legs_touching] == 0
    assert read[sensors.wall_contacts] == 0


def test_servo_torque_is_the_pd_law_clipped_at_the_limit(scene):
    robot, data = scene.robot, standing(scene)
    data.qvel[scene.joint_qvel] = 0.5
    data.ctrl[:] = robot.half_sitting_rad + 0.1
    mujoco.mj_forward(scene.model, data)
    expected = [j.kp * 0.1 - j.kd * 0.5 for j in robot.joints]
    assert data.actuator_force == pytest.approx(expected)
    data.ctrl[:] = robot.half_sitting_rad + 1e3
    mujoco.mj_forward(scene.model, data)
    assert data.actuator_force == pytest.approx([j.torque_limit_nm for j in robot.joints])


def test_legs_that_cross_are_felt(scene):
    data = standing(scene)
    half = len(scene.robot.joints) // 2
    rolls = 0
    for k, joint in enumerate(scene.robot.joints):
        forward = data.xaxis[scene.model.joint(joint.name).id][0]
        if abs(forward) > 0.8:
            side = 1 if k < half else -1
            data.qpos[scene.joint_qpos[k]] -= 0.3 * side * np.sign(forward)  # both feet inwards
            rolls += 1
    assert rolls >= 2, "hips roll, and ankles if they can"
    mujoco.mj_forward(scene.model, data)
    assert data.sensordata[scene.sensors.legs_touching] > 0


@pytest.mark.parametrize(("gap_m", "touches"), [(0.02, False), (-0.02, True)])
@pytest.mark.parametrize("name", robot_names())
def test_a_wall_is_felt_and_its_distance_measured(name, gap_m, touches):
    robot = get_robot(name)
    reach = _widest(build_scene(robot, timestep_s=0.001))
    assert reach <= robot.step_model.body.width_m / 2
    wall_y = reach + gap_m + 0.05
    # The wall's own frame is turned and shifted, as a map's may be.
    wall = np.array([[wall_y, 0.0, 0.05, 2.0, 0.0]])
    terraces = Terraces(walls=wall, origin=(0.0, 0.0, np.pi / 2))
    scene = build_scene(robot, timestep_s=0.001, terraces=terraces)
    data = standing(scene)
    assert (data.sensordata[scene.sensors.wall_contacts[0]] > 0) == touches
    measured = min_clearance_m(scene, scene.standing_qpos[None])
    assert measured == pytest.approx(gap_m, abs=2e-3)


def _widest(scene: Scene) -> float:
    """Largest y of any collision shape whose widest point is below the walls' height."""
    data = standing(scene)
    robot = scene.model.geom_conaffinity > 0
    return max(
        data.geom_xpos[geom, 1] + reach_m(scene, data, int(geom))[1]
        for geom in np.flatnonzero(robot)
        if data.geom_xpos[geom, 2] < WALL_HEIGHT_M
    )


def test_clearance_is_unknown_without_walls(scene):
    assert min_clearance_m(scene, scene.standing_qpos[None]) is None


def test_batch_equals_a_loop_over_mj_step_for_any_thread_count(scene):
    rng = np.random.default_rng(3)
    targets = scene.robot.half_sitting_rad + 0.1 * rng.normal(size=(5, 3, scene.model.nu))
    ends = []
    for threads in (1, 2):
        sim = SimBatch(scene, count=3, control_period_s=CONTROL_PERIOD_S, threads=threads)
        for row in targets:
            sim.step(row)
        ends.append(np.concatenate([sim.qpos, sim.qvel], axis=1).copy())
    assert np.array_equal(ends[0], ends[1])
    for k in range(3):
        data = mujoco.MjData(scene.model)
        data.qpos[:] = scene.standing_qpos
        for row in targets:
            data.ctrl[:] = row[k]
            for _ in range(25):
                mujoco.mj_step(scene.model, data)
        assert np.array_equal(ends[0][k], np.concatenate([data.qpos, data.qvel]))


def test_one_broken_simulation_is_told_and_harms_no_other(scene):
    sim = SimBatch(scene, count=3, control_period_s=CONTROL_PERIOD_S)
    whole = SimBatch(scene, count=3, control_period_s=CONTROL_PERIOD_S)
    targets = np.tile(scene.robot.half_sitting_rad, (3, 1))
    sim.qvel[1] = np.nan
    sim.step(targets)
    whole.step(targets)
    assert sim.failed.tolist() == [False, True, False]
    assert np.array_equal(sim.qpos[[0, 2]], whole.qpos[[0, 2]])
    sim.reset(np.array([1]), scene.standing_qpos[None])
    sim.step(targets)
    assert not sim.failed.any()
    assert np.isfinite(sim.qpos).all()


def test_control_period_must_be_whole_physics_steps(scene):
    with pytest.raises(ValueError, match="not a whole number of physics steps"):
        SimBatch(scene, count=1, control_period_s=0.0255)


def test_qpos_at_puts_the_feet_around_the_pose(scene):
    pose = np.array([1.5, -2.0, 2.5])
    soles = scene.soles_at(scene.qpos_at(pose))
    assert soles.mean(axis=0)[:2] == pytest.approx(pose[:2], abs=1e-9)
    assert soles[:, 3] == pytest.approx(2.5, abs=1e-6)
    left = soles[0, :2] - pose[:2]
    assert left @ [-np.sin(2.5), np.cos(2.5)] > 0.05


# What every robot must keep besides.

# By how much the legs must stay off their joints' ends in every step that is planned.
SPARE_RAD = np.radians(2.0)


def joint_ranges(scene: Scene) -> np.ndarray:
    return np.array([scene.model.joint(joint.name).range for joint in scene.robot.joints])


def test_height_is_the_one_the_robot_states(scene):
    data = mujoco.MjData(scene.model)
    data.qpos[:7] = [0, 0, 0, 1, 0, 0, 0]
    mujoco.mj_kinematics(scene.model, data)
    shapes = np.flatnonzero(
        (scene.model.geom_group == PHYSICS_GROUP) & (scene.model.geom_bodyid > 0)
    )
    top = max(data.geom_xpos[geom, 2] + reach_m(scene, data, int(geom))[2] for geom in shapes)
    assert top - data.site("left_sole").xpos[2] == pytest.approx(scene.robot.height_m, abs=0.02)


def test_every_joint_is_limited_and_the_two_legs_are_mirror_images(scene):
    joints, ranges = scene.robot.joints, joint_ranges(scene)
    half = len(joints) // 2
    assert all(scene.model.joint(joint.name).limited for joint in joints)
    assert (ranges[:, 0] < ranges[:, 1]).all()
    for left, right, of_left, of_right in zip(
        joints[:half], joints[half:], ranges[:half], ranges[half:], strict=True
    ):
        mirrored = of_left if left.mirror_sign > 0 else -of_left[::-1]
        assert of_right == pytest.approx(mirrored, abs=1e-6), right.name
        for field in ("kp", "kd", "torque_limit_nm", "speed_limit_rad_s", "armature_kg_m2"):
            assert getattr(left, field) == getattr(right, field) > 0
        assert right.half_sitting_rad == left.mirror_sign * left.half_sitting_rad


def test_joints_of_a_leg_lie_in_its_own_body(scene):
    half = len(scene.robot.joints) // 2
    for k, joint in enumerate(scene.robot.joints):
        body = int(scene.model.joint(joint.name).bodyid[0])
        while scene.model.body(body).name not in ("left_leg", "right_leg"):
            assert body > 0, f"{joint.name} is in no leg"
            body = int(scene.model.body_parentid[body])
        assert scene.model.body(body).name == f"{SIDES[k // half]}_leg"


def planned_steps(scene: Scene) -> list[tuple[float, float, float]]:
    """The step set and the corners of the limits."""
    model = scene.robot.step_model
    corners = itertools.product(model.limits.x_m, model.limits.y_m, model.limits.yaw_rad)
    within = [corner for corner in corners if model.limits.contain(corner)]
    vertices = ((*at, yaw) for at in model.limits.reach_m for yaw in model.limits.yaw_rad)
    within += [vertex for vertex in vertices if model.limits.contain(vertex)]
    return [*model.steps, *within]


@pytest.mark.parametrize("swing", [0, 1])
def test_legs_reach_every_step_within_their_joints_ranges(scene, swing):
    ranges, steps = joint_ranges(scene), planned_steps(scene)
    for step in steps:
        x, y, yaw = step
        feet = np.zeros((2, 4))
        outward = 1 - 2 * swing
        feet[swing] = [x, outward * y, 0, outward * yaw]
        data = posture_over(scene, feet)
        angles = data.qpos[scene.joint_qpos]
        spare = np.minimum(angles - ranges[:, 0], ranges[:, 1] - angles)
        worst = int(spare.argmin())
        assert spare[worst] >= SPARE_RAD, f"{step}: {scene.robot.joints[worst].name}"
        assert data.sensordata[scene.sensors.legs_touching] == 0, f"{step}: the legs touch"
    assert len(steps) > 8


def test_reach_has_an_end():
    """The check would fail for steps that are too long, or too far across."""
    scene = build_scene(get_robot("jvrc1"), timestep_s=0.001)
    with pytest.raises(AssertionError, match="no posture"):
        posture_over(scene, np.array([[1.5, 0.1, 0, 0], [0, -0.1, 0, 0]]))
    data = posture_over(scene, np.array([[0, 0.02, 0, 0], [0, -0.02, 0, 0]]))
    assert data.sensordata[scene.sensors.legs_touching] > 0


def test_robot_whose_package_is_missing_is_left_out_and_says_what_to_install(monkeypatch):
    robot = replace(get_robot("jvrc1"), needs=("no_such_module_at_all", "some_extra"))
    monkeypatch.setattr("sim.robots.jvrc1.ROBOT", robot)
    assert "jvrc1" not in robot_names()
    assert "hrp5p" in robot_names()
    with pytest.raises(
        ValueError, match=r"'jvrc1' needs .* python -m pip .*\[some_extra\]"
    ) as told:
        get_robot("jvrc1")
    assert "\n" not in str(told.value)


# Treads and floor per simulation, parked again at a reset.

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
