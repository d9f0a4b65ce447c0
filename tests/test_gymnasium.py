"""The Gymnasium environments: Gymnasium's own check, and step for step the task they wrap."""

from __future__ import annotations

import importlib.util
import os
import re
import warnings
from typing import Any

import av
import gymnasium
import numpy as np
import pytest
from gymnasium.utils import seeding
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import NormalizeObservation, RecordEpisodeStatistics

from controller.curriculum import Stage
from controller.env import TaskConfig, WalkTask
from controller.gym_env import WalkVectorEnv, environment_id
from controller.gym_render import COLOURS
from controller.policy import load_policy
from planner.robot_model import Side
from sim.robots import get_robot, robot_names
from tests.programs import ROOT, drawn_by, picture_at, run_python

JVRC1 = "Footfall/Jvrc1-v0"
TICKS = 12
SHORT, LONG = TaskConfig(episode_ticks=TICKS), TaskConfig(episode_ticks=1000)


def bare_task(*, count: int, seed: int, config: TaskConfig) -> WalkTask:
    """The task in the state in which an environment is after its reset with the seed."""
    task = WalkTask(get_robot("jvrc1"), count=count, seed=0, config=config)
    task.restart(int(seeding.np_random(seed)[0].integers(2**63)))
    return task


def actions(count: int, steps: int) -> np.ndarray:
    return np.random.default_rng(7).uniform(-0.1, 0.1, (steps, count, 12)).astype(np.float32)


@pytest.mark.parametrize("robot", robot_names())
def test_every_robot_passes_gymnasiums_own_check(robot):
    env = gymnasium.make(environment_id(robot)).unwrapped
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        # Pictures need a GL library: tests/test_gymnasium.py.
        check_env(env, skip_render_check=True)
    told = [str(warning.message) for warning in caught]
    # Actions are in rad, as the policy gives them.
    assert [line for line in told if "normalized space" not in line] == []


def test_one_robot_is_the_task_until_its_episode_ends_and_keeps_its_last_observation():
    env = gymnasium.make(JVRC1, config=SHORT)
    # Longer episodes draw nothing else: they show what the short ones see at their end.
    short = bare_task(count=1, seed=5, config=SHORT)
    longer = bare_task(count=1, seed=5, config=LONG)
    observation, info = env.reset(seed=5)
    assert info == {}
    assert observation == pytest.approx(short.observe()[0], abs=1e-6)
    for tick, action in enumerate(actions(1, TICKS)):
        expected, seen = short.step(action.astype(float)), longer.step(action.astype(float))
        observation, reward, terminated, truncated, info = env.step(action[0])
        assert reward == expected.reward[0]
        assert (terminated, truncated) == (False, tick == TICKS - 1)
        assert np.array_equal(observation, seen.observation[0].astype(np.float32))
        assert info["reward_terms"] == expected.terms
        assert (info["landed"], info["failed"]) == (False, False)
    assert not np.array_equal(observation, expected.observation[0].astype(np.float32))


def test_many_robots_are_the_task_and_final_obs_is_what_the_ended_episodes_saw():
    envs = gymnasium.make_vec(JVRC1, num_envs=3, config=SHORT, threads=2)
    assert isinstance(envs, WalkVectorEnv)
    assert envs.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    short = bare_task(count=3, seed=5, config=SHORT)
    longer = bare_task(count=3, seed=5, config=LONG)
    observation, _ = envs.reset(seed=5)
    assert np.array_equal(observation, short.observe().astype(np.float32))
    for tick, action in enumerate(actions(3, TICKS + 2)):
        expected, seen = short.step(action.astype(float)), longer.step(action.astype(float))
        observation, reward, terminated, truncated, info = envs.step(action)
        assert np.array_equal(observation, expected.observation.astype(np.float32))
        assert np.array_equal(reward, expected.reward)
        assert not terminated.any()
        at_end = tick == TICKS - 1
        assert truncated.tolist() == [at_end] * 3
        assert info["_landed"].tolist() == [not at_end] * 3
        assert ("final_obs" in info) == ("final_info" in info) == at_end
        if at_end:
            assert info["_final_obs"].all()
            final = np.stack(info["final_obs"])
            assert np.array_equal(final, seen.observation.astype(np.float32))
            assert info["final_info"]["_landed"].all()


