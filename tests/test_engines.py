"""Drake and MuJoCo simulate the same robots in the same scenes; each holds the other."""

from __future__ import annotations

import sys
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from app.engines import EngineOptions, load_engine
from app.evaluation.parts import EvaluationSetup, Part, ResultCache
from app.output import InputError
from controller.assessment import assess_mode, at_navigation_rate
from controller.evaluation.rollouts import chained, start_walks, walk
from controller.gait import CONTROL_PERIOD_S
from controller.policy import load_policy
from maps.boxes import Terraces
from sim.drake.contact_model import ContactModel, EngineError
from sim.engines import MUJOCO, DrakeEngine
from sim.robots import get_robot, robot_names
from sim.scene import Scene, build_scene
from tests.programs import ROOM, refusal
from tests.scenes import FREE_FALL_M, sunk_on_treads

pytest.importorskip("pydrake", reason="it comes with the extra `drake`")

from sim.drake.batch import StateLayout
from sim.drake.plant import plant_of, require_known

DRAKE = DrakeEngine()
AIR_S, STANDING_S = 0.2, 0.4


@pytest.fixture(scope="module", params=robot_names())
def scene(request) -> Scene:
    scene = build_scene(get_robot(request.param), timestep_s=0.001)
    try:
        require_known(scene.model)
    except EngineError as error:
        pytest.skip(str(error))
    return scene


def both(scene, **settings):
    """The same simulation in MuJoCo and in Drake."""
    settings = {"count": 1, "control_period_s": CONTROL_PERIOD_S, **settings}
    return [engine.simulate(scene, **settings) for engine in (MUJOCO, DRAKE)]


def turned(scene, rng):
    """A state in the air, tilted and spinning."""
    qpos, qvel = scene.standing_qpos.copy(), rng.normal(scale=0.3, size=scene.model.nv)
    qpos[:3] += 0.3, -0.2, 1.0
    qpos[3:7] += rng.normal(scale=0.2, size=4)
    qpos[3:7] /= np.linalg.norm(qpos[3:7])
    return qpos, qvel


def test_mass_matrices_are_the_same(scene):
    parts = plant_of(scene, ContactModel())
    layout = StateLayout(scene.model, parts)
    qpos, qvel = turned(scene, np.random.default_rng(2))
    context = parts.plant.CreateDefaultContext()
    parts.plant.SetPositionsAndVelocities(context, layout.to_drake(qpos, qvel))
    drakes = parts.plant.CalcMassMatrix(context)
    # Column k is what MuJoCo's unit speed k is in Drake's coordinates.
    units = np.eye(scene.model.nv)
    change = np.stack([layout.to_drake(qpos, unit)[scene.model.nq :] for unit in units], axis=1)
    data = mujoco.MjData(scene.model)
    data.qpos[:] = qpos
    mujoco.mj_forward(scene.model, data)
    mujocos = np.zeros((scene.model.nv, scene.model.nv))
    mujoco.mj_fullM(scene.model, data, mujocos)
    assert change.T @ drakes @ change == pytest.approx(mujocos, abs=1e-9)


def test_in_the_air_the_engines_agree_and_so_do_their_sensors(scene):
    rng = np.random.default_rng(1)
    qpos, qvel = turned(scene, rng)
    sims = both(scene, record=("qpos", "qvel"))
    for sim in sims:
        sim.reset(np.array([0]), qpos[None], qvel[None])
    for _ in range(round(AIR_S / CONTROL_PERIOD_S)):
        targets = scene.robot.half_sitting_rad + 0.1 * rng.normal(size=(1, scene.model.nu))
        for sim in sims:
            sim.step(targets)
    ours, drakes = sims
    assert np.abs(ours.qpos - qpos).max() > 0.1
    assert drakes.qpos == pytest.approx(ours.qpos, abs=2e-3)
    assert drakes.qvel == pytest.approx(ours.qvel, abs=0.05)
    sensors = scene.sensors
    for name in ("sole_pos_world", "sole_x_axis_world", "head_pos_world", "com_pos_world"):
        at = getattr(sensors, name)
        assert drakes.sensors[..., at] == pytest.approx(ours.sensors[..., at], abs=5e-3), name
    for name in ("sole_linvel_world", "com_linvel_world", "pelvis_linvel_world"):
        at = getattr(sensors, name)
        assert drakes.sensors[..., at] == pytest.approx(ours.sensors[..., at], abs=0.05), name
    # What is recorded are the states after each physics step, what is sensed those before.
    assert drakes.recorded["qpos"] == pytest.approx(ours.recorded["qpos"], abs=2e-3)
    for sim in sims:
        assert np.array_equal(sim.recorded["qvel"][:, -1], sim.qvel)
        assert np.array_equal(
            sim.sensors[0, 1:, sensors.pelvis_pos_world], sim.recorded["qpos"][0, :-1, :3].T
        )
    assert drakes.sensors[..., sensors.ground_force_world].max() == 0


