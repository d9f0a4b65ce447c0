"""Robots whose servos, encoders, load and ground are other than the model says."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from app.cli import main
from app.evaluation.figures import write_figures
from app.evaluation.hardware import HARDWARE
from app.evaluation.parts import EvaluationSetup
from app.evaluation.sections import hardware_parts
from app.navigation.navigator import Navigator, NavigatorConfig
from app.navigation.report import Outcome
from app.navigation.sensed import SensingConfig
from controller.actuation import ImperfectServos
from controller.walker import Walker
from sim.batch import SimBatch
from sim.hardware import HardwareErrors, change_model
from sim.scene import Scene, build_scene
from tests.scenes import HALL, POLICY, ROBOT

JOINTS = len(ROBOT.joints)


def scene(errors: HardwareErrors | None = None) -> Scene:
    built = build_scene(ROBOT, timestep_s=0.001)
    if errors is not None:
        change_model(built.model, ROBOT, errors)
    return built


def in_the_air(built: Scene, count: int = 1) -> SimBatch:
    sim = SimBatch(built, count=count, control_period_s=0.025)
    qpos = np.tile(built.standing_qpos, (count, 1))
    qpos[:, 2] += 5.0
    sim.reset(np.arange(count), qpos)
    return sim


def commands(number: int, count: int = 1) -> np.ndarray:
    rng = np.random.default_rng(number)
    return ROBOT.half_sitting_rad + rng.uniform(-0.2, 0.2, (count, JOINTS))


def moved(errors: HardwareErrors, *, periods: int = 4) -> np.ndarray:
    """Joints after some control periods in the air with these servos."""
    sim = in_the_air(scene(errors))
    servos = ImperfectServos(sim, errors, seed=0)
    for number in range(periods):
        servos.step(sim, commands(number))
    return sim.qpos[0].copy()


def test_servos_without_errors_are_those_of_the_model():
    plain = in_the_air(scene())
    for number in range(4):
        plain.step(commands(number))
    np.testing.assert_allclose(moved(HardwareErrors()), plain.qpos[0], atol=1e-12)


def test_a_delay_of_a_period_is_the_command_before():
    late = in_the_air(scene())
    for number in range(4):
        late.step(commands(number - 1) if number else ROBOT.half_sitting_rad[None])
    np.testing.assert_allclose(moved(HardwareErrors(delay_s=0.025)), late.qpos[0], atol=1e-12)


def test_a_delay_within_a_period_is_so_many_physics_steps():
    sim, before = in_the_air(scene()), ROBOT.half_sitting_rad[None]
    for number in range(2):
        in_turn = iter([before] * 10 + [commands(number)] * 15)

        def in_force(_sensors, in_turn=in_turn):
            return next(in_turn)

        sim.step_in_parts(25, in_force)
        before = commands(number)
    found = moved(HardwareErrors(delay_s=0.010), periods=2)
    np.testing.assert_allclose(found, sim.qpos[0], atol=1e-12)


def test_jitter_lies_between_the_delays_and_repeats():
    early, late = moved(HardwareErrors(delay_s=0.005)), moved(HardwareErrors(delay_s=0.020))
    between = HardwareErrors(delay_s=0.005, jitter_s=0.015)
    np.testing.assert_array_equal(moved(between), moved(between))
    assert not np.array_equal(moved(between), early)
    assert not np.array_equal(moved(between), late)


def test_encoders_that_are_off_move_the_joints_by_as_much_the_other_way():
    """In the air without weight a joint comes to rest where its encoder reads the target."""
    errors = HardwareErrors(encoder_rad=0.03)
    built = scene(errors)
    built.model.opt.gravity[:] = 0.0
    sim = in_the_air(built)
    servos = ImperfectServos(sim, errors, seed=1)
    for _ in range(120):
        servos.step(sim, ROBOT.half_sitting_rad[None])
    off = sim.qpos[0, built.joint_qpos] - ROBOT.half_sitting_rad
    np.testing.assert_allclose(np.abs(off), 0.03, atol=0.003)
    np.testing.assert_array_equal(np.sign(off), -np.sign(servos.encoder_offset_rad[0]))


def torques(errors: HardwareErrors, command: np.ndarray, qvel: np.ndarray | None = None):
    """Joint torques at the first physics step after a command, from half-sitting in the air."""
    sim = in_the_air(scene(errors))
    if qvel is not None:
        sim.qvel[0, sim.scene.joint_qvel] = qvel
    ImperfectServos(sim, errors, seed=0).step(sim, command[None])
    return sim.sensors[0, 0, sim.scene.sensors.joint_torque]


def test_play_takes_its_half_from_the_spring():
    """kp (0.05 - 0.02 / 2) at first, and nothing for a target within the play."""
    kp = np.array([joint.kp for joint in ROBOT.joints])
    errors = HardwareErrors(backlash_rad=0.02)
    np.testing.assert_allclose(torques(errors, ROBOT.half_sitting_rad + 0.05), 0.04 * kp, rtol=1e-6)
    np.testing.assert_allclose(torques(errors, ROBOT.half_sitting_rad + 0.009), 0.0, atol=1e-9)


def test_a_motor_at_half_its_free_speed_gives_half_its_torque():
    limit = np.array([joint.torque_limit_nm for joint in ROBOT.joints])
    speed = np.array([joint.speed_limit_rad_s for joint in ROBOT.joints])
    errors = HardwareErrors(no_load=2.0)
    driving = torques(errors, ROBOT.half_sitting_rad + 100.0, speed)
    np.testing.assert_allclose(driving, limit / 2, rtol=0.01)
    braking = torques(errors, ROBOT.half_sitting_rad - 100.0, speed)
    np.testing.assert_allclose(braking, -limit, rtol=1e-6)


def test_weaker_gains_and_friction_are_the_models():
    errors = HardwareErrors(gain=0.8, friction_nm=3.0, damping_nms=0.5)
    plain, other, dofs = scene().model, scene(errors).model, scene().joint_qvel
    for name, columns in (("actuator_gainprm", [0]), ("actuator_biasprm", [1, 2])):
        before, after = (getattr(model, name)[:, columns] for model in (plain, other))
        np.testing.assert_allclose(after, 0.8 * before)
        assert np.abs(before).min() > 0
    for name, added in (("dof_frictionloss", 3.0), ("dof_damping", 0.5)):
        change = getattr(other, name) - getattr(plain, name)
        np.testing.assert_allclose(change[dofs], added)
        np.testing.assert_array_equal(np.delete(change, dofs), 0.0)


def test_a_load_is_a_point_mass_on_the_pelvis():
    plain, other = scene(), scene(HardwareErrors(payload_kg=5.0, payload_m=(0.3, -0.1, 0.4)))
    body = plain.model.body("pelvis").id

    def about_origin(model: mujoco.MjModel) -> tuple[float, np.ndarray, np.ndarray]:
        """Mass, first and second moments (3, 3) of the pelvis about its frame's origin."""
        flat = np.empty(9)
        mujoco.mju_quat2Mat(flat, model.body_iquat[body])
        axes = flat.reshape(3, 3)
        mass, at = model.body_mass[body], model.body_ipos[body]
        inertia = axes @ np.diag(model.body_inertia[body]) @ axes.T
        return mass, mass * at, inertia + mass * (at @ at * np.eye(3) - np.outer(at, at))

    arm = np.array([0.3, -0.1, 0.4])
    before, after = about_origin(plain.model), about_origin(other.model)
    assert after[0] - before[0] == pytest.approx(5.0)
    np.testing.assert_allclose(after[1] - before[1], 5.0 * arm)
    added = 5.0 * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    np.testing.assert_allclose(after[2] - before[2], added, atol=1e-9)