@pytest.mark.parametrize("autoreset_mode", ["SameStep", "NextStep"])
def test_with_a_list_of_seeds_it_does_what_gymnasiums_own_vector_of_single_robots_does(
    autoreset_mode,
):
    """Over some episodes, of which one robot's end early, by a fall."""
    config = TaskConfig(episode_ticks=60)
    ours: Any = gymnasium.make_vec(JVRC1, num_envs=3, config=config, autoreset_mode=autoreset_mode)
    oracle: Any = gymnasium.make_vec(
        JVRC1,
        num_envs=3,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": autoreset_mode},
        config=config,
    )
    assert ours.metadata["autoreset_mode"] is oracle.metadata["autoreset_mode"]
    draws = actions(3, 130)
    draws[:, 1] = [-1.0, 0, 0, 2.0, 0, -1.0] * 2  # its legs fold
    ended = []
    for seed in ([11, 5, 7], None):
        assert np.array_equal(ours.reset(seed=seed)[0], oracle.reset(seed=seed)[0])
        for action in draws:
            mine, theirs = ours.step(action), oracle.step(action)
            for value, expected in zip(mine[:4], theirs[:4], strict=True):
                assert value == pytest.approx(expected, abs=1e-12)
            assert ("final_obs" in mine[4]) == ("final_obs" in theirs[4])
            for name in ("landed", "stairs", "failed"):
                told = mine[4][f"_{name}"]
                assert np.array_equal(told, theirs[4].get(f"_{name}", np.zeros(3, bool)))
            ended.append(mine[2] | mine[3])
    episodes = np.sum(ended, axis=0)
    assert episodes.min() >= 4
    assert episodes[1] > episodes[0]


def test_a_robots_episodes_depend_on_its_own_seed_alone():
    seen = []
    for seed in ([1, 2, 3], [8, 2, 9]):
        envs: Any = gymnasium.make_vec(JVRC1, num_envs=3, config=SHORT)
        first = envs.reset(seed=seed)[0]
        seen.append([first, *(envs.step(action)[0] for action in actions(3, 2 * TICKS))])
    one, other = np.array(seen)
    assert np.array_equal(one[:, 1], other[:, 1])
    assert not np.array_equal(one[:, 0], other[:, 0])


@pytest.mark.parametrize("stage", [None, Stage(rise_m=0.1, disturbance_level=1.0)])
def test_gymnasiums_vector_wrappers_run_on_it(stage):
    envs = gymnasium.make_vec(
        JVRC1, num_envs=3, config=SHORT, stage=stage, autoreset_mode=AutoresetMode.NEXT_STEP
    )
    recorded: Any = RecordEpisodeStatistics(NormalizeObservation(envs))
    recorded.reset(seed=[4, 5, 6])
    returns, seen, lengths = np.zeros(3), [], []
    # An episode, and a step in which the next one begins.
    for action in actions(3, 4 * (TICKS + 1)):
        observation, reward, terminated, truncated, info = recorded.step(action)
        seen.append(observation)
        returns += reward
        for row in np.flatnonzero(terminated | truncated):
            assert info["episode"]["r"][row] == pytest.approx(returns[row])
            lengths.append(int(info["episode"]["l"][row]))
            returns[row] = 0.0
    assert lengths == [TICKS] * 12
    assert np.std(seen) == pytest.approx(1.0, abs=0.4)


def test_a_fall_ends_the_episode_of_that_robot_only():
    """The legs of one robot fold; then it stands anew, and what it saw last is told."""
    envs = gymnasium.make_vec(JVRC1, num_envs=2, mode="standing")
    envs.reset(seed=0)
    action = np.zeros((2, 12), np.float32)
    action[1] = [-1.0, 0, 0, 2.0, 0, -1.0] * 2
    for _ in range(200):
        observation, _, terminated, truncated, info = envs.step(action)
        if terminated.any():
            break
    assert terminated.tolist() == [False, True]
    assert truncated.tolist() == [False, False]
    assert info["_final_obs"].tolist() == [False, True]
    assert info["final_obs"][0] is None
    knee = 5 + 3  # roll, pitch, angular velocity, then the joints, the knee the fourth
    # Scaled by 0.5 rad: it was bent by far more than the 0.02 rad in which episodes begin.
    assert info["final_obs"][1][knee] > 0.5
    assert abs(observation[1][knee]) <= 0.02 / 0.5 + 1e-6


def test_landings_are_told_with_their_errors_where_there_are_any():
    envs = gymnasium.make_vec(JVRC1, num_envs=4, mode="in_place")
    policy = load_policy(get_robot("jvrc1"))
    observation, _ = envs.reset(seed=2)
    landings = 0
    # Up to 20 ticks of waiting, 14 of weight shift, then 44 a step.
    for _ in range(90):
        observation, _, terminated, _, info = envs.step(policy.act_scaled(observation))
        landed = info["landed"]
        assert np.array_equal(info["_landing_error_m"], landed)
        assert (info["landing_error_m"][landed] > 0).all()
        assert (info["landing_error_m"][~landed] == 0).all()
        assert not (landed & terminated).any()
        landings += int(landed.sum())
    assert 4 <= landings <= 8


