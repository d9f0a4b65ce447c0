"""What a sample of training costs in CPU time, by part, and what follows for more cores.

    python -m benchmarks.scale [--robot jvrc1] [--robots 256,32] [--ticks 64]

One process, one thread: CPU time of the process is what counts, so that other load on the machine
hardly matters. For each number of robots it trains one update and prints microseconds of CPU per
sample for the physics (`mj_step` and its sensors), the networks, the rest of a control step
(observation, reward, new episodes, PPO's storage) and the learner, and the memory per robot.
docs/scale.md has the formulas that these figures go into.
"""

from __future__ import annotations

import argparse
import resource
import time
from collections import Counter
from pathlib import Path

import torch

from controller.curriculum import Stage
from controller.env import WalkTask
from controller.ppo import PpoConfig, RslWalkEnv, make_ppo
from sim.robots import get_robot


def main() -> None:
    """Print a line for each number of robots."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot", default="jvrc1")
    parser.add_argument("--robots", default="256,32")
    parser.add_argument("--ticks", type=int, default=64)
    options = parser.parse_args()
    torch.set_num_threads(1)
    for count in map(int, options.robots.split(",")):
        config = PpoConfig(robots=count, ticks_per_update=options.ticks, learner_threads=1)
        before_mb = _resident_mb()
        env, spent = _timed_env(options.robot, count)
        ppo = make_ppo(env, config)
        observation = env.get_observations()
        began = time.process_time()
        with torch.inference_mode():
            for _ in range(config.ticks_per_update):
                networks = time.process_time()
                actions = ppo.act(observation)
                spent["networks"] += time.process_time() - networks
                observation, rewards, dones, extras = env.step(actions)
                ppo.process_env_step(observation, rewards, dones, extras)
            ppo.compute_returns(observation)
        sampled = time.process_time()
        ppo.update()
        learned = time.process_time()
        spent["rest"] = sampled - began - spent["physics"] - spent["networks"]
        spent["learner"] = learned - sampled
        samples = config.samples_per_update
        parts = ", ".join(
            f"{name} {1e6 * spent[name] / samples:.0f}"
            for name in ("physics", "networks", "rest", "learner")
        )
        grown_mb = _resident_mb() - before_mb
        most_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(
            f"{count} robots: {parts} us of CPU a sample; memory {grown_mb:.0f} MB for them, "
            f"{most_mb:.0f} MB at most in all",
            flush=True,
        )


def _timed_env(robot: str, count: int) -> tuple[RslWalkEnv, Counter[str]]:
    """Robots on flat ground and on stairs, and the CPU time of their physics as it grows."""
    task = WalkTask(get_robot(robot), count=count, seed=0, stage=Stage(rise_m=0.1))
    spent: Counter[str] = Counter()
    sim, advance = task.walker.sim, task.walker.sim._advance

    def timed(*arguments: object) -> None:
        began = time.process_time()
        advance(*arguments)  # type: ignore[arg-type]
        spent["physics"] += time.process_time() - began  # type: ignore[assignment]

    sim._advance = timed  # type: ignore[method-assign]
    return RslWalkEnv(task), spent


def _resident_mb() -> float:
    """Memory of this process now; Linux only."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 1e6


if __name__ == "__main__":
    main()