def test_a_robot_on_ice_slides_down_what_holds_it_else():
    def speed(grip: float) -> float:
        built = scene(HardwareErrors(grip=grip))
        built.model.opt.gravity[:] = 9.81 * np.array([0.3, 0.0, -0.95])
        sim = SimBatch(built, count=1, control_period_s=0.025)
        for _ in range(8):
            sim.step(ROBOT.half_sitting_rad[None])
        return float(sim.sensors[0, -1, built.sensors.sole_linvel_world[:, 0]].mean())

    assert speed(1.0) < 0.05 < 0.3 < speed(0.05)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [({"gain": 0}, "above 0"), ({"delay_s": -1}, "not below 0"), ({"grip": math.nan}, "finite")],
)
def test_errors_that_cannot_be(wrong, said):
    with pytest.raises(ValueError, match=said):
        HardwareErrors(**wrong)


def test_the_policy_reads_encoders_that_are_off():
    errors = HardwareErrors(encoder_rad=0.02)
    true, off = Walker(scene()), Walker(scene(), hardware=errors, seed=4)
    difference = off.observe() - true.observe()
    assert off.servos is not None
    np.testing.assert_allclose(difference[0, 5 : 5 + JOINTS], off.servos.encoder_offset_rad[0])
    np.testing.assert_array_equal(np.delete(difference[0], np.r_[5 : 5 + JOINTS]), 0.0)