@pytest.mark.parametrize("stage", [None, Stage(rise_m=0.1, disturbance_level=1.0)])
@pytest.mark.parametrize("make", [gymnasium.make, gymnasium.make_vec])
def test_same_seed_same_episodes_and_another_seed_others(make, stage):
    first, second = make(JVRC1, stage=stage), make(JVRC1, stage=stage)
    one, two = first.reset(seed=3)[0], second.reset(seed=3)[0]
    assert np.array_equal(one, two)
    # Without a seed the next episodes are other ones, and again the same for both.
    after, after_too = first.reset()[0], second.reset()[0]
    assert np.array_equal(after, after_too)
    assert not np.array_equal(one, after)
    assert not np.array_equal(first.reset(seed=4)[0], one)
    assert np.array_equal(first.reset(seed=3)[0], one)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"mode": "jumping"}, "mode 'jumping': choose one of forward, "),
        ({"render_mode": "human"}, "render_mode 'human': choose 'rgb_array' or None"),
        ({"robot": "atlas"}, "no robot 'atlas': choose one of "),
        ({"num_envs": 0}, "num_envs 0 must be at least 1"),
        ({"autoreset_mode": "Disabled"}, "'Disabled': choose 'SameStep' or 'NextStep'"),
    ],
)
def test_what_cannot_be_made_is_told_in_one_line(given, told):
    with pytest.raises(ValueError, match=told) as caught:
        WalkVectorEnv(**given)
    assert "\n" not in str(caught.value)


def test_seeds_that_do_not_fit_are_refused():
    envs: Any = gymnasium.make_vec(JVRC1, num_envs=2)
    with pytest.raises(ValueError, match="3 seeds for 2 robots: give one for each"):
        envs.reset(seed=[1, 2, 3])
    with pytest.raises(ValueError, match="must be 0 or more"):
        envs.reset(seed=[1, -2])


def test_stairs_are_told():
    envs = gymnasium.make_vec(JVRC1, num_envs=2, mode="stairs_up", stage=Stage(rise_m=0.1))
    envs.reset(seed=0)
    info = envs.step(np.zeros((2, 12)))[4]
    assert info["stairs"].tolist() == [True, True]


def test_actions_of_another_shape_or_not_finite_are_refused():
    env = gymnasium.make(JVRC1).unwrapped
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"has shape \(3,\), it must have \(12,\)"):
        env.step(np.zeros(3))
    with pytest.raises(ValueError, match="not finite"):
        env.step(np.full(12, np.nan))
    with pytest.raises(ValueError, match="reset takes no options here, but got pose"):
        env.reset(options={"pose": 1})
    assert env.render() is None


def test_actions_beyond_their_bounds_act_as_those_at_the_bounds():
    seen = []
    env = gymnasium.make(JVRC1).unwrapped
    for offset in (2.0, 1e6):
        env.reset(seed=0)
        seen.append(env.step(np.full(12, offset))[0])
    assert np.array_equal(*seen)


# The code in docs/gymnasium.md, run as it stands.

PAGE = (ROOT / "docs" / "gymnasium.md").read_text(encoding="utf-8")
PIECES = re.findall(r"^```python\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)


@pytest.mark.slow
@pytest.mark.skipif(
    importlib.util.find_spec("stable_baselines3") is None,
    reason="stable-baselines3 is not installed: it comes with the extra `test`",
)
@pytest.mark.parametrize("piece", PIECES, ids=["one robot", "many robots"])
def test_stable_baselines3_learns_on_it_for_a_few_updates(piece):
    assert ".learn(total_timesteps=" in piece
    code = f"{piece}\nprint(learner.num_timesteps, learner._n_updates)"
    done = run_python("-c", code)
    assert done.returncode == 0, done.stderr
    steps, updates = map(int, done.stdout.split())
    assert steps >= 128
    assert updates >= 2


# Gymnasium's `render`, drawn in a process of its own where a GL library is.

DRAW = """
import sys
import cv2
import gymnasium
import numpy as np
from gymnasium.utils.env_checker import check_env
import controller.gym_env
from controller.curriculum import Stage
from controller.env import TaskConfig
from sim.gl import NoGlError

EXACT = TaskConfig(exact_rise=True)
id = "Footfall/Jvrc1-v0"
try:
    env = gymnasium.make(id, render_mode="rgb_array", mode="standing")
except NoGlError as error:
    sys.exit(str(error))
env.reset(seed=0)
pictures = [env.render()]
fold = np.array([-1.0, 0, 0, 2.0, 0, -1.0] * 2)
terminated = False
while not terminated:
    _, _, terminated, _, _ = env.step(fold)
pictures.append(env.render())
env.reset(seed=0)
pictures.append(env.render())
env.close()
envs = gymnasium.make_vec(id, num_envs=2, render_mode="rgb_array", mode="standing")
envs.reset(seed=1)
pictures += envs.render()
envs.close()
climber = gymnasium.make(
    id, render_mode="rgb_array", mode="stairs_up", stage=Stage(rise_m=0.15), config=EXACT
)
climber.reset(seed=0)
pictures.append(climber.render())
climber.close()
cv2.imwrite(sys.argv[1], np.stack(pictures).reshape(-1, 640, 3))
check_env(gymnasium.make(id).unwrapped)
"""


@pytest.fixture(scope="module")
def pictures(tmp_path_factory) -> np.ndarray:
    """Standing, fallen, standing again, two others, before stairs: (6, 480, 640, 3)."""
    path = tmp_path_factory.mktemp("drawn") / "all.png"
    # MuJoCo is not told of a GL library here, as with somebody who has set nothing.
    environment = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}
    drawn_by("-c", DRAW, path, env=environment)
    return picture_at(path).reshape(-1, 480, 640, 3)