def test_standing_robots_stand_the_same_on_forces_that_move_them(scene):
    """To half a millimetre; H1 sinks by 4 cm in this time, its ankles do not roll.

    Newton's law at each physics step: the mass times what the speed of its centre gains is the sum
    of the forces under the feet and of the weight, over the step.
    """
    sims = both(scene)
    for _ in range(round(STANDING_S / CONTROL_PERIOD_S)):
        for sim in sims:
            sim.step(scene.robot.half_sitting_rad[None])
    ours, drakes = (sim.qpos[0] for sim in sims)
    apart_m = 1.5e-3 if scene.robot.name == "h1" else 5e-4
    assert drakes[:3] == pytest.approx(ours[:3], abs=apart_m)
    assert drakes[7:] == pytest.approx(ours[7:], abs=2.5e-3)
    sensors, mass_kg = scene.sensors, scene.model.body_subtreemass[1]
    force_n, centre_m = [], []
    for sim in sims:
        read = sim.sensors[0]
        force_n.append(read[:, sensors.ground_force_world])
        centre_m.append(read[-1, sensors.pressure_pos_world])
        gained = np.diff(read[:, sensors.com_linvel_world], axis=0) / 0.001
        pulled = force_n[-1].sum(axis=1) / mass_kg - np.array([0.0, 0.0, 9.81])
        assert gained == pytest.approx(pulled[:-1], abs=0.02)
        assert read[:, sensors.legs_touching[0]].max() == 0
        assert read[:, sensors.wall_contacts[0]].max() == 0
    assert force_n[1][-1].sum(axis=0)[2] == pytest.approx(mass_kg * 9.81, rel=0.03)
    assert force_n[1][-1] == pytest.approx(force_n[0][-1], abs=0.015 * mass_kg * 9.81)
    assert centre_m[1] == pytest.approx(centre_m[0], abs=7e-3)


@pytest.fixture(scope="module")
def jvrc1() -> Scene:
    return build_scene(get_robot("jvrc1"), timestep_s=0.001, treads=True)


def test_robots_stand_on_treads_and_fall_where_the_floor_is_lower(jvrc1):
    """As in MuJoCo."""
    sim = DRAKE.simulate(jvrc1, count=3, control_period_s=CONTROL_PERIOD_S, threads=2)
    sunk = sunk_on_treads(sim)
    # Where two treads overlap the ground is twice as stiff.
    assert sunk[0] == pytest.approx(sunk[1], abs=5e-4)
    assert abs(sunk[1]) < 0.015
    assert sunk[2] == pytest.approx(FREE_FALL_M, abs=0.004)
    assert sim.sensors[0, -1, jvrc1.sensors.pressure_pos_world[:, 2]] == pytest.approx(
        0.3, abs=1e-3
    )
    # A reset parks the treads and brings the floor back.
    sim.reset(np.array([2]), jvrc1.standing_qpos[None])
    sim.step(np.tile(jvrc1.robot.half_sitting_rad, (3, 1)))
    assert sim.sensors[2, -1, jvrc1.sensors.ground_force_world[:, 2]].sum() > 400


def walk_ahead(scene, seconds):
    """Errors (steps,) of the feet on a straight walk in Drake, whose robot stays upright."""
    robot = scene.robot
    width_m = robot.step_model.stance_width_m
    relative = np.tile((0.15, width_m, 0.0), (9, 1))
    walker = start_walks(
        robot, lambda rng, row, feet: chained(feet, 0, relative), count=1, seed=0, engine=DRAKE
    )
    errors = []
    for tick in walk(walker, load_policy(robot), round(seconds / CONTROL_PERIOD_S)):
        assert tick.upright[0]
        if tick.landed[0]:
            errors.append(float(np.hypot(*(tick.placed_world - tick.asked_world)[0, :2])))
    return errors


