"""Policies: a small network evaluated in numpy, and its two files.

`NAME.safetensors` holds the weights; `NAME.json` beside it the robot, observation layout,
normaliser, MuJoCo version and record of training. Nothing is unpickled, and torch is not needed.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from controller.observation import layout, normaliser, policy_fields
from maps.files import read_json, read_limited, written_whole
from sim.robot import Robot

if TYPE_CHECKING:
    from controller.walker import Walker

FORMAT = "footstep-policy/1"
POLICY_FOLDER = Path(__file__).parent / "policies"
MOST_WEIGHTS_BYTES = 100_000_000


class PolicyError(ValueError):
    """The policy file is missing, broken, or made for something else."""


@dataclass(frozen=True, kw_only=True, repr=False)
class Policy:
    """Layers of (weight (out, in), bias (out,)) with ReLU between, normaliser, and metadata."""

    layers: tuple[tuple[np.ndarray, np.ndarray], ...]
    offset: np.ndarray
    scale: np.ndarray
    about: dict[str, Any]

    def __repr__(self) -> str:
        inputs, samples = len(self.offset), self.about.get("trained", {}).get("samples", 0)
        return f"Policy({self.about['robot']}: {inputs} inputs, {samples / 1e6:.1f} M samples)"

    @property
    def is_paced(self) -> bool:
        """Whether it observes step durations; if not, it walks at the robot's own gait."""
        return [str(name) for name, _ in self.about["observation"]][-1] == "step_s"

    def step_range_s(self, robot: Robot) -> tuple[float, float]:
        """Shortest and longest duration of a step that it is known to be trained for."""
        if not self.is_paced or "trained" not in self.about:
            return robot.gait.step_s, robot.gait.step_s
        shortest_s, longest_s = self.about["trained"]["config"]["task"]["step_s"]
        return float(shortest_s), float(longest_s)

    def require_pace(self, robot: Robot, step_s: ArrayLike) -> None:
        """Checks that it can take steps of these durations.

        Raises:
            PolicyError: it was not trained to; the message says what it can do.
        """
        low_s, high_s = self.step_range_s(robot)
        least_s, most_s = float(np.min(step_s)), float(np.max(step_s))
        if least_s < low_s - 1e-6 or most_s > high_s + 1e-6:
            what = (
                f"was trained on steps of {low_s:g} to {high_s:g} s"
                if self.is_paced
                else f"knows the gait of {robot.name} alone, {low_s:g} s a step"
            )
            raise PolicyError(
                f"steps of {least_s:g} to {most_s:g} s: this policy {what}; "
                "walk at --pace normal, or train one that sees the durations of steps"
            )

    def start(self, walker: Walker) -> Callable[[], np.ndarray]:
        """A function that advances the walker by one control step, as `Walker.act` does."""
        return lambda: walker.act(self.act(walker.observe()))

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Actions (B, J) in rad for observations (B, N) as they come from `observe`."""
        seen = observation[..., : len(self.offset)]
        return self.act_scaled((seen - self.offset) / self.scale)

    def act_scaled(self, observation: np.ndarray) -> np.ndarray:
        """Actions (B, J) for observations (B, N) that are scaled already."""
        # Older policies ignore the fields that were appended to the observation since.
        values = observation[..., : self.layers[0][0].shape[1]].astype(np.float32)
        for weight, bias in self.layers[:-1]:
            values = np.maximum(values @ weight.T + bias, 0.0)
        weight, bias = self.layers[-1]
        return np.asarray(values @ weight.T + bias, dtype=np.float64)


def own_policy_path(robot: Robot) -> Path:
    """Where the robot's own policy is: among those that come along, or beside the robot's file.

    Where there is none, that of the robot `trained_as`.
    """
    path = (robot.folder or POLICY_FOLDER) / f"{robot.name}.safetensors"
    if robot.trained_as and not path.is_file():
        return path.with_stem(robot.trained_as)
    return path


def policy_for(
    robot: Robot, layers: tuple[tuple[np.ndarray, np.ndarray], ...], **about: Any
) -> Policy:
    """A policy of these layers for the robot, with its present observation."""
    fields = policy_fields(robot)
    offset, scale = normaliser(fields)
    facts = {
        "format": FORMAT,
        "robot": robot.name,
        "joints": [joint.name for joint in robot.joints],
        "observation": layout(fields),
        **({"robot_digest": robot.digest} if robot.digest else {}),
        **about,
    }
    return Policy(layers=layers, offset=offset, scale=scale, about=facts)


def save_policy(policy: Policy, path: Path) -> None:
    """Write path (.safetensors) and the JSON beside it, each under a temporary name first."""
    from safetensors.numpy import save

    tensors = {}
    for k, (weight, bias) in enumerate(policy.layers):
        tensors[f"layer{k}.weight"] = np.ascontiguousarray(weight, dtype=np.float32)
        tensors[f"layer{k}.bias"] = np.ascontiguousarray(bias, dtype=np.float32)
    content = save(tensors)
    about = {
        **policy.about,
        "sha256": hashlib.sha256(content).hexdigest(),
        "normaliser": {"offset": policy.offset.tolist(), "scale": policy.scale.tolist()},
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    with (
        written_whole(path.with_suffix(".safetensors")) as weights,
        written_whole(path.with_suffix(".json")) as facts,
    ):
        weights.write_bytes(content)
        facts.write_bytes((json.dumps(about, indent=1) + "\n").encode())


def load_policy(robot: Robot, path: Path | None = None) -> Policy:
    """The policy at path (.safetensors), by default the robot's own.

    Raises:
        PolicyError: it is not there, cannot be read, or was made for another robot or
            observation; the message says which.
    """
    from safetensors import SafetensorError
    from safetensors.numpy import load

    path = path or own_policy_path(robot)
    about_path = path.with_suffix(".json")
    if not path.is_file():
        if path.is_dir():
            raise PolicyError(f"policy {path}: a folder; name the file in it, NAME.safetensors")
        raise PolicyError(f"no policy file {path}: train one or name another with --policy")
    if not about_path.is_file():
        raise PolicyError(f"policy {path}: no {about_path.name} beside it; keep the two together")
    try:
        content = read_limited(path, MOST_WEIGHTS_BYTES)
        tensors = load(content)
        about = read_json(about_path)
        offset, scale = (np.array(about["normaliser"][k], float) for k in ("offset", "scale"))
        depth = len(tensors) // 2
        layers = tuple(
            (tensors[f"layer{k}.weight"], tensors[f"layer{k}.bias"]) for k in range(depth)
        )
        policy = Policy(layers=layers, offset=offset, scale=scale, about=about)
        _check(robot, path, policy, hashlib.sha256(content).hexdigest())
    except PolicyError:
        raise
    except (SafetensorError, LookupError, TypeError, ValueError, AttributeError, OSError) as error:
        raise PolicyError(f"policy {path} cannot be read ({error}): it is damaged") from error
    return policy


def _check(robot: Robot, path: Path, policy: Policy, digest: str) -> None:
    """Raises PolicyError unless it is for this robot; other errors tell that it is damaged."""
    about, layers = policy.about, policy.layers
    fields = policy_fields(robot)
    if about.get("observation") == layout(fields[:-1]):
        fields = fields[:-1]  # older: without the durations of the steps
    is_stand_in = robot.trained_as and about.get("robot") == robot.trained_as
    expected = {
        "format": FORMAT,
        "robot": robot.trained_as if is_stand_in else robot.name,
        "joints": [joint.name for joint in robot.joints],
        "observation": layout(fields),
        "sha256": digest,
    }
    for key, value in expected.items():
        if about.get(key) != value:
            raise PolicyError(
                f"policy {path} does not fit: its {key} is {about.get(key)}, "
                f"{robot.name} needs {value}"
            )
    inputs, outputs = sum(field.width for field in fields), len(robot.joints)
    widths = [inputs, *(bias.size for _, bias in layers)]
    wanted = list(zip(widths[1:], widths, strict=False))
    if [weight.shape for weight, _ in layers] != wanted or widths[-1] != outputs or not layers:
        raise PolicyError(
            f"policy {path} does not fit: it maps {widths} numbers, {inputs} must become {outputs}"
        )
    known = about.get("robot_digest", robot.digest)
    if known != robot.digest:
        mine = f"that of {robot.option}" if robot.digest else f"the {robot.name} that comes along"
        raise PolicyError(
            f"policy {path} does not fit: it was trained for the robot file of {robot.name} with "
            f"the digest {str(known)[:12]}, which is not {mine}"
            + (f", {robot.digest[:12]}" if robot.digest else "")
            + "; take that file back, or train for this one"
        )
    arrays = [*(array for layer in layers for array in layer), policy.offset, policy.scale]
    if not all(np.isfinite(array).all() for array in arrays):
        raise PolicyError(f"policy {path} has numbers that are not finite: it is damaged")
    if {policy.offset.shape, policy.scale.shape} != {(inputs,)} or not policy.scale.all():
        raise ValueError(f"the normaliser must have {inputs} offsets, and scales other than 0")
    policy.step_range_s(robot)
