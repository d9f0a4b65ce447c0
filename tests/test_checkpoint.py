"""The checkpoint of a run: what is refused, in one line, and what outlives a full disk."""

from __future__ import annotations

import errno
import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from controller.checkpoint import CHECKPOINT, TrainingError, read_checkpoint
from controller.ppo import PpoConfig, TrainConfig
from controller.runner import Trainer
from sim.robots import get_robot

SMALL = TrainConfig(
    samples=256,
    updates_per_segment=2,
    ppo=PpoConfig(robots=2, ticks_per_update=32, hidden=(8,), minibatches=2),
)


@pytest.fixture(scope="module")
def trainer(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    return Trainer(get_robot("jvrc1"), SMALL, folder, threads=1, command="test")


@pytest.fixture
def saved(trainer):
    """The trainer with its checkpoint as it was at the start."""
    trainer.segment = 0
    trainer.save_checkpoint()
    return trainer


def change(trainer, **values):
    """Put other values into the checkpoint; None takes the key out."""
    path = trainer.out / CHECKPOINT
    document = torch.load(path, weights_only=True)
    document.update(values)
    torch.save({key: value for key, value in document.items() if value is not None}, path)


def refusal(trainer) -> str:
    with pytest.raises(TrainingError) as raised:
        trainer.resume()
    message = str(raised.value)
    assert "\n" not in message
    return message


def test_checkpoint_of_another_layout_is_refused_saying_what_differs(saved):
    layout = json.loads(torch.load(saved.out / CHECKPOINT, weights_only=True)["layout"])
    assert layout["observation"][0] == ["roll_pitch_rad", 2]
    layout["observation"][0] = ["pitch_roll_rad", 2]
    change(saved, layout=json.dumps(layout))
    message = refusal(saved)
    assert "is from another layout: its observation is [['pitch_roll_rad', 2]" in message
    assert "jvrc1 has [['roll_pitch_rad', 2]" in message


def test_checkpoint_from_before_layouts_were_stored_is_taken(saved):
    change(saved, layout=None)
    saved.resume()
    assert read_checkpoint(saved.out, SMALL, saved.robot).segment == 0


def test_networks_of_another_size_are_refused(saved):
    learner = torch.load(saved.out / CHECKPOINT, weights_only=True)["learner"]
    key = next(k for k, v in learner["actor_state_dict"].items() if v.ndim == 2)
    learner["actor_state_dict"][key] = torch.zeros(8, 40)
    change(saved, learner=learner, layout=None)
    assert "its networks do not fit jvrc1 as it is now" in refusal(saved)


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"format": "walk-training/1"}, "is not a walk-training/3 checkpoint"),
        ({"stage": None}, "is damaged: KeyError('stage')"),
        ({"stage": {"rise": 0.1}}, "is damaged"),
        ({"config": "{"}, "is damaged"),
        ({"learner": {}}, "its networks do not fit"),
    ],
)
def test_damaged_checkpoint_is_refused(saved, values, told):
    change(saved, **values)
    assert told in refusal(saved)


def test_file_that_is_no_checkpoint_is_refused(saved):
    path = saved.out / CHECKPOINT
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    assert "it is damaged or no checkpoint" in refusal(saved)
    torch.save([1, 2], path)
    assert "is not a walk-training/3 checkpoint" in refusal(saved)


def test_other_settings_are_named(saved):
    robot = get_robot("jvrc1")
    with pytest.raises(TrainingError, match=r"other settings \(seed, corpus\): resume with those"):
        read_checkpoint(saved.out, replace(SMALL, seed=1, corpus="x"), robot)
    longer = replace(SMALL, samples=4000)  # a run may be made longer
    assert read_checkpoint(saved.out, longer, robot).segment == 0


def run_of(trainer, monkeypatch, writes):
    """A run whose segments cost nothing, each the best so far; tells what is written when."""

    def segment(writer):
        trainer.segment += 1
        return SimpleNamespace(best=True)

    real = Path.write_bytes

    def write_bytes(path, content):
        writes.append(path.name)
        if len(writes) > 5:
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(path, content)

    monkeypatch.setattr(trainer, "_run_segment", segment)
    monkeypatch.setattr(Path, "write_bytes", write_bytes)
    trainer.run(lambda report: None)


def test_full_disk_ends_the_run_in_one_line_and_keeps_the_last_checkpoint(saved, monkeypatch):
    """The policy comes before the checkpoint: a run killed between them writes it once more."""
    writes: list[str] = []
    with pytest.raises(TrainingError, match="No space left on device; make room") as raised:
        run_of(saved, monkeypatch, writes)
    assert "\n" not in str(raised.value)
    policy = ["jvrc1.safetensors.tmp", "jvrc1.json.tmp", "checkpoint.pt.tmp"]
    assert writes == policy * 2
    assert read_checkpoint(saved.out, SMALL, saved.robot).segment == 1
    assert not (saved.out / "checkpoint.pt.tmp").exists()


def test_run_stops_before_the_disk_is_full(saved, monkeypatch):
    free = iter([60_000_000, 40_000_000])
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=next(free)))
    with pytest.raises(TrainingError, match=r"too little disk: 40 MB .* needs 50 MB"):
        run_of(saved, monkeypatch, [])
    assert read_checkpoint(saved.out, SMALL, saved.robot).segment == 1