def test_the_policy_that_learned_in_mujoco_walks_in_drake(jvrc1):
    errors = walk_ahead(jvrc1, 3.5)
    assert len(errors) >= 2
    assert max(errors) < 0.04


def test_episodes_on_stairs_are_walked_in_drake():
    """The treads are placed and bear the robot; a second of it, that no test takes long."""
    robot = get_robot("jvrc1")
    config = replace(at_navigation_rate(), episode_ticks=40)
    result = assess_mode(
        robot,
        load_policy(robot),
        "stairs_up",
        episodes=1,
        seed=0,
        config=config,
        tread_error_m=0.02,
        engine=DRAKE,
    )
    assert (result.falls, result.episode_ticks.tolist()) == (0, [40])


def test_an_evaluation_tells_the_engine_and_takes_up_no_other_ones_results(tmp_path):
    robot = get_robot("jvrc1")
    caches = []
    part = Part(name="gait", robot_seconds=1.0, measure=lambda results: {})
    for engine in (MUJOCO, DRAKE):
        setup = EvaluationSetup(
            robot=robot, controller=load_policy(robot), episodes=1, seed=0, engine=engine
        )
        assert setup.draws(2)["engine"] is engine
        assert setup.who.get("engine") == engine.about
        caches.append(ResultCache(tmp_path, setup))
    caches[0].write(part, {"falls": 0})
    assert caches[0].read(part) == {"falls": 0}
    assert caches[1].read(part) is None


@pytest.mark.slow
def test_every_robot_with_a_policy_walks_in_drake(scene):
    errors = walk_ahead(scene, 6.0)
    assert len(errors) >= 4
    assert max(errors) < 0.08


def test_a_push_is_an_impulse(jvrc1):
    """In the air 100 N for 25 ms give the robot 2.5 N s, in both engines."""
    qpos = jvrc1.standing_qpos + np.eye(jvrc1.model.nq)[2]
    speeds = []
    for sim in both(jvrc1):
        sim.reset(np.array([0]), qpos[None])
        sim.push(np.array([[0.0, 100.0, 0.0]]))
        sim.step(jvrc1.robot.half_sitting_rad[None])
        sim.push(np.zeros((1, 3)))
        sim.step(jvrc1.robot.half_sitting_rad[None])
        speeds.append(sim.sensors[0, -1, jvrc1.sensors.com_linvel_world])
        assert speeds[-1][1] == pytest.approx(2.5 / jvrc1.robot.mass_kg, rel=1e-3)
    assert speeds[0] == pytest.approx(speeds[1], abs=1e-4)


def test_legs_and_walls_that_touch_are_told():
    """Hips rolled inwards until the shanks meet; a wall of 1 m through the pelvis."""
    robot = get_robot("jvrc1")
    box = np.array([[0.0, 0.0, 0.2, 0.2, 0.0]])
    scene = build_scene(robot, timestep_s=0.001, terraces=replace(Terraces(), walls=box))
    qpos = scene.standing_qpos.copy()
    qpos[2] += 0.1
    for name, angle in (("L_HIP_R", -0.4), ("R_HIP_R", 0.4)):
        qpos[scene.joint_qpos[[j.name for j in robot.joints].index(name)]] = angle
    for sim in both(scene):
        sim.reset(np.array([0]), qpos[None])
        sim.step(robot.half_sitting_rad[None])
        read = sim.sensors[0, 0]
        assert read[scene.sensors.legs_touching[0]] > 0
        assert read[scene.sensors.wall_contacts[0]] > 0


def test_one_broken_simulation_is_told_and_harms_no_other(jvrc1):
    sim = DRAKE.simulate(jvrc1, count=2, control_period_s=CONTROL_PERIOD_S)
    alone = DRAKE.simulate(jvrc1, count=1, control_period_s=CONTROL_PERIOD_S)
    targets = np.tile(jvrc1.robot.half_sitting_rad, (2, 1))
    sim.qvel[0] = np.nan
    sim.step(targets)
    alone.step(targets[:1])
    assert sim.failed.tolist() == [True, False]
    assert np.array_equal(sim.qpos[1], alone.qpos[0])
    sim.reset(np.array([0]), jvrc1.standing_qpos[None])
    sim.step(targets)
    assert not sim.failed.any()


