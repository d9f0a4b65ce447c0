"""Images of a policy on flights of stairs as in training, one row per flight.

    python -m docs.make.stairs_picture --image stairs.png [--policy NAME.safetensors] [--rise 0.1]

Plates show the present and the next step, blue for the left foot. The flights are held out:
training uses other seeds.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

from app.output import write_picture
from app.pictures.film import tile
from controller.curriculum import Stage
from controller.env import TaskConfig
from controller.gym_env import GymTask
from controller.gym_render import HEIGHT, WIDTH
from controller.policy import Policy, load_policy
from sim.robots import get_robot

MODES = ("stairs_over", "stairs_curved")
MOMENTS = 6
SHOWN_TICKS = 520


def main() -> None:
    """Walk the flights and write the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--image", type=Path, required=True)
    parser.add_argument("--robot", default="jvrc1")
    parser.add_argument("--policy", type=Path)
    parser.add_argument("--rise", type=float, default=0.10)
    parser.add_argument("--seed", type=int, default=39)
    options = parser.parse_args()
    policy = load_policy(get_robot(options.robot), options.policy)
    pictures = [
        picture
        for mode in MODES
        for picture in moments(options.robot, policy, mode, options.rise, options.seed)
    ]
    write_picture(options.image, tile(pictures, MOMENTS)[:, :, ::-1])


def moments(robot: str, policy: Policy, mode: str, rise_m: float, seed: int) -> list[np.ndarray]:
    """Moments of one walk, evenly spread, each (HEIGHT / 2, WIDTH / 2, 3), red green blue."""
    task = GymTask(
        robot,
        mode=mode,
        config=TaskConfig(exact_rise=True, episode_ticks=SHOWN_TICKS + 2),
        stage=Stage(rise_m=rise_m),
        render_mode="rgb_array",
    )
    task.restart(np.random.SeedSequence([20_000 + seed]))
    shown = set(np.linspace(60, SHOWN_TICKS, MOMENTS).astype(int))
    pictures, observation = [], task.observe()
    for tick in range(SHOWN_TICKS + 1):
        if tick in shown:
            picture = task.pictures()[0]
            # Half size, as the renderer does not smooth edges.
            pictures.append(
                cv2.resize(picture, (WIDTH // 2, HEIGHT // 2), None, 0, 0, cv2.INTER_AREA)
            )
        step = task.step(policy.act(task.unscaled(observation)))
        if step.terminated.any():
            raise RuntimeError(f"the robot fell at tick {tick} of {mode}, seed {seed}")
        observation = step.observation
    task.close()
    return pictures


if __name__ == "__main__":
    main()
