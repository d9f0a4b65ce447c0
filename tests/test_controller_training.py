"""The task, the sequences it draws, the policy's files, and training that resumes exactly."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from controller.assessment import ModeResult, assess_mode, score
from controller.curriculum import Curriculum, Stage
from controller.env import TaskConfig, WalkTask
from controller.observation import critic_fields, mirror_map, policy_fields
from controller.policy import Policy, PolicyError, load_policy, policy_for, save_policy
from controller.ppo import PpoConfig, RslWalkEnv, TrainConfig, make_ppo, plain_layers
from controller.runner import Trainer
from controller.step_cursor import STANCE
from controller.step_sequences import MAX_STEPS, MODES, PlannedSteps, draw_sequence
from maps.grid import OccupancyGrid
from planner.corpus.corpus import corpus_of
from planner.options import PlannerOptions
from planner.plan import feet_at, relative_step
from planner.planner import plan_footsteps
from planner.robot_model import Side
from sim.robots import get_robot, robot_names

ROBOT = get_robot("jvrc1")
TINY = TrainConfig(
    samples=2 * 2 * 64,
    updates_per_segment=2,
    assess_episodes=2,
    curriculum=Curriculum(top_rise_m=0.1, rise_step_m=0.05, flat_success=0, stairs_success=0),
    task=TaskConfig(episode_ticks=8),
    ppo=PpoConfig(robots=4, ticks_per_update=16, hidden=(8,), minibatches=2, epochs=2),
)


@pytest.mark.parametrize("name", robot_names())
def test_networks_treat_left_and_right_alike(name):
    """Whatever their weights; and the layers that are saved are the network that was trained."""
    robot, rng = get_robot(name), np.random.default_rng(3)
    learner = make_ppo(RslWalkEnv(WalkTask(robot, count=2, seed=0)), TINY.ppo)
    for parameter in (*learner.actor.mlp.parameters(), *learner.critic.mlp.parameters()):
        torch.nn.init.normal_(parameter)
    policy = policy_for(robot, plain_layers(learner.actor.mlp))
    index, sign = mirror_map(policy_fields(robot))
    seen = rng.normal(size=(20, len(index)))
    action, image = policy.act_scaled(seen), policy.act_scaled(seen[:, index] * sign)
    joint_index, joint_sign = robot.mirror_joints
    size = np.abs(action).max()
    assert image == pytest.approx(action[:, joint_index] * joint_sign, abs=1e-5 * size)
    trained = learner.actor.mlp(torch.from_numpy(seen).float()).detach().numpy()
    assert trained == pytest.approx(action, abs=1e-5 * size)

    index, sign = mirror_map(policy_fields(robot) + critic_fields())
    seen = rng.normal(size=(20, len(index)))
    value, image = (
        learner.critic.mlp(torch.from_numpy(x).float()).detach().numpy()
        for x in (seen, seen[:, index] * sign)
    )
    assert image == pytest.approx(value, abs=1e-4 * float(np.abs(value).max()))


def test_without_symmetry_left_and_right_are_learned_apart():
    """And the layers that are saved are still the network that was trained."""
    rng, (index, sign) = np.random.default_rng(3), mirror_map(policy_fields(ROBOT))
    learner = make_ppo(
        RslWalkEnv(WalkTask(ROBOT, count=2, seed=0)), replace(TINY.ppo, symmetric=False)
    )
    policy = policy_for(ROBOT, plain_layers(learner.actor.mlp))
    seen = rng.normal(size=(20, len(index)))
    action, image = policy.act_scaled(seen), policy.act_scaled(seen[:, index] * sign)
    joint_index, joint_sign = ROBOT.mirror_joints
    assert np.abs(image - action[:, joint_index] * joint_sign).max() > 0.1 * np.abs(action).max()
    trained = learner.actor.mlp(torch.from_numpy(seen).float()).detach().numpy()
    assert trained == pytest.approx(action, abs=1e-5)


def test_without_the_offset_the_first_targets_are_about_joints_at_zero():
    """The same weights ask for targets that lie by half-sitting lower, and are still symmetric."""
    env, targets_rad = RslWalkEnv(WalkTask(ROBOT, count=2, seed=0)), []
    for half_sitting_offset in (True, False):
        torch.manual_seed(5)
        learner = make_ppo(env, replace(TINY.ppo, half_sitting_offset=half_sitting_offset))
        seen = np.random.default_rng(1).normal(size=(20, env.task.observe().shape[1]))
        action = policy_for(ROBOT, plain_layers(learner.actor.mlp)).act_scaled(seen)
        targets_rad.append(ROBOT.half_sitting_rad + action)
    with_offset, without = targets_rad
    half_sitting = np.tile(ROBOT.half_sitting_rad, (20, 1))
    assert with_offset - without == pytest.approx(half_sitting, abs=1e-5)


def small_policy(robot, seed=0) -> Policy:
    rng = np.random.default_rng(seed)
    inputs, outputs = 17 + 2 * len(robot.joints), len(robot.joints)
    layers = (
        (rng.normal(size=(8, inputs)).astype(np.float32), np.zeros(8, np.float32)),
        (0.01 * rng.normal(size=(outputs, 8)).astype(np.float32), np.zeros(outputs, np.float32)),
    )
    return policy_for(robot, layers, note="a test's")


@pytest.mark.parametrize("name", robot_names())
@pytest.mark.parametrize("mode", [*MODES, None])
def test_drawn_steps_alternate_and_keep_the_limits(name, mode):
    robot = get_robot(name)
    model, rng = robot.training_model, np.random.default_rng(4)
    feet = np.array([[0.3, 0.1, 0, 0.5], [0.4, -0.1, 0, 0.5]])
    steps = 0
    for _ in range(40):
        sequence = draw_sequence(rng, model, feet, mode=mode, steps=MAX_STEPS)
        for k in range(2, len(sequence.side)):
            support, swing = sequence.pose_world[k - 1], sequence.pose_world[k]
            assert sequence.side[k] != sequence.side[k - 1]
            relative = relative_step(support, swing, Side(int(sequence.side[k])))
            assert model.limits.contain(relative, tolerance=1e-6), relative
            steps += 1
    assert steps > 100


@pytest.mark.parametrize("name", robot_names())
def test_what_is_planned_lies_within_what_is_trained(name):
    robot = get_robot(name)
    planned, trained = robot.step_model.limits, robot.training_model.limits
    for inner, outer in (
        (planned.x_m, trained.x_m),
        (planned.y_m, trained.y_m),
        (planned.yaw_rad, trained.yaw_rad),
    ):
        assert outer[0] <= inner[0] < inner[1] <= outer[1]


def test_standing_mode_has_no_steps():
    feet = np.array([[0.0, 0.1, 0, 0], [0.0, -0.1, 0, 0]])
    sequence = draw_sequence(np.random.default_rng(0), ROBOT.step_model, feet, mode="standing")
    assert len(sequence.side) == 2


def test_same_seed_same_episodes_whatever_the_threads():
    rng = np.random.default_rng(0)
    actions = 0.2 * rng.normal(size=(60, 6, 12))
    runs = []
    for threads in (1, 2):
        task = WalkTask(ROBOT, count=6, seed=11, threads=threads)
        runs.append([task.step(action) for action in actions])
    for first, second in zip(*runs, strict=True):
        assert np.array_equal(first.observation, second.observation)
        assert np.array_equal(first.reward, second.reward)
        assert np.array_equal(first.terminated, second.terminated)


def test_a_fall_terminates_and_does_not_truncate():
    """Legs let go: the targets fold the knees, and the pelvis sinks below its limit."""
    task = WalkTask(ROBOT, count=3, seed=0, mode="standing")
    fold = np.array([-1.0, 0, 0, 2.0, 0, -1.0] * 2)
    for _ in range(200):
        step = task.step(np.tile(fold, (3, 1)))
        if step.terminated.any():
            break
    assert step.terminated.any()
    assert not step.truncated[step.terminated].any()
    assert (task.ticks[step.terminated] == 0).all()


def test_a_full_episode_truncates_and_does_not_terminate():
    task = WalkTask(ROBOT, count=2, seed=0, mode="standing", config=TaskConfig(episode_ticks=5))
    ends = [task.step(np.zeros((2, 12))) for _ in range(5)]
    assert not any(step.truncated.any() or step.terminated.any() for step in ends[:4])
    assert ends[4].truncated.all()
    assert not ends[4].terminated.any()


def test_simulation_that_leaves_the_finite_numbers_ends_its_episode_only():
    task = WalkTask(ROBOT, count=3, seed=0, mode="standing")
    task.walker.sim.qvel[1] = np.nan
    step = task.step(np.zeros((3, 12)))
    assert step.failed.tolist() == [False, True, False]
    assert step.terminated.tolist() == [False, True, False]
    assert step.reward[1] == 0
    assert np.isfinite(step.observation).all()
    assert np.isfinite(step.critic_observation).all()


@pytest.mark.slow
def test_held_out_assessment_repeats_and_counts_each_landing():
    policy, config = load_policy(ROBOT), TaskConfig(episode_ticks=150)
    first, again, other = (
        assess_mode(ROBOT, policy, "forward", episodes=4, seed=seed, config=config)
        for seed in (1, 1, 2)
    )
    # Up to 20 ticks of waiting, 14 of weight shift, then 44 a step: two or three steps each.
    assert 8 <= len(first.landing_error_m) <= 12
    assert first.falls == 0
    assert np.array_equal(first.landing_error_m, again.landing_error_m)
    assert not np.array_equal(first.landing_error_m, other.landing_error_m)
    assert np.hypot(*first.landing_offset_m.T) == pytest.approx(first.landing_error_m)
    assert first.episode_ticks.tolist() == [150] * 4


def test_policy_acts_as_its_layers_worked_by_hand():
    policy = small_policy(ROBOT)
    observation = np.random.default_rng(3).normal(size=(2, 41))
    (w1, b1), (w2, b2) = policy.layers
    scaled = (observation - policy.offset) / policy.scale
    expected = np.array([w2 @ np.maximum(w1 @ row + b1, 0) + b2 for row in scaled])
    assert policy.act(observation) == pytest.approx(expected, abs=1e-5)


def test_policy_comes_back_from_its_files(tmp_path):
    policy = small_policy(ROBOT)
    save_policy(policy, tmp_path / "p.safetensors")
    again = load_policy(ROBOT, tmp_path / "p.safetensors")
    observation = np.random.default_rng(0).normal(size=(3, 41))
    assert np.array_equal(again.act(observation), policy.act(observation))
    assert again.about["note"] == "a test's"
    assert {path.name for path in tmp_path.iterdir()} == {"p.json", "p.safetensors"}


def test_policy_that_does_not_fit_is_refused_saying_why(tmp_path):
    path = tmp_path / "p.safetensors"
    with pytest.raises(PolicyError, match=r"no policy file .*p\.safetensors"):
        load_policy(ROBOT, path)
    with pytest.raises(PolicyError, match="a folder; name the file in it"):
        load_policy(ROBOT, tmp_path)
    path.touch()
    with pytest.raises(PolicyError, match=r"p\.safetensors: no p\.json beside it"):
        load_policy(ROBOT, path)
    save_policy(small_policy(ROBOT), path)
    other = replace(ROBOT, name="someone_else")
    with pytest.raises(PolicyError, match="its robot is jvrc1, someone_else needs"):
        load_policy(other, path)
    about = json.loads(path.with_suffix(".json").read_text())
    about["observation"][0][1] = 3
    path.with_suffix(".json").write_text(json.dumps(about))
    with pytest.raises(PolicyError, match="its observation is"):
        load_policy(ROBOT, path)
    save_policy(small_policy(ROBOT), path)
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(PolicyError, match="damaged"):
        load_policy(ROBOT, path)
    save_policy(small_policy(ROBOT), path)
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(bytes(content))
    with pytest.raises(PolicyError, match="sha256"):
        load_policy(ROBOT, path)


def train(tmp_path, name, config, *, resume=False, threads=1) -> Trainer:
    trainer = Trainer(ROBOT, config, tmp_path / name, threads=threads, command="test")
    if resume:
        trainer.resume()
    trainer.run(lambda report: None)
    return trainer


def weights_of(trainer: Trainer) -> list[np.ndarray]:
    """Weights and biases of the policy as it is trained, layer by layer."""
    return [array for layer in trainer.ppo.actor.mlp.layers() for array in layer]


@pytest.mark.slow
def test_run_cut_off_and_resumed_gives_the_policy_of_the_whole_run(tmp_path):
    whole = train(tmp_path, "whole", TINY, threads=2)
    # A killed run has the whole run's schedule: give its checkpoint that configuration.
    cut = Trainer(ROBOT, TINY, tmp_path / "cut2", threads=1, command="test")
    (tmp_path / "cut2").mkdir()
    reports = []

    def stop_after_one(report):
        reports.append(report)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        cut.run(stop_after_one)
    resumed = train(tmp_path, "cut2", TINY, resume=True)
    assert len(reports) == 1
    assert all(map(np.array_equal, weights_of(resumed), weights_of(whole)))
    assert len(whole.history) == len(resumed.history) == 2
    # The first segment was on flat ground, the second on the first stairs, in both runs alike.
    assert [line["rise_m"] for line in resumed.history] == [0.0, 0.05]
    assert resumed.stage == whole.stage == Stage(rise_m=0.10, disturbance_level=1.0)
    assert resumed.best_score == whole.best_score


@pytest.mark.slow
def test_training_changes_the_policy_and_another_seed_another_way(tmp_path):
    first = weights_of(train(tmp_path, "a", TINY))
    other = weights_of(train(tmp_path, "b", replace(TINY, seed=1)))
    assert not np.array_equal(first[0], other[0])
    saved = load_policy(ROBOT, tmp_path / "a" / "jvrc1.safetensors")
    assert saved.about["trained"]["seed"] == 0


def test_planned_steps_are_pieces_of_plans_with_either_foot_first():
    model = ROBOT.step_model
    plans = [
        plan_footsteps(
            empty_floor(), model, start=(1, 1, 0), goal=goal, options=PlannerOptions(refine=False)
        )
        for goal in ((2.5, 1.2, 0.4), (1.0, 1.0, 0.0))
    ]
    assert [len(plan) > 0 for plan in plans] == [True, False]
    planned = PlannedSteps.of(corpus_of(plans, "jvrc1"), "jvrc1", ROBOT.training_model)
    feet = feet_at((0.0, 0.0, 0.0), model.stance_width_m)
    rng, firsts = np.random.default_rng(0), set()
    for _ in range(20):
        sequence = planned.draw(rng, feet, steps=4)
        side, pose = sequence.side[STANCE:], sequence.pose_world[STANCE:]
        firsts.add(int(side[0]))
        support = np.concatenate([[feet[1 - side[0]]], pose[:-1]])
        steps = [
            relative_step(a, b, Side(int(s))) for a, b, s in zip(support, pose, side, strict=True)
        ]
        starts = range(len(planned.relative) - len(steps) + 1)
        assert any(np.allclose(steps, planned.relative[k : k + len(steps)]) for k in starts)
        assert len(steps) == 4
    assert firsts == {0, 1}


def empty_floor():
    return OccupancyGrid(cells=np.zeros((60, 80), np.uint8), resolution_m=0.05)


def test_an_older_policy_does_not_look_at_the_durations_of_steps(tmp_path):
    """Before steps had durations of their own, observations ended with the steps."""
    paced = small_policy(ROBOT)
    assert paced.is_paced
    (w1, b1), last = paced.layers
    older = replace(
        paced,
        layers=((w1[:, :-2], b1), last),
        offset=paced.offset[:-2],
        scale=paced.scale[:-2],
        about={**paced.about, "observation": paced.about["observation"][:-1]},
    )
    save_policy(older, tmp_path / "old.safetensors")
    again = load_policy(ROBOT, tmp_path / "old.safetensors")
    assert not again.is_paced
    observation = np.random.default_rng(1).normal(size=(2, 41))
    other = observation + np.r_[np.zeros(39), 1.0, 1.0]
    assert np.array_equal(again.act(observation), again.act(other))
    assert not np.array_equal(paced.act(observation), paced.act(other))


def test_episodes_take_steps_of_drawn_durations_and_stairs_none_too_quick():
    config = TaskConfig(paced_share=1.0, step_s=(0.7, 1.4))
    for mode, low in (("forward", 0.7), ("stairs", 1.1)):
        task = WalkTask(ROBOT, count=64, seed=2, mode=mode, config=config, stage=Stage(rise_m=0.1))
        task.walker.cursor.entry[:] = 2
        task.walker.cursor.standing[:] = False
        step_s = task.walker.cursor.step_s
        assert step_s.min() >= low - 0.0125
        assert step_s.max() <= 1.4 + 0.0125
        assert len(np.unique(step_s[:, 0])) > 8
        # In some episodes the duration changes from step to step, in most it does not.
        assert 0.5 < np.mean(step_s[:, 0] == step_s[:, 1]) < 1.0
    own = WalkTask(ROBOT, count=8, seed=2, config=TaskConfig(paced_share=0.0))
    own.walker.cursor.entry[:] = 2
    assert own.walker.cursor.step_s == pytest.approx(np.full((8, 2), 1.1))


def result_with(falls: int, strayed: int = 0) -> ModeResult:
    none = np.zeros(0)
    return ModeResult(
        mode="mixed",
        episodes=43,
        falls=falls,
        strayed=strayed,
        episode_ticks=np.full(43, 400),
        landing_error_m=none,
        landing_heading_error_rad=none,
        landing_offset_m=np.zeros((0, 2)),
    )


def test_the_best_policy_climbs_highest_then_fails_least_then_walks_best():
    """One failure of 43 is chance: it is the reward that tells; two are not."""
    low, high = Stage(rise_m=0.10), Stage(rise_m=0.15)
    none, one, two = (result_with(0),), (result_with(1),), (result_with(1, strayed=1),)
    assert score(high, two, 0.1) > score(low, none, 0.9)
    assert score(high, one, 0.1) > score(high, two, 0.9)
    assert score(high, one, 0.8) > score(high, none, 0.7) > score(high, one, 0.6)
    # Each assessment has its own: one failure on flat ground and one on stairs are both chance.
    assert score(high, (*one, *one), 0.8) > score(high, (*none, *two), 0.9)