@pytest.mark.parametrize("timestep_s", [0.0005, 0.0025])
def test_physics_steps_of_other_lengths_give_as_many_sensors(jvrc1, timestep_s):
    engine = DrakeEngine(contact=ContactModel(timestep_s=timestep_s))
    height = jvrc1.sensors.pelvis_pos_world[2]
    sims = [
        e.simulate(jvrc1, count=1, control_period_s=CONTROL_PERIOD_S, record=("qvel",))
        for e in (engine, DRAKE)
    ]
    for sim in sims:
        for _ in range(4):
            sim.step(jvrc1.robot.half_sitting_rad[None])
        assert sim.sensors.shape[1] == sim.recorded["qvel"].shape[1] == 25
        assert np.array_equal(sim.recorded["qvel"][:, -1], sim.qvel)
    other, usual = sims
    steps = min(25, round(CONTROL_PERIOD_S / timestep_s))
    assert len(np.unique(other.sensors[0, :, height])) == steps
    assert other.qpos == pytest.approx(usual.qpos, abs=3e-3)


def test_parts_of_a_control_step_are_the_whole(jvrc1):
    sims = [DRAKE.simulate(jvrc1, count=1, control_period_s=CONTROL_PERIOD_S) for _ in range(2)]
    targets = jvrc1.robot.half_sitting_rad[None] + 0.05
    sims[0].step(targets)
    seen = []

    def held(sensors: np.ndarray) -> np.ndarray:
        seen.append(sensors)
        return targets

    sims[1].step_in_parts(5, held)
    assert np.array_equal(sims[0].qpos, sims[1].qpos)
    assert np.array_equal(sims[0].sensors, sims[1].sensors)
    assert np.array_equal(seen[3], sims[0].sensors[:, 14])
    with pytest.raises(ValueError, match="25 physics steps do not divide into 4 parts"):
        sims[1].step_in_parts(4, lambda sensors: targets)


def test_what_drake_cannot_hold_is_named(jvrc1):
    with pytest.raises(ValueError, match="cannot record 'qacc' in Drake: only qpos, qvel"):
        DRAKE.simulate(jvrc1, count=1, control_period_s=CONTROL_PERIOD_S, record=("qacc",))
    sim = DRAKE.simulate(jvrc1, count=1, control_period_s=CONTROL_PERIOD_S)
    with pytest.raises(EngineError, match="holds no variation of friction"):
        sim.variation()
    with pytest.raises(InputError, match="holds no closed loops and couplings"):
        load_engine(EngineOptions(engine="drake"), get_robot("cassie"))
    robot = jvrc1.robot

    def sprung():
        spec = robot.build()
        spec.joint("L_KNEE").stiffness[0] = 10.0
        return spec

    with pytest.raises(InputError, match=r"no sprung joint such as L_KNEE.* --engine mujoco"):
        load_engine(EngineOptions(engine="drake"), replace(robot, build=sprung))


def test_options_of_drake_are_refused_with_mujoco():
    robot = get_robot("jvrc1")
    assert load_engine(EngineOptions(), robot) is MUJOCO
    with pytest.raises(InputError, match="--contact-modulus goes with --engine drake"):
        load_engine(EngineOptions(contact_modulus=1e7), robot)
    engine = load_engine(EngineOptions(engine="drake", contact="tamsi"), robot)
    assert engine.about is not None
    assert engine.about["contact"]["approximation"] == "tamsi"


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--engine", "bullet"), "--engine: 'bullet' is not one of mujoco, drake"),
        (
            ("--contact", "sap", "--contact-friction", "0.5"),
            "--contact-friction goes with",
        ),
        (
            ("--engine", "drake", "--contact-time-step", "0.003"),
            "--contact-time-step: control period 0.025 s is not a whole number of physics steps",
        ),
        (("--engine", "drake", "--view"), "--view shows walks in mujoco: leave out --engine drake"),
    ],
)
def test_wrong_options_get_one_line(capsys, options, told, tmp_path):
    words = ["navigate", "--map", ROOM, "--goal", "1,0,0", "--out", tmp_path / "walk", *options]
    assert told in refusal(capsys, *words)


def test_drake_that_is_not_installed_is_told_in_one_line(capsys, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "pydrake", None)
    words = ("trials", "--map", ROOM, "--engine", "drake", "--out", tmp_path / "trials")
    assert refusal(capsys, *words) == (
        "error: --engine drake needs the package drake: python -m pip install -e '.[drake]'\n"
    )
