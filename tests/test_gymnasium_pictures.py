"""Gymnasium's `render`, drawn in a process of its own where a GL library is."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from controller.gym_render import COLOURS
from planner.robot_model import Side
from sim.gl import NO_GL

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
    drawing = subprocess.run(
        [sys.executable, "-c", DRAW, str(path)],
        capture_output=True,
        text=True,
        check=False,
        cwd=Path(__file__).resolve().parent.parent,
        env=environment,
    )
    if drawing.returncode == 1 and drawing.stderr.strip() == NO_GL:
        pytest.skip(NO_GL)
    assert drawing.returncode == 0, drawing.stderr
    picture = cv2.imread(str(path))
    assert picture is not None
    return picture.reshape(-1, 480, 640, 3)


def test_a_picture_shows_the_robot_and_both_steps(pictures):
    assert len(pictures) == 6
    standing = pictures[0].astype(int)
    for side in Side:
        colour = 255 * np.array(COLOURS[side][:3])
        assert (np.abs(standing - colour).max(axis=2) < 40).sum() > 20, side


def test_the_last_picture_of_an_episode_shows_how_it_ended(pictures):
    standing, fallen, again = pictures[:3].astype(int)
    assert np.abs(standing - again).max() <= 2  # software GL may round a pixel otherwise
    assert (np.abs(standing - fallen).max(axis=2) > 40).sum() > 1000


def test_every_robot_of_a_vector_is_drawn(pictures):
    assert (pictures[3] != pictures[4]).any()


def test_stairs_are_drawn(pictures):
    # The treads' colour in light, blue green red; nothing else is brown.
    blue, green, red = pictures[5].astype(int).transpose(2, 0, 1)
    assert ((red - blue > 15) & (red - green < 20) & (red > 60)).sum() > 5000
