"""What training disturbs: within its ranges, repeatable, and nothing at all when switched off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from controller.curriculum import Stage
from controller.env import TaskConfig, WalkTask
from controller.gait import CONTROL_PERIOD_S
from controller.randomization import PUSH_TICKS, Disturbances, DomainRandomization
from controller.step_sequences import draw_sequence
from controller.walker import Walker
from planner.plan import relative_step
from planner.robot_model import Side
from sim.batch import SimBatch
from sim.robots import get_robot
from sim.scene import build_scene
from sim.terrain import Ground

COUNT = 400
LOUD = replace(DomainRandomization(), undisturbed_share=0.0, latency_share=1.0, push_share=1.0)


def drawn(config, level, seed=0):
    disturbances, rng = Disturbances(config, COUNT, 12, 62.0), np.random.default_rng(seed)
    for row in range(COUNT):
        disturbances.draw_episode(rng, row, level, ticks=100)
    return disturbances


class FakeSim:
    """Records the pushes."""

    def __init__(self):
        self.forces = []

    def push(self, force):
        self.forces.append(force.copy())


def impulses(disturbances):
    """Impulse (B,) in N s that each robot gets over an episode."""
    sim = FakeSim()
    for tick in range(100 + PUSH_TICKS):
        disturbances.push(sim, np.full(COUNT, tick))
    return np.linalg.norm(sim.forces, axis=2).sum(axis=0) * CONTROL_PERIOD_S


@pytest.mark.parametrize("level", [1.0, 0.5])
def test_amplitudes_fill_their_ranges_and_scale_with_the_level(level):
    disturbances = drawn(LOUD, level)
    for amplitude, highest in (
        (np.degrees(disturbances.joint_noise_rad), 6.5),
        (np.degrees(disturbances.tilt_noise_rad), 1.0),
        (disturbances.angular_speed_noise_rad_s, 0.1),
        (disturbances.latency_ticks, 1.0),
        (impulses(disturbances), 0.35 * 62.0),
    ):
        assert amplitude.min() >= 0
        assert 0.95 * highest * level < amplitude.max() <= highest * level * (1 + 1e-9)
        assert np.mean(amplitude) == pytest.approx(highest * level / 2, rel=0.1)
    errors = [
        disturbances.draw_tread_error_m(np.random.default_rng(k), level) for k in range(COUNT)
    ]
    assert np.mean(np.equal(errors, 0.0)) == pytest.approx(0.3, abs=0.07)
    assert 0.05 * level < max(errors) <= 0.055 * level


def test_quiet_episodes_have_none_of_it():
    disturbances = drawn(replace(LOUD, undisturbed_share=0.4), 1.0)
    quiet = disturbances.joint_noise_rad == 0
    assert quiet.mean() == pytest.approx(0.4, abs=0.07)
    for amplitude in (
        disturbances.tilt_noise_rad,
        disturbances.angular_speed_noise_rad_s,
        disturbances.latency_ticks,
        impulses(disturbances),
    ):
        assert np.array_equal(amplitude == 0, quiet)


def test_noise_of_joint_speeds_goes_with_that_of_positions():
    """3 degrees on positions are 30 deg/s on speeds; clock and steps are seen as they are."""
    disturbances = drawn(DomainRandomization.exactly(joint_noise_deg=3.0), 1.0)
    noise = disturbances.sense(np.random.default_rng(0), np.zeros((COUNT, 39)))
    limit = np.radians(np.r_[np.zeros(5), np.full(12, 3.0), np.full(12, 30.0), np.zeros(10)])
    assert np.all(np.abs(noise) <= limit)
    assert np.abs(noise).max(axis=0) == pytest.approx(limit, rel=0.05)


def test_same_seed_same_draws():
    first, again, other = drawn(LOUD, 1.0), drawn(LOUD, 1.0), drawn(LOUD, 1.0, seed=1)
    assert np.array_equal(first.joint_noise_rad, again.joint_noise_rad)
    assert np.array_equal(impulses(first), impulses(again))
    assert not np.array_equal(first.joint_noise_rad, other.joint_noise_rad)


def test_a_moved_step_keeps_the_limits_and_carries_the_later_ones_along():
    robot, rng, count = get_robot("jvrc1"), np.random.default_rng(2), 64
    model = robot.training_model
    walker = Walker(build_scene(robot, timestep_s=0.005), count=count)
    feet = walker.scene.soles_at(walker.scene.standing_qpos)
    for row in range(count):
        walker.follow(row, draw_sequence(rng, model, feet, mode="arbitrary", steps=4))
    config = DomainRandomization(undisturbed_share=0.0, moved_share=1.0, moved_m=0.1)
    disturbances = Disturbances(config, count, len(robot.joints), robot.mass_kg)
    for row in range(count):
        disturbances.draw_episode(rng, row, 1.0, ticks=100)
    allowed, cursor, moves = np.arange(count // 2), walker.cursor, 0
    for _ in range(250):
        cursor.advance()
        window, last = cursor.window.copy(), cursor.step_number == 4
        disturbances.move_steps(rng, walker, 1.0, allowed)
        change = cursor.window - window
        moved = np.flatnonzero(change.any(axis=(1, 2)))
        assert set(moved) <= set(allowed)
        assert (cursor.swinging & (2 * cursor.tick <= cursor.ticks.swing))[moved].all()
        assert not change[..., 2:].any()
        assert np.abs(change).max() <= np.hypot(0.1, 0.1) + 1e-9
        # After the last step the window shows the other foot, which stands.
        assert change[moved, 1] == pytest.approx(change[moved, 0] * ~last[moved, None])
        for row in moved.tolist():
            side, (left, right) = Side(int(cursor.side[row])), cursor.foot_targets[row]
            support, swing = (left, right) if side == Side.RIGHT else (right, left)
            assert model.limits.contain(relative_step(support, swing, side), tolerance=1e-6)
        moves += len(moved)
    assert cursor.arrived.all()
    assert moves > 100


def standing_run(stage, randomization, seed=0):
    """Everything a task with nothing drawn in it gives, whatever the seed, over 20 steps."""
    config = TaskConfig(
        joint_noise_rad=0.0,
        joint_speed_noise_rad_s=0.0,
        wait_ticks=0,
        episode_ticks=12,
        randomization=randomization,
    )
    task = WalkTask(
        get_robot("jvrc1"), count=2, seed=seed, mode="standing", config=config, stage=stage
    )
    actions = 0.1 * np.random.default_rng(5).normal(size=(20, 2, 12))
    steps = [task.step(action) for action in actions]
    return [
        np.concatenate([s.observation, s.critic_observation, s.reward[:, None]], 1) for s in steps
    ]


def test_all_switched_off_is_bit_identical_to_no_disturbance():
    clear = standing_run(Stage(), DomainRandomization())
    off = standing_run(Stage(disturbance_level=1.0), DomainRandomization.exactly(), seed=1)
    assert np.array_equal(clear, off)
    for change in (
        {"joint_noise_deg": (1.0, 1.0)},
        {"latency_share": 1.0, "latency_ticks": (0.5, 0.5)},
        {"push_share": 1.0, "push_m_s": (0.16, 0.16)},
        {"mass_factor": (1.05, 1.05)},
        {"gain_factor": (1.05, 1.05)},
        {"friction_factor": (0.2, 0.2)},
        {"pelvis_com_m": (0.01, 0.01)},
    ):
        on = standing_run(
            Stage(disturbance_level=1.0), replace(DomainRandomization.exactly(), **change)
        )
        assert not np.array_equal(clear, on), change


def test_task_restarted_at_level_0_is_undisturbed():
    config = TaskConfig(randomization=LOUD)
    task = WalkTask(
        get_robot("jvrc1"), count=2, seed=0, config=config, stage=Stage(disturbance_level=1.0)
    )
    assert task.walker.latency_ticks.all()
    task.restart(3, stage=Stage())
    assert not task.walker.latency_ticks.any()
    observation = task.observe()
    assert np.array_equal(observation, task.critic_observe()[:, : observation.shape[1]])


def falling(variation, push_n):
    """Speed (3,) of a pelvis pushed sideways for one control step, high above the floor."""
    scene = build_scene(get_robot("jvrc1"), timestep_s=0.005, treads=True)
    sim = SimBatch(scene, count=1, control_period_s=CONTROL_PERIOD_S)
    sim.place_ground(0, Ground(floor_z_m=-5.0))
    if variation is not None:
        ones = {"friction": np.ones(1), "mass": np.ones(1), "gain": np.ones(1)}
        sim.variation().set(**{**ones, "pelvis_com_m": np.zeros((1, 3)), **variation})
    sim.push(np.array([[0.0, push_n, 0.0]]))
    sim.step(scene.robot.half_sitting_rad[None])
    return sim.qvel[0, :3].copy()


def test_models_vary_by_their_factors():
    """Twice the mass takes half the speed from the same push; factors of one change nothing."""
    plain = falling(None, 300.0)
    assert plain[1] > 0.1
    assert np.array_equal(falling({}, 300.0), plain)
    assert falling({"mass": np.array([2.0])}, 300.0)[1] == pytest.approx(plain[1] / 2, rel=0.05)


@pytest.mark.parametrize(
    "values",
    [
        {"joint_noise_deg": (3.0, 1.0)},
        {"push_m_s": (-0.1, 0.1)},
        {"tread_error_m": (0.0, float("inf"))},
        {"latency_ticks": (0.0, 2.0)},
        {"mass_factor": (0.0, 1.0)},
        {"undisturbed_share": 1.5},
        {"joint_speed_noise_per_s": -1.0},
    ],
)
def test_impossible_ranges_are_refused_by_their_names(values):
    with pytest.raises(ValueError, match=next(iter(values))):
        DomainRandomization(**values)
