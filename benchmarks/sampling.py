"""Control steps per second while sampling for training, against bare physics.

    python -m benchmarks.sampling [--robots 256] [--threads 2] [--rounds 5]

Sampling is all that training does between two updates: policy and value networks, observation,
physics, reward, new episodes, and PPO's bookkeeping. Bare physics is `mj_step` alone, called in
C on the same threads: the very same control steps again, from the recorded states and controls.
The two alternate in one run, so that their ratio holds when the machine's speed drifts.
"""

from __future__ import annotations

import argparse
import statistics
import time

import torch

from controller.env import TaskConfig, WalkTask
from controller.policy import load_policy
from controller.ppo import PpoConfig, RslWalkEnv, make_ppo
from sim.robots import get_robot


def main() -> None:
    """Print the medians of both rates and of their ratio."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot", default="jvrc1")
    parser.add_argument("--robots", type=int, default=256)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    robot = get_robot(options.robot)
    torch.set_num_threads(1)
    config = PpoConfig(robots=options.robots)
    for timestep_s in (0.005, 0.0025, 0.001):
        task_config = TaskConfig(timestep_s=timestep_s)
        task = WalkTask(
            robot, count=options.robots, seed=0, threads=options.threads, config=task_config
        )
        env = RslWalkEnv(task)
        ppo = make_ppo(env, config)
        _take_over(ppo, robot)
        rounds = [_round(env, ppo, config) for _ in range(options.rounds)]
        sampling, bare = (statistics.median(column) for column in zip(*rounds, strict=True))
        ratio = statistics.median(a / b for a, b in rounds)
        print(
            f"physics at {1 / timestep_s:5.0f} Hz: sampling {sampling:7.0f} control steps/s, "
            f"bare mj_step {bare:7.0f}, ratio {ratio:.3f} "
            f"({options.rounds} rounds of {config.samples_per_update} steps)"
        )


def _take_over(ppo, robot) -> None:  # type: ignore[no-untyped-def]
    """Give the learner the shipped policy's weights: robots that walk, as late in training.

    A policy of a `SymmetricNetwork` is twice as wide, the network itself in the first half of each
    layer and half of its output; one from before is a network that is mirrored anyway.
    """
    modules = [m for m in ppo.get_policy().mlp.modules() if isinstance(m, torch.nn.Linear)]
    layers = load_policy(robot).layers
    is_wide = layers[0][0].shape[0] == 2 * modules[0].out_features
    with torch.no_grad():
        for module, (weight, bias) in zip(modules, layers, strict=True):
            scale = 2.0 if is_wide and module is modules[-1] else 1.0
            inner = weight[: module.out_features, : module.in_features]
            module.weight.copy_(scale * torch.from_numpy(inner))
            module.bias.copy_(torch.from_numpy(bias[: module.out_features]))


def _round(env: RslWalkEnv, ppo, config: PpoConfig) -> tuple[float, float]:  # type: ignore[no-untyped-def]
    """Rates of sampling and of bare physics over the same control steps."""
    sim = env.task.walker.sim
    batch = sim._batch
    states, controls = [], []
    sampling_s = 0.0
    observation = env.get_observations()
    with torch.inference_mode():
        for _ in range(config.ticks_per_update):
            states.append(batch.state.copy())
            started = time.perf_counter()
            actions = ppo.act(observation)
            observation, rewards, dones, extras = env.step(actions)
            ppo.process_env_step(observation, rewards, dones, extras)
            sampling_s += time.perf_counter() - started
            controls.append(sim._ctrl.copy())
    ppo.storage.clear()
    kept = batch.state.copy()
    bare_s = 0.0
    for state, control in zip(states, controls, strict=True):
        batch.state[:] = state
        sim._ctrl[:] = control
        started = time.perf_counter()
        batch.step(nstep=sim.substeps)
        bare_s += time.perf_counter() - started
    batch.state[:] = kept
    samples = config.samples_per_update
    return samples / sampling_s, samples / bare_s


if __name__ == "__main__":
    main()