@pytest.mark.parametrize("sensing", [None, SensingConfig()], ids=["true", "sensed"])
def test_the_shipped_policy_walks_with_all_a_little_off(sensing):
    hardware = HardwareErrors(delay_s=0.010, gain=0.9, encoder_rad=math.radians(0.5))
    navigator = Navigator(
        HALL, ROBOT, POLICY, start=(0, 0, 0), goal=(0.6, 0.0, 0.0),
        config=NavigatorConfig(hardware=hardware, sensing=sensing),
    )  # fmt: skip
    navigator.plan()
    while navigator.outcome is None:
        navigator.tick()
    assert navigator.outcome is Outcome.REACHED


def test_evaluation_measures_every_value_and_shows_it(tmp_path):
    setup = EvaluationSetup(robot=ROBOT, controller=POLICY, episodes=20, seed=0, threads=2)
    parts = {part.name: part for part in hardware_parts(setup)}
    assert len(parts) == sum(len(kind.values) for kind in HARDWARE.values())
    weak = parts["hardware-servo_gains-0.9"].measure({})
    slippery = parts["hardware-grip-0.05"].measure({})
    assert (weak["walks"], weak["falls"], weak["unit"]) == (2, 0, "times the model's")
    assert 0 < weak["error_m_median"] < weak["error_m_p95"] < 0.06
    assert slippery["falls"] > 0 or slippery["error_m_p95"] > 2 * weak["error_m_p95"]
    write_figures({"hardware": [weak, slippery]}, tmp_path)
    assert (tmp_path / "hardware.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--hardware", "glue=1"], "'glue' is not one of gain, delay_s"),
        (["--hardware", "gain=x"], "'gain=x' is not NAME=VALUE"),
        (["--hardware", "gain=-1"], "gain -1.0 must be finite and not below 0"),
        (["--hardware", "gain=0.9", "--controller", "lipm"], "--hardware goes with"),
        (["--hardware", "gain=0.9", "--view"], "no --view"),
    ],
)
def test_hardware_that_cannot_be(words, said, capsys):
    assert main(["navigate", "--map", "maps/room.png", "--goal", "1,0,0", *words]) == 2
    assert said in capsys.readouterr().err


def test_evaluation_of_a_controller_by_a_model_has_no_such_section(tmp_path, capsys):
    words = ["--controller", "lipm", "--sections", "hardware", "--out", str(tmp_path / "out")]
    assert main(["evaluate", *words]) == 2
    assert "--sections hardware goes with --controller policy" in capsys.readouterr().err