RECORD = """
import sys
from types import ModuleType

import av
import gymnasium
import numpy as np
from gymnasium.wrappers.vector import NormalizeObservation, RecordVideo
import controller.gym_env
from controller.env import TaskConfig
from sim.gl import NoGlError


class Clip:
    def __init__(self, frames, fps):
        self.frames, self.fps = frames, fps

    def write_videofile(self, path, logger):
        with av.open(path, "w") as film:
            stream = film.add_stream("mpeg4", rate=self.fps)
            stream.height, stream.width = self.frames[0].shape[:2]
            stream.bit_rate = 8_000_000
            for frame in self.frames:
                film.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
            film.mux(stream.encode(None))


# Gymnasium writes films by MoviePy, which is not among the dependencies.
try:
    import moviepy
except ImportError:
    names = "moviepy", "moviepy.video", "moviepy.video.io", "moviepy.video.io.ImageSequenceClip"
    sys.modules |= {name: ModuleType(name) for name in names}
    sys.modules[names[-1]].ImageSequenceClip = Clip

try:
    envs = gymnasium.make_vec(
        "Footfall/Jvrc1-v0",
        num_envs=2,
        mode="standing",
        render_mode="rgb_array",
        autoreset_mode="NextStep",
        config=TaskConfig(episode_ticks=int(sys.argv[2])),
    )
except NoGlError as error:
    sys.exit(str(error))
films = RecordVideo(NormalizeObservation(envs), sys.argv[1], episode_trigger=lambda episode: True)
films.reset(seed=[3, 4])
seen = [np.hstack(envs.render())]
fold = 0.3 * np.tile([-1.0, 0, 0, 2.0, 0, -1.0], (2, 2))
# Two episodes, and a step in which the second one begins.
for _ in range(2 * int(sys.argv[2]) + 1):
    films.step(fold)
    seen.append(np.hstack(envs.render()))
films.close()
np.save(sys.argv[3], seen)
"""


@pytest.mark.slow
def test_gymnasiums_recorder_films_each_episode_from_its_first_state_to_its_last(tmp_path):
    environment = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}
    seen_file = tmp_path / "seen.npy"
    drawn_by("-c", RECORD, tmp_path / "films", TICKS, seen_file, env=environment)
    seen = np.load(seen_file).reshape(2, TICKS + 1, 480, 2 * 640, 3)
    for episode, pictures in enumerate(seen):
        with av.open(str(tmp_path / "films" / f"rl-video-episode-{episode}.mp4")) as container:
            assert container.streams.video[0].average_rate == 40
            frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
        assert np.shape(frames) == pictures.shape
        # A film is not exact, but each frame is more like its moment than like any other.
        off = [[np.abs(p.astype(int) - f).mean() for p in pictures] for f in frames]
        assert np.argmin(off, axis=1).tolist() == list(range(TICKS + 1))
    assert len(list((tmp_path / "films").iterdir())) == 2


@pytest.mark.slow
def test_a_picture_shows_the_robot_and_both_steps(pictures):
    assert len(pictures) == 6
    standing = pictures[0].astype(int)
    for side in Side:
        colour = 255 * np.array(COLOURS[side][:3])
        assert (np.abs(standing - colour).max(axis=2) < 40).sum() > 20, side


@pytest.mark.slow
def test_the_last_picture_of_an_episode_shows_how_it_ended(pictures):
    standing, fallen, again = pictures[:3].astype(int)
    assert np.abs(standing - again).max() <= 2  # software GL may round a pixel otherwise
    assert (np.abs(standing - fallen).max(axis=2) > 40).sum() > 1000


@pytest.mark.slow
def test_every_robot_of_a_vector_is_drawn(pictures):
    assert (pictures[3] != pictures[4]).any()


@pytest.mark.slow
def test_stairs_are_drawn(pictures):
    # The treads' colour in light, blue green red; nothing else is brown.
    blue, green, red = pictures[5].astype(int).transpose(2, 0, 1)
    assert ((red - blue > 15) & (red - green < 20) & (red > 60)).sum() > 5000
