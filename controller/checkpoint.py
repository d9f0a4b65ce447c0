"""Checkpoints: the state of a training run as a file to resume from."""

from __future__ import annotations

import io
import json
import shutil
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch

from controller.curriculum import Stage
from controller.observation import critic_fields, layout, policy_fields
from controller.ppo import TrainConfig
from maps.files import check_unpacked, from_json, written_whole
from sim.robot import Robot

CHECKPOINT = "checkpoint.pt"
CHECKPOINT_FORMAT = "walk-training/5"
# Checkpoint, the one that replaces it, policy, corpus and log together take a fifth of this.
LEAST_FREE_BYTES = 50_000_000


class TrainingError(ValueError):
    """Training cannot go on as asked; the message is one line."""


@dataclass(frozen=True, kw_only=True)
class Checkpoint:
    """State of a run after `segment` segments, before it trains at `stage`, with `blended` rewards.

    `best_score` is of the best policy so far, `history` has one entry per segment, `learner` is
    the state of PPO.
    """

    segment: int
    stage: Stage
    blended: float
    best_score: tuple[float, ...]
    history: list[dict[str, Any]]
    learner: dict[str, Any]


def require_room(folder: Path) -> None:
    """Raises TrainingError where the disk of a folder is too full for a run to go on.

    Later is too late: TensorBoard writes in a thread of its own, which ends in a traceback.
    """
    free = shutil.disk_usage(folder).free
    if free < LEAST_FREE_BYTES:
        raise TrainingError(
            f"too little disk: {free / 1e6:.0f} MB are free in {folder}, "
            f"a run needs {LEAST_FREE_BYTES / 1e6:.0f} MB"
        )


def write_checkpoint(folder: Path, config: TrainConfig, robot: Robot, state: Checkpoint) -> None:
    """Write a checkpoint, under a temporary name first.

    Raises:
        OSError: it cannot be written; the one that was there stays.
    """
    document = {
        "format": CHECKPOINT_FORMAT,
        "config": json.dumps(asdict(config)),
        "layout": json.dumps(_layout(robot)),
        "segment": state.segment,
        "stage": asdict(state.stage),
        "blended": state.blended,
        "best_score": list(state.best_score),
        "history": json.dumps(state.history),
        "learner": state.learner,
    }
    # Through memory, so that a full disk is an OSError and not an error of torch's own.
    content = io.BytesIO()
    torch.save(document, content)
    folder.mkdir(parents=True, exist_ok=True)
    with written_whole(folder / CHECKPOINT) as temporary:
        temporary.write_bytes(content.getbuffer())


def read_checkpoint(folder: Path, config: TrainConfig, robot: Robot) -> Checkpoint:
    """The folder's checkpoint.

    Raises:
        TrainingError: there is none, it cannot be read, or it is of another configuration,
            observation or robot.
    """
    path = folder / CHECKPOINT
    if not path.is_file():
        raise TrainingError(f"{folder} holds no {CHECKPOINT} to resume from")
    try:
        with path.open("rb") as file:
            check_unpacked(file)
            with zipfile.ZipFile(file) as archive:
                if archive.testzip() is not None:  # torch does not look at the checksums
                    raise zipfile.BadZipFile
        # To the CPU: a run on a GPU may go on without one.
        document = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:
        # torch's own message is many lines of advice that does not apply here.
        raise TrainingError(f"{path} cannot be read: it is damaged or no checkpoint") from error
    if not isinstance(document, Mapping) or document.get("format") != CHECKPOINT_FORMAT:
        raise TrainingError(f"{path} is not a {CHECKPOINT_FORMAT} checkpoint")
    try:
        _check_config(folder, config, from_json(document["config"]))
        _check_layout(path, robot, from_json(document.get("layout", "null")))
        state = Checkpoint(
            segment=document["segment"],
            stage=Stage(**document["stage"]),
            blended=document["blended"],
            best_score=tuple(document["best_score"]),
            history=from_json(document["history"]),
            learner=document["learner"],
        )
        _check_progress(config, state)
        return state
    except TrainingError:
        raise
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise TrainingError(f"{path} is damaged: {error!r}") from error


def _check_progress(config: TrainConfig, state: Checkpoint) -> None:
    """Raises ValueError or TypeError for what no run of these settings comes to."""
    if state.segment != len(state.history) or type(state.segment) is not int:
        raise ValueError(f"segment {state.segment!r} with a history of {len(state.history)}")
    for line in state.history:
        if not line.keys() >= {"assess", "assess_stairs", "rise_m"}:
            raise ValueError("a segment that was not assessed")
    for value, most in (
        (state.stage.rise_m, config.curriculum.top_rise_m),
        (state.stage.disturbance_level, 1.0),
    ):
        if not 0 <= value <= most:
            raise ValueError(f"{value} is not from 0 to {most}, in {state.stage}")
    if not 0 <= state.blended <= 1:
        raise ValueError(f"rewards blended by {state.blended}, which is not from 0 to 1")
    if not all(isinstance(part, int | float) and part == part for part in state.best_score):
        raise ValueError(f"a best score of {state.best_score}")


def _check_config(folder: Path, config: TrainConfig, theirs: Mapping[str, Any]) -> None:
    mine = json.loads(json.dumps(asdict(config)))
    differing = [key for key in mine if mine[key] != theirs.get(key) and key != "samples"]
    if differing:
        raise TrainingError(
            f"{folder / CHECKPOINT} was made with other settings ({', '.join(differing)}): resume "
            f"with those of {folder / 'config.json'} or choose another folder"
        )


def _layout(robot: Robot) -> dict[str, Any]:
    """Meaning of the inputs and outputs of the networks."""
    return {
        "observation": layout(policy_fields(robot)),
        "critic": layout(critic_fields()),
        "joints": [joint.name for joint in robot.joints],
        **({"robot_digest": robot.digest} if robot.digest else {}),
    }


def _check_layout(path: Path, robot: Robot, theirs: Mapping[str, Any] | None) -> None:
    """Compare, unless the checkpoint is from before layouts were stored."""
    mine = json.loads(json.dumps(_layout(robot)))
    for key, value in mine.items():
        if theirs is not None and theirs.get(key) != value:
            raise TrainingError(
                f"{path} is from another layout: its {key} is {theirs.get(key)}, "
                f"{robot.name} has {value}"
            )
