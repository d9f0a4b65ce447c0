"""rsl-rl's PPO on the walking task: adapter, settings of the learner and of a whole run."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import torch
from rsl_rl.algorithms import PPO
from rsl_rl.env import VecEnv
from tensordict import TensorDict

from controller.curriculum import Curriculum
from controller.env import TaskConfig, WalkTask
from controller.observation import SCALED_LIMIT, critic_fields, mirror_map, policy_fields
from controller.rewards import RewardSchedule

MirrorMap = tuple[np.ndarray, np.ndarray]
Layers = tuple[tuple[np.ndarray, np.ndarray], ...]  # (weight, bias) of each


@dataclass(frozen=True, kw_only=True)
class PpoConfig:
    """Settings of PPO. Learning rate and noise change linearly from first to last value.

    `symmetric` networks treat left and right alike; without `half_sitting_offset` the first actions
    ask for joints at 0 instead of half-sitting. Both are only ever switched off to show what they
    are for.
    """

    robots: int = 256
    ticks_per_update: int = 64
    hidden: tuple[int, ...] = (256, 256)
    epochs: int = 4
    minibatches: int = 8
    learning_rate: tuple[float, float] = (3e-4, 7e-5)
    action_std_rad: tuple[float, float] = (0.223, 0.08)
    gamma: float = 0.99
    lam: float = 0.95
    clip: float = 0.2
    learner_threads: int = 2
    symmetric: bool = True
    half_sitting_offset: bool = True

    @property
    def samples_per_update(self) -> int:
        """Control steps of all robots between two updates."""
        return self.robots * self.ticks_per_update


class RslWalkEnv(VecEnv):  # type: ignore[misc]
    """The walking task as rsl-rl sees it; observations are scaled and in float32.

    The simulations are on the CPUs, the tensors on the `device` of the networks.
    """

    def __init__(self, task: WalkTask, device: torch.device | str = "cpu"):
        self.task = task
        self.num_envs = task.count
        self.num_actions = len(task.robot.joints)
        self.max_episode_length = task.config.episode_ticks
        self.episode_length_buf = torch.zeros(task.count, dtype=torch.long)
        self.device = device
        self.cfg = asdict(task.config)

    def get_observations(self) -> TensorDict:
        """The present observations."""
        observation = self.task.observe()
        return self._pack(observation, self.task.critic_observe())

    def step(self, actions: torch.Tensor) -> tuple[TensorDict, torch.Tensor, torch.Tensor, dict]:
        """One control step of every robot; `extras` holds the task's `Transition`."""
        step = self.task.step(actions.cpu().numpy().astype(np.float64))
        done = self._tensor(step.terminated | step.truncated).long()
        extras = {"time_outs": self._tensor(step.truncated).float(), "transition": step}
        observation = self._pack(step.observation, step.critic_observation)
        return observation, self._tensor(step.reward).float(), done, extras

    def _pack(self, observation: np.ndarray, critic_observation: np.ndarray) -> TensorDict:
        return TensorDict(
            {"actor": self._limited(observation), "critic": self._limited(critic_observation)},
            batch_size=[self.num_envs],
        )

    def _limited(self, observation: np.ndarray) -> torch.Tensor:
        return self._tensor(np.clip(observation, -SCALED_LIMIT, SCALED_LIMIT)).float()

    def _tensor(self, array: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(array).to(self.device)


class SymmetricNetwork(torch.nn.Module):
    """The mean of a network and its mirror image, so that left and right are alike by design.

    With M that mirrors observations x and N that mirrors outputs, each an (index, sign) pair as
    from `mirror_map`: (f(x) + N f(M x)) / 2.
    """

    _index: torch.Tensor
    _sign: torch.Tensor
    _output_index: torch.Tensor
    _output_sign: torch.Tensor

    def __init__(self, network: torch.nn.Module, observed: MirrorMap, output: MirrorMap):
        super().__init__()
        self.network = network
        # Buffers move with the network to its device; they are no part of what is saved.
        for name, (index, sign) in (("", observed), ("_output", output)):
            self.register_buffer(f"{name}_index", torch.from_numpy(index), persistent=False)
            self.register_buffer(f"{name}_sign", torch.from_numpy(sign).float(), persistent=False)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """Outputs (n, J) for scaled observations (n, N)."""
        mirrored = observation[:, self._index] * self._sign
        output, image = self.network(torch.cat([observation, mirrored])).chunk(2)
        return 0.5 * (output + image[:, self._output_index] * self._output_sign)

    def layers(self) -> Layers:
        """It as one plain network of twice the width."""
        (first, first_bias), *middle, (last, last_bias) = plain_layers(self.network)
        image = np.zeros_like(first)
        image[:, self._index.cpu().numpy()] = first * self._sign.cpu().numpy()
        index, sign = self._output_index.cpu().numpy(), self._output_sign.cpu().numpy()
        return (
            (np.vstack([first, image]), np.tile(first_bias, 2)),
            *((np.kron(np.eye(2, dtype=w.dtype), w), np.tile(b, 2)) for w, b in middle),
            (
                0.5 * np.hstack([last, last[index] * sign[:, None]]),
                0.5 * (last_bias + last_bias[index] * sign),
            ),
        )


def plain_layers(network: torch.nn.Module) -> Layers:
    """A network as linear layers with ReLU between, a symmetric one twice as wide."""
    if isinstance(network, SymmetricNetwork):
        return network.layers()
    linear = [part for part in network.modules() if isinstance(part, torch.nn.Linear)]
    arrays = [(part.weight, part.bias) for part in linear]
    return tuple((w.detach().cpu().numpy(), b.detach().cpu().numpy()) for w, b in arrays)


class RankedPPO(PPO):  # type: ignore[misc]
    """PPO that normalises the advantages over the samples of all ranks, as one process does."""

    def compute_returns(self, obs: TensorDict) -> None:
        """Returns and advantages of the rollout, given the observations after it."""
        super().compute_returns(obs)
        if not self.is_multi_gpu:
            return
        advantages = (self.storage.returns - self.storage.values).double()
        sums = torch.stack([advantages.sum(), advantages.square().sum()])
        torch.distributed.all_reduce(sums)
        count = advantages.numel() * self.gpu_world_size
        mean = sums[0] / count
        std = ((sums[1] - count * mean**2) / (count - 1)).sqrt()
        self.storage.advantages = ((advantages - mean) / (std + 1e-8)).float()


def make_ppo(env: RslWalkEnv, config: PpoConfig, multi_gpu: Mapping[str, int] | None = None) -> PPO:
    """A new learner for the environment; weights are drawn from torch's generator.

    With several ranks, as `Ranks.multi_gpu` tells, it has the weights of rank 0 and averages its
    gradients over all; rsl-rl calls them GPUs, here they may be CPUs.
    """
    network = {"class_name": "MLPModel", "hidden_dims": list(config.hidden), "activation": "relu"}
    noise = {
        "class_name": "GaussianDistribution",
        "init_std": config.action_std_rad[0],
        "learn_std": False,
    }
    settings = {
        "algorithm": {
            "class_name": RankedPPO,
            "num_learning_epochs": config.epochs,
            "num_mini_batches": config.minibatches,
            "learning_rate": config.learning_rate[0],
            "schedule": "fixed",
            "desired_kl": None,
            "gamma": config.gamma,
            "lam": config.lam,
            "clip_param": config.clip,
            "entropy_coef": 0.0,
        },
        "actor": {**network, "distribution_cfg": noise},
        "critic": dict(network),
        "obs_groups": {"actor": ["actor"], "critic": ["critic"]},
        "num_steps_per_env": config.ticks_per_update,
        "multi_gpu": multi_gpu,
    }
    with contextlib.redirect_stdout(io.StringIO()):  # it prints its networks
        ppo = PPO.construct_algorithm(env.get_observations(), env, settings, str(env.device))
    robot = env.task.robot
    seen, alone = policy_fields(robot), (np.array([0]), np.array([1.0]))
    if not config.half_sitting_offset:
        # An action is an offset from half-sitting: so its mean begins where the joints are at 0.
        *_, last = (part for part in ppo.actor.mlp.modules() if isinstance(part, torch.nn.Linear))
        with torch.no_grad():
            last.bias.sub_(torch.from_numpy(robot.half_sitting_rad).float())
    if config.symmetric:
        ppo.actor.mlp = SymmetricNetwork(ppo.actor.mlp, mirror_map(seen), robot.mirror_joints)
        ppo.critic.mlp = SymmetricNetwork(ppo.critic.mlp, mirror_map(seen + critic_fields()), alone)
    for model in (ppo.actor, ppo.critic):
        model.to(env.device)
    if multi_gpu is not None:
        ppo.broadcast_parameters()
    return ppo


def set_progress(ppo: PPO, config: PpoConfig, share: float) -> None:
    """Set learning rate and action noise for the `share` in [0, 1] of the run that is done."""

    def between(ends: tuple[float, float]) -> float:
        return ends[0] + (ends[1] - ends[0]) * min(share, 1.0)

    ppo.learning_rate = between(config.learning_rate)
    for group in ppo.optimizer.param_groups:
        group["lr"] = ppo.learning_rate
    with torch.no_grad():
        ppo.actor.distribution.std_param.fill_(between(config.action_std_rad))


def load_learner(ppo: PPO, state: Mapping[str, Any]) -> None:
    """Take up the state that `ppo.save()` gave of a learner of the same networks.

    Raises:
        ValueError, LookupError, TypeError, AttributeError: it is not of the same networks, or not
            whole.
        FloatingPointError: it holds numbers that no training gives: nan, inf or negative squares.
    """
    mine = ppo.save()
    models, optimizer = ("actor_state_dict", "critic_state_dict"), state["optimizer_state_dict"]
    for model in models:
        _check_tensors(state[model], mine[model])
    (group,), (theirs,) = ppo.optimizer.param_groups, optimizer["param_groups"]
    # The learning rate follows from the share of the run that is done: `set_progress`.
    kept = group.keys() & theirs.keys() - {"params", "lr"}
    if any(type(theirs[key]) is not type(group[key]) for key in kept) or any(
        theirs[key] != group[key] for key in kept
    ):
        raise ValueError("its optimizer has other settings")
    numbers = mine["optimizer_state_dict"]["param_groups"][0]["params"]
    if theirs["params"] != numbers or not isinstance(theirs["lr"], float):
        raise ValueError("its optimizer has other parameters")
    for number, moments in optimizer["state"].items():
        parameter = group["params"][numbers.index(number)]
        squares = torch.zeros_like(parameter)
        _check_tensors(
            moments,
            {"step": torch.tensor(0.0), "exp_avg": squares, "exp_avg_sq": squares},
        )
        if min(moments["step"].item(), moments["exp_avg_sq"].min().item()) < 0:
            raise FloatingPointError("its optimizer holds negative squares")
    ppo.load(state, None, True)


def _check_tensors(theirs: Mapping[str, torch.Tensor], mine: Mapping[str, torch.Tensor]) -> None:
    """Holds tensors to names, shapes and types before their numbers are read.

    A small file can claim tensors of any size.
    """
    if theirs.keys() != mine.keys():
        raise ValueError("its networks have other parts")
    for name, wanted in mine.items():
        tensor = theirs[name]
        if (tensor.shape, tensor.dtype, tensor.layout) != (
            wanted.shape,
            wanted.dtype,
            wanted.layout,
        ):
            raise ValueError(f"its {name} is {tuple(tensor.shape)}, not {tuple(wanted.shape)}")
    if not all(bool(torch.isfinite(tensor).all()) for tensor in theirs.values()):
        raise FloatingPointError("it holds numbers that are not finite")


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """Settings of a whole run. `samples` are control steps of single robots.

    `corpus` is the digest of the planner's corpus used in training, empty for none. A run with
    `warm_up` begins with these reward weights and blends to the task's: see `RewardSchedule`.
    """

    robot: str = "jvrc1"
    samples: int = 16_000_000
    seed: int = 0
    corpus: str = ""
    warm_up: Mapping[str, float] | None = None
    updates_per_segment: int = 20
    assess_episodes: int = 128
    curriculum: Curriculum = field(default_factory=Curriculum)
    task: TaskConfig = field(default_factory=TaskConfig)
    ppo: PpoConfig = field(default_factory=PpoConfig)

    @property
    def samples_per_segment(self) -> int:
        """Control steps between two checkpoints."""
        return self.updates_per_segment * self.ppo.samples_per_update

    @property
    def rewards(self) -> RewardSchedule:
        """Weights of the reward over the run."""
        first = self.task.reward if self.warm_up is None else self.warm_up
        return RewardSchedule(first=first, last=self.task.reward)

    @property
    def segments(self) -> int:
        """Segments of the run, rounded up to cover `samples`."""
        return -(-self.samples // self.samples_per_segment)
